//! `host-sim faults`: flies a mission with a board while seeded schedules inject faults into its
//! ground link, and compares it with the same controller in this process. `cargo xtask firmware
//! faults` runs many of these missions.

use std::path::PathBuf;

use clap::Args;
use environment::Allocation;
use files::input;
use firmware_core::console::PolicyKind;
use host_sim::flight::{
    self, FlightSettings, Peer, RealTimeFactor,
    computer::{Campaign, Image, SLOTS_EACH, Twin, check_order, order},
};
use link::HostPort;
use scenario::{Events, ScenarioChoice};
use vehicle::{Profile, Vehicle};

use super::{Failure, board::GroundLink};

/// The options of `host-sim faults`.
#[derive(Debug, Args)]
pub(crate) struct FaultsArguments {
    #[command(flatten)]
    mission: ScenarioChoice,
    /// Address of the board: ground link at PORT, MAVLink at PORT + 1, console at PORT + 2
    #[arg(long, value_name = "HOST:PORT")]
    board: HostPort,
    /// The .policy file (from `trainer convert`) that is in the board's flash memory, for the controller
    /// in this process
    #[arg(long, value_name = "FILE")]
    policy: PathBuf,
    /// Number of fault schedules; each lasts three slots, the last of which has no faults
    #[arg(long, default_value_t = 20)]
    schedules: u32,
    /// Authenticate the ground link with the key in this file (64 hexadecimal digits, mode 600), and
    /// inject forged, replayed, reflected and unauthenticated frames as well
    #[arg(long, value_name = "FILE")]
    ground_key: Option<PathBuf>,
    /// Seed of the schedules and the faults
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Flies with both controllers and prints the injected faults and the board's counters as a JSON
/// object.
pub(crate) fn execute(arguments: &FaultsArguments) -> Result<(), Failure> {
    let scenario = arguments.mission.load().map_err(Failure::bad_input)?;
    let schedules_max = scenario.mission.slots() / SLOTS_EACH;
    if arguments.schedules > schedules_max {
        return Err(Failure::bad_input(format!(
            "--schedules is {}, but a mission of {} slots has at most {schedules_max} schedules of \
             {SLOTS_EACH} slots",
            arguments.schedules,
            scenario.mission.slots()
        )));
    }
    let named = |error| Failure::bad_input(format!("{}: {error}", arguments.policy.display()));
    let policy = input::read(&arguments.policy).map_err(named)?;
    let GroundLink { vehicle, ground } = GroundLink::of(arguments.ground_key.as_deref())?;
    let settings = FlightSettings {
        ground_link: ground,
        policy: "in flash".into(),
        inner: Allocation::Exact,
        profile: Profile::Ideal,
        real_time_factor: RealTimeFactor::Max,
        seed: arguments.seed,
        symbols_per_slot: 1,
        ignores_errors: false,
        events: Events::default(),
    };
    check_order(&scenario).map_err(Failure::bad_input)?;
    let mut order = order(&scenario, settings.profile, PolicyKind::Trained);
    // Some schedules interrupt the link for longer than a mission allows.
    order.ground_patience = None;
    order.ground_link = vehicle;
    let twin = Twin::new(&order, Some(policy.into())).map_err(Failure::bad_input)?;
    let image = Image::connect(&arguments.board, &order).map_err(Failure::failed)?;
    let computers = (image, twin);
    let campaign = Campaign::new(computers, &order, arguments.schedules, arguments.seed);
    let mut campaign = campaign.map_err(Failure::bad_input)?;
    let vehicle = Vehicle::new(flight::vehicle_settings(&scenario, settings.profile));
    let peer = Peer::built_in(vehicle);
    flight::fly_with(&scenario, &mut campaign, &settings, peer, &mut ())
        .map_err(|failed| Failure::failed(failed.error))?;
    let tally = campaign.finish().map_err(Failure::failed)?;
    let text = serde_json::to_string(&tally).map_err(Failure::failed)?;
    println!("{text}");
    Ok(())
}

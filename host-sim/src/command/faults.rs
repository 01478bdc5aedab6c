//! `host-sim faults`: a mission with a board whose ground link is damaged by seeded schedules,
//! beside its twin in this process; `cargo xtask firmware faults` strings many of them together.

use std::path::PathBuf;

use clap::Args;
use environment::Allocation;
use files::input;
use firmware_core::console::PolicyKind;
use host_sim::flight::{
    self, FlightSettings, Pace, Peer,
    computer::{Campaign, Image, SLOTS_EACH, Twin, order},
};
use link::HostPort;
use scenario::{Events, ScenarioChoice};
use vehicle::{Profile, Vehicle};

use super::Failure;

/// What is flown, and with which faults.
#[derive(Debug, Args)]
pub(crate) struct FaultsArguments {
    #[command(flatten)]
    mission: ScenarioChoice,
    /// The board: its ground link is at PORT, MAVLink at PORT + 1 and the console at PORT + 2
    #[arg(long, value_name = "HOST:PORT")]
    board: HostPort,
    /// The policy in the board's flash, for its twin: as `trainer convert` writes it
    #[arg(long, value_name = "FILE")]
    policy: PathBuf,
    /// Fault schedules, of three slots each, the last of them clean
    #[arg(long, default_value_t = 20)]
    schedules: u32,
    /// Of the schedules and the damage
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Flies both; prints what was injected and counted as a JSON object.
pub(crate) fn execute(arguments: &FaultsArguments) -> Result<(), Failure> {
    let scenario = arguments.mission.load().map_err(Failure::bad_input)?;
    let room = scenario.mission.slots() / SLOTS_EACH;
    if arguments.schedules > room {
        return Err(Failure::bad_input(format!(
            "--schedules {}: the mission has room for {room}, of {SLOTS_EACH} slots each",
            arguments.schedules
        )));
    }
    let named = |error| Failure::bad_input(format!("{}: {error}", arguments.policy.display()));
    let policy = input::read(&arguments.policy).map_err(named)?;
    let settings = FlightSettings {
        policy: "in flash".into(),
        inner: Allocation::Exact,
        profile: Profile::Ideal,
        pace: Pace::Max,
        seed: arguments.seed,
        symbols_per_slot: 1,
        events: Events::default(),
    };
    let mut order = order(&scenario, settings.profile, PolicyKind::Trained);
    // Schedules are silent for longer than a mission may be.
    order.ground_patience = None;
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

//! `host-sim upload`: plans the whole mission and uploads it to an autopilot.

use clap::{Args, ValueEnum};
use environment::Allocation;
use firmware_core::autopilot::mission::Ending;
use host_sim::{
    flight::{self, FlightSettings, Peer, RealTimeFactor},
    interrupt,
    policy::PolicyChoice,
    upload::{Upload, UploadProgress},
};
use indicatif::{ProgressBar, ProgressStyle};
use vehicle::{Profile, Vehicle};

use super::doctor::AutopilotArguments;
use super::{Failure, load_policy, load_scenario, terminal, warn_of_policy};

#[derive(Clone, Copy, Debug, ValueEnum)]
enum EndingChoice {
    /// Land at the last waypoint
    Land,
    /// Return to the place of take-off and land there
    Return,
}

/// The options of `host-sim upload`.
#[derive(Debug, Args)]
pub(crate) struct UploadArguments {
    #[command(flatten)]
    autopilot: AutopilotArguments,
    /// The policy that plans the waypoints: shipped, plan, straight-line, fixed, search, or a file
    #[arg(long, default_value = "straight-line")]
    policy: PolicyChoice,
    /// What the vehicle does after the last waypoint
    #[arg(long, value_enum, default_value = "land")]
    ending: EndingChoice,
    /// Start the mission after the upload: the motors are armed and the vehicle takes off
    #[arg(long)]
    start: bool,
    /// Follow the flight until the motors stop, then restore parameters; the exit code is 0 only if
    /// the last waypoint was reached
    #[arg(long, requires = "start")]
    watch: bool,
    /// Set the autopilot's parameters that limit the mission's speed. They STAY set, because the
    /// mission is flown after this command has ended; their former values are printed. They are
    /// restored if the upload fails, and with --watch after the flight
    #[arg(long)]
    set_params: bool,
}

/// The distance below which two waypoints count as the same, m.
const SAME_PLACE_M: f64 = 0.5;

/// Plans the mission with the ideal vehicle, uploads it, reads it back, and starts it if requested.
pub(crate) fn execute(arguments: &UploadArguments) -> Result<(), Failure> {
    let scenario = load_scenario(&arguments.autopilot.scenario)?;
    let (policy, policy_name) = load_policy(&arguments.policy, &scenario)?;
    warn_of_policy(&policy_name, policy.foreign_mission(&scenario).as_deref());
    let settings = FlightSettings {
        ground_link: None,
        policy: policy_name,
        inner: Allocation::Exact,
        profile: Profile::Ideal,
        real_time_factor: RealTimeFactor::Max,
        seed: 1,
        symbols_per_slot: 1,
        ignores_errors: false,
        events: scenario::Events::default(),
    };
    let vehicle = Vehicle::new(flight::vehicle_settings(&scenario, Profile::Ideal));
    let record = flight::fly(
        &scenario,
        policy,
        &settings,
        Peer::built_in(vehicle),
        &mut (),
    )
    .map_err(|failed| Failure::failed(format!("planning: {}", failed.error)))?;
    let mission = scenario.mission.parameters();
    let mut waypoints: Vec<_> = record.slots.iter().map(|slot| slot.planned).collect();
    // A position within one slot's reach of the destination counts as arrived in the paper.
    let last_m = waypoints
        .last()
        .map(|last| (mission.destination - last).norm());
    if last_m.is_none_or(|last_m| last_m > SAME_PLACE_M) {
        waypoints.push(mission.destination);
    }
    let (mut session, mut client) =
        arguments
            .autopilot
            .connect(&scenario, "upload", arguments.set_params)?;
    let upload = Upload {
        waypoints: &waypoints,
        speed_mps: mission.max_speed_mps,
        ending: match arguments.ending {
            EndingChoice::Land => Ending::Land,
            EndingChoice::Return => Ending::Return,
        },
        start: arguments.start,
        watch: arguments.watch,
        patience: arguments.autopilot.patience(),
    };
    let stop = interrupt::flag();
    let bar = transfer_bar()?;
    let outcome = upload.run(
        &mut session,
        &mut client,
        &stop,
        |progress| match progress {
            UploadProgress::Items { done, count } => {
                bar.set_length(count.into());
                bar.set_position(done.into());
            }
            UploadProgress::Note(words) => bar.suspend(|| eprintln!("note: {words}")),
        },
    );
    bar.finish_and_clear();
    session.flush()?;
    let items = outcome.map_err(Failure::failed)?;
    let begun = match (arguments.start, arguments.watch) {
        (_, true) => "; the mission was flown to its end",
        (true, false) => "; the mission was started",
        (false, false) => "",
    };
    println!("{items} mission items uploaded and read back{begun}");
    Ok(())
}

/// Creates the progress bar over the mission's items.
fn transfer_bar() -> Result<ProgressBar, Failure> {
    let style = ProgressStyle::with_template("item {pos}/{len} {wide_bar} {elapsed}")
        .map_err(Failure::failed)?;
    Ok(ProgressBar::with_draw_target(Some(0), terminal()).with_style(style))
}

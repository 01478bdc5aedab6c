//! `host-sim upload`: plans the whole mission and hands it to an autopilot.

use clap::{Args, ValueEnum};
use environment::Allocation;
use firmware_core::autopilot::mission::Ending;
use host_sim::{
    flight::{self, FlightSettings, Pace, Peer},
    interrupt,
    policy::PolicyChoice,
    upload::{Progress, Upload},
};
use indicatif::{ProgressBar, ProgressStyle};
use vehicle::{Profile, Vehicle};

use super::doctor::AutopilotArguments;
use super::{Failure, load_policy, load_scenario, terminal};

#[derive(Clone, Copy, Debug, ValueEnum)]
enum EndingChoice {
    Land,
    Return,
}

/// What to hand over, and to whom.
#[derive(Debug, Args)]
pub(crate) struct UploadArguments {
    #[command(flatten)]
    autopilot: AutopilotArguments,
    /// Who plans the way-points: straight-line, fixed, or a file
    #[arg(long, default_value = "straight-line")]
    policy: PolicyChoice,
    /// What follows the last way-point
    #[arg(long, value_enum, default_value = "land")]
    ending: EndingChoice,
    /// Fly it as soon as it is there: arms the motors and takes off
    #[arg(long)]
    start: bool,
    /// Follow the flight until the motors stop, with exit code 0 only if the last waypoint was
    /// reached, and put parameters back then
    #[arg(long, requires = "start")]
    watch: bool,
    /// Set the autopilot's parameters that clip the mission's speed. They STAY set, for the mission
    /// flies after this command has ended; what they were is printed. After a failed upload, and with
    /// --watch after the flight, they are put back
    #[arg(long)]
    set_params: bool,
}

/// Way-points that are nearer to each other are one, m.
const SAME_PLACE_M: f64 = 0.5;

/// Plans on the ideal vehicle, uploads, reads back, and starts if asked.
pub(crate) fn execute(arguments: &UploadArguments) -> Result<(), Failure> {
    let scenario = load_scenario(&arguments.autopilot.scenario)?;
    let (policy, policy_name) = load_policy(&arguments.policy, &scenario)?;
    let settings = FlightSettings {
        policy: policy_name,
        inner: Allocation::Exact,
        profile: Profile::Ideal,
        pace: Pace::Max,
        seed: 1,
        symbols_per_slot: 1,
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
    // The paper counts a place one more slot away as arrived.
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
            Progress::Items { done, count } => {
                bar.set_length(count.into());
                bar.set_position(done.into());
            }
            Progress::Note(words) => bar.suspend(|| eprintln!("note: {words}")),
        },
    );
    bar.finish_and_clear();
    session.flush()?;
    let items = outcome.map_err(Failure::failed)?;
    let begun = match (arguments.start, arguments.watch) {
        (_, true) => ", and flown to the end",
        (true, false) => ", and it flies",
        (false, false) => "",
    };
    println!("{items} mission items uploaded and read back{begun}");
    Ok(())
}

/// Over items, on a terminal.
fn transfer_bar() -> Result<ProgressBar, Failure> {
    let style = ProgressStyle::with_template("item {pos}/{len} {wide_bar} {elapsed}")
        .map_err(Failure::failed)?;
    Ok(ProgressBar::with_draw_target(Some(0), terminal()).with_style(style))
}

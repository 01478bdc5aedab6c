//! `host-sim run`: flies one mission and writes what came of it.

use std::{io::Write, path::PathBuf, str::FromStr};

use clap::Args;
use environment::Allocation;
use host_sim::{
    experiment::context,
    flight::{
        self, FailedFlight, FlightError, FlightSettings, Observer, Pace, Peer,
        board::{self, Board},
    },
    interrupt::Presses,
    journal::{self, ParameterJournal},
    policy::PolicyChoice,
    record::{FlightEvent, FlightNotes, FlightRecord, SlotRecord, Summary},
    report::{self, Look},
    world::SYMBOLS_PER_SLOT,
};
use indicatif::{ProgressBar, ProgressStyle};
use link::{LinkAddress, key, lossy::Impairment};
use scenario::{Scenario, ScenarioChoice};
use vehicle::{Profile, Vehicle};

use super::{
    Failure,
    board::{BoardChoice, OpenBoard, footprint_in_words},
    doctor::{OwnAddressArguments, parse_mps},
    load_policy, terminal,
};

/// How to fly.
#[derive(Debug, Args)]
pub(crate) struct RunArguments {
    #[command(flatten)]
    mission: ScenarioChoice,
    /// Who decides: shipped (the policy that was trained for a shipped scenario; plan for any other),
    /// plan (the onboard planner, for any mission), straight-line, fixed, search, or a file: .onnx
    /// or .policy (a trained policy), .csv or .plan (waypoints that were planned elsewhere)
    #[arg(long, default_value = "shipped")]
    policy: PolicyChoice,
    /// How the powers of a slot are chosen: exact, alternating (the paper's Alg. 1), or its
    /// comparison schemes fixed-user-power[:WATTS] and fixed-sensor-power[:WATTS] (without
    /// WATTS the scenario's largest power)
    #[arg(long, default_value = "exact", value_name = "METHOD")]
    inner: Allocation,
    /// Which vehicle: ideal, multirotor, arducopter or px4; without it ideal where it is built in,
    /// elsewhere what the autopilot's heartbeat says
    #[arg(long, value_parser = Profile::from_str)]
    profile: Option<Profile>,
    /// Where the vehicle is: builtin, udpout:HOST:PORT, udpin:HOST:PORT, tcpout:HOST:PORT or
    /// serial:DEVICE:BAUD
    #[arg(long, default_value = "builtin")]
    link: LinkAddress,
    /// A ground station beside, as often as needed: hears all that passes between the client and
    /// the vehicle; what it sends goes to the vehicle
    #[arg(long, value_name = "LINK")]
    also: Vec<LinkAddress>,
    /// Sign what is sent and take only what is signed, with the key in this file (64 hexadecimal
    /// digits or 32 bytes, mode 600)
    #[arg(long, value_name = "FILE")]
    signing_key: Option<PathBuf>,
    /// Set the autopilot's parameters that clip the mission's speed (host-sim doctor names them),
    /// and put them back at the end, however it ends
    #[arg(long)]
    set_params: bool,
    /// The speed that the airframe reaches, m/s: a mission that needs more is refused before
    /// take-off, and no trial leg is flown (with --set-params one shows it before the first slot)
    #[arg(long, value_name = "MPS", value_parser = parse_mps)]
    airframe_speed: Option<f64>,
    /// Make the link a bad one: loss=0.2,duplicate=0.05,reorder=0.05,corrupt=0.01,delay-ms=40,seed=3
    #[arg(long, value_name = "FAULTS", value_parser = Impairment::from_str)]
    impair: Option<Impairment>,
    #[command(flatten)]
    own: OwnAddressArguments,
    #[command(flatten)]
    board: BoardChoice,
    /// How fast time passes: so many seconds of flight a second, or max
    #[arg(long, default_value = "max", value_parser = parse_pace, value_name = "X|max")]
    speed: Pace,
    /// Of the symbols and the noise that are drawn
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Symbols drawn in each slot for the empirical MSE
    #[arg(long, default_value_t = SYMBOLS_PER_SLOT, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    symbols: u32,
    /// Where to write summary.json, slots.csv, report.html, the MAVLink log and, while parameters of
    /// the vehicle are changed, their journal
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// Print summary.json on standard output, and nothing else there
    #[arg(long)]
    json: bool,
}

fn parse_pace(text: &str) -> Result<Pace, String> {
    if text == "max" {
        return Ok(Pace::Max);
    }
    match text.parse::<f64>() {
        Ok(factor) if factor.is_finite() && (0.001..=1000.0).contains(&factor) => {
            Ok(Pace::Factor(factor))
        }
        _ => Err("must be a number from 0.001 to 1000, or max".into()),
    }
}

/// Flies, writes, prints.
pub(crate) fn execute(arguments: &RunArguments) -> Result<(), Failure> {
    let scenario = arguments.mission.load().map_err(Failure::bad_input)?;
    let allowed = arguments.inner.check(&scenario.mission);
    allowed.map_err(Failure::bad_input)?;
    if arguments.board.is_asked_for() {
        return fly_board(arguments, &scenario);
    }
    let (policy, policy_name) = load_policy(&arguments.policy, &scenario)?;
    if arguments.policy == PolicyChoice::Shipped && policy.provenance().is_none() {
        eprintln!("no trained policy is shipped for this mission: {policy_name} flies");
    }
    let policy_warning = policy.foreign_mission(&scenario);
    if let Some(warning) = &policy_warning {
        eprintln!("warning: {policy_name}: {warning}");
    }
    let (settings, peer, mut show) = prepare(arguments, &scenario, policy_name)?;
    let flown = flight::fly(&scenario, policy, &settings, peer, &mut show);
    show.bar.finish_and_clear();
    let flown = flown
        .map(|record| {
            let notes = FlightNotes {
                policy_warning: policy_warning.clone(),
                ideal_sum_rate: ideal_sum_rate(&record, arguments),
            };
            FlightRecord { notes, ..record }
        })
        .map_err(|mut failed| {
            if let Some(record) = &mut failed.record {
                record.notes.policy_warning = policy_warning;
            }
            failed
        });
    end(flown, arguments)
}

/// Flies the same policy with the ideal vehicle if the flight was with another one. The difference
/// of the totals is the loss due to the vehicle's dynamics and its links.
fn ideal_sum_rate(record: &FlightRecord, arguments: &RunArguments) -> Option<f64> {
    if record.profile == Profile::Ideal.name() {
        return None;
    }
    let ideal = context::fly(&record.scenario, &arguments.policy, arguments.inner).ok()?;
    Some(ideal.summary().sum_rate)
}

/// As [`execute`], with a board's controller.
fn fly_board(arguments: &RunArguments, scenario: &Scenario) -> Result<(), Failure> {
    if arguments.inner != Allocation::Exact
        || arguments.signing_key.is_some()
        || arguments.set_params
        || arguments.airframe_speed.is_some()
    {
        return Err(Failure::bad_input(
            "a board allocates by --inner exact, neither signs nor sets parameters, and flies what \
             it is told: --signing-key, --set-params and --airframe-speed are for --controller \
             in-process --precision f64",
        ));
    }
    let prepared = |policy_name| prepare(arguments, scenario, policy_name);
    if arguments.own.is_given() {
        return Err(Failure::bad_input(
            "a board speaks as the onboard computer of its vehicle: --system-id and \
             --component-id are for --controller in-process --precision f64",
        ));
    }
    if arguments.link != LinkAddress::Builtin && arguments.profile.is_none() {
        return Err(Failure::bad_input(
            "a board is told its vehicle's limits before it hears the vehicle: give --profile",
        ));
    }
    let chosen = (&arguments.policy, arguments.profile.unwrap_or_default());
    match arguments.board.open(scenario, chosen)? {
        OpenBoard::Image(mut image) => {
            let (settings, peer, mut show) = prepared("in flash".into())?;
            let flown = board::fly(scenario, &mut *image, &settings, peer, &mut show);
            show.bar.finish_and_clear();
            if let Ok(Some(footprint)) = image.footprint() {
                eprintln!("{}", footprint_in_words(&footprint));
            }
            end(flown, arguments)
        }
        OpenBoard::Twin(mut twin) => {
            let (settings, peer, mut show) = prepared(arguments.policy.to_string())?;
            let flown = board::fly(scenario, &mut *twin, &settings, peer, &mut show);
            show.bar.finish_and_clear();
            end(flown, arguments)
        }
    }
}

/// The folder, the vehicle, and what is shown meanwhile.
fn prepare(
    arguments: &RunArguments,
    scenario: &Scenario,
    policy: String,
) -> Result<(FlightSettings, Peer, Show), Failure> {
    report::prepare(&arguments.out)
        .map_err(|error| Failure::bad_input(format!("--out: {error}")))?;
    let settings = FlightSettings {
        policy,
        inner: arguments.inner,
        profile: arguments.profile.unwrap_or_default(),
        pace: arguments.speed,
        seed: arguments.seed,
        symbols_per_slot: arguments.symbols,
    };
    let peer = connect(arguments, scenario)?
        .log_to(&arguments.out.join("mavlink.tlog"))
        .map_err(|error| Failure::failed(format!("mavlink.tlog: {error}")))?;
    Ok((
        settings,
        peer,
        Show::new(scenario, shows_events(arguments))?,
    ))
}

/// Whether events are shown when they happen. The built-in vehicle without a pace flies a mission
/// in a moment, and its events are shown only where that fails.
fn shows_events(arguments: &RunArguments) -> bool {
    arguments.link != LinkAddress::Builtin || arguments.speed != Pace::Max
}

/// An event in a line.
fn line(event: &FlightEvent) -> String {
    format!("{:9.2} s  {}", event.time_s, event.text)
}

/// What came of a flight.
fn end(flown: Result<FlightRecord, FailedFlight>, arguments: &RunArguments) -> Result<(), Failure> {
    let failed = match flown {
        Ok(record) => return conclude(&record, arguments),
        Err(failed) => failed,
    };
    if let Some(record) = &failed.record {
        if !shows_events(arguments) {
            for event in &record.events {
                eprintln!("{}", line(event));
            }
        }
        // What was flown is worth a report, and the cause of its end more than an error there.
        if let Err(Failure::Failed(problem)) = write_report(record, arguments) {
            eprintln!("warning: {problem}");
        }
    }
    Err(match failed.error {
        error @ FlightError::Allocation(_) => Failure::bad_input(error),
        error @ FlightError::Ended { .. } => Failure::Interrupted(error.to_string()),
        error => Failure::failed(error),
    })
}

/// The vehicle: built in, or at the other end of `--link`.
fn connect(arguments: &RunArguments, scenario: &Scenario) -> Result<Peer, Failure> {
    let key = arguments.signing_key.as_deref().map(key::read).transpose();
    let key = key.map_err(Failure::bad_input)?;
    let open = |option: &str, address: &LinkAddress| {
        let failed = |error| Failure::failed(format!("{option} {address}: {error}"));
        address.open().map_err(failed)
    };
    let mut peer = if arguments.link == LinkAddress::Builtin {
        let mut vehicle = flight::vehicle_settings(scenario, arguments.profile.unwrap_or_default());
        vehicle.signing = key.clone().map(|key| (key, 0));
        Peer::built_in(Vehicle::new(vehicle))
    } else {
        eprintln!(
            "waiting for an autopilot at {}, {} s at most",
            arguments.link,
            flight::CONNECT_PATIENCE.as_secs_f64()
        );
        let file = arguments.out.join(journal::FILE_NAME);
        let journal = ParameterJournal::open(&file, &arguments.link.to_string());
        let journal = journal.map_err(Failure::bad_input)?;
        Peer::elsewhere(open("--link", &arguments.link)?).with_journal(journal)
    };
    peer = peer.spoken_to_as(arguments.own.address());
    if arguments.link != LinkAddress::Builtin && arguments.profile.is_none() {
        peer = peer.naming_profile();
    }
    for address in &arguments.also {
        peer = peer.beside(&address.to_string(), open("--also", address)?);
    }
    if let Some(key) = key {
        peer = peer.signed_with(key);
    }
    if let Some(impairment) = &arguments.impair {
        peer = peer.impaired(impairment);
    }
    if let Some(speed_mps) = arguments.airframe_speed {
        peer = peer.with_airframe_speed(speed_mps);
    }
    if arguments.set_params {
        peer = peer.with_parameters_set();
    }
    Ok(peer)
}

/// Writes the files and prints the summary.
fn write_report(record: &FlightRecord, arguments: &RunArguments) -> Result<Summary, Failure> {
    let out = &arguments.out;
    let summary: Summary = report::write(record, out)
        .map_err(|error| Failure::failed(format!("{}: {error}", out.display())))?;
    let mut stdout = std::io::stdout().lock();
    if arguments.json {
        let text = serde_json::to_string_pretty(&summary).map_err(Failure::failed)?;
        writeln!(stdout, "{text}")?;
    } else {
        if !record.slots.is_empty() {
            writeln!(
                stdout,
                "{}",
                report::table(record, &summary, Look::of_stdout())
            )?;
        }
        writeln!(stdout, "report: {}", out.join("report.html").display())?;
    }
    Ok(summary)
}

/// Writes the report of a mission that was flown to its end, and says whether it went as asked.
fn conclude(record: &FlightRecord, arguments: &RunArguments) -> Result<(), Failure> {
    let summary = write_report(record, arguments)?;
    if summary.mse_violations > 0 {
        eprintln!(
            "warning: the average was less accurate than asked in {} of {} slots",
            summary.mse_violations, summary.slots
        );
    }
    if summary.arrived && summary.fair && summary.constraint_violations == 0 {
        return Ok(());
    }
    Err(Failure::failed(format!(
        "flown to the end, but {}: {:.1} m from the destination, {} constraints broken; a vehicle \
         that is slower than the mission asks cannot do better: host-sim doctor names the \
         parameters, --set-params sets them for the flight",
        if summary.arrived {
            "not as asked"
        } else {
            "not arrived"
        },
        summary.arrival_distance_m,
        summary.constraint_violations
    )))
}

/// A progress bar over slots on a terminal, events above it, and ctrl-C.
struct Show {
    bar: ProgressBar,
    data: f64,
    /// Events are shown when they happen.
    events: bool,
    presses: Presses,
}

impl Show {
    fn new(scenario: &Scenario, events: bool) -> Result<Self, Failure> {
        let slots = u64::from(scenario.mission.slots());
        let bar = ProgressBar::with_draw_target(Some(slots), terminal()).with_style(
            ProgressStyle::with_template("slot {pos}/{len} {wide_bar} {msg} {elapsed}")
                .map_err(Failure::failed)?,
        );
        Ok(Self {
            bar,
            data: 0.0,
            events,
            presses: Presses::watch(),
        })
    }
}

impl Observer for Show {
    fn slot(&mut self, slot: &SlotRecord) {
        self.data += slot.rate;
        self.bar.set_message(format!(
            "user {} {:.3} bit/s/Hz, {:.2} in all",
            slot.user_name(),
            slot.rate,
            self.data
        ));
        self.bar.set_position(u64::from(slot.slot));
    }

    fn event(&mut self, event: &FlightEvent) {
        if self.events && event.notable {
            self.bar.suspend(|| eprintln!("{}", line(event)));
        }
        if self.bar.position() == 0 {
            self.bar.set_message(event.text.clone());
        }
    }

    fn waiting(&mut self, words: &str) {
        self.bar.suspend(|| eprintln!("{words}"));
    }

    fn duty(&mut self, words: &str) {
        self.bar.suspend(|| eprintln!("warning: {words}"));
    }

    fn note(&mut self, words: &str) {
        self.bar.suspend(|| eprintln!("note: {words}"));
    }

    fn wants_stop(&self) -> bool {
        self.presses.count() >= 1
    }

    fn wants_end(&self) -> bool {
        self.presses.count() >= 2
    }
}

//! `host-sim run`: flies one mission and writes its report.

use std::{
    io::Write,
    path::{Path, PathBuf},
    str::FromStr,
};

use clap::Args;
use environment::Allocation;
use host_sim::{
    benchmark::{BOUNDS_FILE, Bounds},
    experiment::context,
    flight::{
        self, ClientSettings, FailedFlight, FlightError, FlightSettings, Observer, Pace, Peer,
        computer::{InProcess, OnboardComputer},
    },
    interrupt::Presses,
    journal::{self, ParameterJournal},
    policy::PolicyChoice,
    record::{CertifiedBound, FlightEvent, FlightNotes, FlightRecord, SlotRecord, Summary},
    report::{self, Look},
    world::SYMBOLS_PER_SLOT,
};
use indicatif::{ProgressBar, ProgressStyle};
use link::{LinkAddress, key, lossy::Impairment};
use planning::bound::BoundSettings;
use scenario::{Events, Scenario, ScenarioChoice};
use vehicle::{Profile, Vehicle};

use super::{
    Failure,
    board::{BoardChoice, OpenBoard, footprint_line},
    bound::certify_watched,
    doctor::{OwnAddressArguments, parse_mps},
    load_policy, terminal,
};

/// The options of `host-sim run`.
#[derive(Debug, Args)]
pub(crate) struct RunArguments {
    #[command(flatten)]
    mission: ScenarioChoice,
    /// The policy: shipped (the policy that was trained for a shipped scenario, plan for any other
    /// scenario), plan (the onboard planner), straight-line, fixed, search, or a file: .onnx or
    /// .policy (a trained policy), .csv or .plan (planned waypoints)
    #[arg(long, default_value = "shipped")]
    policy: PolicyChoice,
    /// How the powers of a slot are allocated: exact, alternating (the paper's Alg. 1), or one of the
    /// paper's comparison schemes, fixed-user-power[:WATTS] and fixed-sensor-power[:WATTS] (default
    /// of WATTS: the scenario's largest power)
    #[arg(long, default_value = "exact", value_name = "METHOD")]
    inner: Allocation,
    /// The vehicle profile: ideal, multirotor, arducopter or px4 [default: ideal for the built-in
    /// vehicle, otherwise according to the autopilot's heartbeat]
    #[arg(long, value_parser = Profile::from_str)]
    profile: Option<Profile>,
    /// The MAVLink link to the vehicle: builtin (the built-in vehicle in this process),
    /// udpout:HOST:PORT, udpin:HOST:PORT, tcpout:HOST:PORT or serial:DEVICE:BAUD
    #[arg(long, default_value = "builtin")]
    link: LinkAddress,
    /// The link to an additional ground station; may be given several times. The ground station
    /// receives all messages between the client and the vehicle, and its messages are forwarded to
    /// the vehicle
    #[arg(long, value_name = "LINK")]
    also: Vec<LinkAddress>,
    /// Sign all sent messages with the key in this file (64 hexadecimal digits or 32 bytes, mode
    /// 600), and accept only messages with a valid signature
    #[arg(long, value_name = "FILE")]
    signing_key: Option<PathBuf>,
    /// Set the autopilot's parameters that limit the mission's speed (host-sim doctor lists them) for
    /// the flight, and restore them when it ends for any reason
    #[arg(long)]
    set_params: bool,
    /// Highest speed of the airframe in m/s. A mission that needs a higher speed is refused before
    /// take-off. Without this option, --set-params makes the vehicle fly a trial leg before the first
    /// slot to measure the speed
    #[arg(long, value_name = "MPS", value_parser = parse_mps)]
    airframe_speed: Option<f64>,
    /// Inject faults into the link, for example
    /// loss=0.2,duplicate=0.05,reorder=0.05,corrupt=0.01,delay-ms=40,seed=3
    #[arg(long, value_name = "FAULTS", value_parser = Impairment::from_str)]
    impair: Option<Impairment>,
    #[command(flatten)]
    own: OwnAddressArguments,
    #[command(flatten)]
    board: BoardChoice,
    /// Simulation speed relative to real time, or max for as fast as possible
    #[arg(long, default_value = "max", value_parser = parse_pace, value_name = "X|max")]
    speed: Pace,
    /// Seed of the random symbols and the noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Changes of the mission in flight: a TOML file (docs/formats.md) with users and sensors that
    /// move, join or leave, and new values of the threshold, noise, speed limit or number of slots,
    /// each from a slot on
    #[arg(long, value_name = "FILE")]
    events: Option<PathBuf>,
    /// Compare the total with the certified upper bound of the mission, as host-sim bound computes
    /// it (up to two minutes), or from a bounds.csv beside the scenario file that has this mission
    #[arg(long, conflicts_with = "events")]
    bound: bool,
    /// Number of symbols that are transmitted in each slot to measure the MSE
    #[arg(long, default_value_t = SYMBOLS_PER_SLOT, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    symbols: u32,
    /// Output directory for summary.json, slots.csv, report.html, the MAVLink log and, while
    /// parameters of the vehicle are changed, their journal
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// Print only the contents of summary.json on standard output
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

/// Flies the mission, writes the report and prints the summary.
pub(crate) fn execute(arguments: &RunArguments) -> Result<(), Failure> {
    let scenario = arguments.mission.load().map_err(Failure::bad_input)?;
    let allowed = arguments.inner.check(&scenario.mission);
    allowed.map_err(Failure::bad_input)?;
    if arguments.board.is_selected() {
        return fly_board(arguments, &scenario);
    }
    let (policy, policy_name) = load_policy(&arguments.policy, &scenario)?;
    if arguments.policy == PolicyChoice::Shipped && policy.provenance().is_none() {
        eprintln!(
            "no trained policy is shipped for this mission; flying with --policy {policy_name}"
        );
    }
    let policy_warning = policy.foreign_mission(&scenario);
    if let Some(warning) = &policy_warning {
        eprintln!("warning: {policy_name}: {warning}");
    }
    let (prepared, client) = prepare(arguments, &scenario, policy_name)?;
    let computer = InProcess::new(
        &scenario,
        policy,
        &prepared.settings,
        client,
        &prepared.peer,
    );
    let mut flown = match computer {
        Ok(mut computer) => fly(&scenario, &mut computer, prepared),
        Err(error) => Err(error.into()),
    };
    match &mut flown {
        Ok(record) => {
            record.notes = FlightNotes {
                policy_warning,
                ideal_sum_rate: ideal_sum_rate(record, arguments),
                certified_bound: None,
            };
        }
        Err(failed) => {
            if let Some(record) = &mut failed.record {
                record.notes.policy_warning = policy_warning;
            }
        }
    }
    end(flown, arguments)
}

/// Returns the certified bound of a mission if it was asked for: from the `bounds.csv` beside the
/// scenario file, which is looked up by the digest of the mission, or else computed now.
fn certified_bound(scenario: &Scenario, arguments: &RunArguments) -> Option<CertifiedBound> {
    if !arguments.bound {
        return None;
    }
    let folder = arguments.mission.scenario.parent()?;
    let folder = match folder.as_os_str().is_empty() {
        true => Path::new("."),
        false => folder,
    };
    let known = Bounds::read(folder).unwrap_or_else(|problem| {
        eprintln!("warning: {problem}");
        Bounds::default()
    });
    if let Some(record) = known.of(&scenario.digest()) {
        return Some(CertifiedBound {
            upper: record.upper,
            file: Some(folder.join(BOUNDS_FILE).display().to_string()),
        });
    }
    match certify_watched(scenario, &BoundSettings::default(), None) {
        Ok(bound) => Some(CertifiedBound {
            upper: bound.upper,
            file: None,
        }),
        Err(problem) => {
            eprintln!("warning: no certified bound: {problem}");
            None
        }
    }
}

/// Flies the same policy with the ideal vehicle if the flight was with another one. The difference
/// of the totals is the loss due to the vehicle's dynamics and its links.
fn ideal_sum_rate(record: &FlightRecord, arguments: &RunArguments) -> Option<f64> {
    if record.profile == Profile::Ideal.name() {
        return None;
    }
    let (policy, inner) = (&arguments.policy, arguments.inner);
    let ideal = context::fly(&record.scenario, &record.changes, policy, inner).ok()?;
    Some(ideal.summary().sum_rate)
}

/// Like [`execute`], with the controller of a board.
fn fly_board(arguments: &RunArguments, scenario: &Scenario) -> Result<(), Failure> {
    if arguments.inner != Allocation::Exact
        || arguments.signing_key.is_some()
        || arguments.set_params
        || arguments.airframe_speed.is_some()
    {
        return Err(Failure::bad_input(
            "a board supports only --inner exact, and neither signs messages nor sets parameters: \
             --signing-key, --set-params and --airframe-speed need --controller in-process \
             --precision f64",
        ));
    }
    if arguments.own.is_given() {
        return Err(Failure::bad_input(
            "a board always uses the MAVLink address of an onboard computer: --system-id and \
             --component-id need --controller in-process --precision f64",
        ));
    }
    if arguments.link != LinkAddress::Builtin && arguments.profile.is_none() {
        return Err(Failure::bad_input(
            "a board needs the limits of its vehicle before it connects to the vehicle: --profile \
             must be given",
        ));
    }
    let chosen = (&arguments.policy, arguments.profile.unwrap_or_default());
    match arguments.board.open(scenario, chosen)? {
        OpenBoard::Image(mut image) => {
            let (prepared, _) = prepare(arguments, scenario, "in flash".into())?;
            end(fly(scenario, &mut *image, prepared), arguments)
        }
        OpenBoard::Twin(mut twin) => {
            let (prepared, _) = prepare(arguments, scenario, arguments.policy.to_string())?;
            end(fly(scenario, &mut *twin, prepared), arguments)
        }
    }
}

/// What every computer needs for a flight.
struct Prepared {
    settings: FlightSettings,
    peer: Peer,
    show: Show,
}

/// The folder, the vehicle, and what is shown meanwhile.
fn prepare(
    arguments: &RunArguments,
    scenario: &Scenario,
    policy: String,
) -> Result<(Prepared, ClientSettings), Failure> {
    report::prepare(&arguments.out)
        .map_err(|error| Failure::bad_input(format!("--out: {error}")))?;
    let settings = FlightSettings {
        policy,
        inner: arguments.inner,
        profile: arguments.profile.unwrap_or_default(),
        pace: arguments.speed,
        seed: arguments.seed,
        symbols_per_slot: arguments.symbols,
        events: match &arguments.events {
            Some(path) => Events::load(path, &scenario.mission).map_err(Failure::bad_input)?,
            None => Events::default(),
        },
    };
    let (peer, client) = connect(arguments, scenario)?;
    let peer = peer
        .log_to(&arguments.out.join("mavlink.tlog"))
        .map_err(|error| Failure::failed(format!("mavlink.tlog: {error}")))?;
    let show = Show::new(scenario, shows_events(arguments))?;
    let prepared = Prepared {
        settings,
        peer,
        show,
    };
    Ok((prepared, client))
}

/// Flies with any computer, and writes and prints what came of it.
fn fly(
    scenario: &Scenario,
    computer: &mut impl OnboardComputer,
    prepared: Prepared,
) -> Result<FlightRecord, FailedFlight> {
    let Prepared {
        settings,
        peer,
        mut show,
    } = prepared;
    let flown = flight::fly_with(scenario, computer, &settings, peer, &mut show);
    show.bar.finish_and_clear();
    if let Ok(Some(footprint)) = computer.footprint() {
        eprintln!("{}", footprint_line(&footprint));
    }
    flown
}

/// Returns whether events are displayed when they happen. With the built-in vehicle at full speed a
/// mission takes only a moment, and its events are displayed only if the flight fails.
fn shows_events(arguments: &RunArguments) -> bool {
    arguments.link != LinkAddress::Builtin || arguments.speed != Pace::Max
}

/// Formats an event as one line.
fn line(event: &FlightEvent) -> String {
    format!("{:9.2} s  {}", event.time_s, event.text)
}

/// Writes the report of a flight that was completed or failed, and returns its error.
fn end(flown: Result<FlightRecord, FailedFlight>, arguments: &RunArguments) -> Result<(), Failure> {
    let failed = match flown {
        Ok(mut record) => {
            record.notes.certified_bound = certified_bound(&record.scenario, arguments);
            return conclude(&record, arguments);
        }
        Err(failed) => failed,
    };
    if let Some(record) = &failed.record {
        if !shows_events(arguments) {
            for event in &record.events {
                eprintln!("{}", line(event));
            }
        }
        // A failed flight is reported as well; its cause matters more than an error in writing the
        // report.
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

/// The vehicle, built in or at the other end of `--link`, and what the client in this process may do
/// with it.
fn connect(
    arguments: &RunArguments,
    scenario: &Scenario,
) -> Result<(Peer, ClientSettings), Failure> {
    let key = arguments.signing_key.as_deref().map(key::read).transpose();
    let key = key.map_err(Failure::bad_input)?;
    let open = |option: &str, address: &LinkAddress| {
        let failed = |error| Failure::failed(format!("{option} {address}: {error}"));
        address.open().map_err(failed)
    };
    let mut client = ClientSettings::default().spoken_to_as(arguments.own.address());
    let mut peer = if arguments.link == LinkAddress::Builtin {
        let mut vehicle = flight::vehicle_settings(scenario, arguments.profile.unwrap_or_default());
        vehicle.signing = key.clone().map(|key| (key, 0));
        Peer::built_in(Vehicle::new(vehicle))
    } else {
        eprintln!(
            "waiting at most {1} s for an autopilot at {0}",
            arguments.link,
            flight::CONNECT_PATIENCE.as_secs_f64()
        );
        let file = arguments.out.join(journal::FILE_NAME);
        let journal = ParameterJournal::open(&file, &arguments.link.to_string());
        client = client.with_journal(journal.map_err(Failure::bad_input)?);
        Peer::elsewhere(open("--link", &arguments.link)?)
    };
    if arguments.link != LinkAddress::Builtin && arguments.profile.is_none() {
        client = client.naming_profile();
    }
    for address in &arguments.also {
        peer = peer.beside(&address.to_string(), open("--also", address)?);
    }
    if let Some(key) = key {
        client = client.signed_with(key);
    }
    if let Some(impairment) = &arguments.impair {
        peer = peer.impaired(impairment);
    }
    if let Some(speed_mps) = arguments.airframe_speed {
        client = client.with_airframe_speed(speed_mps);
    }
    if arguments.set_params {
        client = client.with_parameters_set();
    }
    Ok((peer, client))
}

/// Writes the report's files and prints the summary.
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

/// Writes the report of a completed mission. Fails if the vehicle did not arrive or a constraint was
/// violated.
fn conclude(record: &FlightRecord, arguments: &RunArguments) -> Result<(), Failure> {
    let summary = write_report(record, arguments)?;
    if summary.mse_violations > 0 {
        eprintln!(
            "warning: the MSE exceeded the threshold in {} of {} slots",
            summary.mse_violations, summary.slots
        );
    }
    if summary.arrived && summary.fair && summary.constraint_violations == 0 {
        return Ok(());
    }
    Err(Failure::failed(format!(
        "the mission was flown to its last slot, but {}: {:.1} m from the destination, {} constraint \
         violations; if the vehicle is slower than the mission requires, host-sim doctor lists the \
         parameters that limit it, and --set-params sets them for the flight",
        if summary.arrived {
            "violates its constraints"
        } else {
            "did not reach the destination"
        },
        summary.arrival_distance_m,
        summary.constraint_violations
    )))
}

/// Displays a progress bar over the slots and the events above it, and watches for Ctrl-C.
struct Show {
    bar: ProgressBar,
    data: f64,
    /// Whether events are displayed when they happen.
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
            "user {} {:.3} bit/s/Hz, sum {:.2}",
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

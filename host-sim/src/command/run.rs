//! `host-sim run`: flies one mission and writes its report.

mod certified;
mod ending;
mod progress;

use std::{
    path::{Path, PathBuf},
    str::FromStr,
};

use clap::Args;
use environment::Allocation;
use firmware_core::{
    autopilot::wire::signing::{LinkSigning, SigningState},
    link::Credentials,
};
use host_sim::{
    experiment::ideal_flight,
    flight::{
        self, ClientSettings, FailedFlight, FlightSettings, Peer, RealTimeFactor,
        computer::{InProcess, OnboardComputer},
    },
    journal::{self, ParameterJournal},
    policy::PolicyChoice,
    record::FlightRecord,
    report,
    signing::SigningUpkeep,
    world::SYMBOLS_PER_SLOT,
};
use link::{LinkAddress, lossy::Impairment, tlog};
use scenario::{Events, Scenario, ScenarioChoice};
use vehicle::{Profile, Vehicle};

use super::{
    Failure,
    board::{BoardChoice, BoardKeys, GroundLink, OpenBoard, footprint_line},
    doctor::{OwnAddressArguments, parse_mps},
    load_policy,
    signing::SigningArguments,
    warn_of_policy,
};
use certified::certified_bound;
use ending::OutputArguments;
use progress::Progress;

/// The options of `host-sim run`.
#[derive(Debug, Args)]
pub(crate) struct RunArguments {
    #[command(flatten)]
    mission: ScenarioChoice,
    /// The policy: shipped (the policy that was trained for a shipped scenario, plan for any other
    /// scenario), plan (the onboard planner), plan-once[:SECONDS] (its plan from before take-off, made
    /// within this time, and not improved in flight), any (the shipped policy that was trained for any
    /// mission), straight-line, fixed, search, a file: .onnx or .policy (a trained policy), .csv or
    /// .plan (planned waypoints), or a directory of .onnx files, one of which was trained for the
    /// mission
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
    #[command(flatten)]
    signing: SigningArguments,
    /// Authenticate the ground link between the ground and the onboard computer with the key in this
    /// file (64 hexadecimal digits, mode 600): see docs/security.md
    #[arg(long, value_name = "FILE")]
    ground_key: Option<PathBuf>,
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
    #[arg(long, default_value = "max", value_parser = parse_real_time_factor, value_name = "X|max")]
    speed: RealTimeFactor,
    /// Seed of the random symbols and the noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Changes of the mission in flight: a TOML file (docs/formats.md) with users and sensors that
    /// move, join or leave, and new values of the threshold, noise, speed limit or number of slots,
    /// each from a slot on
    #[arg(long, value_name = "FILE")]
    events: Option<PathBuf>,
    /// Do not tell the vehicle how good its channel estimates are (the scenario's [uncertainty]): it
    /// takes them for exact
    #[arg(long)]
    ignore_errors: bool,
    /// Compare the total with the certified upper bound of the mission, as host-sim bound computes
    /// it (which can take minutes), or from a bounds.csv beside the scenario file that has this mission
    #[arg(long, conflicts_with = "events")]
    bound: bool,
    /// Number of symbols that are transmitted in each slot to measure the MSE
    #[arg(long, default_value_t = SYMBOLS_PER_SLOT, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    symbols: u32,
    #[command(flatten)]
    output: OutputArguments,
}

fn parse_real_time_factor(text: &str) -> Result<RealTimeFactor, String> {
    if text == "max" {
        return Ok(RealTimeFactor::Max);
    }
    match text.parse::<f64>() {
        Ok(factor) if factor.is_finite() && (0.001..=1000.0).contains(&factor) => {
            Ok(RealTimeFactor::Factor(factor))
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
    let GroundLink { vehicle, ground } = GroundLink::of(arguments.ground_key.as_deref())?;
    let (policy, policy_name) = load_policy(&arguments.policy, &scenario)?;
    if arguments.policy == PolicyChoice::Shipped && policy.provenance().is_none() {
        eprintln!(
            "no trained policy is shipped for this mission; flying with --policy {policy_name}"
        );
    }
    let policy_warning = policy.foreign_mission(&scenario);
    warn_of_policy(&policy_name, policy_warning.as_deref());
    let (mut prepared, mut client) = prepare(arguments, &scenario, policy_name)?;
    prepared.settings.ground_link = ground;
    if let Some(credentials) = vehicle {
        client = client.with_ground_link(credentials);
    }
    let computer = InProcess::new(
        &scenario,
        policy,
        &prepared.settings,
        client,
        &prepared.peer,
    );
    let mut flown = match computer {
        Ok(mut computer) => fly(&scenario, &mut computer, prepared, policy_warning),
        Err(error) => Err(error.into()),
    };
    if let Ok(record) = &mut flown {
        record.notes.ideal_sum_rate = ideal_sum_rate(record, arguments);
    }
    end(flown, arguments)
}

/// Flies the same policy with the ideal vehicle if the flight was with another one. The difference
/// of the totals is the loss due to the vehicle's dynamics and its links.
fn ideal_sum_rate(record: &FlightRecord, arguments: &RunArguments) -> Option<f64> {
    if Profile::from_str(&record.profile).is_ok_and(Profile::is_ideal) {
        return None;
    }
    let (policy, inner) = (&arguments.policy, arguments.inner);
    let ideal = ideal_flight::fly(&record.scenario, &record.changes, policy, inner).ok()?;
    Some(ideal.summary().sum_rate)
}

/// Like [`execute`], with the controller of a board.
fn fly_board(arguments: &RunArguments, scenario: &Scenario) -> Result<(), Failure> {
    if arguments.inner != Allocation::Exact
        || arguments.set_params
        || arguments.airframe_speed.is_some()
    {
        return Err(Failure::bad_input(
            "a board supports only --inner exact, and sets no parameters: --set-params and \
             --airframe-speed need --controller in-process --precision f64",
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
    let GroundLink { vehicle, ground } = GroundLink::of(arguments.ground_key.as_deref())?;
    let (signing, mut upkeep) = signing(arguments)?.unzip();
    let keys = BoardKeys {
        ground_link: vehicle.as_ref(),
        mavlink: signing.as_ref(),
    };
    let flown = (arguments, scenario, ground);
    let flown = match arguments.board.open(scenario, chosen, keys)? {
        OpenBoard::Image(mut image) => {
            fly_ordered(flown, (&mut *image, upkeep.as_mut()), "in flash".into())
        }
        OpenBoard::Twin(mut twin) => {
            let policy = arguments.policy.to_string();
            fly_ordered(flown, (&mut *twin, upkeep.as_mut()), policy)
        }
    };
    let saved = upkeep.map_or(Ok(()), SigningUpkeep::finish);
    flown.and(saved.map_err(Failure::failed))
}

/// Flies with a controller that has its mission order.
fn fly_ordered(
    (arguments, scenario, ground): (&RunArguments, &Scenario, Option<Credentials>),
    (computer, upkeep): (&mut impl OnboardComputer, Option<&mut SigningUpkeep>),
    policy: String,
) -> Result<(), Failure> {
    let trained_for = computer.scenario_digest();
    let policy_warning = trained_for.and_then(|digest| scenario.foreign_policy(digest));
    warn_of_policy(&policy, policy_warning.as_deref());
    let (mut prepared, _) = prepare(arguments, scenario, policy)?;
    prepared.settings.ground_link = ground;
    let flown = fly(scenario, computer, prepared, policy_warning);
    // A board keeps nothing over a reset: its state is saved here, for its next order.
    if let Some(upkeep) = upkeep {
        let state = computer.signing_state().map_err(Failure::failed)?;
        upkeep.note(|| state);
    }
    end(flown, arguments)
}

/// What every computer needs for a flight.
struct Prepared {
    settings: FlightSettings,
    peer: Peer,
    progress: Progress,
}

/// Prepares the output directory, the vehicle and the progress display.
fn prepare(
    arguments: &RunArguments,
    scenario: &Scenario,
    policy: String,
) -> Result<(Prepared, ClientSettings), Failure> {
    arguments.output.check_mcap()?;
    report::prepare(&arguments.output.out)
        .map_err(|error| Failure::bad_input(format!("--out: {error}")))?;
    let settings = FlightSettings {
        ground_link: None,
        policy,
        inner: arguments.inner,
        profile: arguments.profile.unwrap_or_default(),
        real_time_factor: arguments.speed,
        seed: arguments.seed,
        symbols_per_slot: arguments.symbols,
        ignores_errors: arguments.ignore_errors,
        events: match &arguments.events {
            Some(path) => Events::load(path, &scenario.mission).map_err(Failure::bad_input)?,
            None => Events::default(),
        },
    };
    (scenario.with_motion(&settings.events)).map_err(|problem| {
        let file = arguments.events.as_deref().unwrap_or(Path::new("--events"));
        Failure::bad_input(format!("{}: {problem}", file.display()))
    })?;
    let (peer, client) = connect(arguments, scenario)?;
    let peer = peer
        .log_to(&arguments.output.out.join("mavlink.tlog"))
        .map_err(|error| Failure::failed(format!("mavlink.tlog: {error}")))?;
    let progress = Progress::new(scenario, shows_events(arguments))?;
    let prepared = Prepared {
        settings,
        peer,
        progress,
    };
    Ok((prepared, client))
}

/// Flies with any computer. The record has the warning about the policy, also if the flight fails.
fn fly(
    scenario: &Scenario,
    computer: &mut impl OnboardComputer,
    prepared: Prepared,
    policy_warning: Option<String>,
) -> Result<FlightRecord, FailedFlight> {
    let Prepared {
        settings,
        peer,
        mut progress,
    } = prepared;
    let mut flown = flight::fly_with(scenario, computer, &settings, peer, &mut progress);
    progress.clear();
    if let Ok(Some(footprint)) = computer.footprint() {
        eprintln!("{}", footprint_line(&footprint));
    }
    let record = match &mut flown {
        Ok(record) => Some(record),
        Err(failed) => failed.record.as_deref_mut(),
    };
    if let Some(record) = record {
        record.notes.policy_warning = policy_warning;
    }
    flown
}

/// Reports the flight. Events that were not displayed when they happened are displayed now if it
/// failed.
fn end(
    mut flown: Result<FlightRecord, FailedFlight>,
    arguments: &RunArguments,
) -> Result<(), Failure> {
    if let Ok(record) = &mut flown
        && arguments.bound
    {
        let file = &arguments.mission.scenario;
        record.notes.certified_bound = certified_bound(&record.scenario, file);
    }
    ending::report(flown, &arguments.output, !shows_events(arguments))
}

/// Returns whether events are displayed when they happen. With the built-in vehicle at full speed a
/// mission takes only a moment, and its events are displayed only if the flight fails.
fn shows_events(arguments: &RunArguments) -> bool {
    arguments.link != LinkAddress::Builtin || arguments.speed != RealTimeFactor::Max
}

/// Reads the key and the state of our own signatures.
fn signing(arguments: &RunArguments) -> Result<Option<(LinkSigning, SigningUpkeep)>, Failure> {
    let date_us = match arguments.link {
        LinkAddress::Builtin => tlog::SIMULATED_EPOCH_US,
        _ => tlog::wall_clock_us(),
    };
    arguments.signing.load(1, date_us)
}

/// Creates the built-in vehicle or opens `--link`, and returns it with the settings of the client in
/// this process.
fn connect(
    arguments: &RunArguments,
    scenario: &Scenario,
) -> Result<(Peer, ClientSettings), Failure> {
    let signing = signing(arguments)?;
    let open = |option: &str, address: &LinkAddress| {
        let failed = |error| Failure::failed(format!("{option} {address}: {error}"));
        address.open().map_err(failed)
    };
    let mut client = ClientSettings::default().with_address(arguments.own.address());
    let mut peer = if arguments.link == LinkAddress::Builtin {
        let mut vehicle = flight::vehicle_settings(scenario, arguments.profile.unwrap_or_default());
        vehicle.signing = signing.as_ref().map(|(signing, _)| LinkSigning {
            link: 0,
            state: SigningState::default(),
            ..signing.clone()
        });
        Peer::built_in(Vehicle::new(vehicle))
    } else {
        eprintln!(
            "waiting at most {1} s for an autopilot at {0}",
            arguments.link,
            flight::CONNECT_PATIENCE.as_secs_f64()
        );
        let file = arguments.output.out.join(journal::FILE_NAME);
        let journal = ParameterJournal::open(&file, &arguments.link.to_string());
        client = client.with_journal(journal.map_err(Failure::bad_input)?);
        Peer::external(open("--link", &arguments.link)?)
    };
    if arguments.link != LinkAddress::Builtin && arguments.profile.is_none() {
        client = client.with_profile_from_heartbeat();
    }
    for address in &arguments.also {
        peer = peer.with_ground_station(&address.to_string(), open("--also", address)?);
    }
    if let Some((signing, upkeep)) = signing
        && !arguments.board.is_selected()
    {
        client = client.signed_with(signing, upkeep);
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

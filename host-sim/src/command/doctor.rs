//! `host-sim doctor`: reports whether a mission could be flown with an autopilot, and how well,
//! without moving the vehicle.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::Args;
use firmware_core::autopilot::{Autopilot, AutopilotSettings, Event, OwnAddress};
use firmware_core::time::Duration;
use host_sim::{
    doctor,
    flight::{self, ProfileChoice},
    interrupt,
    journal::{self, ParameterJournal},
    policy::PolicyChoice,
    session::Session,
};
use link::{
    Link, LinkAddress, Port,
    lossy::{Impaired, Impairment},
    tlog::{TlogWriter, wall_clock_us},
};
use scenario::Scenario;
use vehicle::Profile;

use super::signing::KeyArguments;
use super::{Failure, load_policy, load_scenario};

/// The options for the connection to an autopilot.
#[derive(Debug, Args)]
pub(crate) struct AutopilotArguments {
    /// The MAVLink link to the autopilot: udpout:HOST:PORT, udpin:HOST:PORT, tcpout:HOST:PORT or
    /// serial:DEVICE:BAUD
    #[arg(long)]
    link: LinkAddress,
    /// Simulation speed of the autopilot relative to real time; 1 for a real autopilot
    #[arg(long, default_value_t = 1.0, value_parser = parse_speed, value_name = "X")]
    speed: f64,
    /// The vehicle profile, which sets the limits for planning: ideal, multirotor, arducopter or px4
    /// [default: according to the autopilot's heartbeat]
    #[arg(long, value_parser = Profile::from_str)]
    profile: Option<Profile>,
    /// Highest speed of the airframe in m/s, if it is known
    #[arg(long, value_name = "MPS", value_parser = parse_mps)]
    airframe_speed: Option<f64>,
    #[command(flatten)]
    own: OwnAddressArguments,
    /// The scenario: a TOML file, or the name of a shipped scenario
    #[arg(long, default_value = "separated", value_name = "FILE")]
    pub(super) scenario: PathBuf,
    #[command(flatten)]
    signing: KeyArguments,
    /// Inject faults into the link, for example
    /// loss=0.2,duplicate=0.05,reorder=0.05,corrupt=0.01,delay-ms=40,seed=3
    #[arg(long, value_name = "FAULTS", value_parser = Impairment::from_str)]
    impair: Option<Impairment>,
    /// File for the MAVLink log [default: out/doctor.tlog or out/upload.tlog]
    #[arg(long, value_name = "FILE")]
    tlog: Option<PathBuf>,
    /// Longest time to wait for the autopilot to become ready, in seconds of its time
    #[arg(long, default_value_t = 60, value_name = "S", value_parser = clap::value_parser!(u64).range(1..=3600))]
    patience: u64,
}

/// The MAVLink address of this program.
#[derive(Clone, Copy, Debug, Args)]
pub(crate) struct OwnAddressArguments {
    /// MAVLink system id of this program [default: that of the vehicle]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..))]
    system_id: Option<u8>,
    /// MAVLink component id of this program [default: 191, onboard computer]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(2..))]
    component_id: Option<u8>,
}

impl OwnAddressArguments {
    /// Returns whether an id was given.
    pub(super) fn is_given(&self) -> bool {
        self.system_id.or(self.component_id).is_some()
    }

    /// Returns the address.
    pub(super) fn address(&self) -> OwnAddress {
        let usual = OwnAddress::ONBOARD_COMPUTER;
        OwnAddress {
            system: self.system_id,
            component: self.component_id.unwrap_or(usual.component),
        }
    }
}

/// Parses a speed in m/s.
pub(super) fn parse_mps(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|mps| (0.1..=1000.0).contains(mps))
        .ok_or_else(|| "must be a number of m/s from 0.1 to 1000".into())
}

fn parse_speed(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|speed| (0.001..=1000.0).contains(speed))
        .ok_or_else(|| "must be a number from 0.001 to 1000".into())
}

impl AutopilotArguments {
    pub(super) fn patience(&self) -> Duration {
        Duration::from_secs(self.patience)
    }

    /// Returns the name of the link for the parameter journal.
    fn link_name(&self) -> String {
        self.link.to_string()
    }

    /// Creates the log of all messages. `command` determines the default file name.
    fn log(&self, command: &str) -> Result<TlogWriter<Box<dyn Write + Send>>, Failure> {
        let default = || Path::new("out").join(format!("{command}.tlog"));
        let path = self.tlog.clone().unwrap_or_else(default);
        let folder = path.parent().unwrap_or(Path::new(""));
        let created = match folder.as_os_str().is_empty() {
            true => Ok(()),
            false => fs::create_dir_all(folder),
        };
        let file = created.and_then(|()| File::create(&path));
        let named = |error| Failure::bad_input(format!("--tlog {}: {error}", path.display()));
        let file = BufWriter::new(file.map_err(named)?);
        Ok(TlogWriter::new(Box::new(file), wall_clock_us()))
    }

    /// Opens a session on the link and a client for the mission. `command` determines the default name
    /// of the log.
    pub(super) fn connect(
        &self,
        scenario: &Scenario,
        command: &str,
        set_parameters: bool,
    ) -> Result<(Session, Autopilot<f64>), Failure> {
        // The limits of the slowest airframe apply until the heartbeat identifies the vehicle.
        let settings = AutopilotSettings {
            own: self.own.address(),
            set_parameters,
            airframe_speed_mps: self.airframe_speed,
            ..flight::autopilot_settings(scenario, self.profile.unwrap_or(Profile::Multirotor))
        };
        let client = Autopilot::new(settings).map_err(Failure::bad_input)?;
        let signing = self.signing.load(1)?;
        let failed = |error| Failure::failed(format!("--link {}: {error}", self.link));
        let mut port = Port::new(
            impaired(self.link.open().map_err(failed)?, self.impair.as_ref()),
            client.own(),
        );
        port.log_to(self.log(command)?);
        if let Some(signing) = signing {
            port.sign_with(signing);
        }
        let patience = self.patience().min(flight::CONNECT_PATIENCE);
        eprintln!(
            "waiting at most {1} s for an autopilot at {0}",
            self.link,
            patience.as_secs_f64()
        );
        let profile = ProfileChoice::new(scenario, self.profile);
        let session = Session::new(port, self.speed).choosing(profile);
        Ok((session, client))
    }
}

/// Returns the link, with injected faults if any are configured.
pub(super) fn impaired(link: Box<dyn Link>, impairment: Option<&Impairment>) -> Box<dyn Link> {
    match impairment {
        Some(impairment) => Box::new(Impaired::new(link, impairment)),
        None => link,
    }
}

/// The options of `host-sim doctor`.
#[derive(Debug, Args)]
pub(crate) struct DoctorArguments {
    #[command(flatten)]
    autopilot: AutopilotArguments,
    /// The policy whose flight is predicted: shipped, plan, straight-line, fixed, search, or a file
    #[arg(long, default_value = "shipped")]
    policy: PolicyChoice,
    /// Only restore the parameters that an interrupted run left changed, as soon as the vehicle is
    /// disarmed
    #[arg(long)]
    restore: bool,
    /// The parameter journal that the run wrote into its --out directory
    #[arg(long, value_name = "FILE", requires = "restore", default_value_os_t = default_journal())]
    journal: PathBuf,
}

fn default_journal() -> PathBuf {
    Path::new("out").join(journal::FILE_NAME)
}

/// Restores the parameters of the journal.
fn restore(arguments: &DoctorArguments) -> Result<(), Failure> {
    let (autopilot, file) = (&arguments.autopilot, &arguments.journal);
    // A missing file with the name that runs use means that nothing was left changed; any other
    // missing file is a typing error.
    let named_by_run = file
        .file_name()
        .is_some_and(|name| name == journal::FILE_NAME);
    if !named_by_run && !file.exists() {
        return Err(Failure::bad_input(format!(
            "--journal {}: no such file; a run writes {} into its --out directory",
            file.display(),
            journal::FILE_NAME
        )));
    }
    let journal = ParameterJournal::open(file, &autopilot.link_name());
    let mut journal = journal.map_err(Failure::bad_input)?;
    if journal.is_empty() {
        println!("{}: no parameters to restore", file.display());
        return Ok(());
    }
    let scenario = load_scenario(&autopilot.scenario)?;
    let (mut session, mut client) = autopilot.connect(&scenario, "doctor", false)?;
    let (stop, say) = (interrupt::flag(), |words: &str| eprintln!("{words}"));
    journal::restore(&mut session, &mut client, &mut journal, &stop, say)
        .map_err(Failure::failed)?;
    println!(
        "all parameters were restored; {} was deleted",
        file.display()
    );
    Ok(())
}

/// Examines the autopilot and prints the diagnosis. Fails if a mission would not start.
pub(crate) fn execute(arguments: &DoctorArguments) -> Result<(), Failure> {
    if arguments.restore {
        return restore(arguments);
    }
    let (arguments, examined) = (&arguments.autopilot, arguments);
    let scenario = load_scenario(&arguments.scenario)?;
    let (mut session, mut client) = arguments.connect(&scenario, "doctor", false)?;
    let begun = session.now();
    let say = |event: &Event| {
        if matches!(event, Event::Connected { .. } | Event::Waiting(_)) {
            eprintln!("{event}");
        }
    };
    let patience = arguments.patience();
    let mut diagnosis =
        doctor::examine(&mut session, &mut client, patience, &interrupt::flag(), say)?;
    if diagnosis.vehicle.is_none() {
        return Err(Failure::failed(session.silence(begun)));
    }
    session.flush()?;
    let (policy, _) = load_policy(&examined.policy, &scenario)?;
    let (ideal_policy, _) = load_policy(&examined.policy, &scenario)?;
    let policies = [policy, ideal_policy];
    diagnosis.outcome = doctor::predict(&scenario, policies, &client, diagnosis.is_ready());
    println!("{diagnosis}");
    if diagnosis.is_ready() {
        Ok(())
    } else {
        Err(Failure::failed("the autopilot is not ready for a mission"))
    }
}

//! `host-sim vehicle`: runs the built-in vehicle as a separate process.

use std::{path::PathBuf, str::FromStr};

use clap::Args;
use firmware_core::time::Duration;
use host_sim::serve::serve;
use host_sim::{flight, interrupt, signing::SigningUpkeep};
use link::{LinkAddress, lossy::Impairment, tlog};
use vehicle::{Airframe, Profile, Vehicle};

use super::doctor::impaired;
use super::signing::SigningArguments;
use super::{Failure, load_scenario};

/// The link id of a vehicle's signatures, as of the first link of an autopilot.
const LINK: u8 = 0;

/// The options of `host-sim vehicle`.
#[derive(Debug, Args)]
pub(crate) struct VehicleArguments {
    /// The MAVLink link: udpin:HOST:PORT, udpout:HOST:PORT, tcpout:HOST:PORT or serial:DEVICE:BAUD
    #[arg(long, default_value = "udpin:127.0.0.1:14550", value_name = "LINK")]
    listen: LinkAddress,
    /// The vehicle profile: ideal, multirotor, arducopter or px4
    #[arg(long, default_value = "ideal", value_parser = Profile::from_str)]
    profile: Profile,
    /// Simulation speed relative to real time
    #[arg(long, default_value_t = 1.0, value_name = "X")]
    speed: f64,
    /// The airframe: strong (reaches 30 m/s and more), or stock (the default one of the autopilot's
    /// simulator)
    #[arg(long, default_value = "strong", value_parser = Airframe::from_str, value_name = "FRAME")]
    frame: Airframe,
    /// Rate of the vehicle's clock, in its seconds per second [default: according to the profile]
    #[arg(long, value_name = "R")]
    clock_rate: Option<f64>,
    /// Speed of the mean wind from the west in m/s; gusts are added [default: the scenario's
    /// uncertainty.wind_mps]
    #[arg(long, value_name = "W")]
    wind_mps: Option<f64>,
    /// Stop sending and receiving after this number of seconds of the vehicle's time, with the link
    /// left open
    #[arg(long, value_name = "S")]
    die_after: Option<f64>,
    /// The scenario at whose start the vehicle stands: a TOML file, or the name of a shipped scenario
    #[arg(long, default_value = "separated", value_name = "FILE")]
    scenario: PathBuf,
    /// Set a parameter to another value than the profile's default; may be given several times
    #[arg(long = "param", value_name = "NAME=VALUE", value_parser = parse_parameter)]
    parameters: Vec<(String, f32)>,
    #[command(flatten)]
    signing: SigningArguments,
    /// Inject faults into the link, for example
    /// loss=0.2,duplicate=0.05,reorder=0.05,corrupt=0.01,delay-ms=40,seed=3
    #[arg(long, value_name = "FAULTS", value_parser = Impairment::from_str)]
    impair: Option<Impairment>,
}

fn parse_parameter(text: &str) -> Result<(String, f32), String> {
    let parsed = text
        .split_once('=')
        .and_then(|(name, value)| Some((name.to_owned(), value.parse().ok()?)));
    parsed
        .filter(|(_, value): &(_, f32)| value.is_finite())
        .ok_or_else(|| "must be NAME=NUMBER".into())
}

/// Runs the vehicle until Ctrl-C.
pub(crate) fn execute(arguments: &VehicleArguments) -> Result<(), Failure> {
    let scenario = load_scenario(&arguments.scenario)?;
    if !(arguments.speed.is_finite() && (0.001..=1000.0).contains(&arguments.speed)) {
        return Err(Failure::bad_input(format!(
            "--speed is {}, but must be a number from 0.001 to 1000",
            arguments.speed
        )));
    }
    let mut settings = flight::vehicle_settings(&scenario, arguments.profile);
    settings.ability = arguments.profile.ability_with(arguments.frame);
    let within = |name, value: f64, low: f64, high: f64| {
        let inside = (low..=high).contains(&value).then_some(value);
        inside.ok_or_else(|| {
            let problem = format!("{name} is {value}, but must be a number from {low} to {high}");
            Failure::bad_input(problem)
        })
    };
    if let Some(rate) = arguments.clock_rate {
        settings.clock_rate = within("--clock-rate", rate, 0.5, 2.0)?;
    }
    if let Some(wind_mps) = arguments.wind_mps {
        settings.wind_mps = within("--wind-mps", wind_mps, 0.0, 30.0)?;
    }
    if let Some(after) = arguments.die_after {
        let after = within("--die-after", after, 0.0, 1e6)?;
        settings.die_after = Some(Duration::from_secs_f64(after));
    }
    let known = arguments.profile.parameter_names();
    for (name, _) in &arguments.parameters {
        if !known.contains(&name.as_str()) {
            return Err(Failure::bad_input(format!(
                "--param {name}: no such parameter; the profile {} has {}",
                arguments.profile,
                known.join(", ")
            )));
        }
    }
    settings.parameters.clone_from(&arguments.parameters);
    let mut upkeep = SigningUpkeep::default();
    if let Some((signing, of_signing)) = arguments.signing.load(LINK, tlog::wall_clock_us())? {
        settings.signing = Some(signing);
        upkeep = of_signing;
    }
    let stop = interrupt::flag();
    let failed = |error| Failure::failed(format!("--listen {}: {error}", arguments.listen));
    let link = arguments.listen.open().map_err(failed)?;
    let mut link = impaired(link, arguments.impair.as_ref());
    eprintln!(
        "{} vehicle at {}, speed {}; stop it with Ctrl-C",
        arguments.profile.name(),
        arguments.listen,
        arguments.speed
    );
    serve(
        link.as_mut(),
        Vehicle::new(settings),
        arguments.speed,
        &stop,
        &mut upkeep,
    )
    .map_err(failed)?;
    upkeep.finish().map_err(Failure::failed)
}

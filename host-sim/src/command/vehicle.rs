//! `host-sim vehicle`: the built-in vehicle as a process of its own.

use std::{path::PathBuf, str::FromStr};

use clap::Args;
use host_sim::{
    flight, interrupt,
    link::{LinkAddress, key, lossy::Impairment, tlog},
    vehicle::{Profile, Vehicle, serve},
};

use super::doctor::impaired;
use super::{Failure, load_scenario};

/// Which vehicle, and where.
#[derive(Debug, Args)]
pub(crate) struct VehicleArguments {
    /// Where to speak MAVLink
    #[arg(long, default_value = "udpin:127.0.0.1:14550", value_name = "LINK")]
    listen: LinkAddress,
    /// How it behaves
    #[arg(long, default_value = "ideal", value_parser = Profile::from_str)]
    profile: Profile,
    /// How fast time passes: so many seconds of flight a second
    #[arg(long, default_value_t = 1.0, value_name = "X")]
    speed: f64,
    /// The mission at whose start it stands: a TOML file, or the name of a shipped scenario
    #[arg(long, default_value = "separated", value_name = "FILE")]
    scenario: PathBuf,
    /// A parameter that differs from the profile's default, as often as needed
    #[arg(long = "param", value_name = "NAME=VALUE", value_parser = parse_parameter)]
    parameters: Vec<(String, f32)>,
    /// Sign what is sent and take only what is signed, with the key in this file
    #[arg(long, value_name = "FILE")]
    signing_key: Option<PathBuf>,
    /// Make the link a bad one: loss=0.2,duplicate=0.05,reorder=0.05,corrupt=0.01,delay-ms=40,seed=3
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

/// Serves until ctrl-C.
pub(crate) fn execute(arguments: &VehicleArguments) -> Result<(), Failure> {
    let scenario = load_scenario(&arguments.scenario)?;
    if !(arguments.speed.is_finite() && (0.001..=1000.0).contains(&arguments.speed)) {
        return Err(Failure::bad_input(format!(
            "--speed is {}, but must be a number from 0.001 to 1000",
            arguments.speed
        )));
    }
    let mut settings = flight::vehicle_settings(&scenario, arguments.profile);
    let known = arguments.profile.parameter_names();
    for (name, _) in &arguments.parameters {
        if !known.contains(&name.as_str()) {
            return Err(Failure::bad_input(format!(
                "--param {name}: the {} vehicle has only {}",
                arguments.profile,
                known.join(", ")
            )));
        }
    }
    settings.parameters.clone_from(&arguments.parameters);
    if let Some(file) = &arguments.signing_key {
        let key = key::read(file).map_err(Failure::bad_input)?;
        settings.signing = Some((key, tlog::wall_clock_us()));
    }
    let stop = interrupt::flag();
    let failed = |error| Failure::failed(format!("--listen {}: {error}", arguments.listen));
    let link = arguments.listen.open().map_err(failed)?;
    let mut link = impaired(link, arguments.impair.as_ref());
    eprintln!(
        "{} vehicle at {}, speed {}; ctrl-C ends it",
        arguments.profile.name(),
        arguments.listen,
        arguments.speed
    );
    serve(
        link.as_mut(),
        Vehicle::new(settings),
        arguments.speed,
        &stop,
    )
    .map_err(failed)
}

//! `trainer export|convert|evaluate|probe`: the commands for one policy.

use std::{
    io::{BufWriter, Write, stdout},
    path::{Path, PathBuf},
};

#[cfg(feature = "onnx")]
use anyhow::ensure;
use anyhow::{Context, Error, anyhow};
use clap::Args;
use environment::Allocation;
use files::input;
#[cfg(feature = "onnx")]
use firmware_core::policy::{
    onnx::SetsOnnx,
    sets::{EvaluateSets, SetsObservation, SetsOutput},
};
use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    policy::{
        Policy, StraightLine, format_version,
        mlp::{self, Mlp},
        sets::{self, NetworkWithWork, Precision, SetsNetwork, SetsPolicy, SetsWork},
    },
};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use scenario::{Scenario, ScenarioChoice};
use serde::Serialize;
#[cfg(feature = "onnx")]
use trainer::imitation::states::Difference;
use trainer::{
    any_mission, checkpoint,
    evaluate::{Flight, fly},
    imitation::states::random_states,
    onnx,
};

use super::outcome::{Failure, Outcome, write};

#[derive(Debug, Args)]
pub(crate) struct Export {
    /// The checkpoint.bin of a run
    checkpoint: PathBuf,
    /// The ONNX file to write
    #[arg(long, value_name = "FILE", required_unless_present = "policy")]
    onnx: Option<PathBuf>,
    /// The .policy file to write, of a run with --missions random
    #[arg(long, value_name = "FILE", conflicts_with = "onnx")]
    policy: Option<PathBuf>,
    /// Of a run with --missions random: write weights of 32 instead of 16 bits
    #[arg(long)]
    single: bool,
    /// Write the latest policy instead of the best one
    #[arg(long)]
    latest: bool,
}

impl Export {
    pub(crate) fn execute(self) -> Outcome {
        if self.policy.is_some() || any_mission::method(&self.checkpoint).is_some() {
            return self.export_for_any_mission();
        }
        let Some(onnx) = &self.onnx else {
            return Ok(());
        };
        let progress = checkpoint::read_progress(&self.checkpoint).map_err(Failure::BadInput)?;
        let best = progress.best.filter(|_| !self.latest);
        let actor = best.map_or(progress.latest, |best| best.actor);
        write(onnx, &onnx::write(&actor))
    }

    fn export_for_any_mission(&self) -> Outcome {
        let precision = match self.single {
            true => Precision::Single,
            false => Precision::Half,
        };
        let network = any_mission::read_network(&self.checkpoint, self.latest);
        let network = network.map_err(Failure::BadInput)?;
        if let Some(path) = &self.policy {
            let file = network.to_policy_file(precision);
            return write(path, &file.map_err(Failure::BadInput)?);
        }
        let Some(path) = &self.onnx else {
            return Ok(());
        };
        let file = onnx::sets::write(&network, precision);
        write(path, &file.map_err(Failure::BadInput)?)
    }
}

#[derive(Debug, Args)]
pub(crate) struct Convert {
    /// The ONNX file to read
    onnx: PathBuf,
    /// The .policy file to write
    policy: PathBuf,
}

impl Convert {
    pub(crate) fn execute(self) -> Outcome {
        let file = converted(&self.onnx).map_err(Failure::BadInput)?;
        write(&self.policy, &file)
    }
}

/// Returns the `.policy` file of an ONNX file.
fn converted(path: &Path) -> anyhow::Result<Vec<u8>> {
    let name = || path.display().to_string();
    let bytes = input::read(path).with_context(name)?;
    if onnx::sets::is_for_any_mission(&bytes) {
        let (network, precision) = onnx::sets::parse(&bytes).with_context(name)?;
        return network.to_policy_file(precision);
    }
    let actor = onnx::read::parse(&bytes).with_context(name)?;
    let file = actor.to_policy_file()?;
    // A file that the vehicle would reject is not written.
    Mlp::load(&file[..])?;
    Ok(file)
}

/// The shipped policy for any mission.
const ANY: &[u8] = include_bytes!("../../../models/any.policy");

#[derive(Debug, Args)]
pub(crate) struct Evaluate {
    /// A .onnx or .policy file, `any` (the shipped policy for any mission), or `straight-line`
    policy: PathBuf,
    #[command(flatten)]
    mission: ScenarioChoice,
    /// How the powers of a slot are chosen: exact, alternating, fixed-user-power[:WATTS] or
    /// fixed-sensor-power[:WATTS]
    #[arg(long, default_value_t)]
    inner: Allocation,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

impl Evaluate {
    pub(crate) fn execute(self) -> Outcome {
        let (scenario, mut policy) = self.load().map_err(Failure::BadInput)?;
        let flight = fly(&scenario.mission, &mut *policy, self.inner).map_err(Failure::Failed)?;
        self.print(&flight).map_err(Failure::Failed)
    }

    fn load(&self) -> anyhow::Result<(Scenario, Box<dyn Policy<f64, USERS_MAX>>)> {
        let scenario = self.mission.load().map_err(Error::msg)?;
        self.inner.check(&scenario.mission).map_err(Error::msg)?;
        if self.policy == Path::new("straight-line") {
            let policy = Box::new(StraightLine::new(&scenario.mission));
            return Ok((scenario, policy));
        }
        let file = if self.policy == Path::new("any") {
            ANY.to_vec()
        } else if self.policy.extension().is_some_and(|kind| kind == "onnx") {
            converted(&self.policy)?
        } else {
            input::read(&self.policy).with_context(|| self.policy.display().to_string())?
        };
        if format_version(&file).ok() == Some(sets::FORMAT_VERSION) {
            let mut work = Box::<SetsWork>::default();
            let name = || self.policy.display().to_string();
            let network = SetsNetwork::load(file, &mut work).with_context(name)?;
            let policy: SetsPolicy<f64, _, USERS_MAX, SENSORS_MAX> =
                SetsPolicy::new(NetworkWithWork { network, work }, &scenario.mission)
                    .with_context(name)?;
            return Ok((scenario, Box::new(policy)));
        }
        let policy: Mlp<Vec<u8>> = Mlp::load(file)
            .map_err(|error: mlp::LoadError| anyhow!("{}: {error}", self.policy.display()))?;
        let fits = policy.provenance().check(&scenario.mission);
        fits.with_context(|| self.policy.display().to_string())?;
        if let Some(warning) = scenario.foreign_policy(&policy.provenance().scenario_digest) {
            eprintln!("warning: {}: {warning}", self.policy.display());
        }
        Ok((scenario, Box::new(policy)))
    }

    fn print(&self, flight: &Flight) -> anyhow::Result<()> {
        if self.json {
            println!("{}", serde_json::to_string_pretty(flight)?);
            return Ok(());
        }
        println!(
            "sum rate {:.3} bit/s/Hz; arrived {} ({:.1} m left); fair {}; MSE violations {}; \
             shield interventions {}",
            flight.sum_rate,
            flight.arrived,
            flight.arrival_distance_m,
            flight.fair,
            flight.mse_violations,
            flight.shield_interventions
        );
        Ok(())
    }
}

#[derive(Debug, Args)]
pub(crate) struct Probe {
    /// A .onnx file
    onnx: PathBuf,
    /// Number of observations
    #[arg(long, default_value_t = 10_000)]
    count: usize,
    /// Seed of the random observations
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Of a policy for any mission: also run it by tract, and fail where it differs by more than 1e-5
    /// of full scale
    #[cfg(feature = "onnx")]
    #[arg(long)]
    tract: bool,
}

#[derive(Serialize)]
struct ProbeLine<'a> {
    observation: &'a [f32],
    displacement: &'a [f32],
    user_scores: &'a [f32],
}

/// The same for a policy for any mission; rows that are not used are left out.
#[derive(Serialize)]
struct SetsProbeLine<'a> {
    mission: &'a [f32],
    users: &'a [[f32; sets::USER_COLUMNS]],
    sensors: &'a [[f32; sets::SENSOR_COLUMNS]],
    displacement: [f32; 2],
    user_scores: &'a [f32],
}

fn write_line(out: &mut impl Write, line: &impl Serialize) -> anyhow::Result<()> {
    writeln!(out, "{}", serde_json::to_string(line)?)?;
    Ok(())
}

/// The largest difference between two evaluations of a network, in units of full scale.
#[cfg(feature = "onnx")]
const TOLERANCE: f32 = 1e-5;

/// The network by tract, and how far it differs from that on a microcontroller.
#[cfg(feature = "onnx")]
struct ByTract {
    network: SetsOnnx,
    difference: Difference,
}

#[cfg(feature = "onnx")]
impl ByTract {
    fn note(&mut self, sets: &SetsObservation, expected: &SetsOutput) -> anyhow::Result<()> {
        let got = self
            .network
            .evaluate(sets)
            .context("tract cannot evaluate it")?;
        let columns = sets::MISSION_COLUMN_NAMES.iter().zip(&sets.mission);
        let mut reach = columns.filter(|(name, _)| **name == "reach_m");
        let (_, reach_m) = reach.next().context("an observation has a reach")?;
        self.difference.note(&got, expected, *reach_m);
        Ok(())
    }

    fn check(&self) -> anyhow::Result<()> {
        let difference = self.difference.of_full_scale();
        ensure!(
            difference <= TOLERANCE,
            "tract differs by {difference:e} of full scale, more than {TOLERANCE:e}"
        );
        Ok(())
    }
}

impl Probe {
    #[cfg(feature = "onnx")]
    fn by_tract(&self) -> anyhow::Result<Option<ByTract>> {
        if !self.tract {
            return Ok(None);
        }
        let name = || self.onnx.display().to_string();
        let file = input::read(&self.onnx).with_context(name)?;
        Ok(Some(ByTract {
            network: SetsOnnx::load(&file).with_context(name)?,
            difference: Difference::default(),
        }))
    }

    pub(crate) fn execute(self) -> Outcome {
        let bytes = input::read(&self.onnx).with_context(|| self.onnx.display().to_string());
        if onnx::sets::is_for_any_mission(&bytes.map_err(Failure::BadInput)?) {
            return self.probe_for_any_mission();
        }
        let load = || -> anyhow::Result<_> {
            let actor = onnx::read::read(&self.onnx)?;
            let policy = Mlp::load(actor.to_policy_file()?)?;
            Ok((actor, policy))
        };
        let (actor, policy) = load().map_err(Failure::BadInput)?;
        let mut rng = Pcg64Mcg::seed_from_u64(self.seed);
        let mut out = BufWriter::new(stdout().lock());
        for _ in 0..self.count {
            let observation = actor.random_observation(&mut rng);
            let outputs = policy.evaluate(&observation);
            let line = ProbeLine {
                observation: &observation,
                displacement: &outputs[..2],
                user_scores: &outputs[2..],
            };
            write_line(&mut out, &line).map_err(Failure::Failed)?;
        }
        out.flush().map_err(|error| Failure::Failed(error.into()))
    }

    fn probe_for_any_mission(&self) -> Outcome {
        let mut work = Box::<SetsWork>::default();
        let load = |work: &mut SetsWork| -> anyhow::Result<_> {
            Ok(SetsNetwork::load(converted(&self.onnx)?, work)?)
        };
        let network = load(&mut work).map_err(Failure::BadInput)?;
        #[cfg(feature = "onnx")]
        let mut tract = self.by_tract().map_err(Failure::BadInput)?;
        let mut out = BufWriter::new(stdout().lock());
        let written = random_states(self.count, self.seed, |sets| {
            let output = network.evaluate(sets, &mut work);
            let output = output.context("the network cannot be evaluated")?;
            #[cfg(feature = "onnx")]
            if let Some(tract) = &mut tract {
                tract.note(sets, &output)?;
            }
            let line = SetsProbeLine {
                mission: &sets.mission,
                users: sets.user_rows(),
                sensors: sets.sensor_rows(),
                displacement: output.displacement_m,
                user_scores: &output.user_scores,
            };
            write_line(&mut out, &line)
        });
        written.map_err(Failure::Failed)?;
        #[cfg(feature = "onnx")]
        if let Some(tract) = &tract {
            tract.check().map_err(Failure::Failed)?;
        }
        out.flush().map_err(|error| Failure::Failed(error.into()))
    }
}

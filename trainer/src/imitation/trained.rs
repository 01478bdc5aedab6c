//! A trained network with its origin, and the `.policy` file that flies
//! ([`firmware_core::policy::sets`]).

use anyhow::{Context, anyhow};
use firmware_core::{
    inner::Workspace,
    policy::{
        Observation,
        sets::{
            self, Precision, SetsHeader, SetsObservation, SetsProvenance, SetsWork,
            write as write_file,
        },
    },
};
use scenario::random;

use super::{held_out::FIRST_SEED, settings::ImitationSettings};
use crate::nn::sets::Architecture;

/// More bytes than header and test vector of a file have.
const OVERHEAD_BYTES: usize = 16 * 1024;

/// A trained network, with its origin.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainedNetwork {
    /// Its sizes.
    pub architecture: Architecture,
    /// Its parameters, in the order of the file.
    pub parameters: Vec<f32>,
    /// Its origin. Episodes are the missions that the run had learned from when it was saved.
    pub provenance: SetsProvenance,
}

impl TrainedNetwork {
    /// Returns a network of a run that has learned from so many missions.
    ///
    /// # Errors
    /// Fails if the run has learned from more missions than a provenance can count.
    pub fn of_run(
        settings: &ImitationSettings,
        algorithm: &str,
        missions: u64,
        parameters: Vec<f32>,
    ) -> anyhow::Result<Self> {
        let text = "a provenance is bounded";
        let distribution = settings.distribution();
        Ok(Self {
            architecture: settings.architecture,
            parameters,
            provenance: SetsProvenance {
                algorithm: algorithm.try_into().ok().context(text)?,
                missions: distribution.as_str().try_into().ok().context(text)?,
                episodes: missions.try_into()?,
                seed: settings.seed,
            },
        })
    }

    /// Returns the bytes of a `.policy` file. Its test vector is the start of a held-out mission.
    ///
    /// # Errors
    /// Fails if the network exceeds the limits of `firmware-core`, or a parameter is not finite in
    /// this precision.
    pub fn to_policy_file(&self, precision: Precision) -> anyhow::Result<Vec<u8>> {
        let architecture = sets::Architecture {
            width: self.architecture.width.try_into()?,
            hidden: self.architecture.hidden.try_into()?,
            layers: self.architecture.layers.try_into()?,
        };
        let test = test_observation()?;
        let header = SetsHeader::new(self.provenance.clone(), architecture, precision, &test);
        let mut file = vec![0; OVERHEAD_BYTES + precision.bytes() * self.parameters.len()];
        let weights = self.parameters.iter().copied();
        let mut work = SetsWork::default();
        let length = write_file(&header, weights, &test, &mut work, &mut file)?;
        file.truncate(length);
        Ok(file)
    }
}

/// Returns the observation of test vectors: the start of the first held-out mission.
///
/// # Errors
/// Fails if that mission cannot be drawn.
pub fn test_observation() -> anyhow::Result<SetsObservation> {
    let scenario = random(FIRST_SEED, None).map_err(|error| anyhow!(error))?;
    let mission = scenario.mission;
    let observation = Observation::at_start(&mission);
    Ok(SetsObservation::new(
        &mission,
        &observation,
        &mut Workspace::default(),
    ))
}

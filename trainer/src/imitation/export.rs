//! The network as the `.policy` file that flies ([`firmware_core::policy::sets`]).

use anyhow::{Context, anyhow};
use firmware_core::{
    inner::Workspace,
    policy::{
        Observation,
        sets::{
            Architecture, Precision, SetsHeader, SetsObservation, SetsProvenance, SetsWork, write,
        },
    },
};
use scenario::random;

use super::{held_out::FIRST_SEED, run::TrainedNetwork};

/// More bytes than header and test vector of a file have.
const OVERHEAD_BYTES: usize = 16 * 1024;

impl TrainedNetwork {
    /// Returns the bytes of a `.policy` file. Its test vector is the start of a held-out mission.
    ///
    /// # Errors
    /// Fails if the network exceeds the limits of `firmware-core`, or a parameter is not finite in
    /// this precision.
    pub fn to_policy_file(&self, precision: Precision) -> anyhow::Result<Vec<u8>> {
        let architecture = Architecture {
            width: self.architecture.width.try_into()?,
            hidden: self.architecture.hidden.try_into()?,
            layers: self.architecture.layers.try_into()?,
        };
        let text = "a provenance is bounded";
        let provenance = SetsProvenance {
            algorithm: "imitation".try_into().ok().context(text)?,
            missions: "random".try_into().ok().context(text)?,
            episodes: self.missions,
            seed: self.seed,
        };
        let test = test_observation()?;
        let header = SetsHeader::new(provenance, architecture, precision, &test);
        let mut file = vec![0; OVERHEAD_BYTES + precision.bytes() * self.parameters.len()];
        let weights = self.parameters.iter().copied();
        let length = write(&header, weights, &test, &mut SetsWork::default(), &mut file)?;
        file.truncate(length);
        Ok(file)
    }
}

/// Returns the observation at the start of the first held-out mission.
fn test_observation() -> anyhow::Result<SetsObservation> {
    let scenario = random(FIRST_SEED, None).map_err(|error| anyhow!(error))?;
    let mission = scenario.mission;
    let observation = Observation::at_start(&mission);
    Ok(SetsObservation::new(
        &mission,
        &observation,
        &mut Workspace::default(),
    ))
}

//! A trained network with its origin, and the `.policy` file that flies
//! ([`firmware_core::policy::sets`]).

use anyhow::{Context, anyhow, ensure};
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

    /// Replaces each parameter by the mean of it and those of other networks. Networks of one training
    /// that is continued lie in one basin of the loss, and their mean is mostly better than each.
    ///
    /// # Errors
    /// Fails if another network has another size or was trained on other missions.
    pub fn average_with(&mut self, others: &[Self]) -> anyhow::Result<()> {
        for other in others {
            ensure!(
                self.architecture == other.architecture,
                "its sizes are {:?}, but must be {:?}",
                other.architecture,
                self.architecture
            );
            let (missions, expected) = (&other.provenance.missions, &self.provenance.missions);
            ensure!(
                missions == expected,
                "its missions are {missions:?}, but must be {expected:?}"
            );
        }
        let scale = 1.0 / (1.0 + others.len() as f32);
        for (index, own) in self.parameters.iter_mut().enumerate() {
            let sum: f32 = others.iter().map(|other| other.parameters[index]).sum();
            *own = scale * (*own + sum);
        }
        Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imitation::encoder::FEATURES;
    use crate::nn::sets::SetNetwork;

    #[test]
    fn parameters_are_averaged_with_those_of_networks_that_fit() {
        let settings = ImitationSettings::default();
        let network = |seed| {
            let parameters = SetNetwork::new(settings.architecture, FEATURES, seed).export();
            TrainedNetwork::of_run(&settings, "imitation", 1, parameters).expect("a network")
        };
        let (mut mean, other) = (network(1), network(2));
        let others = std::slice::from_ref(&other);
        mean.average_with(others).expect("fits");
        let own = network(1);
        let last = own.parameters.len() - 1;
        for index in [0, last / 2, last] {
            let expected = 0.5 * (own.parameters[index] + other.parameters[index]);
            assert_eq!(mean.parameters[index], expected);
        }
        let mut larger = network(2);
        larger.architecture.layers += 1;
        let error = mean.average_with(&[larger]).expect_err("another size");
        assert!(error.to_string().contains("layers: 4"), "{error}");
        let mut elsewhere = network(2);
        elsewhere.provenance.missions = "one".try_into().expect("short");
        let error = mean.average_with(&[elsewhere]).expect_err("other missions");
        assert!(error.to_string().contains("\"one\""), "{error}");
        assert_ne!(mean.parameters, own.parameters);
    }
}

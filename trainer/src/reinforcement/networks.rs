//! What is learned: actor, critics, their targets, sigma and the temperatures.

use anyhow::Context;
use pulp::Arch;
use serde::{Deserialize, Serialize};

use super::{
    distribution::{displacement_entropy, log_sigma_of},
    settings::ReinforcementSettings,
};
use crate::{
    imitation::encoder::FEATURES,
    nn::{
        Adam, exp,
        sets::{FeatureSizes, Heads, SetNetwork},
    },
    record::limit_norm,
    temperature::Temperature,
};

/// The features of a critic: the displacement is two more of the mission.
pub const CRITIC_FEATURES: FeatureSizes = FeatureSizes {
    mission: FEATURES.mission + 2,
    ..FEATURES
};
/// The range of `ln sigma`.
const LOG_SIGMA: [f32; 2] = [-5.0, 0.0];

/// A network and the state of its optimizer.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The network.
    pub network: SetNetwork,
    adam: Adam,
}

impl Trained {
    fn new(network: SetNetwork) -> Self {
        Self {
            adam: Adam::new(network.layout().len),
            network,
        }
    }

    /// Takes a step against the gradient, limited to length `longest`. Returns its length before.
    pub fn descend(
        &mut self,
        arch: Arch,
        learning_rate: f32,
        longest: f32,
        gradient: &mut [f32],
    ) -> f32 {
        let norm = limit_norm(gradient, longest);
        self.network.update(|parameters| {
            self.adam.step(arch, learning_rate, parameters, gradient);
        });
        norm
    }

    fn saved(&self) -> (Vec<f32>, Adam) {
        (self.network.export(), self.adam.clone())
    }
}

/// `ln sigma`, with its optimizer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exploration {
    log_sigma: f32,
    adam: Adam,
}

impl Exploration {
    /// Returns `sigma`.
    pub fn sigma(&self) -> f32 {
        exp(self.log_sigma)
    }

    /// Returns the entropy of the displacement before its length is limited, nats.
    pub fn entropy(&self) -> f32 {
        displacement_entropy(self.log_sigma)
    }

    /// Takes a step against the gradient of `ln sigma`.
    pub fn descend(&mut self, arch: Arch, learning_rate: f32, gradient: f32) {
        let log_sigma = std::slice::from_mut(&mut self.log_sigma);
        self.adam.step(arch, learning_rate, log_sigma, &[gradient]);
        let [low, high] = LOG_SIGMA;
        self.log_sigma = self.log_sigma.clamp(low, high);
    }
}

/// Everything that is learned.
#[derive(Clone, Debug)]
pub struct Networks {
    /// `phi`.
    pub actor: Trained,
    /// `theta_1`, `theta_2`.
    pub critics: [Trained; 2],
    /// `theta'_1`, `theta'_2`.
    pub targets: [SetNetwork; 2],
    /// `sigma`.
    pub exploration: Exploration,
    /// `alpha_d`.
    pub displacement_temperature: Temperature,
    /// `alpha_u`.
    pub user_temperature: Temperature,
}

/// What a checkpoint has of [`Networks`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SavedNetworks {
    /// The actor's parameters and optimizer.
    pub actor: (Vec<f32>, Adam),
    critics: [(Vec<f32>, Adam); 2],
    targets: [Vec<f32>; 2],
    exploration: Exploration,
    displacement_temperature: Temperature,
    user_temperature: Temperature,
}

impl Networks {
    /// Creates new networks.
    pub fn new(settings: &ReinforcementSettings) -> Self {
        let (sizes, seed) = (settings.imitation.architecture, settings.imitation.seed);
        let critic = |index: u64| {
            let seed = seed.wrapping_add(1 + index);
            let sizes = settings.critic_architecture;
            SetNetwork::with_heads(sizes, CRITIC_FEATURES, Heads::Critic, seed)
        };
        let critics = [critic(0), critic(1)];
        Self {
            actor: Trained::new(SetNetwork::new(sizes, FEATURES, seed)),
            targets: critics.clone(),
            critics: critics.map(Trained::new),
            exploration: Exploration {
                log_sigma: log_sigma_of(settings.displacement_entropy),
                adam: Adam::new(1),
            },
            displacement_temperature: Temperature::new(settings.initial_temperature),
            user_temperature: Temperature::new(settings.initial_temperature),
        }
    }

    /// Returns what a checkpoint needs to restore the networks.
    pub fn saved(&self) -> SavedNetworks {
        SavedNetworks {
            actor: self.actor.saved(),
            critics: self.critics.each_ref().map(Trained::saved),
            targets: self.targets.each_ref().map(SetNetwork::export),
            exploration: self.exploration.clone(),
            displacement_temperature: self.displacement_temperature.clone(),
            user_temperature: self.user_temperature.clone(),
        }
    }

    /// Restores the networks.
    ///
    /// # Errors
    /// Fails if a network has another size than the settings say.
    pub fn restored(
        settings: &ReinforcementSettings,
        saved: SavedNetworks,
    ) -> anyhow::Result<Self> {
        let mut networks = Self::new(settings);
        let load = |trained: &mut Trained, (parameters, adam): (Vec<f32>, Adam)| {
            import(&mut trained.network, &parameters)?;
            trained.adam = adam;
            anyhow::Ok(())
        };
        load(&mut networks.actor, saved.actor)?;
        for (critic, saved) in networks.critics.iter_mut().zip(saved.critics) {
            load(critic, saved)?;
        }
        for (target, saved) in networks.targets.iter_mut().zip(&saved.targets) {
            import(target, saved)?;
        }
        networks.exploration = saved.exploration;
        networks.displacement_temperature = saved.displacement_temperature;
        networks.user_temperature = saved.user_temperature;
        Ok(networks)
    }

    /// Moves the targets towards the critics (eq:theta1).
    pub fn soft_update(&mut self, tau: f32) {
        for (target, critic) in self.targets.iter_mut().zip(&self.critics) {
            target.update(|parameters| {
                let learned = critic.network.parameters();
                for (parameter, learned) in parameters.iter_mut().zip(learned) {
                    *parameter += tau * (learned - *parameter);
                }
            });
        }
    }
}

/// Replaces the parameters of a network.
fn import(network: &mut SetNetwork, parameters: &[f32]) -> anyhow::Result<()> {
    let imported = network.import(parameters).ok();
    imported.context("the checkpoint's network has another size")
}

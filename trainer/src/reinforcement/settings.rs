//! The settings of a run.

use serde::{Deserialize, Serialize};

use crate::{imitation::settings::ImitationSettings, nn::sets::Architecture};

/// All settings of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReinforcementSettings {
    /// `gamma`.
    pub discount: f32,
    /// The highest learning rate of the critics. It rises and falls as the actor's, which is
    /// `imitation.learning_rate`.
    pub critic_learning_rate: f32,
    /// The largest norm of a critic's gradient; longer ones are scaled to it.
    pub critic_gradient_norm_max: f32,
    /// `tau` of eq:theta1.
    pub tau: f32,
    /// Initial value of both temperatures, in units of the mean rate of a slot.
    pub initial_temperature: f32,
    /// Learning rate of both temperatures and of sigma.
    pub temperature_learning_rate: f32,
    /// Target entropy of the displacement, nats, in units of the way of a slot. Sigma starts where the
    /// entropy is this.
    pub displacement_entropy: f32,
    /// Target entropy of the user as a fraction of the entropy of a uniform choice among the users
    /// that are admissible in the state.
    pub user_entropy_fraction: f32,
    /// Number of first steps in which only the critics learn: they must know the policy that they are
    /// to improve, or they destroy it.
    pub actor_frozen_steps: u64,
    /// Number of missions before the first step that are flown at random instead of by the policy.
    pub random_missions: u64,
    /// The weight of the loss of imitation; 0 leaves it out.
    pub imitation_weight: f32,
    /// Number of states of the loss of imitation.
    pub imitation_batch: usize,
    /// The fraction of transitions with another admissible user than the one that was served, whose
    /// reward and next state are known as well.
    pub alternative_fraction: f64,
    /// Number of missions in the memory; a newer one replaces the oldest.
    pub memory_missions: usize,
    /// The sizes of the critics.
    pub critic_architecture: Architecture,
    /// What an imitation has as well: seed, duration, batch, missions, planner, the actor's sizes and
    /// learning rate, and evaluation.
    pub imitation: ImitationSettings,
}

impl ReinforcementSettings {
    /// Returns the settings of a run that starts from an untrained network.
    pub fn from_new() -> Self {
        Self {
            discount: 0.95,
            critic_learning_rate: 1e-3,
            critic_gradient_norm_max: 10.0,
            tau: 0.005,
            initial_temperature: 0.05,
            temperature_learning_rate: 3e-4,
            displacement_entropy: -2.0,
            user_entropy_fraction: 0.2,
            actor_frozen_steps: 0,
            random_missions: 16,
            imitation_weight: 0.0,
            imitation_batch: 64,
            alternative_fraction: 0.5,
            memory_missions: 4_000,
            critic_architecture: Architecture {
                hidden: 128,
                layers: 2,
                ..Architecture::default()
            },
            imitation: ImitationSettings {
                batch: 128,
                learning_rate: 5e-4,
                first_missions: 16,
                steps_per_mission: 4,
                evaluate_every: 500,
                report_every: 100,
                ..ImitationSettings::default()
            },
        }
    }

    /// Returns the settings of a run that improves a trained network.
    pub fn improving() -> Self {
        let new = Self::from_new();
        Self {
            initial_temperature: 0.001,
            displacement_entropy: -3.0,
            user_entropy_fraction: 0.05,
            actor_frozen_steps: 5_000,
            random_missions: 0,
            imitation_weight: 0.5,
            imitation: ImitationSettings {
                learning_rate: 3e-5,
                ..new.imitation
            },
            ..new
        }
    }

    /// Returns the learning rates of actor and critics after `steps`, of which `fraction` (0 to 1) of
    /// the run consists.
    pub fn learning_rates_after(&self, steps: u64, fraction: f64) -> [f32; 2] {
        let rate = |steps| self.imitation.learning_rate_after(steps, fraction);
        let actor = match steps.checked_sub(self.actor_frozen_steps) {
            Some(steps) => rate(steps),
            None => 0.0,
        };
        let scale = self.critic_learning_rate / self.imitation.learning_rate;
        [actor, rate(steps) * scale]
    }

    /// Checks that the settings make a run.
    ///
    /// # Errors
    /// Names the setting that is out of its range.
    pub fn check(&self) -> Result<(), String> {
        self.imitation.check()?;
        let sizes = self.critic_architecture.check();
        sizes.map_err(|message| format!("critic_{message}"))?;
        let positive = |x: f32| x > 0.0 && x.is_finite();
        let unit = |x: f32| (0.0..=1.0).contains(&x);
        let checks = [
            (
                unit(self.discount) && self.discount < 1.0,
                "discount must be 0 or above, and below 1",
            ),
            (
                positive(self.critic_learning_rate),
                "critic_learning_rate must be above 0",
            ),
            (
                positive(self.critic_gradient_norm_max),
                "critic_gradient_norm_max must be above 0",
            ),
            (
                unit(self.tau) && self.tau > 0.0,
                "tau must be above 0 and at most 1",
            ),
            (
                positive(self.initial_temperature),
                "initial_temperature must be above 0",
            ),
            (
                positive(self.temperature_learning_rate),
                "temperature_learning_rate must be above 0",
            ),
            (
                (-8.0..=2.0).contains(&self.displacement_entropy),
                "displacement_entropy must be -8 to 2",
            ),
            (
                unit(self.user_entropy_fraction),
                "user_entropy_fraction must be 0 to 1",
            ),
            (
                self.imitation_weight >= 0.0 && self.imitation_weight.is_finite(),
                "imitation_weight must be 0 or above",
            ),
            (
                self.imitation_weight == 0.0 || self.imitation_batch > 0,
                "imitation_batch must be above 0",
            ),
            (
                (0.0..=1.0).contains(&self.alternative_fraction),
                "alternative_fraction must be 0 to 1",
            ),
            (
                self.memory_missions >= self.imitation.first_missions,
                "memory_missions must be at least imitation.first_missions",
            ),
        ];
        let wrong = checks.into_iter().find(|(holds, _)| !holds);
        wrong.map_or(Ok(()), |(_, message)| Err(message.to_owned()))
    }
}

//! All settings of a training run, in one struct.
//!
//! *Table I* marks values that the paper gives, *ours* values that it does not give. The preset
//! [`Preset::Paper`] is Table I with our values for the rest; [`Preset::Tuned`] has the settings
//! with the best results so far (`docs/training.md` says by how much each change helped).

use clap::ValueEnum;
use environment::Allocation;
use environment::{Constraints, EnvironmentSettings};
use firmware_core::policy::mlp::WIDTH_MAX;
use serde::{Deserialize, Serialize};

/// The learning algorithm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Algorithm {
    /// Soft actor-critic with a hybrid action ([`crate::sac`]).
    #[value(help = "Soft actor-critic with a hybrid action")]
    Sac,
    /// Deep deterministic policy gradient ([`crate::ddpg`]).
    #[value(help = "Deep deterministic policy gradient")]
    Ddpg,
}

impl Algorithm {
    /// Returns its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sac => "sac",
            Self::Ddpg => "ddpg",
        }
    }
}

/// A set of values for [`TrainingSettings`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Table I.
    #[value(help = "Table I of the paper")]
    Paper,
    /// The same state, action, networks and episodes with another discount and other learning
    /// rates, and with additions to the paper: how a mission's return is distributed over its slots
    /// ([`TrainingSettings::fairness_prices`], [`TrainingSettings::value_shaping`]), and for SAC
    /// which transitions are stored and where entropy counts
    /// ([`TrainingSettings::alternative_users`], [`TrainingSettings::entropy_when_forced`]).
    #[value(help = "The settings with the best results so far (docs/training.md)")]
    Tuned,
}

/// The largest number of transitions in a replay memory, which takes about 20 GB.
const BUFFER_MAX: usize = 100_000_000;

/// All settings of a training run. The documented defaults are those of [`Preset::Paper`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingSettings {
    /// The algorithm.
    pub algorithm: Algorithm,
    /// The seed of all random numbers of the run.
    pub seed: u64,

    /// Number of episodes of `N` slots. Sec. VI: 4,000.
    pub episodes: u32,
    /// `alpha_pi`. Table I: 1e-4.
    pub policy_learning_rate: f32,
    /// `alpha_q`. Table I: 1e-4.
    pub critic_learning_rate: f32,
    /// `gamma`. Table I: 0.90.
    pub discount: f32,
    /// Number of transitions in a batch ("min-batch"). Table I: 64.
    pub batch: usize,
    /// Capacity `|D|` of the replay memory, a ring buffer. Table I: 10^6, of which 4,000 episodes
    /// of 60 slots fill a quarter.
    pub buffer_capacity: usize,
    /// Number of neurons in each of the two hidden layers of every network. Sec. VI: 128.
    pub hidden: usize,

    /// `lambda_1`, the weight of the rate. Ours: 1, so that returns are in bit/s/Hz.
    pub rate_weight: f32,
    /// Whether serving a user also earns its fairness price (eq:a3) minus the mean price. Over a
    /// mission in which every user is served its quota these terms sum to zero, so returns and best
    /// missions do not change, but serving a user now rather than later is rewarded at once
    /// (`docs/training.md`). Ours.
    pub fairness_prices: bool,
    /// Whether the change of the relaxed mission's value ([`environment::ValueToGo`]) over a slot is
    /// added to its reward: potential-based shaping, which does not change the order of missions.
    /// Ours.
    pub value_shaping: bool,
    /// `lambda_2`, the weight of the trajectory reward, per metre and slot. Ours: small, because
    /// arrival is certain under the shield and the term only biases the path.
    pub trajectory_weight: f32,
    /// `R_f`, the arrival reward before it is multiplied by `lambda_2`. Ours.
    pub arrival_reward: f32,
    /// How the powers of a slot are chosen: optimally, or by one of the paper's comparison
    /// schemes. A slot in which sensors of fixed power cannot meet the MSE threshold earns nothing.
    pub inner: Allocation,
    /// How forbidden actions are treated. Ours: the shield that flies is the shield that trains.
    pub constraints: Constraints,

    /// `tau` of eq:theta1, "<< 1". Ours: 0.005. Its name in files is `target_rate`.
    #[serde(rename = "target_rate")]
    pub tau: f32,
    /// Learning rate of both temperatures (eq:beta). Ours: the learning rate of the policy.
    pub temperature_learning_rate: f32,
    /// Initial value of both temperatures. Ours.
    pub initial_temperature: f32,
    /// Target entropy of the displacement, nats, for a step scaled to `[-1, 1]^2`. Ours: the
    /// negative of its dimension, which is the usual choice. (The paper prints `-prod(varpi)`.)
    pub displacement_entropy: f32,
    /// Whether the displacement's entropy counts also where the shield leaves only one way to fly,
    /// on the flight to the destination at full speed. Alg. 2: it does.
    pub entropy_when_forced: bool,
    /// Target entropy of the user as a fraction of the entropy of a uniform choice among the users
    /// that are admissible in the state. Ours.
    pub user_entropy_fraction: f32,
    /// Number of slots with uniformly random actions before learning starts. Ours; Alg. 2 says "if
    /// D is filled", which would take 16,667 episodes if it meant the whole capacity.
    pub warmup_slots: u64,
    /// Number of additional transitions that are stored for every slot, each with another
    /// admissible user, sampled uniformly. Their rewards and next states are known exactly, because
    /// the waypoint does not depend on the user. For SAC only: DDPG's action contains the users'
    /// scores. Alg. 2: none.
    pub alternative_users: u32,
    /// Number of gradient steps per slot. Alg. 2: one.
    pub gradient_steps_per_slot: u32,
    /// Number of environments that are stepped together, each followed by its gradient steps.
    /// Alg. 2: one.
    pub environments: usize,
    /// DDPG: standard deviation of the exploration noise, in units of `[-1, 1]`. Ours.
    pub exploration_noise: f32,

    /// Number of episodes between deterministic evaluations; the best policy is kept. Ours.
    pub evaluate_every: u32,
    /// Number of episodes between checkpoints. Ours.
    pub checkpoint_every: u32,
    /// A loss whose magnitude exceeds this, or a NaN, stops the run. Ours.
    pub loss_limit: f32,
}

impl TrainingSettings {
    /// Returns the values of a preset.
    pub fn preset(preset: Preset, algorithm: Algorithm, seed: u64) -> Self {
        let environment = EnvironmentSettings::default();
        let paper = Self {
            algorithm,
            seed,
            episodes: 4_000,
            policy_learning_rate: 1e-4,
            critic_learning_rate: 1e-4,
            discount: 0.90,
            batch: 64,
            buffer_capacity: 1_000_000,
            hidden: 128,
            rate_weight: environment.rate_weight,
            fairness_prices: false,
            value_shaping: false,
            trajectory_weight: environment.trajectory_weight,
            arrival_reward: environment.arrival_reward,
            inner: environment.allocation,
            constraints: environment.constraints,
            tau: 0.005,
            temperature_learning_rate: 1e-4,
            initial_temperature: 0.1,
            displacement_entropy: -2.0,
            entropy_when_forced: environment.entropy_when_forced,
            user_entropy_fraction: 0.2,
            warmup_slots: 1_200,
            alternative_users: 0,
            gradient_steps_per_slot: 1,
            environments: 1,
            exploration_noise: 0.1,
            evaluate_every: 20,
            checkpoint_every: 500,
            loss_limit: 1e6,
        };
        let of_sac = algorithm == Algorithm::Sac;
        match preset {
            Preset::Paper => paper,
            Preset::Tuned => Self {
                discount: 0.99,
                policy_learning_rate: 1e-3,
                critic_learning_rate: 1e-3,
                temperature_learning_rate: 1e-3,
                fairness_prices: true,
                value_shaping: true,
                // DDPG has neither values per user nor entropies.
                alternative_users: u32::from(of_sac),
                entropy_when_forced: !of_sac,
                ..paper
            },
        }
    }

    /// Returns the settings of the environment.
    pub fn environment_settings(&self) -> EnvironmentSettings {
        EnvironmentSettings {
            rate_weight: self.rate_weight,
            trajectory_weight: self.trajectory_weight,
            arrival_reward: self.arrival_reward,
            allocation: self.inner,
            constraints: self.constraints,
            entropy_when_forced: self.entropy_when_forced,
        }
    }

    /// Checks that every value is in its range.
    ///
    /// # Errors
    /// Names the first field that is not, its value and what is allowed.
    pub fn check(&self) -> Result<(), SettingsError> {
        let positive = |field, value: f32| {
            let right = value.is_finite() && value > 0.0;
            SettingsError::unless(right, field, value, "a finite number above 0")
        };
        let fraction = |field, value: f32| {
            let right = (0.0..=1.0).contains(&value);
            SettingsError::unless(right, field, value, "a number from 0 to 1")
        };
        let count = |field, value: u64| {
            SettingsError::unless(value > 0, field, value, "a whole number above 0")
        };
        let finite = |field, value: f32| {
            SettingsError::unless(value.is_finite(), field, value, "a finite number")
        };
        let weight = |field, value: f32| {
            let right = value.is_finite() && value >= 0.0;
            SettingsError::unless(right, field, value, "a finite number, 0 or above")
        };
        weight("rate_weight", self.rate_weight)?;
        weight("trajectory_weight", self.trajectory_weight)?;
        weight("arrival_reward", self.arrival_reward)?;
        weight("exploration_noise", self.exploration_noise)?;
        finite("displacement_entropy", self.displacement_entropy)?;
        count(
            "gradient_steps_per_slot",
            self.gradient_steps_per_slot.into(),
        )?;
        count("episodes", self.episodes.into())?;
        positive("policy_learning_rate", self.policy_learning_rate)?;
        positive("critic_learning_rate", self.critic_learning_rate)?;
        positive("temperature_learning_rate", self.temperature_learning_rate)?;
        positive("initial_temperature", self.initial_temperature)?;
        positive("loss_limit", self.loss_limit)?;
        fraction("discount", self.discount)?;
        fraction("target_rate", self.tau)?;
        fraction("user_entropy_fraction", self.user_entropy_fraction)?;
        SettingsError::unless(
            self.algorithm == Algorithm::Sac || self.alternative_users == 0,
            "alternative_users",
            self.alternative_users,
            "0 for ddpg, whose action is the users' scores",
        )?;
        count("batch", self.batch as u64)?;
        SettingsError::unless(
            (1..=WIDTH_MAX).contains(&self.hidden),
            "hidden",
            self.hidden,
            "from 1 to the widest layer that flies, 256",
        )?;
        count("environments", self.environments as u64)?;
        count("evaluate_every", self.evaluate_every.into())?;
        count("checkpoint_every", self.checkpoint_every.into())?;
        SettingsError::unless(
            (self.batch..=BUFFER_MAX).contains(&self.buffer_capacity),
            "buffer_capacity",
            self.buffer_capacity,
            "at least the batch, and at most 100 million",
        )
    }
}

/// Error returned when a setting is out of its range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field} is {value}, but must be {expected}")]
pub struct SettingsError {
    field: &'static str,
    value: String,
    expected: &'static str,
}

impl SettingsError {
    fn unless(
        right: bool,
        field: &'static str,
        value: impl ToString,
        expected: &'static str,
    ) -> Result<(), Self> {
        if right {
            return Ok(());
        }
        Err(Self {
            field,
            value: value.to_string(),
            expected,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_preset_is_table_one() {
        let s = TrainingSettings::preset(Preset::Paper, Algorithm::Sac, 1);
        assert_eq!(
            (s.policy_learning_rate, s.critic_learning_rate),
            (1e-4, 1e-4)
        );
        assert_eq!(
            (s.discount, s.batch, s.buffer_capacity),
            (0.90, 64, 1_000_000)
        );
        assert_eq!(
            (s.episodes, s.hidden, s.gradient_steps_per_slot),
            (4_000, 128, 1)
        );
        assert_eq!(s.check(), Ok(()));
    }

    #[test]
    fn a_wrong_value_is_named() {
        let mut s = TrainingSettings::preset(Preset::Tuned, Algorithm::Ddpg, 1);
        s.discount = 1.5;
        let message = s.check().unwrap_err().to_string();
        assert_eq!(message, "discount is 1.5, but must be a number from 0 to 1");
        type Spoil = fn(&mut TrainingSettings);
        let spoilt: [(&str, Spoil); 7] = [
            ("alternative_users is 2", |s| {
                (s.algorithm, s.alternative_users) = (Algorithm::Ddpg, 2);
            }),
            ("buffer_capacity is", |s| s.buffer_capacity = usize::MAX),
            ("hidden is 257", |s| s.hidden = 257),
            ("displacement_entropy is NaN", |s| {
                s.displacement_entropy = f32::NAN
            }),
            ("gradient_steps_per_slot is 0", |s| {
                s.gradient_steps_per_slot = 0
            }),
            ("rate_weight is inf", |s| s.rate_weight = f32::INFINITY),
            ("exploration_noise is -1", |s| s.exploration_noise = -1.0),
        ];
        for (words, spoil) in spoilt {
            let mut s = TrainingSettings::preset(Preset::Paper, Algorithm::Sac, 1);
            spoil(&mut s);
            let message = s.check().unwrap_err().to_string();
            assert!(message.starts_with(words), "{message}");
        }
    }
}

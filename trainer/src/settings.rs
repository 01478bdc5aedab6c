//! Everything that can be set about a training run, in one struct.
//!
//! *Table I* marks what the paper gives; *ours* marks what it leaves open. The preset
//! [`Preset::Paper`] is Table I with our choices for the rest; [`Preset::Tuned`] is what learns
//! best that we know (`docs/training.md` says by how much each change helped).

use clap::ValueEnum;
use firmware_core::policy::mlp::WIDTH_MAX;
use host_sim::allocation::Allocation;
use serde::{Deserialize, Serialize};

/// Which algorithm learns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Algorithm {
    /// Soft actor-critic with a hybrid action ([`crate::sac`]).
    Sac,
    /// Deep deterministic policy gradient ([`crate::ddpg`]).
    Ddpg,
}

impl Algorithm {
    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sac => "sac",
            Self::Ddpg => "ddpg",
        }
    }
}

/// A set of values for [`Settings`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Table I.
    Paper,
    /// The same state, action, networks and episodes; another discount and other learning rates,
    /// and what the paper has not: how a mission's return is paid out over its slots
    /// ([`Settings::fairness_prices`], [`Settings::value_shaping`]), and for SAC what is
    /// remembered and where entropy counts ([`Settings::alternative_users`],
    /// [`Settings::entropy_when_forced`]).
    Tuned,
}

/// How the environment treats an action that the constraints forbid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Constraints {
    /// The shield projects it, as it will in flight: every episode arrives and is fair.
    Shielded,
    /// The paper's form: only area and speed are projected; an unfair choice earns nothing
    /// (`r^c = 0`), a missed destination costs (`r^d`).
    Penalty,
}

/// Transitions that a memory may be made for: some 20 GB.
const BUFFER_MAX: usize = 100_000_000;

/// The documented defaults are [`Preset::Paper`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Which algorithm.
    pub algorithm: Algorithm,
    /// Random numbers of the whole run start here.
    pub seed: u64,

    /// Episodes of `N` slots; Sec. VI: 4,000.
    pub episodes: u32,
    /// `alpha_pi`; Table I: 1e-4.
    pub policy_learning_rate: f32,
    /// `alpha_q`; Table I: 1e-4.
    pub critic_learning_rate: f32,
    /// `gamma`; Table I: 0.90.
    pub discount: f32,
    /// "min-batch"; Table I: 64.
    pub batch: usize,
    /// `|D|`; Table I: 10^6. A ring: 4,000 episodes of 60 slots fill a quarter of it.
    pub buffer_capacity: usize,
    /// Neurons in each of the two hidden layers of every network; Sec. VI: 128.
    pub hidden: usize,

    /// `lambda_1`, weight of the rate. Ours: 1, so that a return reads in bit/s/Hz.
    pub rate_weight: f32,
    /// Whether serving a user also earns its price of fairness (eq:a3), less what the prices come
    /// to on average: over a mission in which every user has its quota they add up to nothing, so
    /// returns and best missions stay the same, but what a user is worth now rather than later is
    /// paid at once (`docs/training.md`). Ours.
    pub fairness_prices: bool,
    /// Whether a slot is also paid what it adds to the value of the relaxed mission
    /// ([`crate::relaxation`]): potential-based shaping, which leaves the order of missions as it
    /// is. Ours.
    pub value_shaping: bool,
    /// `lambda_2`, weight of the trajectory reward, per metre and slot. Ours. Under the shield
    /// arrival is certain and the term only biases where to be meanwhile, so it is small.
    pub trajectory_weight: f32,
    /// `R_f`, the arrival reward before `lambda_2`. Ours.
    pub arrival_reward: f32,
    /// How the powers of a slot are chosen: optimally, or by one of the paper's comparison
    /// schemes. In such a slot as sensors of fixed power cannot make accurate enough, nothing is
    /// earned.
    pub inner: Allocation,
    /// Shield or penalty. Ours: the shield that flies is the shield that trains.
    pub constraints: Constraints,

    /// `tau` of eq:theta1, "<< 1". Ours: 0.005.
    pub target_rate: f32,
    /// Learning rate of both temperatures (eq:beta). Ours: that of the policy.
    pub temperature_learning_rate: f32,
    /// Both temperatures at the start. Ours.
    pub initial_temperature: f32,
    /// Target entropy of the displacement, nats, with a step scaled to `[-1, 1]^2`.
    /// Ours: minus its dimension, as is usual. (The paper prints `-prod(varpi)`.)
    pub displacement_entropy: f32,
    /// Whether the displacement's entropy counts, and is paid for, also where the shield leaves no
    /// choice: on the way home at full speed. Alg. 2: it does.
    pub entropy_when_forced: bool,
    /// Target entropy of the user choice as a fraction of that of an even choice among the users
    /// admissible in the state. Ours.
    pub user_entropy_fraction: f32,
    /// Slots of uniformly random action before learning. Ours; Alg. 2 says "if D is filled",
    /// which would take 16,667 episodes if it meant the whole capacity.
    pub warmup_slots: u64,
    /// For every slot flown, transitions with so many other admissible users, drawn evenly, are
    /// remembered beside it: what they would have earned and led to is known exactly, as the
    /// way-point does not depend on the user. For SAC only: DDPG's action is the users' scores.
    /// Alg. 2: none.
    pub alternative_users: u32,
    /// Gradient steps per slot. Alg. 2: one.
    pub gradient_steps_per_slot: u32,
    /// Environments that are stepped together, each followed by its gradient steps. Alg. 2: one.
    pub environments: usize,
    /// DDPG: standard deviation of the exploration noise, in `[-1, 1]` units. Ours.
    pub exploration_noise: f32,

    /// Deterministic evaluation every so many episodes; the best policy is kept. Ours.
    pub evaluate_every: u32,
    /// Checkpoint every so many episodes. Ours.
    pub checkpoint_every: u32,
    /// A loss beyond this, or a NaN, stops the run. Ours.
    pub loss_limit: f32,
}

impl Settings {
    /// The values of a preset.
    pub fn preset(preset: Preset, algorithm: Algorithm, seed: u64) -> Self {
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
            rate_weight: 1.0,
            fairness_prices: false,
            value_shaping: false,
            trajectory_weight: 1e-6,
            arrival_reward: 1e6,
            inner: Allocation::Exact,
            constraints: Constraints::Shielded,
            target_rate: 0.005,
            temperature_learning_rate: 1e-4,
            initial_temperature: 0.1,
            displacement_entropy: -2.0,
            entropy_when_forced: true,
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

    /// Names the first value that makes no sense.
    ///
    /// # Errors
    /// The field, its value and what would be right.
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
        fraction("target_rate", self.target_rate)?;
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

/// A setting that makes no sense.
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
        let s = Settings::preset(Preset::Paper, Algorithm::Sac, 1);
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
        let mut s = Settings::preset(Preset::Tuned, Algorithm::Ddpg, 1);
        s.discount = 1.5;
        let message = s.check().unwrap_err().to_string();
        assert_eq!(message, "discount is 1.5, but must be a number from 0 to 1");
        type Spoil = fn(&mut Settings);
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
            let mut s = Settings::preset(Preset::Paper, Algorithm::Sac, 1);
            spoil(&mut s);
            let message = s.check().unwrap_err().to_string();
            assert!(message.starts_with(words), "{message}");
        }
    }
}

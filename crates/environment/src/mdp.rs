//! The environment itself: one mission that is flown again and again.
//!
//! ```text
//! r   = lambda_1 (r^c + p_m) + lambda_2 r^d
//! r^c = R_n  if the slot satisfies the constraints, else 0
//! r^d = R_f  if n = N and ||q_N - q_f|| <= V_max delta,  else  -n ||q_n - q_f||
//! ```
//!
//! `p_m` is the fairness price of the served user `m` ([`Environment::with_prices`]); without
//! prices it is 0, as in the paper. With value shaping ([`Environment::with_values`]), the change
//! of the relaxed mission's value over the slot is added to the reward of the rate. A reward is
//! then the difference between what the slot achieved and the best that the relaxed mission could
//! have achieved.
//!
//! [`Constraints::Shielded`] treats actions as the controller does in flight: displacement and
//! user are projected, so every episode arrives and is fair. [`Constraints::Penalty`] is the
//! paper's form: area and speed are enforced by projection, fairness and arrival only by the
//! reward.

use std::sync::Arc;

use firmware_core::{
    Displacement, Mission, Position, PowerGain, SENSORS_MAX, Scalar, USERS_MAX,
    channel::GroundNode,
    inner::{Method, SlotAllocation, SlotLimits, Status, Workspace},
    policy::{Observation, sets::SetsObservation, state_len},
    shield::{self, Agility, Fairness, Intervention, ReachableSet},
};

use crate::{
    action::{Action, UserSet},
    normalizer::{Dimensions, Normalizer},
    outcome::{Episode, Reward, Step, StepResult},
    relaxation::ValueToGo,
    settings::{Constraints, EnvironmentSettings},
};

/// Slack below which the shield leaves only one way to fly, in units of `V_max delta`.
const FORCED_SLACK: f64 = 0.03;

/// Weights of the reward: `lambda_1`, `lambda_2` and `R_f`.
#[derive(Clone, Copy, Debug)]
struct Weights {
    rate: f64,
    trajectory: f64,
    arrival: f64,
}

/// An environment for one mission. `T` is `f64`, as in the host's simulations, or `f32`.
#[derive(Clone, Debug)]
pub struct Environment<T: Scalar> {
    mission: Mission<T, USERS_MAX, SENSORS_MAX>,
    limits: SlotLimits<T>,
    method: Method<T>,
    constraints: Constraints,
    weights: Weights,
    /// `p_m` of every user, bit/s/Hz.
    prices: Vec<f64>,
    values: Option<Arc<ValueToGo>>,
    entropy_when_forced: bool,
    normalizer: Normalizer,
    workspace: Workspace<T, SENSORS_MAX>,
    #[cfg(all(feature = "simd", target_arch = "x86_64"))]
    gains: Option<Box<crate::gains::NodeGains>>,
    state: EpisodeState<T>,
}

/// The part of an environment that changes from slot to slot: an episode under way. One
/// [`Environment`] can step through many episodes of its mission in turns, because everything else
/// in it is the same for all of them: see [`Environment::swap_state`].
#[derive(Clone, Debug)]
pub struct EpisodeState<T: Scalar> {
    fairness: Fairness<USERS_MAX>,
    slots_done: u32,
    position: Position<T>,
    rate: T,
    mse: T,
    episode: Episode,
}

impl<T: Scalar> EpisodeState<T> {
    /// Returns the state before the first slot of a mission.
    pub fn start(mission: &Mission<T, USERS_MAX, SENSORS_MAX>) -> Self {
        Self {
            fairness: Fairness::new(mission),
            slots_done: 0,
            position: mission.parameters().start,
            rate: T::zero(),
            mse: T::zero(),
            episode: Episode::default(),
        }
    }

    /// Returns the number of slots that are done.
    pub fn slots_done(&self) -> u32 {
        self.slots_done
    }

    /// Returns the vehicle's position.
    pub fn position(&self) -> Position<T> {
        self.position
    }

    /// Returns the sums of the episode so far.
    pub fn episode(&self) -> &Episode {
        &self.episode
    }
}

impl<T: Scalar> Environment<T> {
    /// Returns an environment at the start of the mission.
    pub fn new(
        mission: Mission<T, USERS_MAX, SENSORS_MAX>,
        settings: &EnvironmentSettings,
    ) -> Self {
        Self {
            limits: SlotLimits::of_mission(&mission),
            method: settings.allocation.method(&mission),
            constraints: settings.constraints,
            weights: Weights {
                rate: settings.rate_weight.into(),
                trajectory: settings.trajectory_weight.into(),
                arrival: settings.arrival_reward.into(),
            },
            prices: vec![0.0; mission.user_count()],
            values: None,
            normalizer: Normalizer::of_mission(&mission),
            entropy_when_forced: settings.entropy_when_forced,
            workspace: Workspace::default(),
            #[cfg(all(feature = "simd", target_arch = "x86_64"))]
            gains: (&mission as &dyn std::any::Any)
                .downcast_ref()
                .and_then(crate::gains::NodeGains::new)
                .map(Box::new),
            state: EpisodeState::start(&mission),
            mission,
        }
    }

    /// Adds the fairness prices `lambda_m` (`docs/bound.md`), bit/s/Hz, to the reward: serving
    /// user `m` earns `lambda_m - floor(N/M) sum lambda / N`, so that the prices sum to zero over
    /// a mission in which every user is served exactly its quota.
    pub fn with_prices(mut self, prices: &[f64]) -> Self {
        let (slots, quota) = (self.mission.slots(), self.mission.quota());
        let paid = f64::from(quota) * prices.iter().sum::<f64>();
        let mean = paid / f64::from(slots);
        self.prices = prices.iter().map(|price| price - mean).collect();
        self
    }

    /// Returns what serving each user earns besides the rate, bit/s/Hz.
    pub fn prices(&self) -> &[f64] {
        &self.prices
    }

    /// Adds `V_n(q_n) - V_{n-1}(q_{n-1})` to the reward of slot `n`: potential-based shaping
    /// (Ng, Harada and Russell, 1999) without its discount. Over a mission the added terms sum to
    /// `-V_0(q_0)` for every sequence of actions, so all returns shift by the same amount. A
    /// reward then includes what the slot leads to, and the discount applies only to what the
    /// relaxation does not model. [`value_to_go`](Self::value_to_go) computes `values`.
    pub fn with_values(mut self, values: Arc<ValueToGo>) -> Self {
        self.values = Some(values);
        self
    }

    /// Solves the relaxed mission with this environment's prices and power allocation. The result
    /// is meant for [`with_values`](Self::with_values).
    pub fn value_to_go(&self) -> ValueToGo {
        let mut scratch = self.clone();
        ValueToGo::new(&self.mission, |place| scratch.best_worth(place))
    }

    /// Returns the largest value of a slot at a place: rate plus price of the best user, bit/s/Hz.
    /// Moves the vehicle there.
    pub(crate) fn best_worth(&mut self, place: Position<T>) -> f64 {
        self.state.position = place;
        let worth = (0..self.mission.user_count()).map(|user| {
            let feasible = self.solve_slot(user);
            let rate = if feasible {
                self.state.rate.to_f64()
            } else {
                0.0
            };
            rate + self.prices[user]
        });
        worth.fold(f64::NEG_INFINITY, f64::max)
    }

    /// Returns `V_n(q_n)` of the present state, or 0 without shaping.
    fn potential(&self) -> f64 {
        let position = self.state.position;
        let place = Position::new(position.x.to_f64(), position.y.to_f64());
        let values = self.values.as_ref();
        values.map_or(0.0, |values| values.at(self.state.slots_done, &place))
    }

    /// Returns the sizes of the learning problem.
    pub fn dimensions(&self) -> Dimensions {
        let users = self.mission.user_count();
        Dimensions {
            users,
            observation: state_len(users),
        }
    }

    /// Returns the mission.
    pub fn mission(&self) -> &Mission<T, USERS_MAX, SENSORS_MAX> {
        &self.mission
    }

    /// Starts a new episode.
    pub fn reset(&mut self) {
        self.state = EpisodeState::start(&self.mission);
    }

    /// Returns the position of the vehicle, metres.
    pub fn position(&self) -> Position<T> {
        self.state.position
    }

    /// Returns the sums over the current episode so far.
    pub fn episode(&self) -> &Episode {
        &self.state.episode
    }

    /// Writes the normalized observation into `state`, which must hold [`Dimensions::observation`] numbers. Before the
    /// first slot, rate and MSE are 0.
    pub fn observe(&self, state: &mut [f32]) {
        self.observe_raw(state);
        self.normalizer.apply(state);
    }

    /// As [`observe`](Self::observe), in raw units: the input of a policy file of format version 1.
    pub fn observe_raw(&self, state: &mut [f32]) {
        let mut raw = [T::zero(); state_len(USERS_MAX)];
        let len = self.observation().write_state(&mut raw);
        for (x, raw) in state.iter_mut().zip(&raw[..len]) {
            *x = raw.to_f64() as f32;
        }
    }

    /// Returns the observation that a policy decides the coming slot from.
    pub fn observation(&self) -> Observation<'_, T> {
        Observation {
            slot: self.state.slots_done + 1,
            counts: self.state.fairness.counts(),
            rate: self.state.rate,
            mse: self.state.mse,
            position: self.state.position,
            agility: Agility::ideal(&self.mission),
        }
    }

    /// Returns the observation of the mission as sets: the input of a policy file of format version
    /// 2.
    pub fn observe_sets(&mut self) -> SetsObservation {
        let observation = Observation {
            slot: self.state.slots_done + 1,
            counts: self.state.fairness.counts(),
            rate: self.state.rate,
            mse: self.state.mse,
            position: self.state.position,
            agility: Agility::ideal(&self.mission),
        };
        SetsObservation::new(&self.mission, &observation, &mut self.workspace)
    }

    /// Exchanges the episode under way and another one of the same mission. The state of an episode
    /// of another mission gives meaningless results.
    pub fn swap_state(&mut self, state: &mut EpisodeState<T>) {
        std::mem::swap(&mut self.state, state);
    }

    /// Returns the user with the highest score that may be served in the coming slot, the first of
    /// equals, as the controller chooses it in flight; and whether another user has a higher score.
    /// The scores, one per user, must be finite.
    pub fn choose_user(&self, scores: &[f32]) -> (usize, bool) {
        let admissible = self.admissible();
        let mut chosen = None;
        let mut highest = f32::NEG_INFINITY;
        for (user, &score) in scores.iter().enumerate() {
            highest = highest.max(score);
            if admissible >> user & 1 == 1 && chosen.is_none_or(|(_, best)| score > best) {
                chosen = Some((user, score));
            }
        }
        chosen.map_or((0, true), |(user, score)| (user, highest > score))
    }

    /// Returns the users that may be served in the coming slot: all users in the penalty form and
    /// after slot `N`.
    pub fn admissible(&self) -> UserSet {
        let users = self.mission.user_count();
        let all = UserSet::MAX >> (UserSet::BITS - users as u32);
        if self.constraints == Constraints::Penalty || self.state.slots_done == self.mission.slots()
        {
            return all;
        }
        let admissible = self.state.fairness.admissible();
        admissible.fold(0, |set, user| set | 1 << user)
    }

    /// Returns whether the displacement's entropy counts in this state. It does not if
    /// [`EnvironmentSettings::entropy_when_forced`] is false and the shield leaves only one way to
    /// fly, because the flight to the destination takes all the slots that are left (up to a
    /// slack of 3 % of `V_max delta`).
    pub fn entropy_mask(&self) -> bool {
        if self.entropy_when_forced || self.constraints == Constraints::Penalty {
            return true;
        }
        let left = self.mission.slots() - self.state.slots_done;
        let distance_m = (self.state.position - self.mission.parameters().destination).norm();
        let slack_m = self.mission.reach_m() * T::count(left as usize + 1) - distance_m;
        slack_m > self.mission.reach_m() * T::of(FORCED_SLACK)
    }

    /// Returns the result that [`advance`](Self::advance) would have, and writes the observation
    /// that would follow, without changing the environment's state.
    pub fn peek_step(&mut self, action: &Action, next_observation: &mut [f32]) -> StepResult {
        let saved = self.state.clone();
        let result = self.advance(action, next_observation);
        self.state = saved;
        result
    }

    /// Flies a slot and writes the observation that follows.
    pub fn advance(&mut self, action: &Action, next_observation: &mut [f32]) -> StepResult {
        let step = self.step(action);
        self.observe(next_observation);
        StepResult {
            step,
            admissible: self.admissible(),
            entropy_mask: self.entropy_mask(),
        }
    }

    /// Flies a slot. After slot `N` the environment must be [`reset`](Self::reset) before the next
    /// step.
    pub fn step(&mut self, action: &Action) -> Step {
        let slot = self.state.slots_done + 1;
        let before = self.potential();
        let reach = self.mission.reach_m();
        let wish = Displacement::new(
            T::of(action.components[0].into()) * reach,
            T::of(action.components[1].into()) * reach,
        );
        let mut intervention = Intervention::default();
        let waypoint = shield::admissible_waypoint(&self.reachable(slot), &wish, &mut intervention);
        let fair = self.state.fairness.admits(action.user);
        self.state.position = waypoint;
        let feasible = self.solve_slot(action.user);
        self.state.fairness.record(Some(action.user));
        self.state.slots_done = slot;

        let last = slot >= self.mission.slots();
        let left_m = (waypoint - self.mission.parameters().destination).norm();
        let arrived = last && self.mission.has_arrived(&waypoint);
        let rate = self.state.rate.to_f64();
        let rate_reward = if fair && feasible { rate } else { 0.0 };
        let trajectory = if arrived {
            self.weights.arrival
        } else {
            -f64::from(slot) * left_m.to_f64()
        };
        let price = if fair { self.prices[action.user] } else { 0.0 };
        let shaping = self.potential() - before;
        let total = self.weights.rate * (rate_reward + price + shaping)
            + self.weights.trajectory * trajectory;

        let e = &mut self.state.episode;
        e.reward += total;
        e.rate_reward += self.weights.rate * rate_reward;
        e.trajectory_reward += self.weights.trajectory * trajectory;
        e.sum_rate += rate;
        e.mse_violations += u32::from(!feasible);
        e.interventions += u32::from(intervention.any());
        e.arrived = arrived;
        e.fair = self.state.fairness.is_fair();
        Step {
            reward: Reward {
                rate: rate_reward,
                trajectory,
                total,
            },
            rate,
            mse: self.state.mse.to_f64(),
            feasible,
            intervention,
            last,
        }
    }

    /// Returns the places that slot `slot` may end at.
    fn reachable(&self, slot: u32) -> ReachableSet<T> {
        match self.constraints {
            Constraints::Shielded => {
                ReachableSet::of_slot(&self.mission, slot, self.state.position)
            }
            Constraints::Penalty => {
                let p = self.mission.parameters();
                // No place of the area is farther from the destination than this, so only area and
                // speed restrict the flight: the paper's boundary projection.
                let anywhere = p.area.east_m + p.area.north_m;
                let reach = self.mission.reach_m();
                ReachableSet::new(p.area, self.state.position, reach, p.destination, anywhere)
            }
        }
    }

    /// Computes rate and MSE of serving `user` from the present position, and returns whether the
    /// MSE threshold `Gamma` is met.
    fn solve_slot(&mut self, user: usize) -> bool {
        let mut amplitude_gains = [T::zero(); SENSORS_MAX];
        let amplitude_gains = &mut amplitude_gains[..self.mission.sensor_count()];
        let user_gain = self.write_gains(user, amplitude_gains);
        let mut coefficients = [T::zero(); SENSORS_MAX];
        let allocation = self
            .workspace
            .sensors_of_amplitude(&self.limits, amplitude_gains)
            .and_then(|field| {
                let user_gain = Some(user_gain);
                field.allocate(&self.method, amplitude_gains, user_gain, &mut coefficients)
            });
        // The channels of a valid mission always give a valid slot problem.
        let Ok(SlotAllocation { solution, mse }) = allocation else {
            debug_assert!(false, "{allocation:?}");
            return false;
        };
        self.state.rate = solution.rate;
        self.state.mse = mse;
        matches!(solution.status, Status::Optimal { .. })
    }

    /// Writes the amplitude gains of the sensors from the present position, and returns the power
    /// gain of a user.
    fn write_gains(&mut self, user: usize, amplitudes: &mut [T]) -> PowerGain<T> {
        let position = self.state.position;
        #[cfg(all(feature = "simd", target_arch = "x86_64"))]
        if let Some(gains) = &mut self.gains {
            // `T` is `f64`: these conversions do nothing.
            let double = |place: Position<T>| Position::new(place.x.to_f64(), place.y.to_f64());
            let ground = self.mission.parameters().users[user];
            let mut power = 0.0;
            let sensors = gains.at(&double(position), &double(ground), &mut power);
            for (amplitude, &sensor) in amplitudes.iter_mut().zip(sensors) {
                *amplitude = T::of(sensor);
            }
            return PowerGain(T::of(power));
        }
        let gain = |node| self.mission.power_gain(node, &position);
        for (sensor, amplitude) in amplitudes.iter_mut().enumerate() {
            *amplitude = gain(GroundNode::Sensor(sensor)).amplitude();
        }
        gain(GroundNode::User(user))
    }
}

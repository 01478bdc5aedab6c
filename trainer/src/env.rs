//! The learning environment: the MDP of Sec. V-A over the onboard code.
//!
//! Shield, fairness rule, channel, slot solution and MSE are firmware-core's; only the
//! reward is written here:
//!
//! ```text
//! r   = lambda_1 (r^c + p_m) + lambda_2 r^d
//! r^c = R_n  where the slot keeps the constraints, else 0
//! r^d = R_f  if n = N and ||q_N - q_f|| <= V_max delta,  else  -n ||q_n - q_f||
//! ```
//!
//! `p_m` is the price of fairness of the served user `m`, where the settings ask for prices
//! ([`Environment::with_prices`]), else 0 as in the paper. Where they ask for value shaping
//! ([`Environment::with_values`]), what is still to be had after the slot is added and what was
//! to be had before it is taken away: a reward is then what the slot cost against the best that
//! the relaxed mission could do.
//!
//! [`Constraints::Shielded`] flies what would fly: displacement and user are projected, so every
//! episode arrives and is fair. [`Constraints::Penalty`] is the paper's form: area and speed are
//! projected, fairness and arrival are only paid for.

use std::sync::Arc;

use firmware_core::{
    Displacement, Mission, Position, PowerGain, SENSORS_MAX, Scalar, USERS_MAX,
    aircomp::Slot,
    inner::{Method, SlotLimits, Status, Workspace},
    policy::Observation,
    shield::{self, Fairness, Intervention, ReachableSet},
};

use crate::{
    learner::{Choice, Dimensions},
    relaxation::ValueToGo,
    replay::UserSet,
    settings::{Constraints, Settings},
};

/// Scales the paper's state to numbers around `[-1, 1]`: `(x - offset) * scale`. Part of the
/// exported policy.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Normalizer {
    /// What to subtract, raw units.
    pub offset: Vec<f32>,
    /// What to multiply with, one over raw units.
    pub scale: Vec<f32>,
}

impl Normalizer {
    /// Counts by the quota, the rate by its limit `log2(1/(1 - J Gamma))`, the MSE by `Gamma`,
    /// positions by the area.
    pub fn of_mission<T: Scalar>(mission: &Mission<T, USERS_MAX, SENSORS_MAX>) -> Self {
        let p = mission.parameters();
        // Full scale of every component: [0, full] becomes [-1, 1].
        let full = std::iter::repeat_n(f64::from(mission.quota().max(1)), mission.user_count())
            .chain([
                mission.slot_rate_limit().to_f64(),
                p.mse_threshold.to_f64(),
                p.area.east_m.to_f64(),
                p.area.north_m.to_f64(),
            ]);
        let (offset, scale) = full
            .map(|full| ((full / 2.0) as f32, (2.0 / full) as f32))
            .unzip();
        Self { offset, scale }
    }

    /// Normalises in place.
    pub fn apply(&self, state: &mut [f32]) {
        for ((x, offset), scale) in state.iter_mut().zip(&self.offset).zip(&self.scale) {
            *x = (*x - offset) * scale;
        }
    }
}

/// The parts of a step's reward, for logs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reward {
    /// `r^c`, bit/s/Hz.
    pub rate: f64,
    /// `r^d`, metres times slots (or `R_f`).
    pub trajectory: f64,
    /// `lambda_1 (r^c + p_m) + lambda_2 r^d`, shaped or not.
    pub total: f64,
}

/// What a step came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The reward and its parts.
    pub reward: Reward,
    /// `R_n`, bit/s/Hz, whether or not it was rewarded.
    pub rate: f64,
    /// Whether the slot met `Gamma`.
    pub feasible: bool,
    /// What the shield changed.
    pub intervention: Intervention,
    /// Slot `N` is over.
    pub last: bool,
}

/// A step and where it leads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outlook {
    /// What it came to.
    pub step: Step,
    /// Who may be served next.
    pub admissible: UserSet,
    /// Whether the displacement's entropy counts next: [`Environment::has_choice`].
    pub has_choice: bool,
}

/// How an episode ended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Episode {
    /// Sum of rewards.
    pub reward: f64,
    /// Sum of `lambda_1 r^c`.
    pub rate_reward: f64,
    /// Sum of `lambda_2 r^d`.
    pub trajectory_reward: f64,
    /// Sum of `R_n`, bit/s/Hz.
    pub sum_rate: f64,
    /// Slots that missed `Gamma`.
    pub mse_violations: u32,
    /// Slots in which the shield changed the displacement.
    pub interventions: u32,
    /// Whether it ended within one slot of the destination.
    pub arrived: bool,
    /// Whether every user had its quota.
    pub fair: bool,
}

/// Slack below which the shield leaves no choice, in units of `V_max delta`.
const FORCED: f64 = 0.03;

/// Weights of the reward.
#[derive(Clone, Copy, Debug)]
struct Weights {
    rate: f64,
    trajectory: f64,
    arrival: f64,
}

/// One mission, flown over and over. `T` is `f64` as in the host's simulations, or `f32`.
#[derive(Clone, Debug)]
pub struct Environment<T: Scalar> {
    mission: Mission<T, USERS_MAX, SENSORS_MAX>,
    limits: SlotLimits<T>,
    method: Method<T>,
    constraints: Constraints,
    weights: Weights,
    /// `p_m`, bit/s/Hz.
    prices: Vec<f64>,
    values: Option<Arc<ValueToGo>>,
    entropy_when_forced: bool,
    normalizer: Normalizer,
    workspace: Workspace<T, SENSORS_MAX>,
    now: Moment<T>,
}

/// What changes from slot to slot.
#[derive(Clone, Debug)]
struct Moment<T: Scalar> {
    fairness: Fairness<USERS_MAX>,
    slots_done: u32,
    position: Position<T>,
    rate: T,
    mse: T,
    episode: Episode,
}

impl<T: Scalar> Moment<T> {
    fn start(mission: &Mission<T, USERS_MAX, SENSORS_MAX>) -> Self {
        Self {
            fairness: Fairness::new(mission),
            slots_done: 0,
            position: mission.parameters().start,
            rate: T::zero(),
            mse: T::zero(),
            episode: Episode::default(),
        }
    }
}

impl<T: Scalar> Environment<T> {
    /// At the start of the mission.
    pub fn new(mission: Mission<T, USERS_MAX, SENSORS_MAX>, settings: &Settings) -> Self {
        Self {
            limits: SlotLimits::of_mission(&mission),
            method: settings.inner.method(&mission),
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
            now: Moment::start(&mission),
            mission,
        }
    }

    /// With prices of fairness `lambda_m` (`docs/bound.md`), bit/s/Hz: serving `m` earns
    /// `lambda_m` less `floor(N/M) sum lambda / N`, so that they add up to nothing over a
    /// mission in which every user has its quota.
    pub fn with_prices(mut self, prices: &[f64]) -> Self {
        let (slots, quota) = (self.mission.slots(), self.mission.quota());
        let paid = f64::from(quota) * prices.iter().sum::<f64>();
        let mean = paid / f64::from(slots);
        self.prices = prices.iter().map(|price| price - mean).collect();
        self
    }

    /// Adds `V_n(q_n) - V_{n-1}(q_{n-1})` to the reward of slot `n`: potential-based shaping
    /// (Ng, Harada and Russell, 1999) without its discount. Over a mission it adds up to
    /// `-V_0(q_0)` whatever is done, so returns keep their order and their distances; but a
    /// reward then holds what the slot leads to, and the discount weighs only what the
    /// relaxation does not know.
    pub fn with_values(mut self, values: Arc<ValueToGo>) -> Self {
        self.values = Some(values);
        self
    }

    /// What a slot is worth at a place at most: the best user's rate and price, bit/s/Hz.
    pub(crate) fn best_worth(&mut self, place: Position<T>) -> f64 {
        self.now.position = place;
        let worth = (0..self.mission.user_count()).map(|user| {
            let feasible = self.solve_slot(user);
            let rate = if feasible {
                self.now.rate.to_f64()
            } else {
                0.0
            };
            rate + self.prices[user]
        });
        worth.fold(f64::NEG_INFINITY, f64::max)
    }

    /// `V_n(q_n)`, where there is shaping.
    fn value_to_go(&self) -> f64 {
        let position = self.now.position;
        let place = Position::new(position.x.to_f64(), position.y.to_f64());
        let values = self.values.as_ref();
        values.map_or(0.0, |values| values.at(self.now.slots_done, &place))
    }

    /// Sizes for the learner.
    pub fn dimensions(&self) -> Dimensions {
        let users = self.mission.user_count();
        Dimensions {
            users,
            observation: Observation::<T>::state_len(users),
        }
    }

    /// The mission.
    pub fn mission(&self) -> &Mission<T, USERS_MAX, SENSORS_MAX> {
        &self.mission
    }

    /// Back to the start.
    pub fn reset(&mut self) {
        self.now = Moment::start(&self.mission);
    }

    /// Where the vehicle is, metres.
    pub fn position(&self) -> Position<T> {
        self.now.position
    }

    /// The episode so far.
    pub fn episode(&self) -> &Episode {
        &self.now.episode
    }

    /// Writes the normalised state; `state` must hold `M + 4` numbers.
    pub fn observe(&self, state: &mut [f32]) {
        let mut raw = [T::zero(); USERS_MAX + 4];
        let len = Observation {
            slot: self.now.slots_done + 1,
            counts: self.now.fairness.counts(),
            rate: self.now.rate,
            mse: self.now.mse,
            position: self.now.position,
        }
        .write_state(&mut raw);
        for (x, raw) in state.iter_mut().zip(&raw[..len]) {
            *x = raw.to_f64() as f32;
        }
        self.normalizer.apply(state);
    }

    /// Who may be served in the coming slot. In the penalty form and after slot `N`: everybody.
    pub fn admissible(&self) -> UserSet {
        let users = self.mission.user_count();
        let everybody = UserSet::MAX >> (UserSet::BITS - users as u32);
        if self.constraints == Constraints::Penalty || self.now.slots_done == self.mission.slots() {
            return everybody;
        }
        (0..users)
            .filter(|&user| self.now.fairness.admits(user))
            .fold(0, |set, user| set | 1 << user)
    }

    /// Whether the displacement's entropy counts in this state: whether the shield leaves a
    /// choice, where the settings make that distinction. It leaves none once the way home takes
    /// all the slots that are left, up to [`FORCED`].
    pub fn has_choice(&self) -> bool {
        if self.entropy_when_forced || self.constraints == Constraints::Penalty {
            return true;
        }
        let left = self.mission.slots() - self.now.slots_done;
        let home_m = (self.now.position - self.mission.parameters().destination).norm();
        let slack_m = self.mission.reach_m() * T::count(left as usize + 1) - home_m;
        slack_m > self.mission.reach_m() * T::of(FORCED)
    }

    /// What [`step`](Self::step) would come to, and lead to. Writes the state that follows;
    /// nothing is flown.
    pub fn foresee(&mut self, choice: &Choice, state: &mut [f32]) -> Outlook {
        let now = self.now.clone();
        let outlook = self.advance(choice, state);
        self.now = now;
        outlook
    }

    /// Flies a slot and writes the state that follows.
    pub fn advance(&mut self, choice: &Choice, state: &mut [f32]) -> Outlook {
        let step = self.step(choice);
        self.observe(state);
        Outlook {
            step,
            admissible: self.admissible(),
            has_choice: self.has_choice(),
        }
    }

    /// Flies a slot. Steps after the last one go nowhere: [`reset`](Self::reset) first.
    pub fn step(&mut self, choice: &Choice) -> Step {
        let slot = self.now.slots_done + 1;
        let before = self.value_to_go();
        let reach = self.mission.reach_m();
        let wish = Displacement::new(
            T::of(choice.action[0].into()) * reach,
            T::of(choice.action[1].into()) * reach,
        );
        let mut intervention = Intervention::default();
        let waypoint = shield::admissible_waypoint(&self.reachable(slot), &wish, &mut intervention);
        let fair = self.now.fairness.admits(choice.user);
        self.now.position = waypoint;
        let feasible = self.solve_slot(choice.user);
        self.now.fairness.record(Some(choice.user));
        self.now.slots_done = slot;

        let last = slot >= self.mission.slots();
        let left_m = (waypoint - self.mission.parameters().destination).norm();
        let arrived = last && self.mission.has_arrived(&waypoint);
        let rate = self.now.rate.to_f64();
        let rate_reward = if fair && feasible { rate } else { 0.0 };
        let trajectory = if arrived {
            self.weights.arrival
        } else {
            -f64::from(slot) * left_m.to_f64()
        };
        let price = if fair { self.prices[choice.user] } else { 0.0 };
        let gained = self.value_to_go() - before;
        let total = self.weights.rate * (rate_reward + price + gained)
            + self.weights.trajectory * trajectory;

        let e = &mut self.now.episode;
        e.reward += total;
        e.rate_reward += self.weights.rate * rate_reward;
        e.trajectory_reward += self.weights.trajectory * trajectory;
        e.sum_rate += rate;
        e.mse_violations += u32::from(!feasible);
        e.interventions += u32::from(intervention.any());
        e.arrived = arrived;
        e.fair = self.now.fairness.is_fair();
        Step {
            reward: Reward {
                rate: rate_reward,
                trajectory,
                total,
            },
            rate,
            feasible,
            intervention,
            last,
        }
    }

    fn reachable(&self, slot: u32) -> ReachableSet<T> {
        match self.constraints {
            Constraints::Shielded => ReachableSet::of_slot(&self.mission, slot, self.now.position),
            Constraints::Penalty => {
                let p = self.mission.parameters();
                // Far enough home for any place of the area: the paper's boundary projection.
                let anywhere = p.area.east_m + p.area.north_m;
                let reach = self.mission.reach_m();
                ReachableSet::new(p.area, self.now.position, reach, p.destination, anywhere)
            }
        }
    }

    /// Rate and MSE of serving `user` from here; whether `Gamma` is met.
    fn solve_slot(&mut self, user: usize) -> bool {
        let p = self.mission.parameters();
        let channel = self.mission.channel();
        let mut gains = [PowerGain(T::zero()); SENSORS_MAX];
        let gains = &mut gains[..p.sensors.len()];
        for (gain, sensor) in gains.iter_mut().zip(&p.sensors) {
            *gain = channel.power_gain(&self.now.position, sensor);
        }
        let user_gain = channel.power_gain(&self.now.position, &p.users[user]);
        let solution = self
            .workspace
            .sensors(&self.limits, gains)
            .and_then(|field| self.method.solve(&field, Some(user_gain)));
        // A valid mission's channels make a slot problem.
        let Ok(solution) = solution else {
            debug_assert!(false, "{solution:?}");
            return false;
        };
        let mut coefficients = [T::zero(); SENSORS_MAX];
        let coefficients = &mut coefficients[..gains.len()];
        for (coefficient, &gain) in coefficients.iter_mut().zip(gains.iter()) {
            *coefficient = solution.coefficient(gain);
        }
        self.now.rate = solution.rate;
        self.now.mse = Slot {
            sensor_gains: gains,
            sensor_coefficients: coefficients,
            user_gain,
            user_power: solution.user_power,
            noise_power: self.limits.noise_power,
        }
        .mse(solution.normalizing_factor);
        matches!(solution.status, Status::Optimal { .. })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        learner::Learner,
        sac::Sac,
        settings::{Algorithm, Preset},
    };
    use firmware_core::{
        controller::{ChannelState, Controller},
        policy::{Action, Policy},
    };
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;
    use scenario::{HostMission, Scenario};
    use std::{cell::RefCell, rc::Rc};

    fn mission(name: &str) -> HostMission {
        Scenario::shipped(name).expect("shipped").mission
    }

    fn settings(constraints: Constraints) -> Settings {
        Settings {
            constraints,
            ..Settings::preset(Preset::Paper, Algorithm::Sac, 1)
        }
    }

    /// Hands the controller what the environment was told to do.
    struct Told(Rc<RefCell<Choice>>, f64, usize);

    impl Policy<f64, USERS_MAX> for Told {
        fn decide(&mut self, _: &Observation<'_, f64>) -> Action<f64, USERS_MAX> {
            let choice = self.0.borrow();
            let component = |i: usize| f64::from(choice.action[i]) * self.1;
            Action {
                displacement: Displacement::new(component(0), component(1)),
                user_scores: (0..self.2)
                    .map(|m| f64::from(u8::from(m == choice.user)))
                    .collect(),
            }
        }
    }

    /// The environment that trains is the environment that flies: same waypoints, rates and MSE
    /// as the controller, bit for bit.
    #[test]
    fn random_episodes_equal_the_controllers_flights() {
        for name in ["separated", "mixed"] {
            let mission = mission(name);
            let mut rng = Pcg64Mcg::seed_from_u64(4);
            let mut environment =
                Environment::new(mission.clone(), &settings(Constraints::Shielded));
            let users = mission.user_count();
            for _ in 0..20 {
                environment.reset();
                let told = Rc::new(RefCell::new(Choice::default()));
                let policy = Told(Rc::clone(&told), mission.reach_m(), users);
                let mut controller = Controller::new(mission.clone(), policy);
                let mut sum_rate = 0.0;
                while !controller.is_over() {
                    let admissible = environment.admissible();
                    let mut choice = told.borrow_mut();
                    Sac::choose_at_random(users, admissible, &mut rng, &mut choice);
                    let from = environment.position();
                    let step = environment.step(&choice);
                    drop(choice);
                    let plan = controller.plan(from).expect("at rest");
                    assert_eq!(plan.waypoint, environment.position());
                    assert_eq!(plan.served_user, told.borrow().user);
                    assert!(!plan.intervention.user);
                    let state = ChannelState::predicted(&mission, plan.slot, &plan.waypoint);
                    let command = controller.allocate(&state).expect("planned");
                    assert_eq!(command.rate, step.rate);
                    assert_eq!(command.mse, environment.now.mse);
                    sum_rate += command.rate;
                }
                let episode = environment.episode();
                assert_eq!(episode.sum_rate, sum_rate);
                assert!(episode.arrived && episode.fair);
                assert_eq!(episode.mse_violations, 0);
            }
        }
    }

    #[test]
    fn the_reward_is_the_papers() {
        let mission = mission("separated");
        let mut settings = settings(Constraints::Shielded);
        (settings.rate_weight, settings.trajectory_weight) = (2.0, 0.5);
        settings.arrival_reward = 7.0;
        let mut environment = Environment::new(mission.clone(), &settings);
        let mut choice = Choice {
            action: vec![0.7, 0.7],
            user: 0,
        };
        for slot in 1..=60_u32 {
            choice.user = (slot as usize - 1) % 15;
            let step = environment.step(&choice);
            let left = (environment.position() - mission.parameters().destination).norm();
            let trajectory = if slot == 60 {
                7.0
            } else {
                -f64::from(slot) * left
            };
            assert_eq!(step.reward.trajectory, trajectory);
            assert_eq!(step.reward.rate, step.rate);
            assert_eq!(step.reward.total, 2.0 * step.rate + 0.5 * trajectory);
            assert_eq!(step.last, slot == 60);
        }
    }

    /// Prices move rewards between slots and add up to nothing over a fair mission.
    #[test]
    fn prices_leave_the_return_of_a_fair_mission_as_it_is() {
        let mission = mission("mixed");
        let prices: Vec<f64> = (0..15).map(|user| 0.1 * f64::from(user) - 0.3).collect();
        let settings = settings(Constraints::Shielded);
        let plain = Environment::new(mission, &settings);
        let (mut plain, mut priced) = (plain.clone(), plain.with_prices(&prices));
        let mut rng = Pcg64Mcg::seed_from_u64(2);
        let mut choice = Choice::default();
        let mut moved = 0;
        for _ in 0..60 {
            Sac::choose_at_random(15, plain.admissible(), &mut rng, &mut choice);
            let (a, b) = (plain.step(&choice).reward, priced.step(&choice).reward);
            assert_eq!(a.rate, b.rate);
            // The mean price is 0.4.
            let expected = prices[choice.user] - 0.4;
            assert!((b.total - a.total - expected).abs() < 1e-12);
            moved += u32::from(expected.abs() > 0.1);
        }
        assert!(moved > 40, "{moved}");
        let (plain, priced) = (plain.episode(), priced.episode());
        assert!(plain.fair && (plain.reward - priced.reward).abs() < 1e-9);
    }

    /// Shaping moves rewards between slots: over any mission it adds up to the same.
    #[test]
    fn shaping_shifts_the_return_of_every_mission_alike() {
        let settings = settings(Constraints::Shielded);
        let plain = Environment::new(mission("mixed"), &settings);
        let values = Arc::new(ValueToGo::new(&plain));
        let at_start = values.at(0, &plain.position());
        assert!(at_start > 60.0, "{at_start}");
        let (mut plain, mut shaped) = (plain.clone(), plain.with_values(values));
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let mut choice = Choice::default();
        for _ in 0..5 {
            let mut moved = 0.0_f64;
            for _ in 0..60 {
                Sac::choose_at_random(15, plain.admissible(), &mut rng, &mut choice);
                let (a, b) = (plain.step(&choice).reward, shaped.step(&choice).reward);
                moved = moved.max((b.total - a.total).abs());
            }
            assert!(moved > 0.5, "{moved}");
            let shift = shaped.episode().reward - plain.episode().reward;
            assert!((shift + at_start).abs() < 1e-9, "{shift} {at_start}");
            plain.reset();
            shaped.reset();
        }
    }

    /// What is foreseen for a user is what comes when it is served, and nothing is flown.
    #[test]
    fn what_is_foreseen_comes_true() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let settings = settings(Constraints::Shielded);
        let mut environment = Environment::new(mission("separated"), &settings);
        let (mut before, mut after) = (vec![0.0; 19], vec![0.0; 19]);
        let mut foreseen = vec![0.0; 19];
        let mut choice = Choice::default();
        loop {
            Sac::choose_at_random(15, environment.admissible(), &mut rng, &mut choice);
            environment.observe(&mut before);
            let outlook = environment.foresee(&choice, &mut foreseen);
            environment.observe(&mut after);
            assert_eq!(before, after);
            assert_eq!(environment.advance(&choice, &mut after), outlook);
            assert_eq!(after, foreseen);
            if outlook.step.last {
                break;
            }
        }
    }

    /// On the way home at full speed, and only there, the displacement is no choice.
    #[test]
    fn there_is_no_choice_once_the_way_home_takes_every_slot() {
        let settings = Settings {
            entropy_when_forced: false,
            ..settings(Constraints::Shielded)
        };
        let mission = mission("separated");
        let mut environment = Environment::new(mission.clone(), &settings);
        let away = |sign: f32| Choice {
            action: vec![sign, sign],
            user: 0,
        };
        let mut forced = 0;
        for slot in 0..60_usize {
            let (has_choice, from) = (environment.has_choice(), environment.position());
            let places = [1.0, -1.0].map(|sign| {
                let mut branch = environment.clone();
                branch.step(&away(sign));
                branch.position()
            });
            if !has_choice {
                // Whatever is asked for, it goes the same way.
                assert!((places[0] - places[1]).norm() < 15.0, "slot {slot}");
                forced += 1;
            } else if (from - mission.parameters().start).norm() < 1.0 && slot < 10 {
                assert!((places[0] - places[1]).norm() > 25.0, "slot {slot}");
            }
            environment.step(&Choice {
                user: slot % 15,
                ..away(-1.0)
            });
        }
        assert!((20..50).contains(&forced), "{forced}");
    }

    /// In the penalty form nothing but area and speed is enforced, and it shows in the reward.
    #[test]
    fn the_penalty_form_lets_constraints_be_broken_and_charges_for_it() {
        let mission = mission("separated");
        let mut environment = Environment::new(mission, &settings(Constraints::Penalty));
        let choice = Choice {
            action: vec![-1.0, -1.0],
            user: 3,
        };
        let mut unpaid = 0;
        loop {
            assert_eq!(environment.admissible(), 0x7fff);
            let step = environment.step(&choice);
            unpaid += u32::from(step.rate > 0.0 && step.reward.rate == 0.0);
            if step.last {
                assert!(step.reward.trajectory < -60.0 * 1000.0);
                break;
            }
        }
        // 4 slots are user 3's, and everybody else's 56 can then no longer be met.
        assert_eq!(unpaid, 56);
        assert!(!environment.episode().arrived && !environment.episode().fair);
        assert_eq!(environment.position(), Position::new(0.0, 0.0));
    }

    #[test]
    fn observations_are_normalised_to_the_unit_cube() {
        let mission = mission("mixed");
        let mut rng = Pcg64Mcg::seed_from_u64(9);
        let mut environment = Environment::new(mission, &settings(Constraints::Shielded));
        let mut state = vec![f32::NAN; environment.dimensions().observation];
        let mut choice = Choice::default();
        loop {
            environment.observe(&mut state);
            assert!(
                state.iter().all(|x| (-1.0..=1.001).contains(x)),
                "{state:?}"
            );
            Sac::choose_at_random(15, environment.admissible(), &mut rng, &mut choice);
            if environment.step(&choice).last {
                break;
            }
        }
    }
}

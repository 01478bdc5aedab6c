//! The world around the vehicle: the true channels and the signals.
//!
//! The signals of a slot are drawn and superposed as in eq:yr: the symbol of every sensor times its
//! coefficient and its channel including the phase, the symbol of the user, and the noise of the
//! receiver. From the sum the vehicle estimates the average (eq:Fhat). Over many symbols this gives
//! an empirical MSE to compare with the analytic one; for the symbols of the sensors' measurements
//! it gives an estimate in physical units.
//!
//! Where the scenario has an `[uncertainty]` table, what is known and what is true differ
//! (`truth.rs`): the vehicle is told estimates of the channels, and the signals pass through the true
//! ones.

mod air;
mod field;
mod truth;

use firmware_core::{
    Position, PowerGain, SENSORS_MAX, USERS_MAX, aircomp,
    channel::GroundNode,
    controller::{ChannelQuality, ChannelState, SlotCommand},
    inner::{Method, SlotLimits, UncertainWorkspace, Workspace},
    time::Duration,
    uncertainty::Uncertainty,
};
use nalgebra::Complex;
use rand::SeedableRng;
use rand_pcg::Pcg64;

use crate::{nomographic::Nomographic, record::SignalRecord};
use air::{Air, ChannelError, unit_symbol};
use scenario::{Events, HostMission, Scenario, Timeline};
use truth::Truth;

/// What is known of the channels of a slot: the estimates that the host sends.
pub type HostChannelState = ChannelState<f64, USERS_MAX, SENSORS_MAX>;
/// The slot command that the host receives.
pub type HostSlotCommand = SlotCommand<f64, SENSORS_MAX>;

/// Everything outside the vehicle.
#[derive(Clone, Debug)]
pub struct World {
    /// The mission as it is in each slot.
    timeline: Timeline,
    /// What differs from what is known; `None` if everything is known.
    truth: Option<Truth>,
    /// What is measured under each version of the mission.
    sensing: Vec<SensedValues>,
    seed: u64,
    symbols_per_slot: u32,
}

/// The measurements of the sensors that are there.
#[derive(Clone, Debug)]
struct SensedValues {
    function: Nomographic,
    /// The measurements, indexed by slot and sensor, in the scenario's unit.
    measurements: Vec<Vec<f64>>,
}

impl SensedValues {
    fn new(scenario: &Scenario, mission: &HostMission) -> Self {
        let all = scenario.sensing.measurements(mission);
        let of_present = |values: &[f64]| -> Vec<f64> {
            let present = mission.sensors().map(|(sensor, _)| sensor);
            // A sensor that joined has the weight of an average one.
            let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
            let value = |sensor: usize| values.get(sensor).copied().unwrap_or(mean);
            present.map(value).collect()
        };
        let measurements: Vec<_> = all.iter().map(|row| of_present(row)).collect();
        let weights = of_present(&scenario.sensing.weights);
        Self {
            function: Nomographic::new(scenario.sensing.function, &weights, &measurements),
            measurements,
        }
    }
}

/// The true result of a slot command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlotOutcome {
    /// eq:rate at the true channels, bit/s/Hz; where they are not known exactly, a rate that can be
    /// achieved.
    pub rate: f64,
    /// The MSE at the true channels; where they are not known exactly, its expectation.
    pub mse: f64,
    /// The rate of the same user at the same place if all channels were known exactly, bit/s/Hz;
    /// `None` in a world in which they are.
    pub perfect_rate: Option<f64>,
    /// The result of the drawn signals.
    pub signals: SignalRecord,
}

/// The default number of symbols drawn in a slot: 24,000 in a mission of 60 slots.
pub const SYMBOLS_PER_SLOT: u32 = 400;

impl World {
    /// Creates the world of a scenario in which these events happen. The same `seed` draws the same
    /// signals in every slot, whatever the policy does.
    pub fn new(scenario: &Scenario, events: &Events, seed: u64, symbols_per_slot: u32) -> Self {
        let timeline = events.timeline(&scenario.mission);
        let versions = timeline.versions().iter();
        Self {
            sensing: versions
                .map(|(_, mission)| SensedValues::new(scenario, mission))
                .collect(),
            timeline,
            truth: Truth::draw(scenario),
            seed,
            symbols_per_slot: symbols_per_slot.max(1),
        }
    }

    /// Returns the mission as it is in each slot.
    pub fn timeline(&self) -> &Timeline {
        &self.timeline
    }

    /// Returns whether the mission has this slot: 1 to `N`.
    pub fn has_slot(&self, slot: u32) -> bool {
        (1..=self.timeline.in_slot(slot).slots()).contains(&slot)
    }

    /// Returns whether the mission has this user in a slot: 0 to `M - 1`.
    pub fn has_user(&self, slot: u32, user: usize) -> bool {
        user < self.timeline.in_slot(slot).user_count()
    }

    /// Returns the estimates of the channels of a slot with the vehicle at `vehicle`; 0 for users and
    /// sensors that left, and for sensors that are silent.
    pub fn channel_state(&self, slot: u32, vehicle: &Position<f64>) -> HostChannelState {
        let mission = self.timeline.in_slot(slot);
        let mut state = ChannelState::predicted(mission, slot, vehicle);
        for (user, gain) in state.user_gains.iter_mut().enumerate() {
            let node = GroundNode::User(user);
            *gain = self.measured(mission.has_user(user), (node, *gain), slot, vehicle);
        }
        for (sensor, gain) in state.sensor_gains.iter_mut().enumerate() {
            let node = GroundNode::Sensor(sensor);
            *gain = self.measured(mission.has_sensor(sensor), (node, *gain), slot, vehicle);
        }
        state
    }

    /// Returns what pilots measure of a node with this gain in the channel model.
    fn measured(
        &self,
        is_there: bool,
        (node, modelled): (GroundNode, PowerGain<f64>),
        slot: u32,
        vehicle: &Position<f64>,
    ) -> PowerGain<f64> {
        let silence = PowerGain(0.0);
        match &self.truth {
            _ if !is_there => silence,
            None => modelled,
            Some(truth) => {
                let mission = self.timeline.in_slot(slot);
                let gain = truth.measured(mission, node, slot, vehicle);
                gain.unwrap_or(silence)
            }
        }
    }

    /// Returns the quality of the estimates from a slot on; `None` if they are exact.
    pub fn quality(&self, slot: u32) -> Option<ChannelQuality<USERS_MAX, SENSORS_MAX>> {
        let mission = self.timeline.in_slot(slot);
        (self.truth.as_ref()).and_then(|truth| truth.quality(mission, slot))
    }

    /// Returns whether the channel state of a slot never reaches the vehicle.
    pub fn loses_state(&self, slot: u32) -> bool {
        (self.truth.as_ref()).is_some_and(|truth| truth.loses_state(slot))
    }

    /// Returns the time from an arrival to its channel state.
    pub fn state_delay(&self) -> Duration {
        let delay_s = self.truth.as_ref().map_or(0.0, Truth::state_delay_s);
        Duration::from_secs_f64(delay_s)
    }

    /// Returns the result of a slot in which all users and sensors execute `command`, with the vehicle
    /// at `vehicle`.
    ///
    /// # Panics
    /// Panics if the mission does not have the command's [slot](Self::has_slot).
    pub fn transmit(&self, command: &HostSlotCommand, vehicle: &Position<f64>) -> SlotOutcome {
        let mission = self.timeline.in_slot(command.slot);
        let estimates = self.channel_state(command.slot, vehicle);
        let gains: Vec<_> = mission
            .of_sensors(&estimates.sensor_gains)
            .copied()
            .collect();
        let mut sent = command.sensor_coefficients.clone();
        // A sensor that the vehicle does not know yet is told nothing.
        let _ = sent.resize(mission.sensor_count(), 0.0);
        let coefficients: Vec<_> = mission.of_sensors(&sent).copied().collect();
        let slot = aircomp::Slot {
            sensor_gains: &gains,
            sensor_coefficients: &coefficients,
            user_gain: command
                .served_user
                .and_then(|user| estimates.user_gains.get(user))
                .copied()
                .unwrap_or_default(),
            user_power: command.user_power,
            noise_power: mission.parameters().noise_power,
        };
        let eta = command.normalizing_factor;
        let (rate, mse) = match self.statistics(command.slot, command.served_user) {
            None => (slot.rate(), slot.mse(eta)),
            Some(statistics) => {
                let statistics = statistics.of_slot();
                let rate = slot.achievable_rate(&statistics);
                (rate, slot.expected_mse(&statistics, eta))
            }
        };
        SlotOutcome {
            rate,
            mse,
            perfect_rate: self.truth.is_some().then(|| {
                let user = command.served_user;
                self.best_rate(&Method::Exact, command.slot, user, vehicle, None)
            }),
            signals: self.receive(&slot, command),
        }
    }

    /// Returns the statistics of the errors of the sensors that are there, and of a user; `None` if
    /// estimates have no errors.
    fn statistics(&self, slot: u32, user: Option<usize>) -> Option<Uncertainty<f64, SENSORS_MAX>> {
        let truth = self.truth.as_ref()?;
        let sensors = self.timeline.in_slot(slot).sensors();
        truth
            .has_channel_errors()
            .then(|| truth.statistics(sensors.map(|(sensor, _)| sensor), user))
    }

    /// Returns the rate, bit/s/Hz, of a slot in which `user`, if any, is served with the vehicle at
    /// `vehicle` and the powers that `method` allocates.
    ///
    /// # Panics
    /// Panics if the mission does not have this [user](Self::has_user).
    pub fn rate_at(
        &self,
        method: &Method<f64>,
        slot: u32,
        user: Option<usize>,
        vehicle: &Position<f64>,
    ) -> f64 {
        let statistics = self.statistics(slot, user);
        self.best_rate(method, slot, user, vehicle, statistics.as_ref())
    }

    /// As [`rate_at`](Self::rate_at), with errors of these statistics.
    fn best_rate(
        &self,
        method: &Method<f64>,
        slot: u32,
        user: Option<usize>,
        vehicle: &Position<f64>,
        statistics: Option<&Uncertainty<f64, SENSORS_MAX>>,
    ) -> f64 {
        let state = self.channel_state(slot, vehicle);
        let mission = self.timeline.in_slot(slot);
        let limits = SlotLimits::of_mission(mission);
        let gains: Vec<_> = mission.of_sensors(&state.sensor_gains).copied().collect();
        let user = user.map(|user| state.user_gains[user]);
        let solution = match statistics {
            None => {
                let mut workspace = Workspace::<f64, SENSORS_MAX>::default();
                let field = workspace.sensors(&limits, &gains);
                field.and_then(|field| method.solve(&field, user))
            }
            Some(statistics) => {
                let mut workspace = UncertainWorkspace::<f64, SENSORS_MAX>::default();
                let statistics = statistics.of_slot();
                let field = workspace.sensors(&limits, &gains, &statistics);
                field.and_then(|field| method.solve(&field, user))
            }
        };
        // The gains of the channel model always form a valid slot problem.
        solution.map_or(0.0, |solution| solution.rate)
    }

    /// Returns the errors of the estimates of the sensors that are there, and of the served user.
    fn errors(&self, command: &HostSlotCommand) -> (Vec<ChannelError>, ChannelError) {
        let truth = self
            .truth
            .as_ref()
            .filter(|truth| truth.has_channel_errors());
        let Some(truth) = truth else {
            return Default::default();
        };
        let sensors = self.timeline.in_slot(command.slot).sensors();
        (
            sensors
                .map(|(sensor, _)| truth.sensor_error(sensor))
                .collect(),
            command
                .served_user
                .map_or_else(ChannelError::default, |user| truth.user_error(user)),
        )
    }

    fn receive(&self, slot: &aircomp::Slot<'_, f64>, command: &HostSlotCommand) -> SignalRecord {
        // One generator per slot: the draws of a slot do not depend on earlier slots.
        let mut random = Pcg64::seed_from_u64(self.seed ^ (u64::from(command.slot) << 32));
        let air = Air::new(slot, self.errors(command), &mut random);
        let sensors = slot.sensor_gains.len() as f64;
        let average = |symbols: &[Complex<f64>]| symbols.iter().sum::<Complex<f64>>() / sensors;
        let estimate = |received: Complex<f64>| received * command.normalizing_factor / sensors;

        let mut symbols = vec![Complex::default(); slot.sensor_gains.len()];
        let (mut squares, mut fourth_powers) = (0.0, 0.0);
        for _ in 0..self.symbols_per_slot {
            symbols.fill_with(|| unit_symbol(&mut random));
            let received = air.superpose(&symbols, &mut random);
            let square = (estimate(received) - average(&symbols)).norm_sqr();
            squares += square;
            fourth_powers += square * square;
        }
        let count = f64::from(self.symbols_per_slot);
        let empirical_mse = squares / count;
        let variance = (fourth_powers / count - empirical_mse * empirical_mse).max(0.0);

        let SensedValues {
            function,
            measurements,
        } = &self.sensing[self.timeline.version_in(command.slot)];
        let measured = &measurements[command.slot as usize - 1];
        let own = function.pre_process(measured);
        let own: Vec<_> = own.into_iter().map(Complex::from).collect();
        let received = air.superpose(&own, &mut random);
        SignalRecord {
            empirical_mse,
            standard_error: (variance / count).sqrt(),
            symbols: self.symbols_per_slot,
            true_value: function.true_value(measured),
            // The measurements are real, so the estimate is the real part.
            estimate: function.post_process(estimate(received).re),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_core::{controller::Controller, policy::StraightLine};
    use scenario::{PerNode, Topology, Uncertainty, generate};

    /// The signals agree with the formula within 4 standard errors over 20,000 symbols in each of
    /// 60 slots, and within 3 over the mission. The seed is fixed, so the test is deterministic.
    #[test]
    fn empirical_mse_meets_the_analytic_one() {
        let scenario = generate(Topology::Separated, 1, 15, 36).unwrap();
        let world = World::new(&scenario, &Events::default(), 7, 20_000);
        let mission = scenario.mission.clone();
        let mut controller = Controller::new(mission.clone(), StraightLine::new(&mission));
        let mut place = mission.parameters().start;
        let mut sum = 0.0;
        for slot in 1..=mission.slots() {
            place = controller.plan(place).unwrap().waypoint;
            let command = controller
                .allocate(&world.channel_state(slot, &place))
                .unwrap();
            let outcome = world.transmit(&command, &place);
            assert!((outcome.mse / command.mse - 1.0).abs() < 1e-12);
            assert!((outcome.rate - command.rate).abs() < 1e-12);
            let ratio = outcome.signals.empirical_mse / outcome.mse;
            assert!(
                (ratio - 1.0).abs() < 4.0 / 20_000f64.sqrt(),
                "{slot}: {ratio}"
            );
            sum += ratio;
        }
        let slots = f64::from(mission.slots());
        assert!((sum / slots - 1.0).abs() < 3.0 / (20_000.0 * slots).sqrt());
    }

    fn uncertain(uncertainty: Uncertainty) -> Scenario {
        let scenario = Scenario::shipped("separated").unwrap();
        scenario.with_uncertainty(uncertainty).unwrap()
    }

    /// Flies a scenario on the straight line, without the ground link. Returns the commands and the
    /// outcomes of all slots.
    fn flown(
        scenario: &Scenario,
        symbols: u32,
        robust: bool,
    ) -> Vec<(HostSlotCommand, SlotOutcome)> {
        let world = World::new(scenario, &Events::default(), 7, symbols);
        let mission = scenario.mission.clone();
        let mut controller = Controller::new(mission.clone(), StraightLine::new(&mission));
        let mut place = mission.parameters().start;
        let slots = (1..=mission.slots()).map(|slot| {
            place = controller.plan(place).unwrap().waypoint;
            if let Some(quality) = world.quality(slot).filter(|_| robust) {
                controller.note_quality(&quality).unwrap();
            }
            let state = world.channel_state(slot, &place);
            let command = controller.allocate(&state).unwrap();
            let outcome = world.transmit(&command, &place);
            (command, outcome)
        });
        slots.collect()
    }

    /// The errors of issue 18: 0.05 and 0.3 rad.
    fn channel_errors() -> Uncertainty {
        Uncertainty {
            sensor_error_variance: PerNode::All(0.05),
            sensor_phase_error_rad: PerNode::All(0.3),
            user_error_variance: PerNode::All(0.05),
            ..Uncertainty::default()
        }
    }

    /// The signals agree with the *expected* MSE within 4 standard errors over 20,000 symbols in each
    /// slot, and within 3 over the mission, for robust and for naive allocations. Naive ones break
    /// `Gamma` in every slot; robust ones in none that is feasible.
    #[test]
    fn empirical_mse_meets_the_expected_one() {
        let scenario = uncertain(channel_errors());
        let threshold = scenario.mission.parameters().mse_threshold;
        for robust in [true, false] {
            let slots = flown(&scenario, 20_000, robust);
            let (mut sum, mut variance) = (0.0, 0.0);
            for (command, outcome) in &slots {
                let slot = command.slot;
                let SignalRecord {
                    empirical_mse,
                    standard_error,
                    ..
                } = outcome.signals;
                let off = (empirical_mse - outcome.mse) / standard_error;
                assert!(off.abs() < 4.0, "slot {slot}: {off} standard errors");
                sum += empirical_mse / outcome.mse;
                variance += (standard_error / outcome.mse).powi(2);
                if robust {
                    assert!(command.status.is_feasible());
                    assert!(outcome.mse <= threshold * (1.0 + 1e-9), "slot {slot}");
                    // What was told is rounded up.
                    assert!(outcome.mse <= command.mse && outcome.rate >= command.rate);
                } else {
                    assert!(outcome.mse > 1.05 * threshold, "slot {slot}");
                    assert!(
                        empirical_mse > threshold + 3.0 * standard_error,
                        "slot {slot}"
                    );
                }
                assert!(outcome.perfect_rate.unwrap() >= outcome.rate - 1e-9 || !robust);
            }
            let count = slots.len() as f64;
            let (mean, deviation) = (sum / count, variance.sqrt() / count);
            assert!(
                (mean - 1.0).abs() < 3.0 * deviation,
                "{mean} +- {deviation}"
            );
        }
    }

    /// Silent sensors are not heard, and send nothing, in the share of the slots that was asked for.
    #[test]
    fn silent_sensors_are_not_heard() {
        let scenario = uncertain(Uncertainty {
            silence_probability: PerNode::All(0.1),
            ..Uncertainty::default()
        });
        let world = World::new(&scenario, &Events::default(), 1, 1);
        let place = Position::new(400.0, 400.0);
        let mission = &scenario.mission;
        let (mut silent, mut heard) = (0.0, 0.0);
        for slot in 1..=mission.slots() {
            let state = world.channel_state(slot, &place);
            assert_eq!(state, world.channel_state(slot, &place));
            for (known, now) in ChannelState::predicted(mission, slot, &place)
                .sensor_gains
                .iter()
                .zip(&state.sensor_gains)
            {
                match now.0 == 0.0 {
                    true => silent += 1.0,
                    false => {
                        heard += 1.0;
                        assert_eq!(now, known);
                    }
                }
            }
        }
        let share: f64 = silent / (silent + heard);
        let deviation = f64::sqrt(0.1 * 0.9 / (silent + heard));
        assert!((share - 0.1).abs() < 4.0 * deviation, "{share}");
    }

    /// Gains fade around the model's as the factor that was asked for: shadowing in dB, and Rician
    /// fading in power, whose variance is `(1 + 2 K) / (1 + K)^2`.
    #[test]
    fn gains_vary_as_was_asked_for() {
        let k_db = 6.0;
        for (uncertainty, expected) in [
            (
                Uncertainty {
                    shadowing_db: 4.0,
                    ..Uncertainty::default()
                },
                [0.0, 16.0],
            ),
            (
                Uncertainty {
                    rician_k_db: Some(k_db),
                    ..Uncertainty::default()
                },
                [
                    1.0,
                    (1.0 + 2.0 * 10f64.powf(0.6)) / (1.0 + 10f64.powf(0.6)).powi(2),
                ],
            ),
        ] {
            let in_db = uncertainty.shadowing_db > 0.0;
            let mut values = Vec::new();
            for seed in 0..60 {
                let scenario = uncertain(Uncertainty {
                    seed,
                    ..uncertainty.clone()
                });
                let world = World::new(&scenario, &Events::default(), 1, 1);
                let place = Position::new(437.0, 612.0);
                let known = ChannelState::predicted(&scenario.mission, 1, &place);
                let state = world.channel_state(1, &place);
                let factors = known
                    .sensor_gains
                    .iter()
                    .zip(&state.sensor_gains)
                    .map(|(known, now)| now.0 / known.0);
                values.extend(
                    factors.map(|factor| if in_db { 10.0 * factor.log10() } else { factor }),
                );
            }
            let count = values.len() as f64;
            let mean = values.iter().sum::<f64>() / count;
            let variance = values
                .iter()
                .map(|value| (value - mean).powi(2))
                .sum::<f64>()
                / count;
            assert!(
                (mean - expected[0]).abs() < 4.0 * (expected[1] / count).sqrt(),
                "{mean}"
            );
            assert!(
                (variance / expected[1] - 1.0).abs() < 0.12,
                "{variance} {expected:?}"
            );
        }
    }

    /// Nodes are not where the map says, and the vehicle is told the gains of where they are.
    #[test]
    fn gains_are_those_of_the_true_places() {
        let scenario = uncertain(Uncertainty {
            position_error_m: 30.0,
            ..Uncertainty::default()
        });
        let world = World::new(&scenario, &Events::default(), 1, 1);
        let tracks = scenario.tracks();
        let place = Position::new(437.0, 612.0);
        let state = world.channel_state(5, &place);
        let mission = &scenario.mission;
        for (user, known) in mission.users() {
            let truly = tracks.place(GroundNode::User(user), 5, known);
            assert_ne!(truly, *known);
            let gain = mission.channel().power_gain(&place, &truly);
            assert_eq!(state.user_gains[user], gain);
        }
    }

    /// Without an `[uncertainty]` table, nothing is drawn and nothing is told that was not before.
    #[test]
    fn a_known_world_is_the_model() {
        let scenario = uncertain(Uncertainty {
            seed: 9,
            ..Uncertainty::default()
        });
        let world = World::new(&scenario, &Events::default(), 1, 1);
        let place = Position::new(437.0, 612.0);
        let known = ChannelState::predicted(&scenario.mission, 3, &place);
        assert_eq!(world.channel_state(3, &place), known);
        assert_eq!(world.quality(3), None);
        assert!(!world.loses_state(3));
        assert_eq!(world.state_delay(), Duration::ZERO);
    }

    #[test]
    fn the_same_seed_draws_the_same_signals() {
        let scenario = generate(Topology::Mixed, 2, 3, 5).unwrap();
        let mission = &scenario.mission;
        let place = Position::new(500.0, 500.0);
        let mut controller = Controller::new(mission.clone(), StraightLine::new(mission));
        controller.plan(place).unwrap();
        let outcome = |seed| {
            let world = World::new(&scenario, &Events::default(), seed, 50);
            let command = controller
                .clone()
                .allocate(&world.channel_state(1, &place))
                .unwrap();
            world.transmit(&command, &place)
        };
        assert_eq!(outcome(1), outcome(1));
        assert_ne!(outcome(1), outcome(2));
    }
}

//! The world around the vehicle: the true channels and the signals.
//!
//! The signals of a slot are drawn and superposed as in eq:yr: the symbol of every sensor times its
//! coefficient and its channel including the phase, the symbol of the user, and the noise of the
//! receiver. From the sum the vehicle estimates the average (eq:Fhat). Over many symbols this gives
//! an empirical MSE to compare with the analytic one; for the symbols of the sensors' measurements
//! it gives an estimate in physical units.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

use firmware_core::{
    Position, PowerGain, SENSORS_MAX, USERS_MAX, aircomp,
    controller::{ChannelState, SlotCommand},
    inner::{Method, SlotLimits, Workspace},
};
use nalgebra::Complex;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::{nomographic::Nomographic, record::SignalRecord};
use scenario::{Events, HostMission, Scenario, Timeline};

/// The channel state that the host sends.
pub type HostChannelState = ChannelState<f64, USERS_MAX, SENSORS_MAX>;
/// The slot command that the host receives.
pub type HostSlotCommand = SlotCommand<f64, SENSORS_MAX>;

/// Everything outside the vehicle.
#[derive(Clone, Debug)]
pub struct World {
    /// The mission as it is in each slot.
    timeline: Timeline,
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
    /// eq:rate at the true channels, bit/s/Hz.
    pub rate: f64,
    /// The MSE at the true channels.
    pub mse: f64,
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

    /// Returns the channels of a slot with the vehicle at `vehicle`; 0 for users and sensors that
    /// left.
    pub fn channel_state(&self, slot: u32, vehicle: &Position<f64>) -> HostChannelState {
        let mission = self.timeline.in_slot(slot);
        let mut state = ChannelState::predicted(mission, slot, vehicle);
        let silence = PowerGain(0.0);
        for (user, gain) in state.user_gains.iter_mut().enumerate() {
            *gain = if mission.has_user(user) {
                *gain
            } else {
                silence
            };
        }
        for (sensor, gain) in state.sensor_gains.iter_mut().enumerate() {
            *gain = if mission.has_sensor(sensor) {
                *gain
            } else {
                silence
            };
        }
        state
    }

    /// Returns the result of a slot in which all users and sensors execute `command`, with the vehicle
    /// at `vehicle`.
    ///
    /// # Panics
    /// Panics if the mission does not have the command's [slot](Self::has_slot).
    pub fn transmit(&self, command: &HostSlotCommand, vehicle: &Position<f64>) -> SlotOutcome {
        let mission = self.timeline.in_slot(command.slot);
        let truth = self.channel_state(command.slot, vehicle);
        let gains: Vec<_> = mission.of_sensors(&truth.sensor_gains).copied().collect();
        let mut sent = command.sensor_coefficients.clone();
        // A sensor that the vehicle does not know yet is told nothing.
        let _ = sent.resize(mission.sensor_count(), 0.0);
        let coefficients: Vec<_> = mission.of_sensors(&sent).copied().collect();
        let slot = aircomp::Slot {
            sensor_gains: &gains,
            sensor_coefficients: &coefficients,
            user_gain: command
                .served_user
                .and_then(|user| truth.user_gains.get(user))
                .copied()
                .unwrap_or_default(),
            user_power: command.user_power,
            noise_power: mission.parameters().noise_power,
        };
        SlotOutcome {
            rate: slot.rate(),
            mse: slot.mse(command.normalizing_factor),
            signals: self.receive(&slot, command),
        }
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
        let state = self.channel_state(slot, vehicle);
        let mission = self.timeline.in_slot(slot);
        let mut workspace = Workspace::<f64, SENSORS_MAX>::default();
        let limits = SlotLimits::of_mission(mission);
        let gains: Vec<_> = mission.of_sensors(&state.sensor_gains).copied().collect();
        let field = workspace.sensors(&limits, &gains);
        let solution =
            field.and_then(|field| method.solve(&field, user.map(|user| state.user_gains[user])));
        // The gains of the channel model always form a valid slot problem.
        solution.map_or(0.0, |solution| solution.rate)
    }

    fn receive(&self, slot: &aircomp::Slot<'_, f64>, command: &HostSlotCommand) -> SignalRecord {
        // One generator per slot: the draws of a slot do not depend on earlier slots.
        let mut random = Pcg64::seed_from_u64(self.seed ^ (u64::from(command.slot) << 32));
        let air = Air::new(slot, &mut random);
        let sensors = slot.sensor_gains.len() as f64;
        let average = |symbols: &[Complex<f64>]| symbols.iter().sum::<Complex<f64>>() / sensors;
        let estimate = |received: Complex<f64>| received * command.normalizing_factor / sensors;

        let mut symbols = vec![Complex::default(); slot.sensor_gains.len()];
        let mut squares = 0.0;
        for _ in 0..self.symbols_per_slot {
            symbols.fill_with(|| unit_symbol(&mut random));
            let received = air.superpose(&symbols, &mut random);
            squares += (estimate(received) - average(&symbols)).norm_sqr();
        }

        let SensedValues {
            function,
            measurements,
        } = &self.sensing[self.timeline.version_in(command.slot)];
        let measured = &measurements[command.slot as usize - 1];
        let own = function.pre_process(measured);
        let own: Vec<_> = own.into_iter().map(Complex::from).collect();
        let received = air.superpose(&own, &mut random);
        SignalRecord {
            empirical_mse: squares / f64::from(self.symbols_per_slot),
            symbols: self.symbols_per_slot,
            true_value: function.true_value(measured),
            // The measurements are real, so the estimate is the real part.
            estimate: function.post_process(estimate(received).re),
        }
    }
}

/// The channels of one slot as complex numbers.
struct Air {
    /// `b_j h_j`, including the phases.
    sensors: Vec<Complex<f64>>,
    /// `g sqrt(p)`.
    user: Complex<f64>,
    /// `sigma`.
    noise_amplitude: f64,
}

impl Air {
    /// Draws the phases. The coefficient of each sensor has the conjugate phase of its channel.
    fn new(slot: &aircomp::Slot<'_, f64>, random: &mut Pcg64) -> Self {
        let mut phase = || random.random_range(0.0..TAU);
        let sensors = slot.sensor_gains.iter().zip(slot.sensor_coefficients);
        let sensors = sensors
            .map(|(gain, &coefficient)| {
                let phase = phase();
                let h = polar(gain.amplitude(), phase);
                let b = polar(coefficient, -phase);
                b * h
            })
            .collect();
        Self {
            sensors,
            user: polar(slot.user_gain.amplitude(), phase()) * slot.user_power.0.sqrt(),
            noise_amplitude: slot.noise_power.0.sqrt(),
        }
    }

    /// Returns the received signal of eq:yr: the sensors send `symbols`, the user sends a symbol of
    /// its own, and the receiver adds noise.
    fn superpose(&self, symbols: &[Complex<f64>], random: &mut Pcg64) -> Complex<f64> {
        let sensors: Complex<f64> = self.sensors.iter().zip(symbols).map(|(a, o)| a * o).sum();
        sensors + self.user * unit_symbol(random) + unit_symbol(random) * self.noise_amplitude
    }
}

/// Returns `magnitude e^(i phase)`.
fn polar(magnitude: f64, phase: f64) -> Complex<f64> {
    Complex::new(phase.cos(), phase.sin()) * magnitude
}

/// Draws a circular complex Gaussian of mean 0 and variance 1.
fn unit_symbol(random: &mut Pcg64) -> Complex<f64> {
    let mut part = || -> f64 { StandardNormal.sample(&mut *random) };
    Complex::new(part(), part()) * FRAC_1_SQRT_2
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_core::{controller::Controller, policy::StraightLine};
    use scenario::{Topology, generate};

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

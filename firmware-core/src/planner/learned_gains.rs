// SPDX-License-Identifier: MIT OR Apache-2.0
//! What the measured gains say about the channel model: a bias per user and sensor.
//!
//! The bias of a node is the mean of `ln(measured / model)` over the slots flown, later ones weighted
//! more. Shadowing and fading scatter it: with a variance `s^2` of the logarithms about their means,
//! over all nodes, a mean `b` of `n` independent ones is planned with as `b max(0, 1 - s^2 / (n b^2))`,
//! the positive part of the estimator of James and Stein. What a few slots show by chance is not
//! planned with; a node that is always weaker than the model says is.
//!
//! Only with the feature `learned-gains`, which builds for a host have: without it no bias is kept.

use crate::{
    channel::GroundNode,
    mission::{Mission, MissionChange},
    policy::MeasuredGains,
    scalar::Scalar,
};

/// The weight of a slot relative to the slot after it.
const MEMORY: f64 = 0.9;
/// The number of successive slots that count as one independent measurement: shadowing that lasts
/// for some slots must not be taken for a property of the node.
const CORRELATED: f64 = 8.0;
/// The change of a bias, as a logarithm of the power gain, from which on it is planned with: 1 dB.
const NOTABLE: f64 = 0.23;
/// The largest magnitude of one slot's logarithm: 30 dB. A node that is hardly heard in one slot is
/// not written off.
const LARGEST: f64 = 6.9;

/// The bias of one node.
#[derive(Clone, Copy, Debug)]
struct Bias<T> {
    /// The weighted sum of the logarithms.
    sum: T,
    /// The factor of the amplitude gain that is planned with.
    factor: T,
}

/// The biases of all nodes.
#[derive(Clone, Debug)]
pub(super) struct LearnedGains<T, const M: usize, const J: usize> {
    #[cfg(feature = "learned-gains")]
    users: [Bias<T>; M],
    #[cfg(feature = "learned-gains")]
    sensors: [Bias<T>; J],
    #[cfg(not(feature = "learned-gains"))]
    users: [Bias<T>; 0],
    #[cfg(not(feature = "learned-gains"))]
    sensors: [Bias<T>; 0],
    /// The sum of the weights.
    weight: T,
    /// The weighted sum of the mean squares about the means.
    scatter: T,
}

impl<T: Scalar, const M: usize, const J: usize> LearnedGains<T, M, J> {
    pub(super) fn new() -> Self {
        let none = Bias {
            sum: T::zero(),
            factor: T::one(),
        };
        Self {
            users: [none; _],
            sensors: [none; _],
            weight: T::zero(),
            scatter: T::zero(),
        }
    }

    /// Returns the factor of a node's amplitude gain.
    pub(super) fn factor(&self, node: GroundNode) -> T {
        let bias = match node {
            GroundNode::User(user) => self.users.get(user),
            GroundNode::Sensor(sensor) => self.sensors.get(sensor),
        };
        bias.map_or(T::one(), |bias| bias.factor)
    }

    /// Takes the gains that were measured in a slot. Returns whether the biases that are planned
    /// with have changed. Worst case: `M + J` gains of the model, logarithms and exponentials.
    pub(super) fn note(
        &mut self,
        mission: &Mission<T, M, J>,
        measured: &MeasuredGains<'_, T>,
    ) -> bool {
        let place = &measured.position;
        let (memory, largest) = (T::of(MEMORY), T::of(LARGEST));
        let weight_before = self.weight.max(T::one());
        self.weight = self.weight * memory + T::one();
        let (mut squares, mut heard) = (T::zero(), 0);
        let users = self.users.iter_mut().zip(measured.user_gains);
        let users = (users.enumerate()).map(|(user, pair)| (GroundNode::User(user), pair));
        let sensors = self.sensors.iter_mut().zip(measured.sensor_gains);
        let sensors =
            (sensors.enumerate()).map(|(sensor, pair)| (GroundNode::Sensor(sensor), pair));
        for (node, (bias, gain)) in users.chain(sensors) {
            let mean_before = bias.sum / weight_before;
            let ratio = gain.0 / mission.power_gain(node, place).0;
            // A slot in which the node is not heard says nothing: it counts as the mean.
            let logarithm = if ratio.finite() && ratio > T::zero() {
                heard += 1;
                ratio.ln().max(-largest).min(largest)
            } else {
                mean_before
            };
            let difference = logarithm - mean_before;
            squares += difference * difference;
            bias.sum = bias.sum * memory + logarithm;
        }
        self.scatter = self.scatter * memory + squares / T::count(heard.max(1));
        self.take_notable()
    }

    /// Plans with the present biases if one of them has notably changed.
    fn take_notable(&mut self) -> bool {
        // `s^2 / n` of the mean of a node.
        let (weight, correlated) = (self.weight, T::of(CORRELATED));
        let variance = self.scatter / weight * correlated / weight;
        let shrunk = |bias: &Bias<T>| {
            let mean = bias.sum / weight;
            let square = mean * mean;
            if square > variance {
                mean * (T::one() - variance / square)
            } else {
                T::zero()
            }
        };
        let mut biases = self.users.iter().chain(&self.sensors);
        let notable = T::of(NOTABLE);
        if !biases.any(|bias| (shrunk(bias) - T::of(2.0) * bias.factor.ln()).abs() > notable) {
            return false;
        }
        for bias in self.users.iter_mut().chain(&mut self.sensors) {
            bias.factor = (shrunk(bias) * T::of(0.5)).exp();
        }
        true
    }

    /// Forgets the bias of a node that is at another place now.
    pub(super) fn forget(&mut self, change: &MissionChange<T>) {
        let bias = match *change {
            MissionChange::User { user, .. } => self.users.get_mut(usize::from(user)),
            MissionChange::Sensor { sensor, .. } => self.sensors.get_mut(usize::from(sensor)),
            _ => None,
        };
        if let Some(bias) = bias {
            *bias = Bias {
                sum: T::zero(),
                factor: T::one(),
            };
        }
    }
}

#[cfg(all(test, feature = "learned-gains"))]
mod tests {
    use super::*;
    use crate::{scalar::Position, test_missions::table_one, units::PowerGain};

    /// The gains of a world in which `error_db` is added to the model's gain of every node, for 20
    /// slots on a path across the area. Returns what was learned, and how often it was notable.
    fn learned(error_db: impl Fn(GroundNode, u32) -> f64) -> (LearnedGains<f64, 16, 64>, usize) {
        let mission = table_one::<f64>();
        let mut learned = LearnedGains::new();
        let mut notable = 0;
        for slot in 0..20 {
            let position = Position::new(100.0 + 30.0 * f64::from(slot), 400.0);
            let gain = |node| {
                let factor = libm::pow(10.0, error_db(node, slot) / 10.0);
                PowerGain(mission.power_gain(node, &position).0 * factor)
            };
            let users: [_; 15] = core::array::from_fn(|user| gain(GroundNode::User(user)));
            let sensors: [_; 36] = core::array::from_fn(|sensor| gain(GroundNode::Sensor(sensor)));
            notable += usize::from(learned.note(
                &mission,
                &MeasuredGains {
                    position,
                    user_gains: &users,
                    sensor_gains: &sensors,
                },
            ));
        }
        (learned, notable)
    }

    fn db(learned: &LearnedGains<f64, 16, 64>, node: GroundNode) -> f64 {
        20.0 * libm::log10(learned.factor(node))
    }

    /// A node that is always weaker is planned with as such, also if it is not heard in some slots;
    /// the others keep the model's gain, and the plan is not changed in every slot.
    #[test]
    fn a_weak_node_is_learned() {
        let (sensor, user) = (GroundNode::Sensor(7), GroundNode::User(3));
        let (learned, notable) = learned(|node, slot| match node {
            _ if node == sensor => -10.0,
            _ if node == user && slot % 3 == 0 => f64::NEG_INFINITY,
            _ if node == user => -6.0,
            _ => 0.0,
        });
        // Within what is notable, and what the few slots leave in doubt.
        assert!((db(&learned, sensor) + 10.0).abs() < 1.3);
        assert!((db(&learned, user) + 6.0).abs() < 1.3);
        assert!(db(&learned, GroundNode::Sensor(8)).abs() < 0.01);
        assert!((1..6).contains(&notable), "{notable}");
    }

    /// Errors that change sign every two slots say nothing about a node.
    #[test]
    fn scatter_is_not_taken_for_a_bias() {
        let (learned, notable) = learned(|node, slot| {
            let of_node = match node {
                GroundNode::User(user) => user,
                GroundNode::Sensor(sensor) => sensor,
            };
            if (slot as usize / 2 + of_node).is_multiple_of(2) {
                6.0
            } else {
                -6.0
            }
        });
        assert_eq!(notable, 0);
        assert_eq!(learned.factor(GroundNode::User(0)), 1.0);
    }

    /// What was learned of a node that moves is forgotten, and nothing else.
    #[test]
    fn a_node_that_moves_starts_without_a_bias() {
        let (mut learned, _) = learned(|_, _| -10.0);
        learned.forget(&MissionChange::Sensor {
            sensor: 7,
            position_m: Position::new(1.0, 2.0),
        });
        assert_eq!(learned.factor(GroundNode::Sensor(7)), 1.0);
        assert!((db(&learned, GroundNode::Sensor(8)) + 10.0).abs() < 1.0);
    }
}

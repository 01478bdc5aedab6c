// SPDX-License-Identifier: MIT OR Apache-2.0
//! The rules that every slot command of a mission keeps.

use core::fmt;

use super::exchange::SlotCommand;
use crate::{mission::Mission, scalar::Scalar};

/// Error returned when a slot command breaks a rule of the mission.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CommandError<T: fmt::Display> {
    /// The slot is not one of the mission.
    #[error("slot {slot}, but the mission has slots 1 to {slots}")]
    Slot {
        /// The slot of the command.
        slot: u32,
        /// `N`, the number of slots of the mission.
        slots: u32,
    },
    /// The served user is not one of the mission.
    #[error("user {user}, but the mission has {users} users")]
    User {
        /// The served user of the command.
        user: usize,
        /// `M`, the number of users of the mission.
        users: usize,
    },
    /// The number of coefficients is not the number of sensors.
    #[error("{got} sensor coefficients, but the mission has {expected} sensors")]
    Coefficients {
        /// The number of coefficients of the command.
        got: usize,
        /// `J`, the number of sensors of the mission.
        expected: usize,
    },
    /// A number is NaN, infinite or negative.
    #[error("{name} is {value}, but must be finite and not negative")]
    Number {
        /// The name of the field.
        name: &'static str,
        /// The invalid value.
        value: T,
    },
    /// A power is above its limit.
    #[error("{name} is {power} W, but must be at most {limit} W")]
    Power {
        /// The name of the transmitter.
        name: &'static str,
        /// The power of the command, W.
        power: T,
        /// The limit of the mission, W.
        limit: T,
    },
    /// A user transmits although nobody is served or the slot is infeasible.
    #[error("the user power is {power} W, but no user may transmit")]
    Silence {
        /// The power of the command, W.
        power: T,
    },
    /// The slot is feasible, but its MSE is above `Gamma`.
    #[error("the MSE is {mse}, but must be at most {threshold} in a feasible slot")]
    Mse {
        /// The MSE of the command.
        mse: T,
        /// `Gamma`.
        threshold: T,
    },
}

impl<T: Scalar, const J: usize> SlotCommand<T, J> {
    /// Checks that the command keeps the rules of its mission: slot and user exist, every number is
    /// finite and not negative, powers are within their limits, a user transmits only where it is
    /// served in a feasible slot, and the MSE of a feasible slot, in expectation where channels are not
    /// known exactly, is at most `Gamma`, up to
    /// [`CONSTRAINT_TOLERANCE`](crate::scalar::Limits::CONSTRAINT_TOLERANCE). Worst case: one pass
    /// over the coefficients.
    ///
    /// # Errors
    /// Returns the first rule that is broken.
    pub fn check<const M: usize>(&self, mission: &Mission<T, M, J>) -> Result<(), CommandError<T>> {
        let p = mission.parameters();
        if !(1..=p.slots).contains(&self.slot) {
            return Err(CommandError::Slot {
                slot: self.slot,
                slots: p.slots,
            });
        }
        if let Some(user) = self.served_user.filter(|&user| user >= p.users.len()) {
            let users = p.users.len();
            return Err(CommandError::User { user, users });
        }
        let (got, expected) = (self.sensor_coefficients.len(), p.sensors.len());
        if got != expected {
            return Err(CommandError::Coefficients { got, expected });
        }
        let coefficients = self.sensor_coefficients.iter().copied();
        let numbers = [
            ("user_power", self.user_power.0),
            ("normalizing_factor", self.normalizing_factor),
            ("rate", self.rate),
            ("mse", self.mse),
        ];
        let named = coefficients.clone().map(|b| ("sensor_coefficients", b));
        for (name, value) in numbers.into_iter().chain(named) {
            if !(value.finite() && value >= T::zero()) {
                return Err(CommandError::Number { name, value });
            }
        }
        let user = ("the user power", self.user_power.0, p.user_power_max.0);
        let sensors = coefficients.map(|b| ("a sensor's power", b * b, p.sensor_power_max.0));
        for (name, power, limit) in core::iter::once(user).chain(sensors) {
            if power > limit {
                return Err(CommandError::Power { name, power, limit });
            }
        }
        let feasible = self.status.is_feasible();
        let power = self.user_power.0;
        if power > T::zero() && !(feasible && self.served_user.is_some()) {
            return Err(CommandError::Silence { power });
        }
        let threshold = p.mse_threshold;
        if feasible && self.mse > threshold * (T::one() + T::CONSTRAINT_TOLERANCE) {
            let mse = self.mse;
            return Err(CommandError::Mse { mse, threshold });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Watt,
        controller::{ChannelState, Controller},
        policy::StraightLine,
        test_missions::table_one,
    };

    #[test]
    fn each_broken_rule_is_named() {
        let mission = table_one::<f64>();
        let mut controller = Controller::new(mission.clone(), StraightLine::new(&mission));
        let place = mission.parameters().start;
        controller.plan(place).expect("at rest");
        let state = ChannelState::predicted(&mission, 1, &place);
        let good = controller.allocate(&state).expect("under way");
        assert_eq!(good.check(&mission), Ok(()));
        type Command = SlotCommand<f64, { crate::SENSORS_MAX }>;
        let broken = |change: fn(&mut Command)| {
            let mut command = good.clone();
            change(&mut command);
            command.check(&mission).expect_err("a broken rule")
        };
        use CommandError as E;
        assert!(matches!(broken(|c| c.slot = 0), E::Slot { slot: 0, .. }));
        assert!(matches!(broken(|c| c.slot = 61), E::Slot { .. }));
        assert!(matches!(
            broken(|c| c.served_user = Some(15)),
            E::User { .. }
        ));
        let one_short = broken(|c| c.sensor_coefficients.truncate(35));
        assert!(matches!(one_short, E::Coefficients { .. }));
        for value in [f64::NAN, f64::INFINITY, -1.0] {
            let mut command = good.clone();
            command.sensor_coefficients[3] = value;
            assert!(matches!(command.check(&mission), Err(E::Number { .. })));
        }
        assert!(matches!(
            broken(|c| c.rate = f64::NAN),
            E::Number { name: "rate", .. }
        ));
        assert!(matches!(
            broken(|c| c.user_power = Watt(0.3)),
            E::Power { .. }
        ));
        let loud = broken(|c| c.sensor_coefficients[0] = 1.0);
        assert!(matches!(
            loud,
            E::Power {
                name: "a sensor's power",
                ..
            }
        ));
        assert!(matches!(
            broken(|c| (c.user_power, c.served_user) = (Watt(0.1), None)),
            E::Silence { .. }
        ));
        assert!(matches!(broken(|c| c.mse = 1.0), E::Mse { .. }));
    }
}

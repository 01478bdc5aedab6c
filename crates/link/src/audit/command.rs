//! The rules for a command and the channel state, with its quality, that it was computed from.

use firmware_core::{
    Mission, PowerGain, Scalar, Watt, aircomp,
    controller::{ChannelQuality, ChannelState, SlotCommand},
    uncertainty::SlotUncertainty,
};

use super::violation::Violation;

/// The tolerance of a promised MSE, in multiples of the precision's constraint tolerance.
const MSE_ROUNDING: f64 = 10.0;

/// Checks a command against the state that it was computed from, and the quality of that.
pub(super) fn check_against_state<T: Scalar, const M: usize, const J: usize>(
    mission: &Mission<T, M, J>,
    command: &SlotCommand<T, J>,
    (state, quality): (&ChannelState<T, M, J>, &ChannelQuality<M, J>),
) -> Result<(), Violation<T>> {
    let slot = command.slot;
    let gains = || state.user_gains.iter().chain(&state.sensor_gains);
    let rejected = gains().filter(|gain| !gain.is_passive()).count();
    check_count(slot, "rejected gains", command.rejected_gains, rejected)?;
    // A rejected gain counts as one of 0.
    let usable = |gain: &PowerGain<T>| {
        let gain = if gain.is_passive() { gain.0 } else { T::zero() };
        PowerGain(gain.to_f64())
    };
    let gains = mission.of_sensors(&state.sensor_gains);
    let sensor_gains: Vec<_> = gains.map(usable).collect();
    let unheard = sensor_gains.iter().filter(|gain| gain.0 == 0.0).count();
    check_count(slot, "unheard sensors", command.unheard_sensors, unheard)?;
    let coefficients = command.sensor_coefficients.iter().enumerate();
    for (sensor, b) in coefficients {
        let gain = usable(&state.sensor_gains[sensor]).0;
        if *b != T::zero() && (gain == 0.0 || !mission.has_sensor(sensor)) {
            return Err(Violation::UnheardSensor { slot, sensor });
        }
    }
    let coefficients = mission.of_sensors(&command.sensor_coefficients);
    let coefficients: Vec<f64> = coefficients.map(|b| b.to_f64()).collect();
    let user_gain = command.served_user.map(|m| usable(&state.user_gains[m]));
    let heard = |(user, _)| usable(&state.user_gains[user]).0 > 0.0;
    let anybody = mission.users().any(heard);
    if anybody != user_gain.is_some_and(|gain| gain.0 > 0.0)
        || anybody != command.served_user.is_some()
    {
        let user = command.served_user;
        return Err(Violation::ServedUser { slot, user });
    }
    let at_state = aircomp::Slot {
        sensor_gains: &sensor_gains,
        sensor_coefficients: &coefficients,
        user_gain: user_gain.unwrap_or_default(),
        user_power: Watt(command.user_power.0.to_f64()),
        noise_power: Watt(mission.parameters().noise_power.0.to_f64()),
    };
    let eta = command.normalizing_factor.to_f64();
    let present = (0..mission.sensor_count()).filter(|&sensor| mission.has_sensor(sensor));
    let sensors: Vec<_> = present.map(|j| quality.sensor(j).uncertainty()).collect();
    let user_error_variance =
        (command.served_user).map_or(0.0, |m| quality.user(m).error_variance());
    let mse = match SlotUncertainty::new(&sensors, user_error_variance) {
        Ok(uncertainty) => at_state.expected_mse(&uncertainty, eta),
        // No quality states a variance that is not one.
        Err(_) => f64::NAN,
    };
    let promised = command.mse.to_f64();
    let tolerance = MSE_ROUNDING * T::CONSTRAINT_TOLERANCE.to_f64();
    if mse <= promised * (1.0 + tolerance) {
        return Ok(());
    }
    Err(Violation::Mse {
        slot,
        mse,
        promised,
    })
}

/// Checks a number that a command states about its gains.
pub(super) fn check_count<T: Scalar>(
    slot: u32,
    name: &'static str,
    got: u16,
    expected: usize,
) -> Result<(), Violation<T>> {
    if usize::from(got) == expected {
        return Ok(());
    }
    Err(Violation::Gains {
        slot,
        name,
        got,
        expected,
    })
}

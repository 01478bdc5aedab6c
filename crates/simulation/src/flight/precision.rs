//! Converts the ground link's messages between the precision of the onboard computer and that of
//! the host.

use firmware_core::{
    Position, PowerGain, SENSORS_MAX, Scalar, USERS_MAX, Watt,
    controller::{ChannelState, DatedChange, Plan, SlotCommand},
    inner::Status,
    link::Arrival,
    mission::MissionChange,
};

fn convert<T: Scalar, U: Scalar>(x: T) -> U {
    U::of(x.to_f64())
}

/// Converts an arrival to double precision.
pub(super) fn arrival<T: Scalar>(from: &Arrival<T>) -> Arrival<f64> {
    Arrival {
        plan: Plan {
            slot: from.plan.slot,
            waypoint: from.plan.waypoint.map(convert),
            served_user: from.plan.served_user,
            intervention: from.plan.intervention,
        },
        position: from.position.map(convert),
        tick: from.tick,
    }
}

/// Converts a command to double precision.
pub(super) fn command<T: Scalar>(
    from: &SlotCommand<T, SENSORS_MAX>,
) -> SlotCommand<f64, SENSORS_MAX> {
    SlotCommand {
        slot: from.slot,
        served_user: from.served_user,
        user_power: Watt(convert(from.user_power.0)),
        sensor_coefficients: from
            .sensor_coefficients
            .iter()
            .copied()
            .map(convert)
            .collect(),
        normalizing_factor: convert(from.normalizing_factor),
        rate: convert(from.rate),
        mse: convert(from.mse),
        status: status(from.status),
        source: from.source,
        age_slots: from.age_slots,
        rejected_gains: from.rejected_gains,
        unheard_sensors: from.unheard_sensors,
    }
}

fn status<T: Scalar>(from: Status<T>) -> Status<f64> {
    match from {
        Status::Optimal { limited_by } => Status::Optimal { limited_by },
        Status::Infeasible { least_mse } => Status::Infeasible {
            least_mse: convert(least_mse),
        },
        Status::ErrorFloor { least_mse } => Status::ErrorFloor {
            least_mse: convert(least_mse),
        },
        Status::Converged { limited_by } => Status::Converged { limited_by },
        Status::IterationLimit { limited_by } => Status::IterationLimit { limited_by },
        Status::Guaranteed { limited_by } => Status::Guaranteed { limited_by },
    }
}

/// Converts channels to the precision of the onboard computer.
pub(super) fn channel_state<T: Scalar>(
    from: &ChannelState<f64, USERS_MAX, SENSORS_MAX>,
) -> ChannelState<T, USERS_MAX, SENSORS_MAX> {
    let gain = |gain: &PowerGain<f64>| PowerGain(convert(gain.0));
    ChannelState {
        slot: from.slot,
        user_gains: from.user_gains.iter().map(gain).collect(),
        sensor_gains: from.sensor_gains.iter().map(gain).collect(),
    }
}

/// Converts a change of the mission to the precision of the onboard computer.
pub(super) fn change<T: Scalar>(from: &DatedChange<f64>) -> DatedChange<T> {
    let place = |position: Position<f64>| position.map(convert);
    DatedChange {
        from_slot: from.from_slot,
        change: match from.change {
            MissionChange::User { user, position_m } => MissionChange::User {
                user,
                position_m: place(position_m),
            },
            MissionChange::UserLeft { user } => MissionChange::UserLeft { user },
            MissionChange::Sensor { sensor, position_m } => MissionChange::Sensor {
                sensor,
                position_m: place(position_m),
            },
            MissionChange::SensorLeft { sensor } => MissionChange::SensorLeft { sensor },
            MissionChange::MseThreshold(threshold) => {
                MissionChange::MseThreshold(convert(threshold))
            }
            MissionChange::NoisePower(power) => MissionChange::NoisePower(Watt(convert(power.0))),
            MissionChange::MaxSpeed(speed_mps) => MissionChange::MaxSpeed(convert(speed_mps)),
            MissionChange::Slots(slots) => MissionChange::Slots(slots),
        },
    }
}

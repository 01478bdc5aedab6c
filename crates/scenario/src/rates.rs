//! The rate that every user would have with the vehicle at a given position: the exact slot
//! solution, computed for all users at once.

use firmware_core::{
    Mission, Position, PowerGain,
    channel::GroundNode,
    inner::{SensorField, SlotLimits, Workspace},
};

/// The rate of a user that left, bit/s/Hz: so low that no assignment serves it.
pub const ABSENT_RATE: f64 = -1000.0;

/// The rates of a mission's users, bit/s/Hz, as a function of the vehicle's position.
///
/// At a position where `Gamma` cannot be met, every user's rate is 0. That of a user that left is
/// [`ABSENT_RATE`].
#[derive(Clone, Debug)]
pub struct PlaceRates<'m, const M: usize, const J: usize> {
    mission: &'m Mission<f64, M, J>,
    limits: SlotLimits<f64>,
    workspace: Workspace<f64, J>,
}

impl<'m, const M: usize, const J: usize> PlaceRates<'m, M, J> {
    /// Creates the rate function of a mission.
    pub fn new(mission: &'m Mission<f64, M, J>) -> Self {
        Self {
            mission,
            limits: SlotLimits::of_mission(mission),
            workspace: Workspace::default(),
        }
    }

    /// Writes the rate of every user with the vehicle over `place`. Worst case: one sort of the
    /// sensors, then `O(log J)` per user.
    pub fn write(&mut self, place: &Position<f64>, rates: &mut [f64]) {
        let mut gains = [PowerGain(0.0); J];
        let mut count = 0;
        for ((sensor, _), gain) in self.mission.sensors().zip(&mut gains) {
            *gain = self.mission.power_gain(GroundNode::Sensor(sensor), place);
            count += 1;
        }
        let sensors = &gains[..count];
        let mission = self.mission;
        with_field(&mut self.workspace, &self.limits, sensors, |field| {
            let users = rates.iter_mut().take(mission.user_count());
            for (user, rate) in users.enumerate() {
                *rate = match field {
                    _ if !mission.has_user(user) => ABSENT_RATE,
                    Some(field) => field.rate(mission.power_gain(GroundNode::User(user), place)),
                    None => 0.0,
                };
            }
        });
    }
}

/// Calls a function with the sorted sensors of a slot. The limits and gains of a valid mission
/// always form a slot problem. If they did not, nothing could be sent, and the result would be
/// `None`.
pub fn with_field<const J: usize>(
    workspace: &mut Workspace<f64, J>,
    limits: &SlotLimits<f64>,
    sensor_gains: &[PowerGain<f64>],
    use_field: impl FnOnce(Option<&SensorField<'_, f64>>),
) {
    use_field(workspace.sensors(limits, sensor_gains).ok().as_ref());
}

//! The rate that every user would have with the vehicle at a given position: the exact slot
//! solution, computed for all users at once.

use firmware_core::{
    Mission, Position, PowerGain,
    inner::{SensorField, SlotLimits, Workspace},
};

/// The rates of a mission's users, bit/s/Hz, as a function of the vehicle's position.
///
/// At a position where `Gamma` cannot be met, every user's rate is 0.
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
        let p = self.mission.parameters();
        let channel = self.mission.channel();
        let mut gains = [PowerGain(0.0); J];
        for (gain, sensor) in gains.iter_mut().zip(&p.sensors) {
            *gain = channel.power_gain(place, sensor);
        }
        let sensors = &gains[..p.sensors.len()];
        with_field(&mut self.workspace, &self.limits, sensors, |field| {
            for (rate, user) in rates.iter_mut().zip(&p.users) {
                *rate = field.map_or(0.0, |field| field.rate(channel.power_gain(place, user)));
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

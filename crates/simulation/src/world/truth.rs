//! The true state of the world: positions of users and sensors, shadowing and fading of their links,
//! silent sensors, and the errors of channel estimates.
//!
//! The vehicle receives an [estimate](super::HostChannelState) per link, which contains the path loss
//! from the true positions, shadowing and small-scale fading. A [`ChannelError`] describes how the true
//! channel differs from this estimate.

use std::f64::consts::TAU;

use firmware_core::{
    Position, PowerGain, SENSORS_MAX, USERS_MAX,
    channel::{GroundNode, SPEED_OF_LIGHT_MPS},
    controller::{ChannelQuality, SensorQuality, UserQuality},
    uncertainty::{SensorUncertainty, Uncertainty},
};
use nalgebra::Complex;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use scenario::{HostMission, Scenario, Tracks};

use super::{
    air::ChannelError,
    field::{Scattering, Shadowing},
};

/// What is true and not known before the flight.
#[derive(Clone, Debug)]
pub(super) struct Truth {
    uncertainty: scenario::Uncertainty,
    tracks: Tracks,
    /// The fields of the users, then those of the sensors; nodes that joined share that of node 0.
    shadowing: [Vec<Shadowing>; 2],
    fading: Option<Fading>,
}

/// Small-scale fading.
#[derive(Clone, Debug)]
struct Fading {
    /// The amplitudes of the direct path and of the scattered ones; their squares sum to 1.
    direct: f64,
    scattered: f64,
    /// One of each node, the users first, with the phase of the direct path against the scattered ones.
    fields: [Vec<(Scattering, f64)>; 2],
}

/// The random quantities that have independent generators.
#[derive(Clone, Copy)]
enum Purpose {
    Shadowing = 1,
    Fading,
    Silence,
    StateLoss,
}

impl Truth {
    /// Draws the world of a scenario, or returns `None` if everything is known.
    pub(super) fn draw(scenario: &Scenario) -> Option<Self> {
        let uncertainty = &scenario.uncertainty;
        if uncertainty.is_none() {
            return None;
        }
        let mission = &scenario.mission;
        let counts = [mission.user_count(), mission.sensor_count()];
        let mut random = generator(uncertainty.seed, Purpose::Shadowing, 0);
        let shadowing = counts.map(|count| {
            let count = if uncertainty.shadowing_db > 0.0 {
                count
            } else {
                0
            };
            let field = |_| Shadowing::draw(uncertainty.shadowing_decorrelation_m, &mut random);
            (0..count).map(field).collect()
        });
        let fading = uncertainty.rician_k_db.map(|k_db| {
            let mut random = generator(uncertainty.seed, Purpose::Fading, 0);
            let half_wave_m = SPEED_OF_LIGHT_MPS / mission.parameters().carrier_hz / 2.0;
            let decorrelation_m = uncertainty.fading_decorrelation_m.unwrap_or(half_wave_m);
            let k = 10f64.powf(k_db / 10.0);
            Fading {
                direct: (k / (k + 1.0)).sqrt(),
                scattered: (1.0 / (k + 1.0)).sqrt(),
                fields: counts.map(|count| {
                    let field = |_| {
                        let field = Scattering::draw(decorrelation_m, &mut random);
                        (field, random.random_range(0.0..TAU))
                    };
                    (0..count).map(field).collect()
                }),
            }
        });
        Some(Self {
            uncertainty: uncertainty.clone(),
            tracks: scenario.tracks(),
            shadowing,
            fading,
        })
    }

    /// Returns the power gain that pilots measure in a slot, with the vehicle at `vehicle`; `None` for
    /// a sensor that is silent. `mission` is what is known in this slot.
    pub(super) fn measured(
        &self,
        mission: &HostMission,
        node: GroundNode,
        slot: u32,
        vehicle: &Position<f64>,
    ) -> Option<PowerGain<f64>> {
        if self.is_silent(node, slot) {
            return None;
        }
        let (kind, index) = match node {
            GroundNode::User(user) => (0, user),
            GroundNode::Sensor(sensor) => (1, sensor),
        };
        let mut gain = self.path_gain(mission, node, slot, vehicle).0;
        let shadowing = &self.shadowing[kind];
        if let Some(field) = shadowing.get(index).or(shadowing.first()) {
            gain *= 10f64.powf(field.at(vehicle) * self.uncertainty.shadowing_db / 10.0);
        }
        if let Some(fading) = &self.fading {
            let fields = &fading.fields[kind];
            if let Some((field, phase)) = fields.get(index).or(fields.first()) {
                let direct = Complex::from_polar(fading.direct, *phase);
                gain *= (direct + field.at(vehicle) * fading.scattered).norm_sqr();
            }
        }
        // A link is passive, however it is scattered.
        Some(PowerGain(gain.min(1.0)))
    }

    /// Returns the mean power gain of the channel model between the vehicle and where the node is.
    fn path_gain(
        &self,
        mission: &HostMission,
        node: GroundNode,
        slot: u32,
        vehicle: &Position<f64>,
    ) -> PowerGain<f64> {
        let p = mission.parameters();
        let known = match node {
            GroundNode::User(user) => p.users.get(user),
            GroundNode::Sensor(sensor) => p.sensors.get(sensor),
        };
        match known {
            Some(known) if !mission.has_gain_map() => {
                let place = self.tracks.place(node, slot, known);
                mission.channel().power_gain(vehicle, &place)
            }
            _ => mission.power_gain(node, vehicle),
        }
    }

    fn is_silent(&self, node: GroundNode, slot: u32) -> bool {
        let GroundNode::Sensor(sensor) = node else {
            return false;
        };
        let probability = self.uncertainty.silence_probability.of(sensor);
        probability > 0.0 && {
            let number = u64::from(slot) << 16 | sensor as u64;
            let mut random = generator(self.uncertainty.seed, Purpose::Silence, number);
            random.random::<f64>() < probability
        }
    }

    /// Returns whether the channel state of a slot never reaches the vehicle.
    pub(super) fn loses_state(&self, slot: u32) -> bool {
        let probability = self.uncertainty.state_loss_probability;
        probability > 0.0 && {
            let mut random = generator(self.uncertainty.seed, Purpose::StateLoss, slot.into());
            random.random::<f64>() < probability
        }
    }

    /// Returns the time from an arrival to its channel state, s.
    pub(super) fn state_delay_s(&self) -> f64 {
        self.uncertainty.state_delay_s
    }

    /// Returns the error of a sensor's estimate.
    pub(super) fn sensor_error(&self, sensor: usize) -> ChannelError {
        ChannelError {
            variance: self.uncertainty.sensor_error_variance.of(sensor),
            phase_rad: self.uncertainty.sensor_phase_error_rad.of(sensor),
        }
    }

    /// Returns the error of a user's estimate.
    pub(super) fn user_error(&self, user: usize) -> ChannelError {
        ChannelError {
            variance: self.uncertainty.user_error_variance.of(user),
            phase_rad: 0.0,
        }
    }

    /// Returns whether estimates differ from the channels.
    pub(super) fn has_channel_errors(&self) -> bool {
        self.uncertainty.has_channel_errors()
    }

    /// Returns the statistics of the errors of these sensors and of a user, by which a slot is
    /// judged.
    pub(super) fn statistics(
        &self,
        sensors: impl Iterator<Item = usize>,
        user: Option<usize>,
    ) -> Uncertainty<f64, SENSORS_MAX> {
        let sensors: Vec<_> = sensors
            .map(|sensor| {
                let ChannelError {
                    variance,
                    phase_rad,
                } = self.sensor_error(sensor);
                SensorUncertainty::with_phase_error(variance, phase_rad).unwrap_or_default()
            })
            .collect();
        let user = user.map_or(0.0, |user| self.user_error(user).variance);
        // Checked with the scenario.
        Uncertainty::new(&sensors, user).expect("statistics of a checked scenario")
    }

    /// Returns what the ground says of the quality of the channel states of a mission.
    pub(super) fn quality(
        &self,
        mission: &HostMission,
        slot: u32,
    ) -> Option<ChannelQuality<USERS_MAX, SENSORS_MAX>> {
        if !self.has_channel_errors() {
            return None;
        }
        let user = |user| UserQuality::new(self.user_error(user).variance).unwrap_or_default();
        let sensor = |sensor| {
            let ChannelError {
                variance,
                phase_rad,
            } = self.sensor_error(sensor);
            SensorQuality::new(variance, phase_rad).unwrap_or_default()
        };
        Some(ChannelQuality {
            slot,
            users: (0..mission.user_count()).map(user).collect(),
            sensors: (0..mission.sensor_count()).map(sensor).collect(),
        })
    }
}

/// Returns the generator for a purpose.
fn generator(seed: u64, purpose: Purpose, number: u64) -> Pcg64 {
    // Neighbouring seeds must not share their generators.
    let seed = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    Pcg64::seed_from_u64(seed ^ (purpose as u64) << 56 ^ number)
}

//! The `[uncertainty]` table: how the world differs from what is known of it before the flight.
//!
//! ```toml
//! [uncertainty]
//! seed = 1                         # of everything below that is drawn
//! # Channels: statistics of the errors of estimates (math: docs/mathematics.md, section 10)
//! sensor_error_variance = 0.05     # relative; or a list with a number for each sensor
//! user_error_variance = 0.02       # relative
//! sensor_phase_error_rad = 0.3     # standard deviation
//! # Channels: how they differ from the channel model
//! rician_k_db = 9.0                # small-scale fading; without this key there is none
//! fading_decorrelation_m = 0.06    # half a wavelength unless given
//! shadowing_db = 4.0               # standard deviation
//! shadowing_decorrelation_m = 50.0
//! # Nodes
//! silence_probability = 0.1        # of each sensor in each slot
//! position_error_m = 15.0          # standard deviation in each direction, of all nodes
//! motion = { model = "gauss-markov", speed_mps = 3.0 }
//! # The vehicle
//! wind_mps = 6.0                   # steady, from the west, with gusts; vehicles with a body
//! # The ground link
//! state_loss_probability = 0.05    # a channel state that is never sent
//! state_delay_s = 0.2              # and one that is sent later
//! ```

use std::{f64::consts::PI, path::PathBuf};

use files::PerNode;
use serde::{Deserialize, Serialize};

use crate::HostMission;

/// How the world differs from what is known of it. Absent keys, and an absent table, mean that
/// everything is known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Uncertainty {
    /// The seed of everything that is drawn.
    pub seed: u64,
    /// The variance of the error of a sensor's channel estimate, relative to its gain.
    #[serde(skip_serializing_if = "PerNode::is_zero")]
    pub sensor_error_variance: PerNode,
    /// The same for users.
    #[serde(skip_serializing_if = "PerNode::is_zero")]
    pub user_error_variance: PerNode,
    /// The standard deviation of the phase with which a sensor's signal arrives, rad.
    #[serde(skip_serializing_if = "PerNode::is_zero")]
    pub sensor_phase_error_rad: PerNode,
    /// The ratio of the direct path's power to that of the scattered ones, dB; `None` without
    /// small-scale fading.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rician_k_db: Option<f64>,
    /// Half the wavelength of the fading, m; that of the carrier if not given. The correlation over a
    /// distance `d` is `J_0(pi d / fading_decorrelation_m)`, which is first 0 at 0.77 of this distance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fading_decorrelation_m: Option<f64>,
    /// The standard deviation of shadowing, dB.
    #[serde(skip_serializing_if = "is_zero")]
    pub shadowing_db: f64,
    /// The distance at which the correlation of shadowing is 1/e, m.
    pub shadowing_decorrelation_m: f64,
    /// The probability that a sensor is silent in a slot: it is not heard, and does not transmit.
    #[serde(skip_serializing_if = "PerNode::is_zero")]
    pub silence_probability: PerNode,
    /// The standard deviation, in each direction, of the true positions around those of the
    /// scenario, m.
    #[serde(skip_serializing_if = "is_zero")]
    pub position_error_m: f64,
    /// How users and sensors move; `None` if they do not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<Motion>,
    /// The steady wind, m/s.
    #[serde(skip_serializing_if = "is_zero")]
    pub wind_mps: f64,
    /// The probability that the ground sends no channel state in a slot.
    #[serde(skip_serializing_if = "is_zero")]
    pub state_loss_probability: f64,
    /// The time from an arrival to its channel state, s.
    #[serde(skip_serializing_if = "is_zero")]
    pub state_delay_s: f64,
}

impl Default for Uncertainty {
    fn default() -> Self {
        Self {
            seed: 1,
            sensor_error_variance: PerNode::default(),
            user_error_variance: PerNode::default(),
            sensor_phase_error_rad: PerNode::default(),
            rician_k_db: None,
            fading_decorrelation_m: None,
            shadowing_db: 0.0,
            shadowing_decorrelation_m: 50.0,
            silence_probability: PerNode::default(),
            position_error_m: 0.0,
            motion: None,
            wind_mps: 0.0,
            state_loss_probability: 0.0,
            state_delay_s: 0.0,
        }
    }
}

/// How nodes move. Which keys a model needs and allows is checked by name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Motion {
    /// The model.
    pub model: MotionModel,
    /// Which nodes move.
    #[serde(default)]
    pub nodes: MovingNodes,
    /// The largest speed of a random waypoint, or the standard deviation of the velocity in each
    /// direction of Gauss-Markov motion, m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_mps: Option<f64>,
    /// Gauss-Markov motion: the time after which the correlation of the velocity is 1/e, s; 20 if it
    /// is not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory_s: Option<f64>,
    /// Motion from a file: a CSV file `slot,node,index,east_m,north_m`. Its path is relative to the
    /// scenario file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub csv: Option<PathBuf>,
    /// The distance, m, from the last reported position of a node at which the vehicle receives an
    /// update; 10 if it is not given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub told_after_m: Option<f64>,
}

/// A model of motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MotionModel {
    /// Each node goes straight to a random place of the area, with a speed from 0.2 of the largest
    /// to the largest, and then to the next.
    RandomWaypoint,
    /// The velocity is a Gauss-Markov process; nodes turn round at the border of the area.
    GaussMarkov,
    /// Positions over time from a CSV file. A node stays where it is until its next row.
    File,
}

/// Which nodes move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MovingNodes {
    /// The users.
    #[default]
    Users,
    /// The sensors.
    Sensors,
    /// Both.
    All,
}

impl MovingNodes {
    /// Returns whether the users are among them.
    pub fn has_users(self) -> bool {
        self != Self::Sensors
    }

    /// Returns whether the sensors are among them.
    pub fn has_sensors(self) -> bool {
        self != Self::Users
    }
}

impl Motion {
    /// Returns [`speed_mps`](Self::speed_mps), which models with a speed have.
    pub(crate) fn speed_mps(&self) -> f64 {
        self.speed_mps.unwrap_or(0.0)
    }

    /// Returns the time after which the correlation of the velocity is 1/e, s.
    pub(crate) fn memory_s(&self) -> f64 {
        self.memory_s.unwrap_or(20.0)
    }

    /// Returns how far a node moves before the vehicle is told, m.
    pub fn told_after_m(&self) -> f64 {
        self.told_after_m.unwrap_or(10.0)
    }

    fn check(&self) -> Result<(), String> {
        let has_speed = self.model != MotionModel::File;
        let name = match self.model {
            MotionModel::RandomWaypoint => "random-waypoint",
            MotionModel::GaussMarkov => "gauss-markov",
            MotionModel::File => "file",
        };
        let keys = [
            ("speed_mps", self.speed_mps.is_some(), has_speed, has_speed),
            (
                "memory_s",
                self.memory_s.is_some(),
                false,
                self.model == MotionModel::GaussMarkov,
            ),
            ("csv", self.csv.is_some(), !has_speed, !has_speed),
        ];
        for (key, given, needed, allowed) in keys {
            if given && !allowed {
                return Err(format!(
                    "uncertainty.motion.{key} is given, but must not be: uncertainty.motion.model \
                     \"{name}\" does not use it"
                ));
            }
            if needed && !given {
                return Err(format!(
                    "uncertainty.motion.{key} is missing, but uncertainty.motion.model \"{name}\" \
                     needs it"
                ));
            }
        }
        within(
            "motion.speed_mps",
            self.speed_mps(),
            [0.0, 100.0],
            "a speed from 0 to 100 m/s",
        )?;
        let time = "a time from 0.001 to 100000 s";
        within("motion.memory_s", self.memory_s(), [1e-3, 1e5], time)?;
        let distance = "a distance from 0.1 to 100000 m";
        within(
            "motion.told_after_m",
            self.told_after_m(),
            [0.1, 1e5],
            distance,
        )
    }
}

/// Checks one number, or one for each of `nodes` nodes.
fn check(
    (name, numbers): (&str, &PerNode),
    nodes: usize,
    range: [f64; 2],
    allowed: &str,
) -> Result<(), String> {
    match numbers {
        PerNode::All(value) => within(name, *value, range, allowed),
        PerNode::Each(values) if values.len() != nodes => Err(format!(
            "uncertainty.{name} has {} entries, but must be one number or have one for each of the \
             {nodes} nodes",
            values.len()
        )),
        PerNode::Each(values) => {
            let mut numbered = values.iter().enumerate();
            numbered.try_for_each(|(index, value)| {
                within(&format!("{name}[{index}]"), *value, range, allowed)
            })
        }
    }
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Returns an error that names the key unless its value is in the range.
fn within(name: &str, value: f64, range: [f64; 2], allowed: &str) -> Result<(), String> {
    if value >= range[0] && value <= range[1] {
        return Ok(());
    }
    Err(format!(
        "uncertainty.{name} is {value}, but must be {allowed}"
    ))
}

impl Uncertainty {
    /// Checks the ranges of all keys.
    ///
    /// # Errors
    /// Returns one line that names the key, its value and what is allowed.
    pub(crate) fn check(&self, mission: &HostMission) -> Result<(), String> {
        const PROBABILITY: [f64; 2] = [0.0, 1.0];
        const VARIANCE: [f64; 2] = [0.0, 10.0];
        let (users, sensors) = (mission.user_count(), mission.sensor_count());
        let variance = "a relative variance from 0 to 10";
        let phase = "a standard deviation from 0 to pi rad";
        let of_sensors = ("sensor_error_variance", &self.sensor_error_variance);
        check(of_sensors, sensors, VARIANCE, variance)?;
        let of_users = ("user_error_variance", &self.user_error_variance);
        check(of_users, users, VARIANCE, variance)?;
        let phases = ("sensor_phase_error_rad", &self.sensor_phase_error_rad);
        check(phases, sensors, [0.0, PI], phase)?;
        if let Some(k) = self.rician_k_db {
            within("rician_k_db", k, [-40.0, 60.0], "from -40 to 60 dB")?;
        }
        let distance = "a distance from 0.001 to 100000 m";
        if let Some(distance_m) = self.fading_decorrelation_m {
            if self.rician_k_db.is_none() {
                return Err(
                    "uncertainty.fading_decorrelation_m is given, but there is no fading without \
                     uncertainty.rician_k_db"
                        .into(),
                );
            }
            within("fading_decorrelation_m", distance_m, [1e-3, 1e5], distance)?;
        }
        let shadowing = "a standard deviation from 0 to 30 dB";
        within("shadowing_db", self.shadowing_db, [0.0, 30.0], shadowing)?;
        within(
            "shadowing_decorrelation_m",
            self.shadowing_decorrelation_m,
            [1e-3, 1e5],
            distance,
        )?;
        let probability = "a probability from 0 to 1";
        let silence = ("silence_probability", &self.silence_probability);
        check(silence, sensors, PROBABILITY, probability)?;
        let error = "a standard deviation from 0 to 10000 m";
        within("position_error_m", self.position_error_m, [0.0, 1e4], error)?;
        within(
            "wind_mps",
            self.wind_mps,
            [0.0, 30.0],
            "a speed from 0 to 30 m/s",
        )?;
        within(
            "state_loss_probability",
            self.state_loss_probability,
            PROBABILITY,
            probability,
        )?;
        within(
            "state_delay_s",
            self.state_delay_s,
            [0.0, 60.0],
            "a time from 0 to 60 s",
        )?;
        if let Some(motion) = &self.motion {
            motion.check()?;
        }
        let moves = [
            ("position_error_m", self.position_error_m > 0.0),
            ("motion", self.motion.is_some()),
        ];
        match moves
            .into_iter()
            .find(|(_, given)| *given && mission.has_gain_map())
        {
            Some((key, _)) => Err(format!(
                "uncertainty.{key} is given, but must not be: the gains of radio.gain_map are those of \
                 the positions in the scenario"
            )),
            None => Ok(()),
        }
    }

    /// Returns the table as it is written in a file; nothing where everything is known.
    pub(crate) fn to_toml(&self) -> String {
        #[derive(Serialize)]
        struct File<'a> {
            uncertainty: &'a Uncertainty,
        }
        if self.is_none() {
            return String::new();
        }
        // Numbers, names and paths: TOML has all of them, except for a path that is not text.
        let text = toml::to_string(&File { uncertainty: self });
        text.map_or_else(|_| String::new(), |text| format!("\n{text}"))
    }

    /// Returns whether estimates of channels have errors: the vehicle is then told how good they
    /// are.
    pub fn has_channel_errors(&self) -> bool {
        let errors = [
            &self.sensor_error_variance,
            &self.user_error_variance,
            &self.sensor_phase_error_rad,
        ];
        !errors.into_iter().all(PerNode::is_zero)
    }

    /// Returns whether everything is known: the paper's world.
    pub fn is_none(&self) -> bool {
        let known = Self {
            seed: self.seed,
            fading_decorrelation_m: self.fading_decorrelation_m,
            shadowing_decorrelation_m: self.shadowing_decorrelation_m,
            ..Self::default()
        };
        *self == known
    }
}

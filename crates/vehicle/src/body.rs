//! The vehicle's body: how it moves towards its demanded position.
//!
//! `ideal` is the paper's kinematics: the vehicle is at the setpoint's position as soon as the
//! setpoint arrives, so any waypoint within V_max delta is reached by the end of the slot. All
//! other bodies are a point mass with a position loop around a velocity loop, whose speed,
//! acceleration and jerk are limited. How the loops follow a stream of moving setpoints is fitted
//! to recorded flights ([`Tracking`]).

use firmware_core::Position;
use firmware_core::time::Duration;
use nalgebra::Vector2;

use super::ability::Ability;
use super::profile::Profile;
use super::wind::Air;

/// A setpoint in map coordinates, as received.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Target {
    pub(super) position: Position<f64>,
    pub(super) altitude_m: f64,
    /// The velocity, or `None` if the setpoint said to ignore it. The vehicle then stops at the
    /// position.
    pub(super) velocity: Option<Vector2<f64>>,
    pub(super) acceleration: Vector2<f64>,
    /// The time since the setpoint was received, seconds.
    pub(super) age_s: f64,
}

/// What the body must do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Demand {
    /// Stands on the ground.
    Rest,
    /// Stops and stays at this altitude.
    Hold { altitude_m: f64 },
    /// Follows a setpoint.
    Track(Target),
    /// Flies to a position at up to this speed and stops there.
    Go {
        position: Position<f64>,
        altitude_m: f64,
        speed_mps: f64,
    },
    /// Descends where it is, at this rate.
    Descend { rate_mps: f64 },
}

/// How a body follows a stream of moving setpoints.
///
/// The constants of ArduCopter and PX4 are fitted to the recordings `arducopter-sac` and `px4-sac`,
/// with the recorded setpoints as input. `tests/replay.rs` checks the distance between the recorded
/// flights and these bodies. ArduCopter's constants are those of its setpoint shaping: a jerk
/// limit, a gain of jerk / acceleration, and a gain of a quarter of that.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tracking {
    /// The gain of the position loop, 1/s. For ArduCopter it is in units of
    /// [`Ability::shaping_per_s`].
    position_gain: f64,
    /// The gain of the velocity loop, in the same unit.
    velocity_gain: f64,
    /// The fraction of a setpoint's acceleration that is fed forward.
    feedforward: f64,
    /// The largest change of the acceleration, m/s^3.
    jerk_mps3: f64,
    /// The largest acceleration, m/s^2.
    acceleration_mps2: f64,
    /// How far the loops may exceed the limit of the airframe. The limit applies to what they
    /// follow.
    headroom: f64,
    /// The delay from a setpoint's arrival to its effect, s.
    delay_s: f64,
    /// The time constant of the lean, s.
    lag_s: f64,
}

impl Tracking {
    /// The constants of a body that has no model in the recordings.
    const GENERIC: Self = Self {
        position_gain: POSITION_GAIN,
        velocity_gain: VELOCITY_GAIN,
        feedforward: 1.0,
        jerk_mps3: f64::INFINITY,
        acceleration_mps2: f64::INFINITY,
        headroom: 1.0,
        delay_s: 0.0,
        lag_s: 0.0,
    };

    const ARDUCOPTER: Self = Self {
        position_gain: 0.260,
        velocity_gain: 1.118,
        feedforward: 1.0,
        jerk_mps3: f64::INFINITY,
        acceleration_mps2: 11.2,
        headroom: 1.15,
        delay_s: 0.031,
        lag_s: 0.042,
    };

    const PX4: Self = Self {
        position_gain: 1.68,
        velocity_gain: 0.985,
        feedforward: 0.625,
        jerk_mps3: 73.6,
        acceleration_mps2: 8.77,
        headroom: 1.0,
        delay_s: 0.063,
        lag_s: 0.0,
    };

    const fn of(profile: Profile) -> Self {
        match profile {
            Profile::Ideal | Profile::Multirotor => Self::GENERIC,
            Profile::ArduCopter => Self::ARDUCOPTER,
            Profile::Px4 => Self::PX4,
        }
    }
}

/// The gain of the position loop, 1/s.
const POSITION_GAIN: f64 = 1.5;
/// The gain of the velocity loop, 1/s.
const VELOCITY_GAIN: f64 = 4.0;
/// The gain of the vertical position loop, 1/s.
const CLIMB_GAIN: f64 = 1.5;
/// The largest vertical acceleration, m/s^2.
const VERTICAL_ACCELERATION: f64 = 4.0;
/// The height below which a descent is slower, m, and the rate of that descent, m/s.
const FLARE: (f64, f64) = (8.0, 1.0);

#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    pub(super) position: Position<f64>,
    pub(super) velocity: Vector2<f64>,
    pub(super) acceleration: Vector2<f64>,
    pub(super) altitude_m: f64,
    pub(super) climb_mps: f64,
    ideal: bool,
    tracking: Tracking,
}

fn clip(vector: Vector2<f64>, longest: f64) -> Vector2<f64> {
    let norm = vector.norm();
    if norm > longest {
        vector * (longest / norm)
    } else {
        vector
    }
}

impl Body {
    pub(super) fn on_ground(position: Position<f64>, profile: Profile) -> Self {
        Self {
            position,
            velocity: Vector2::zeros(),
            acceleration: Vector2::zeros(),
            altitude_m: 0.0,
            climb_mps: 0.0,
            ideal: profile.is_ideal(),
            tracking: Tracking::of(profile),
        }
    }

    /// Returns the delay from a setpoint's arrival to its effect.
    pub(super) fn setpoint_delay(&self) -> Duration {
        Duration::from_secs_f64(self.tracking.delay_s)
    }

    pub(super) fn is_on_ground(&self) -> bool {
        self.altitude_m <= 0.0
    }

    /// Applies a setpoint to an ideal body, which is at the setpoint's position as soon as it
    /// arrives.
    pub(super) fn take(&mut self, target: &Target) {
        if let (true, Some(velocity)) = (self.ideal, target.velocity) {
            self.position = target.position;
            self.velocity = velocity;
            self.acceleration = target.acceleration;
        }
    }

    /// Advances the body by `dt_s` seconds.
    pub(super) fn step(&mut self, dt_s: f64, demand: &Demand, ability: &Ability, air: &Air) {
        let altitude_m = match *demand {
            Demand::Rest => {
                self.velocity = Vector2::zeros();
                self.acceleration = Vector2::zeros();
                (self.altitude_m, self.climb_mps) = (0.0, 0.0);
                return;
            }
            Demand::Hold { altitude_m } | Demand::Go { altitude_m, .. } => Some(altitude_m),
            Demand::Track(target) => Some(target.altitude_m),
            Demand::Descend { .. } => None,
        };
        let climb = match *demand {
            Demand::Descend { rate_mps } if self.altitude_m > FLARE.0 => -rate_mps,
            Demand::Descend { rate_mps } => -rate_mps.min(FLARE.1.max(ability.descent_mps / 4.0)),
            _ => {
                let open = altitude_m.unwrap_or(self.altitude_m) - self.altitude_m;
                (open * CLIMB_GAIN).clamp(-ability.descent_mps, ability.climb_mps)
            }
        };
        self.step_vertical(dt_s, climb, altitude_m);
        let stays_ideal = matches!(
            demand,
            Demand::Track(Target {
                velocity: Some(_),
                ..
            })
        );
        if self.ideal && stays_ideal {
            return; // moved by `take`
        }
        let wanted = self.wanted_acceleration(demand, ability, air);
        let tracking = self.tracking_of(demand, ability);
        let part = dt_s / tracking.lag_s.max(dt_s);
        let jerk = ability.jerk_mps3.min(tracking.jerk_mps3);
        let change = clip((wanted - self.acceleration) * part, jerk * dt_s);
        self.acceleration += change;
        let push = air.surprise * (ability.acceleration_mps2 / ability.airspeed_mps);
        let drag = (self.velocity - air.wind) * ability.drag_per_s;
        let acceleration = self.acceleration + push - drag;
        self.position += self.velocity * dt_s + acceleration * (0.5 * dt_s * dt_s);
        self.velocity = clip(
            self.velocity + acceleration * dt_s,
            ability.speed_mps.max(self.velocity.norm()),
        );
        if self.is_on_ground() {
            self.velocity = Vector2::zeros();
            self.acceleration = Vector2::zeros();
        }
    }

    fn step_vertical(&mut self, dt_s: f64, wanted_mps: f64, altitude_m: Option<f64>) {
        if self.ideal {
            self.climb_mps = wanted_mps;
            if let Some(altitude_m) = altitude_m
                && (altitude_m - self.altitude_m).abs() < 0.05
            {
                (self.altitude_m, self.climb_mps) = (altitude_m, 0.0);
            }
        } else {
            let most = VERTICAL_ACCELERATION * dt_s;
            self.climb_mps += (wanted_mps - self.climb_mps).clamp(-most, most);
        }
        self.altitude_m += self.climb_mps * dt_s;
        if self.altitude_m <= 0.0 {
            self.altitude_m = 0.0;
            self.climb_mps = self.climb_mps.max(0.0);
        }
    }

    fn wanted_acceleration(&self, demand: &Demand, ability: &Ability, air: &Air) -> Vector2<f64> {
        let tracking = self.tracking_of(demand, ability);
        let (velocity, feedforward) = match *demand {
            Demand::Track(Target {
                position,
                velocity: Some(velocity),
                acceleration,
                age_s,
                ..
            }) => {
                // The setpoint states the position at the time of its arrival. It is extrapolated
                // from there, and the acceleration only over a few setpoints.
                let age_s = age_s - tracking.delay_s;
                let bend = age_s.min(0.3);
                let now = velocity + acceleration * bend;
                let place = position + velocity * age_s + acceleration * (0.5 * bend * bend);
                let open = place - self.position;
                (
                    now + open * tracking.position_gain,
                    acceleration * tracking.feedforward,
                )
            }
            Demand::Track(Target { position, .. }) => (
                self.approach(position, ability.speed_mps, ability),
                Vector2::zeros(),
            ),
            Demand::Go {
                position,
                speed_mps,
                ..
            } => (
                self.approach(position, speed_mps.min(ability.speed_mps), ability),
                Vector2::zeros(),
            ),
            _ => (Vector2::zeros(), Vector2::zeros()),
        };
        // The autopilot leans against the steady wind.
        let leans = (air.wind - air.surprise) * ability.drag_per_s;
        let velocity = clip(velocity, ability.speed_mps);
        let velocity = air.wind + clip(velocity - air.wind, ability.airspeed_mps);
        clip(
            feedforward + (velocity - self.velocity) * tracking.velocity_gain - leans,
            (ability.acceleration_mps2 * tracking.headroom).min(tracking.acceleration_mps2),
        )
    }

    /// The fitted constants are valid only for streams of moving setpoints.
    fn tracking_of(&self, demand: &Demand, ability: &Ability) -> Tracking {
        match demand {
            Demand::Track(Target {
                velocity: Some(_), ..
            }) => Tracking {
                position_gain: self.tracking.position_gain * ability.shaping_per_s,
                velocity_gain: self.tracking.velocity_gain * ability.shaping_per_s,
                ..self.tracking
            },
            _ => Tracking::GENERIC,
        }
    }

    /// Returns the velocity that ends at rest at `place`: no faster than the body can brake.
    fn approach(&self, place: Position<f64>, speed_mps: f64, ability: &Ability) -> Vector2<f64> {
        let open = place - self.position;
        let distance = open.norm();
        if distance < 1e-9 {
            return Vector2::zeros();
        }
        let braking = (distance * ability.acceleration_mps2).sqrt();
        open * (speed_mps.min(braking).min(distance * POSITION_GAIN) / distance)
    }
}

//! The physical limits of a vehicle.

/// The physical limits of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ability {
    /// The largest horizontal speed over ground, m/s.
    pub speed_mps: f64,
    /// The largest horizontal speed through the air, m/s.
    pub airspeed_mps: f64,
    /// The largest horizontal acceleration, m/s^2.
    pub acceleration_mps2: f64,
    /// Drag that the autopilot does not model, m/s^2 per m/s through the air. It makes the vehicle
    /// slower than commanded, and the difference grows with the speed.
    pub drag_per_s: f64,
    /// The largest horizontal jerk, m/s^3.
    pub jerk_mps3: f64,
    /// The jerk divided by the acceleration of the autopilot's own limits, 1/s. It determines how
    /// tightly ArduCopter follows its setpoints.
    pub shaping_per_s: f64,
    /// The rate of climb, m/s.
    pub climb_mps: f64,
    /// The rate of descent when landing, m/s.
    pub descent_mps: f64,
}

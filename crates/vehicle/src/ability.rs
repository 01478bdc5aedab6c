//! What a vehicle can do.

/// What the body can do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ability {
    /// Largest horizontal speed over ground, m/s.
    pub speed_mps: f64,
    /// Largest horizontal speed through the air, m/s.
    pub airspeed_mps: f64,
    /// Largest horizontal acceleration, m/s^2.
    pub acceleration_mps2: f64,
    /// Drag that the autopilot does not know of, m/s^2 for each m/s through the air. It makes the
    /// vehicle slower than it is told to be, by more the faster it is.
    pub drag_per_s: f64,
    /// Largest horizontal jerk, m/s^3.
    pub jerk_mps3: f64,
    /// Jerk over acceleration of the autopilot's own limits, 1/s: how firmly ArduCopter follows.
    pub shaping_per_s: f64,
    /// Rate of climb, m/s.
    pub climb_mps: f64,
    /// Rate of descent when landing, m/s.
    pub descent_mps: f64,
}

//! The built-in vehicle: a MAVLink 2 endpoint around a simulated body, without I/O.
//!
//! Its inputs are bytes and the time, its output is bytes, like those of the client that flies it.
//! It does not matter whether they are transferred by a function call, a lossy link or a socket. In
//! simulated time it is deterministic. Its clock may run at another rate than the caller's: its own
//! time is [`VehicleSettings::clock_rate`] times the time that it is given.
//!
//! ```text
//! receive(now, bytes) ─ endpoint ─ mode, arming, setpoint ─ body ─ telemetry ─ next_frame()
//! ```

#![deny(missing_docs)]

mod ability;
mod behavior;
mod body;
mod conduct;
mod endpoint;
mod mission_store;
mod missions;
mod parameters;
mod profile;
mod setpoints;
mod settings;
mod simulated;
mod streams;
mod telemetry;
mod timing;
mod wind;

pub use ability::Ability;
pub use profile::{Airframe, Profile};
pub use settings::{Faults, VehicleSettings};
pub use simulated::{FlightMode, Vehicle};
pub use timing::{Pauses, Sampling};

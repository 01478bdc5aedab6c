//! The built-in vehicle: a MAVLink 2 endpoint around a simulated body, without I/O.
//!
//! It takes bytes and the time and gives bytes, like the client it is flown by; whether they
//! travel through a function call, a lossy link or a socket is not its business. In simulated
//! time it is deterministic. Its clock need not run as fast as the caller's: all of its time is
//! [`VehicleSettings::clock_rate`] of the time that it is given.
//!
//! ```text
//! receive(now, bytes) ─ endpoint ─ mode, arming, setpoint ─ body ─ telemetry ─ next_frame()
//! ```

#![deny(missing_docs)]

mod ability;
mod body;
mod conduct;
mod endpoint;
mod mission_store;
mod missions;
mod parameters;
mod profile;
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

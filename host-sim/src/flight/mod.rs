//! Flies a mission: world, ground link, onboard computer, MAVLink and vehicle in one loop.
//!
//! ```text
//!   World <- Ground  <-- postcard frames -->  Onboard  <-- MAVLink 2 frames -->  vehicle
//! ```
//!
//! Both links carry encoded bytes even if both ends are in this process. With the built-in vehicle
//! time is simulated in steps of 10 ms, as fast as possible or with a real-time factor; with any
//! other vehicle it is real time.

mod airframe;
pub mod board;
mod clock;
mod ground;
mod in_process;
mod observer;
mod outcome;
mod peer;
mod precision;
mod reason;
mod settings;
mod stopwatch;

pub use airframe::{ProfileChoice, WrongProfile};
pub use in_process::fly;
pub use observer::Observer;
pub use outcome::{FailedFlight, FlightError};
pub use peer::Peer;
pub(crate) use reason::is_notable;
pub use settings::{CONNECT_PATIENCE, FlightSettings, Pace, autopilot_settings, vehicle_settings};

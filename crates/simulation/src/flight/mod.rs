//! Flies a mission: world, ground link, onboard computer, MAVLink and vehicle in one loop.
//!
//! ```text
//!   World <- Ground  <-- postcard frames -->  OnboardComputer  <-- MAVLink 2 frames -->  Peer
//! ```
//!
//! The loop (`flight_loop`) is the same for every [`computer::OnboardComputer`]: the controller in
//! this process, the microcontroller image, and its twin.
//!
//! Both links carry encoded bytes even if both ends are in this process. With the built-in vehicle
//! time is simulated in steps of 10 ms, as fast as possible or with a real-time factor; with any
//! other vehicle it is real time.

mod airframe;
mod client;
mod clock;
pub mod computer;
mod flight_loop;
mod ground;
mod observer;
mod outcome;
mod peer;
mod precision;
mod reason;
mod settings;
mod stopwatch;

pub use airframe::{ProfileChoice, WrongProfile};
pub use client::ClientSettings;
pub use flight_loop::{fly, fly_with};
pub use observer::Observer;
pub use outcome::{FailedFlight, FlightError};
pub use peer::Peer;
pub use reason::is_notable;
pub use settings::{
    CONNECT_PATIENCE, FlightSettings, RealTimeFactor, autopilot_settings, vehicle_settings,
};

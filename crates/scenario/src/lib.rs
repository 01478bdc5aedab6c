//! Missions as TOML files: reading, checking, writing and generating them.
//!
//! Units are part of the names of the keys, and unknown keys are errors. Every error is one line
//! that names the file, the field, the value and what is allowed. The ranges are defined in
//! [`firmware_core::mission`], the only place that rejects a mission.
//!
//! * [`Scenario`] is a mission as the host knows it; [`ScenarioChoice`] are the command-line options
//!   that select one.
//! * [`Events`] are the changes of a mission in flight, and [`Timeline`] the mission in each slot.
//! * [`Uncertainty`] is how the world differs from what is known of it, and [`Tracks`] where users and
//!   sensors truly are.
//! * [`generate`] and [`random`] make scenarios; [`MissionGroup`] is a group of random ones.
//! * [`PlaceRates`] computes the rates at any position.

#![deny(missing_docs)]

mod choice;
mod digest;
mod events;
mod file;
mod gain_map;
mod groups;
mod mission_file;
mod node_csv;
mod random;
mod random_events;
mod rates;
mod scenario;
mod sensing;
mod topology;
mod tracks;
mod uncertainty;

use firmware_core::{Mission, SENSORS_MAX, USERS_MAX};

pub use choice::{Changes, ScenarioChoice};
pub use events::{Events, Timeline};
pub use file::ScenarioError;
pub use files::PerNode;
pub use groups::{MissionGroup, MissionProperties};
pub use mission_file::Origin;
pub use random::{DrawnMission, Layout, Layouts, random};
pub use random_events::EventKind;
pub use rates::{ABSENT_RATE, PlaceRates, with_field};
pub use scenario::Scenario;
pub use sensing::{Function, Sensing, TemperatureField};
pub use topology::{Course, Topology, generate, generate_on};
pub use tracks::Tracks;
pub use uncertainty::{Motion, MotionModel, MovingNodes, Uncertainty};

/// A mission as the host flies it: in double precision and at the default capacities.
pub type HostMission = Mission<f64, USERS_MAX, SENSORS_MAX>;

#[cfg(test)]
mod tests;

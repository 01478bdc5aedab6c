//! Planning before take-off, on the host: how good a mission can be, and a mission that is nearly
//! as good.
//!
//! * [`bound`]: an upper bound of the data that any mission can carry, certified.
//! * [`search`]: a feasible mission close to it, offline.
//! * [`planner`]: [`firmware_core::planner`] with the host's memory, and `.plan` files.
//! * [`waypoint_file`]: missions that somebody else has planned.

#![deny(missing_docs)]

pub mod bound;
pub mod planner;
pub mod search;
pub mod waypoint_file;

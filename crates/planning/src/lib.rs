//! Planning before take-off, on the host: how good a mission can be, and a mission that is nearly
//! as good.
//!
//! * [`bound`]: a certified upper bound on the data that any mission can transmit.
//! * [`search`]: a feasible mission close to the bound, computed offline.
//! * [`planner`]: [`firmware_core::planner`] with memory from the host's heap, and `.plan` files.
//! * [`waypoint_file`]: missions that another program has planned, as files.

#![deny(missing_docs)]

pub mod bound;
pub mod hindsight;
pub mod planner;
pub mod search;
pub mod waypoint_file;

//! Flights through simulated missions: the world and its signals, the loop that flies, its record, and
//! the benchmark of policies. The flight logic is in [`firmware_core`] and is only called from here.
//! The command line and the reports of `host-sim` and the Python package are built on this crate.
//!
//! | module | contents |
//! |---|---|
//! | [`world`], [`nomographic`] | the true channels, the signals, the measurements of the sensors |
//! | [`flight`] | the loop that flies one mission with the world and the vehicle |
//! | [`session`] | a client of an autopilot without setpoints |
//! | [`signing`] | clock and saved state of MAVLink signatures |
//! | [`policy`] | the policies that can be named on a command line |
//! | [`record`] | the record of a flight |
//! | [`journal`] | the parameters that were changed in a vehicle and are not restored yet |
//! | [`benchmark`] | policies on many missions, as fractions of certified bounds |
//! | [`processor_time`] | how long something takes, on a busy machine too |

pub mod benchmark;
pub mod flight;
pub mod journal;
pub mod nomographic;
pub mod policy;
pub mod processor_time;
pub mod record;
pub mod session;
pub mod signing;
pub mod world;

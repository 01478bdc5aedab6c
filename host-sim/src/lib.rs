//! The simulator around the onboard controller: the world and its signals, flights, records,
//! reports and the command line. The flight logic is in [`firmware_core`] and is only called from
//! here.
//!
//! | module | contents |
//! |---|---|
//! | [`world`], [`nomographic`] | the true channels, the signals, the measurements of the sensors |
//! | [`flight`] | the loop that flies one mission with the world and the vehicle |
//! | [`session`], [`doctor`], [`upload`], [`watch`] | clients of an autopilot without setpoints |
//! | [`serve`] | the built-in vehicle as a separate process |
//! | [`signing`] | clock and saved state of MAVLink signatures |
//! | [`policy`] | the policies that can be named on a command line |
//! | [`record`], [`report`] | the record of a flight, and the pages made from it |
//! | [`journal`] | the parameters that were changed in a vehicle and are not restored yet |
//! | [`processor_time`] | how long something takes, on a busy machine too |
//! | [`experiment`], [`benchmark`] | the figures of the paper; policies on many missions |
//!
//! Scenarios, the bound and the search, vehicles, links and reference solvers are separate crates:
//! `scenario`, `planning`, `vehicle`, `link` and `reference`. The crate `figures` contains the
//! tools for figures and pages.

pub mod benchmark;
pub mod doctor;
pub mod experiment;
pub mod flight;
pub mod interrupt;
pub mod journal;
pub mod nomographic;
pub mod policy;
pub mod processor_time;
pub mod record;
pub mod report;
pub mod serve;
pub mod session;
pub mod signing;
pub mod upload;
pub mod watch;
pub mod world;

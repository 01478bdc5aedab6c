//! The simulator's reports and its command line. Flights themselves, with their world and their
//! records, are in the crate `simulation`, whose modules are re-exported here.
//!
//! | module | contents |
//! |---|---|
//! | [`doctor`], [`upload`], [`watch`] | clients of an autopilot without setpoints |
//! | [`serve`] | the built-in vehicle as a separate process |
//! | [`report`] | the files and pages made from the record of a flight |
//! | [`flight_log`] | the record of a flight as an MCAP file, for Foxglove |
//! | [`experiment`], [`benchmark`] | the figures of the paper; policies on many missions |
//! | [`interrupt`] | ctrl-C |
//!
//! Scenarios, the bound and the search, vehicles, links and reference solvers are separate crates:
//! `scenario`, `planning`, `vehicle`, `link` and `reference`. The crate `figures` contains the
//! tools for figures and pages.

pub mod benchmark;
pub mod doctor;
pub mod experiment;
pub mod flight_log;
pub mod interrupt;
pub mod report;
pub mod serve;
pub mod upload;
pub mod watch;

pub use simulation::{
    flight, journal, nomographic, policy, processor_time, record, session, signing, world,
};

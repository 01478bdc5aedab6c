//! The simulator around the onboard controller: the world and its signals, flights, records,
//! reports and the command line. Flight logic is in [`firmware_core`] and is only called from here.
//!
//! | module | what it owns |
//! |---|---|
//! | [`world`], [`nomographic`] | true channels, the signals themselves, what sensors measure |
//! | [`flight`] | one mission, world to vehicle and back, in one loop |
//! | [`session`], [`doctor`], [`upload`], [`watch`] | a client that talks to an autopilot and flies nothing |
//! | [`serve`] | the built-in vehicle as a process of its own |
//! | [`policy`] | the policies that can be named on a command line |
//! | [`record`], [`report`] | what a flight leaves behind, and its pages |
//! | [`journal`] | what is changed in a vehicle and not put back yet |
//! | [`experiment`], [`benchmark`] | the figures of the paper; policies on many missions |
//!
//! Scenarios, the bound and the search, vehicles, links and reference solvers are crates of their
//! own: `scenario`, `planning`, `vehicle`, `link`, `reference`, and the kit of
//! figures and pages: `figures`.

pub mod allocation;
pub mod benchmark;
pub mod doctor;
pub mod experiment;
pub mod flight;
pub mod interrupt;
pub mod journal;
pub mod nomographic;
pub mod policy;
pub mod record;
pub mod report;
pub mod serve;
pub mod session;
pub mod upload;
pub mod watch;
pub mod world;

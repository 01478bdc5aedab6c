//! Everything around the onboard controller: scenarios, the world and its signals, the vehicle,
//! links, flights, reports. Flight logic itself lives in [`firmware_core`] and is only called
//! from here.
//!
//! | room | what it owns |
//! |---|---|
//! | [`scenario`] | missions as TOML files |
//! | [`world`], [`nomographic`] | true channels, the signals themselves, what sensors measure |
//! | [`vehicle`] | the built-in vehicle: a MAVLink endpoint around a simulated body |
//! | [`flight`] | one mission, world to vehicle and back, in one loop |
//! | [`bound`] | the most that any mission can carry, certified |
//! | [`search`] | a mission that comes close to it |
//! | [`policy`] | the policies that can be named on a command line |
//! | [`record`] | what a flight leaves behind |
//! | [`journal`] | what is changed in a vehicle and not put back yet |
//! | [`document`] | tables that commands write into documents |
//! | [`experiment`] | the figures of the paper |

pub mod allocation;
pub mod benchmark;
pub mod bound;
pub mod conic;
pub mod doctor;
pub mod document;
pub mod experiment;
pub mod flight;
pub mod input;
pub mod interrupt;
pub mod journal;
pub mod link;
pub mod nomographic;
pub mod planner;
pub mod policy;
pub mod record;
pub mod report;
pub mod scenario;
pub mod search;
pub mod solve;
pub mod upload;
pub mod vehicle;
pub mod world;

//! The host's side.

pub mod conic;
pub mod flight;
pub mod interrupt;
pub mod link;
pub mod nomographic;
pub mod record;
pub mod report;
pub mod scenario;
pub mod solve;
pub mod vehicle;
pub mod world;

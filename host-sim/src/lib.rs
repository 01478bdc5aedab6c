//! The host's side.

pub mod flight;
pub mod nomographic;
pub mod record;
pub mod scenario;
pub mod vehicle;
pub mod world;

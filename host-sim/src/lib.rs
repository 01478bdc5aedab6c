//! The host's side.

pub mod record;
pub mod scenario;

//! The host's side.

pub mod scenario;

//! Learning for the outer problem.

pub mod nn;

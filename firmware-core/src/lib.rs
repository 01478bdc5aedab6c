//! The onboard controller.
#![no_std]
#![deny(missing_docs)]

#[cfg(test)]
extern crate std;

pub mod scalar;

pub use scalar::{Displacement, Position, Scalar};

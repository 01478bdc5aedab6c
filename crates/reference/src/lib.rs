//! Slot problems outside of a flight: the reference implementation that the controller is compared
//! with, and the command that solves problems given as JSON lines.
//!
//! * [`conic`]: the slot problem as a second-order cone program, solved by Clarabel.
//! * [`uncertainty`]: the error statistics in a line.
//! * [`solve`]: reads JSON lines and writes JSON lines, with either solver.

#![deny(missing_docs)]

pub mod conic;
pub mod solve;
pub mod uncertainty;

// SPDX-License-Identifier: MIT OR Apache-2.0
//! Acknowledged commands, one at a time: sent, repeated, given up.
//!
//! Each command is repeated with a rising `confirmation` until its COMMAND_ACK is received. Whether
//! the command had its effect is decided elsewhere from the autopilot's *state* (mode, armed,
//! altitude), because an autopilot may accept a command and then not carry it out.

mod outcome;
mod pending;
mod request;

pub use outcome::CommandOutcome;
pub(super) use outcome::result_name;
pub use pending::Patience;
pub(super) use pending::{Pending, Turn};
pub use request::Request;

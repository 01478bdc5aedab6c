// SPDX-License-Identifier: MIT OR Apache-2.0
//! The console: a board's third serial line, which carries the orders for a flight.
//!
//! A board's image contains no mission. Before a flight the board receives a [`MissionOrder`] with
//! the mission, the vehicle's limits, the policy and the clock to use. It answers
//! [`BoardReport::Ready`] and flies, or refuses and gives the reason. Frames are those of the
//! [ground link](crate::link) under a version of their own, always in single precision.
//!
//! # The clock
//!
//! In the air the board's own timer is used. On a test bench ([`Clock::Console`]) the time is sent
//! over the console, so that board and simulated world stay in step however fast either computes:
//!
//! ```text
//! bench                                             board
//!   ground bytes, MAVLink bytes  ------------------->  waits until it has as many as Tick says,
//!   Tick { now, ground_bytes, mavlink_bytes }  ----->  takes them, does one round at `now`,
//!   waits until it has as many as Tock says  <-------  ground bytes, MAVLink bytes
//!                                            <-------  Tock { ground_bytes, mavlink_bytes, .. }
//! ```
//!
//! The three lines are not ordered relative to one another; the byte counts order them. A flight on
//! a bench is therefore the same, byte for byte, each time.

mod board;
mod mavlink_key;
mod order;
mod protocol;

pub use board::{
    BoardComputer, BoardMission, BoardPlanner, BoardPolicy, PLANNER_CAPACITY,
    PLANNER_OPERATIONS_PER_POLL, PlannerBytes, PlannerNumbers, TrainedPolicy, board_planner, ready,
};
pub use mavlink_key::MavlinkKey;
pub use order::{Clock, MissionOrder, OrderError, PolicyKind, in_single_precision, slot_patience};
pub use protocol::{
    BoardReport, CONSOLE_FRAME_MAX, CONSOLE_VERSION, Call, Calls, Cost, Footprint,
    REPORT_FRAME_MAX, Reports, TEXT_MAX, Tick, Tock, encode_call, encode_report, words,
};

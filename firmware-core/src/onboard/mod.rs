// SPDX-License-Identifier: MIT OR Apache-2.0
//! The whole onboard computer: controller, MAVLink client and ground link in one slot cycle.
//!
//! The module has no I/O and no clock: bytes and time come in as arguments, bytes go out on
//! request.
//!
//! ```text
//!             ground bytes                                  MAVLink bytes
//!                 |  ^                                           |  ^
//!  receive_ground v  | take_ground_frame         receive_mavlink v  | take_mavlink_frame
//!        +--------------------------------------------------------------------+
//!        |  link::Decoder   ->   Controller: plan, allocate   ->   Autopilot  |
//!        +--------------------------------------------------------------------+
//! ```
//!
//! In a slot the computer plans from the measured position, flies the leg, reports the
//! [`Arrival`](crate::link::Arrival), receives the channel state that the ground answers with, allocates, and sends the
//! command and a [`VehicleStatus`](crate::link::VehicleStatus); then the next slot begins. Slot `n` ends at `t_0 + n delta` of
//! the vehicle's clock, where `t_0` is the moment at which slot 1 began: the exchange takes place
//! in the first part of the next slot, and no message moves the end of a slot. An arrival that is
//! not answered is sent again. Where no channel state is received within
//! [`OnboardSettings::channel_patience`], the last one, aged, is used instead, and the command
//! states its age. Everything that is received and not used is counted.
//!
//! ```
//! use firmware_core::{
//!     Mission, Position,
//!     autopilot::{Autopilot, AutopilotSettings, frames::Geodetic, wire::MAX_FRAME},
//!     controller::Controller,
//!     link::FRAME_MAX,
//!     mission::MissionParameters,
//!     onboard::{Onboard, OnboardSettings, Stage},
//!     policy::StraightLine,
//!     time::Instant,
//! };
//!
//! let mission = Mission::new(MissionParameters::<f32, 4, 8> {
//!     users: [Position::new(200.0, 700.0)].into_iter().collect(),
//!     sensors: [Position::new(700.0, 100.0)].into_iter().collect(),
//!     ..MissionParameters::table_one()
//! })?;
//! let p = mission.parameters();
//! let origin = Geodetic { latitude_e7: 473_977_420, longitude_e7: 85_455_940 };
//! let settings = AutopilotSettings::new(origin, p.start, p.altitude_m, p.max_speed_mps);
//! let autopilot = Autopilot::new(settings)?;
//! let policy = StraightLine::new(&mission);
//! let controller = Controller::new(mission, policy);
//! let mut computer = Onboard::new(OnboardSettings::default(), controller, autopilot);
//!
//! // A round of the main loop: what was received on both links, one step, what is to be sent.
//! let now = Instant::from_micros(10_000);
//! computer.launch(now);
//! let (from_vehicle, from_ground): (&[u8], &[u8]) = (&[], &[]);
//! computer.receive_mavlink(now, from_vehicle, true);
//! computer.receive_ground(now, from_ground);
//! computer.poll(now, &mut ());
//! let (mut frame, mut ground_frame) = ([0; MAX_FRAME], [0; FRAME_MAX]);
//! let heartbeat = computer.take_mavlink_frame(now, &mut frame).expect("to the autopilot");
//! assert_eq!(heartbeat[0], 0xFD);
//! assert!(computer.take_ground_frame(&mut ground_frame).is_none());
//! assert_eq!(computer.stage(), Stage::Preparing);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! `examples/main_loop.rs` has the whole loop, over UDP.

mod computer;
mod links;
mod probe;
mod slot_cycle;
mod stage;

pub use computer::{Onboard, OnboardSettings};
pub use probe::{Activity, Probe};
pub use stage::{Fault, Stage};

#[cfg(test)]
mod tests;

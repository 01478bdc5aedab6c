// SPDX-License-Identifier: MIT OR Apache-2.0
//! The MAVLink client: flies the waypoints of the controller with a real autopilot.
//!
//! The client is a state machine without I/O. The caller passes received messages
//! ([`Autopilot::receive`]) and the time, asks for the messages to send ([`Autopilot::poll`], until
//! `None`), and sends them:
//!
//! ```text
//!            bytes                 messages              poll: messages          bytes
//!   link ───────────> wire::Decoder ───────> Autopilot ────────────> wire::Encoder ─────> link
//!                                              │   ▲
//!                       phase, position, ended │   │ launch, fly_leg, land, stop
//!                                              ▼   │
//!                                           slot cycle
//! ```
//!
//! ```
//! use firmware_core::{
//!     Position,
//!     autopilot::{
//!         Autopilot, AutopilotSettings, Phase,
//!         frames::Geodetic,
//!         wire::{Decoder, Encoder, MAX_FRAME},
//!     },
//!     time::{Duration, Instant},
//! };
//!
//! # fn read(_: &mut [u8]) -> usize { 0 }
//! # fn write(_: &[u8]) {}
//! let origin = Geodetic { latitude_e7: 473_977_420, longitude_e7: 85_455_940 };
//! let start = Position::new(50.0, 50.0);
//! let mut client = Autopilot::new(AutopilotSettings::<f64>::new(origin, start, 100.0, 30.0))?;
//! let (mut decoder, mut encoder) = (Decoder::in_order(), Encoder::new(client.own()));
//!
//! let mut now = Instant::ZERO;
//! client.launch(now);
//! let (mut received, mut frame) = ([0; 280], [0; MAX_FRAME]);
//! let mut sent = 0;
//! while now < Instant::ZERO + Duration::from_secs(3) {
//!     let length = read(&mut received);
//!     let mut bytes = &received[..length];
//!     while let Some(frame) = decoder.next_frame(&mut bytes) {
//!         if let Ok(Some(message)) = frame.client_message() {
//!             client.receive(now, frame.sender(), &message);
//!         }
//!     }
//!     while let Some(message) = client.poll(now) {
//!         encoder.send_as(client.own());
//!         if let Some(frame) = encoder.encode_of_client(&message, &mut frame) {
//!             write(frame);
//!             sent += 1;
//!         }
//!     }
//!     now = now + Duration::from_millis(10);
//! }
//! // No autopilot has answered: nothing but heartbeats, one a second, was sent.
//! assert_eq!((client.phase(), sent), (Phase::Connecting, 3));
//! # Ok::<(), firmware_core::autopilot::SettingsError>(())
//! ```
//!
//! # Terms
//!
//! * **phase**: the part of a flight that the client is in ([`Phase`]), from the first heartbeat to
//!   the landing.
//! * **leg**: the flight during one slot. The vehicle is to reach the leg's waypoint when the slot
//!   ends.
//! * **reference**: where the vehicle should be *now*; streamed as setpoints ([`guidance`]).
//! * **sample**: a measured position ([`Sample`]) with the time at which it was taken.
//! * **vehicle time**: the clock of the autopilot, with which its samples are stamped ([`clock`]).
//!   Legs, and so slots, begin and end in it. Time-outs run on our own clock.
//! * **tick**: the end of a leg. The position at a tick is interpolated between the samples around
//!   it, or extrapolated from the last sample where the next one is late. No message, early, late
//!   or lost, moves a tick.
//! * **control**: the client has control while the autopilot is in the mode that follows setpoints
//!   and the client set that mode itself. Lost control is never taken back.
//!
//! # Modules
//!
//! | module | what it contains |
//! |---|---|
//! | `client` | [`Autopilot`]: the state, and most of the interface |
//! | `state_machine`, `state` | the phases, and the state that each has |
//! | `readiness`, `checks`, [`preflight`], `refusals` | before a flight: telemetry and conditions that are waited for, parameters that are read and set, reasons to refuse the start |
//! | `control` | whether the client has control, and may send setpoints |
//! | `supervision`, [`failsafe`] | detected failures, and the reactions to them |
//! | `leg_start`, `leg_end` | the flight of a slot |
//! | `reference`, [`guidance`] | where the vehicle should be now: outside of legs, and in general |
//! | `trial` | measurement of the airframe's speed |
//! | `rx`, `tx` | received messages, and messages to send |
//! | `command` | acknowledged commands |
//! | `telemetry`, [`clock`] | the latest state of the vehicle, and its clock |
//! | [`profile`] | differences between autopilots |
//! | [`frames`] | the map, and north-east-down |
//! | [`wire`] | bytes and messages |
//! | [`mission`] | upload of a whole mission |

mod checks;
mod client;
pub mod clock;
mod command;
mod control;
mod event;
pub mod failsafe;
pub mod frames;
pub mod guidance;
mod leg;
mod leg_end;
mod leg_start;
pub mod mission;
mod phase;
pub mod preflight;
pub mod profile;
mod readiness;
mod reference;
mod refusals;
mod rx;
mod settings;
mod state;
mod state_machine;
mod supervision;
mod telemetry;
mod trial;
mod tx;
pub mod wire;

pub use checks::{Advice, ChangedParameter, Finding, advice};
pub use client::Autopilot;
pub use command::{CommandOutcome, Patience, Request};
pub use event::Event;
pub use leg::{Leg, LegEnd, LegError};
pub use phase::{Obstacle, Phase};
pub use settings::{AutopilotSettings, Coordinates, Geofence, OwnAddress, SettingsError};
pub use telemetry::Sample;

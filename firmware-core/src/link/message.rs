// SPDX-License-Identifier: MIT OR Apache-2.0
//! The messages of the ground link, and the length of their frames.

use serde::{Deserialize, Serialize};

use super::{
    length::{LENGTH, U8, U16, U32, U64, framed, longer},
    status::{SecurityCounters, VehicleStatus},
};
use crate::{
    SENSORS_MAX, USERS_MAX,
    controller::{ChannelQuality, ChannelState, DatedChange, Plan, SlotCommand, check_gain_count},
    scalar::{Position, Scalar},
    time::Tick,
};

/// The protocol version of this crate. Any change of a message needs a new version.
pub const PROTOCOL_VERSION: u8 = 4;

/// The version of authenticated frames: the messages are those of [`PROTOCOL_VERSION`].
pub const SECURE_VERSION: u8 = 64 + PROTOCOL_VERSION;

/// The length of the nonce in an authenticated frame, bytes.
pub(super) const NONCE: usize = 16;

/// The length of the tag, bytes: half of the hash, the least that RFC 2104 recommends.
pub(super) const TAG: usize = 16;

/// The bytes that authentication adds to a frame, before COBS: kind, nonce, counter and tag.
const AUTHENTICATION: usize = 1 + NONCE + 4 + TAG;

/// The longest frame at the default capacities, in double precision, authenticated or not.
pub const FRAME_MAX: usize = secure_frame_max::<f64>(USERS_MAX, SENSORS_MAX);

/// The longest frame of the handshake of an authenticated link, which has no message.
pub const HANDSHAKE_FRAME_MAX: usize = framed(AUTHENTICATION);

/// Returns the length of the longest authenticated frame: see [`frame_max`].
///
/// ```
/// use firmware_core::link::{FRAME_MAX, secure_frame_max};
///
/// assert_eq!(FRAME_MAX, secure_frame_max::<f64>(16, 64));
/// // Frames for 4 users and 8 sensors in single precision are a third as long.
/// assert!(secure_frame_max::<f32>(4, 8) < FRAME_MAX / 3);
/// ```
pub const fn secure_frame_max<T: Scalar>(users: usize, sensors: usize) -> usize {
    framed(message_max::<T>(users, sensors) + AUTHENTICATION)
}

/// Returns the length of the longest frame without authentication for up to so many users and
/// sensors, with numbers of type `T`, delimiters included.
///
/// The longest message is a channel state, a command or a status. A quality is shorter than a
/// channel state, and an arrival, a change and the counters of authentication are shorter than a
/// status, whatever the capacities.
///
/// # Panics
/// Panics, at compile time in a constant, if users and sensors together are more than 65,535: a
/// command counts their gains with 16 bits.
pub const fn frame_max<T: Scalar>(users: usize, sensors: usize) -> usize {
    framed(message_max::<T>(users, sensors))
}

/// Returns the length of the longest message.
const fn message_max<T: Scalar>(users: usize, sensors: usize) -> usize {
    check_gain_count(users, sensors);
    let real = size_of::<T>();
    let state = U32 + LENGTH + users * real + LENGTH + sensors * real;
    let reals = LENGTH + sensors * real + 4 * real;
    // A `usize` is a `u64` on a host.
    let command = U32 + (U8 + U64) + reals + (U8 + real) + U8 + U32 + 2 * U16;
    let plan_quality = U8 + 2 * size_of::<f32>() + U8;
    let status = VehicleStatus::COUNTERS * U32 + plan_quality;
    U8 + longer(state, longer(command, status))
}

/// A message between the ground and the vehicle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
#[allow(clippy::large_enum_variant)] // no allocator: every message has the size of the largest
pub enum Message<T: Scalar, const M: usize, const J: usize> {
    /// To the vehicle: the channels of a slot, measured at the reported position.
    ChannelState(ChannelState<T, M, J>),
    /// To the ground: a slot has been flown; its channels are to be measured.
    Arrival(Arrival<T>),
    /// To the ground: the transmissions of users and sensors in a slot.
    Command(SlotCommand<T, J>),
    /// To the ground, after every slot: the state of the vehicle.
    Status(VehicleStatus),
    /// To the vehicle: what is known of the mission has changed.
    Change(NumberedChange<T>),
    /// To the ground, after the status, where the link is authenticated: what was refused.
    Security(SecurityCounters),
    /// To the vehicle, before the channel state of its slot: how exactly the gains are known from
    /// then on.
    Quality(ChannelQuality<M, J>),
}

/// A change of the mission with its number in the order of all changes, from 1. The vehicle takes
/// them in this order, and its status says how many it has: the ground repeats the others.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct NumberedChange<T: Scalar> {
    /// The number.
    pub number: u32,
    /// The change and its slot.
    pub change: DatedChange<T>,
}

/// Reports that the vehicle is at the end of a slot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct Arrival<T: Scalar> {
    /// The plan of the slot: number, waypoint, user.
    pub plan: Plan<T>,
    /// The measured position of the vehicle at the tick, metres.
    pub position: Position<T>,
    /// The time at which the slot ended, on the vehicle's clock, and how it was determined.
    pub tick: Tick,
}

// SPDX-License-Identifier: MIT OR Apache-2.0
//! The bytes of the two links: from bytes to messages, and from messages to bytes.

use super::computer::Onboard;
use crate::{
    autopilot::wire::{
        self, FrameBuffer,
        signing::{self, LinkSigning, SigningState},
    },
    controller::{ChannelQuality, ChannelState, ControllerError},
    counter::count,
    inner::SlotSolver,
    link::{Message, NumberedChange, secure_frame_max},
    policy::Policy,
    scalar::Scalar,
    time::Instant,
};
use mavlink::dialects::common::MavMessage;

impl<T: Scalar, P: Policy<T, M>, const M: usize, const J: usize, S: SlotSolver<T>, const F: usize>
    Onboard<T, P, M, J, S, F>
{
    /// Signs every MAVLink frame from now on, and accepts only frames with a valid signature. Where
    /// the key is the present one, times and replay state are kept.
    pub fn sign_with(&mut self, signing: LinkSigning) {
        signing::start(&mut self.mavlink_in, &mut self.mavlink_out, signing);
    }

    /// Sets the clock of signatures, microseconds since 1970. It never goes back; a date before 2015
    /// or after 2099 changes nothing. A computer without a clock need not call it: it takes over the
    /// times of accepted frames, and the date in a SYSTEM_TIME of its autopilot.
    pub fn set_signing_time(&mut self, unix_us: u64) {
        signing::set_time(&mut self.mavlink_in, &mut self.mavlink_out, unix_us);
    }

    /// Returns what has to be saved so that after a restart our frames are accepted, and replayed
    /// ones are not; `None` if frames are not signed.
    pub fn signing_state(&self) -> Option<SigningState> {
        signing::state(&self.mavlink_in, &self.mavlink_out)
    }

    /// Takes bytes from the autopilot's link. With `datagram` set they are one datagram: an
    /// incomplete frame at its end is dropped.
    pub fn receive_mavlink(&mut self, now: Instant, bytes: &[u8], datagram: bool) {
        let (autopilot, unreadable) = (&mut self.autopilot, &mut self.mavlink_unreadable);
        let mut date_us = None;
        let mut take = |frame: wire::Frame<'_>| match frame.client_message() {
            // Only the autopilot's, as for every message, and of use only if it was signed.
            Ok(Some(MavMessage::SYSTEM_TIME(time))) => {
                if autopilot
                    .vehicle()
                    .is_some_and(|(address, _)| address == frame.sender())
                {
                    date_us = Some(time.time_unix_usec);
                }
            }
            Ok(Some(message)) => autopilot.receive(now, frame.sender(), &message),
            Ok(None) => {}
            // A value outside an enumeration is counted; the stream can be read on.
            Err(_) => count(unreadable),
        };
        let mut input = bytes;
        while let Some(frame) = self.mavlink_in.next_frame(&mut input) {
            take(frame);
        }
        while datagram && let Some(frame) = self.mavlink_in.end_of_datagram() {
            take(frame);
        }
        signing::synchronize(&mut self.mavlink_in, &mut self.mavlink_out);
        if let Some(date_us) = date_us {
            self.set_signing_time(date_us);
        }
    }

    /// Returns the next frame for the autopilot. Call until `None` after every
    /// [`poll`](Self::poll).
    pub fn take_mavlink_frame<'b>(
        &mut self,
        now: Instant,
        buffer: &'b mut FrameBuffer,
    ) -> Option<&'b [u8]> {
        let message = self.autopilot.poll(now)?;
        self.mavlink_out.send_as(self.autopilot.own());
        let frame = self.mavlink_out.encode_of_client(&message, buffer);
        debug_assert!(frame.is_some(), "{message:?} is not listed in wire::client");
        frame
    }

    /// Takes bytes from the ground link.
    pub fn receive_ground(&mut self, now: Instant, bytes: &[u8]) {
        for &byte in bytes {
            let Some(Ok(message)) = self.ground.push(byte) else {
                continue;
            };
            match message {
                Message::ChannelState(state) => self.take_channel_state(now, state),
                Message::Change(change) => self.take_change(&change),
                Message::Quality(quality) => self.take_quality(&quality),
                Message::Arrival(_)
                | Message::Command(_)
                | Message::Status(_)
                | Message::Security(_) => count(&mut self.slots.echoes),
            }
        }
    }

    /// Keeps a channel state if a slot is waiting for it. Nothing else counts as a sign of the ground
    /// for the failsafe: not what anybody could send at any time, and not what this end has sent.
    fn take_channel_state(&mut self, now: Instant, state: ChannelState<T, M, J>) {
        let wanted = self.measuring.is_some() && self.channel_state.is_none();
        match self.controller.check_state(&state) {
            Ok(_) if wanted => {
                self.channel_state = Some(state);
                self.autopilot.note_ground_link(now);
            }
            Err(ControllerError::WrongSize { .. }) => {
                count(&mut self.slots.states_of_wrong_size);
            }
            _ => count(&mut self.slots.states_out_of_turn),
        }
    }

    /// Takes note of the quality of channel estimates. One that is taken has no counter of its own.
    #[inline(never)] // so that its copies are not in the frame of every message
    fn take_quality(&mut self, quality: &ChannelQuality<M, J>) {
        match self.controller.note_quality(quality) {
            Ok(()) => {}
            Err(ControllerError::WrongSize { .. }) => {
                count(&mut self.slots.states_of_wrong_size);
            }
            Err(_) => count(&mut self.slots.states_out_of_turn),
        }
    }

    /// Takes note of a change of the mission if it is the next one.
    fn take_change(&mut self, change: &NumberedChange<T>) {
        let in_turn = self.slots.changes.checked_add(1) == Some(change.number);
        if in_turn && self.controller.note_change(&change.change) {
            count(&mut self.slots.changes);
        } else {
            count(&mut self.slots.changes_out_of_turn);
        }
    }

    /// Returns the next frame for the ground. Call until `None` after every [`poll`](Self::poll).
    ///
    /// A buffer that is too short for a frame of these capacities does not compile.
    pub fn take_ground_frame<'b, const B: usize>(
        &mut self,
        buffer: &'b mut [u8; B],
    ) -> Option<&'b [u8]> {
        const {
            assert!(
                secure_frame_max::<T>(M, J) <= B,
                "the buffer for frames to the ground is too short for M users and J sensors: it \
                 must have at least `link::secure_frame_max::<T>(M, J)` bytes"
            )
        };
        if self.ground.is_handshake_due() {
            return self.ground.take_handshake(buffer);
        }
        if !self.ground.has_session() {
            return None;
        }
        // A slot's command before the next slot's arrival.
        let message: Message<T, M, J> = if let Some(command) = self.command.take() {
            Message::Command(command)
        } else if let Some(arrival) = self.arrival.take() {
            Message::Arrival(arrival)
        } else if self.status_due {
            self.status_due = false;
            self.security_due = true;
            Message::Status(self.status())
        } else if let Some(&counters) = self.ground.security().filter(|_| self.security_due) {
            self.security_due = false;
            Message::Security(counters)
        } else {
            return None;
        };
        // Every message fits, see above.
        let frame = self.ground.encode(&message, buffer).ok();
        if frame.is_none() {
            // The session was at its last counter.
            count(&mut self.slots.unsent);
        }
        frame
    }
}

//! The bytes of the two links: from bytes to messages, and from messages to bytes.

use super::computer::Onboard;
use crate::{
    autopilot::wire::{
        self, FrameBuffer,
        signing::{Signer, Verifier},
    },
    controller::{ChannelState, ControllerError},
    counter::count,
    inner::SlotSolver,
    link::{self, FRAME_MAX, Message, NumberedChange},
    policy::Policy,
    scalar::Scalar,
    time::Instant,
};

impl<T: Scalar, P: Policy<T, M>, const M: usize, const J: usize, S: SlotSolver<T>>
    Onboard<T, P, M, J, S>
{
    /// Signs every MAVLink frame from now on, and accepts only frames with a valid signature.
    pub fn sign_with(&mut self, signer: Signer, verifier: Verifier) {
        self.mavlink_out.sign_with(signer);
        self.mavlink_in.require_signatures(verifier);
    }

    /// Sets the clock of signatures, microseconds since 1970. It never goes back.
    pub fn set_signing_time(&mut self, unix_us: u64) {
        if let Some(signer) = self.mavlink_out.signer_mut() {
            signer.set_time(unix_us);
        }
        if let Some(verifier) = self.mavlink_in.verifier_mut() {
            verifier.set_time(unix_us);
        }
    }

    /// Takes bytes from the autopilot's link. With `datagram` set they are one datagram: an
    /// incomplete frame at its end is dropped.
    pub fn receive_mavlink(&mut self, now: Instant, bytes: &[u8], datagram: bool) {
        let (autopilot, unreadable) = (&mut self.autopilot, &mut self.mavlink_unreadable);
        let mut take = |frame: wire::Frame<'_>| match frame.client_message() {
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
            let Some(Ok(message)) = self.ground_in.push(byte) else {
                continue;
            };
            self.autopilot.note_ground_link(now);
            match message {
                Message::ChannelState(state) => self.take_channel_state(state),
                Message::Change(change) => self.take_change(&change),
                Message::Arrival(_) | Message::Command(_) | Message::Status(_) => {
                    count(&mut self.slots.echoes);
                }
            }
        }
    }

    /// Keeps a channel state if a slot is waiting for it.
    fn take_channel_state(&mut self, state: ChannelState<T, M, J>) {
        let wanted = self.measuring.is_some() && self.channel_state.is_none();
        match self.controller.check_state(&state) {
            Ok(_) if wanted => self.channel_state = Some(state),
            Err(ControllerError::WrongSize { .. }) => {
                count(&mut self.slots.states_of_wrong_size);
            }
            _ => count(&mut self.slots.states_out_of_turn),
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
    pub fn take_ground_frame<'b>(&mut self, buffer: &'b mut [u8; FRAME_MAX]) -> Option<&'b [u8]> {
        // A slot's command before the next slot's arrival.
        let message: Message<T, M, J> = if let Some(command) = self.command.take() {
            Message::Command(command)
        } else if let Some(arrival) = self.arrival.take() {
            Message::Arrival(arrival)
        } else if self.status_due {
            self.status_due = false;
            Message::Status(self.status())
        } else {
            return None;
        };
        // Every message fits: `encode` does not compile where one could be too long.
        link::encode(&message, buffer).ok()
    }
}

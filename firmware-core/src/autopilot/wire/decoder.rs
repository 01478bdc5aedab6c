// SPDX-License-Identifier: MIT OR Apache-2.0
//! Bytes to frames.

use mavlink::calculate_crc;

use super::frame::Frame;
use super::layout::{CHECKSUM, HEADER, MAX_FRAME, SIGNATURE, SIGNED, START, checksum_seed, field};
use super::sequence_tracker::SequenceTracker;
use super::signing::{Verdict, Verifier};
use crate::counter::{MavlinkCounters, count};

/// Finds frames in a stream of bytes.
#[derive(Clone, Debug)]
pub struct Decoder {
    buffer: [u8; MAX_FRAME],
    /// The number of bytes held.
    length: usize,
    /// The number of bytes at the front that were yielded or refused and are removed by the next
    /// call.
    spent: usize,
    pub(super) counters: MavlinkCounters,
    sequences: Option<SequenceTracker>,
    verifier: Option<Verifier>,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

/// What the bytes at the front of the buffer are.
enum Candidate {
    /// Too short to tell.
    Incomplete,
    /// A good frame of this length.
    Frame(usize),
    /// Not a frame: drop this many bytes.
    Drop(usize),
}

impl Decoder {
    /// Creates an empty decoder.
    pub const fn new() -> Self {
        Self {
            buffer: [0; MAX_FRAME],
            length: 0,
            spent: 0,
            counters: MavlinkCounters {
                frames: 0,
                bad_checksum: 0,
                unknown_message: 0,
                unknown_flags: 0,
                skipped_bytes: 0,
                out_of_order: 0,
                unsigned: 0,
                bad_signature: 0,
                replayed: 0,
            },
            sequences: None,
            verifier: None,
        }
    }

    /// Creates an empty decoder that drops frames which come twice, or after a later frame of the
    /// same sender. A receiver that derives a vehicle's state from the frames needs this.
    pub const fn in_order() -> Self {
        let mut decoder = Self::new();
        decoder.sequences = Some(SequenceTracker::new());
        decoder
    }

    /// Accepts only frames with a valid signature from now on. The replay state of an earlier
    /// verifier with the same key is kept.
    pub fn require_signatures(&mut self, mut verifier: Verifier) {
        if let Some(older) = &self.verifier {
            verifier.continue_from(older);
        }
        self.verifier = Some(verifier);
    }

    /// Returns the verifier of signatures, for example to save its state.
    pub fn verifier(&self) -> Option<&Verifier> {
        self.verifier.as_ref()
    }

    /// Returns the verifier of signatures, for example to set its clock.
    pub fn verifier_mut(&mut self) -> Option<&mut Verifier> {
        self.verifier.as_mut()
    }

    /// Returns the counters of what was received so far.
    pub fn counters(&self) -> MavlinkCounters {
        self.counters
    }

    /// Takes bytes from the front of `input` until a frame is complete, and returns that frame;
    /// returns `None` when the input is used up. Call until `None`. Each input byte is looked at a
    /// bounded number of times (at most the length of a frame, in noise made of start bytes).
    pub fn next_frame(&mut self, input: &mut &[u8]) -> Option<Frame<'_>> {
        loop {
            self.discard_spent();
            match self.candidate() {
                Candidate::Frame(length) => {
                    count(&mut self.counters.frames);
                    self.spent = length;
                    return self.buffer.get(..length).and_then(Frame::new);
                }
                Candidate::Drop(count) => self.spent = count,
                Candidate::Incomplete => {
                    let free = self.buffer.get_mut(self.length..).unwrap_or_default();
                    let count = input.len().min(free.len());
                    if count == 0 {
                        return None;
                    }
                    let (head, tail) = input.split_at_checked(count)?;
                    free.get_mut(..count)?.copy_from_slice(head);
                    self.length += count;
                    *input = tail;
                }
            }
        }
    }

    /// Marks the end of a datagram: the bytes that are still held can no longer become a frame.
    /// Returns the frames that are hidden in them behind a false start byte; call until `None`.
    pub fn end_of_datagram(&mut self) -> Option<Frame<'_>> {
        loop {
            self.discard_spent();
            if self.length == 0 {
                return None;
            }
            match self.candidate() {
                Candidate::Frame(length) => {
                    count(&mut self.counters.frames);
                    self.spent = length;
                    return self.buffer.get(..length).and_then(Frame::new);
                }
                Candidate::Drop(count) => self.spent = count,
                Candidate::Incomplete => {
                    count(&mut self.counters.skipped_bytes);
                    self.spent = 1;
                }
            }
        }
    }

    fn discard_spent(&mut self) {
        let spent = core::mem::take(&mut self.spent);
        if spent > 0 {
            let held = self.buffer.get_mut(..self.length).unwrap_or_default();
            // Never more than is held.
            if spent <= held.len() {
                held.copy_within(spent.., 0);
                self.length = held.len() - spent;
            }
        }
    }

    fn candidate(&mut self) -> Candidate {
        let held = self.buffer.get(..self.length).unwrap_or_default();
        let Some(&first) = held.first() else {
            return Candidate::Incomplete;
        };
        if first != START {
            let noise = held.iter().position(|&b| b == START).unwrap_or(held.len());
            self.counters.skipped_bytes = self.counters.skipped_bytes.saturating_add(noise as u32);
            return Candidate::Drop(noise);
        }
        let Some(header) = held.first_chunk::<HEADER>() else {
            return Candidate::Incomplete;
        };
        let flags = header[field::INCOMPATIBILITY_FLAGS];
        if flags & !SIGNED != 0 {
            count(&mut self.counters.unknown_flags);
            return Candidate::Drop(1);
        }
        let payload = usize::from(header[field::LENGTH]);
        let signature = if flags & SIGNED != 0 { SIGNATURE } else { 0 };
        let whole = HEADER + payload + CHECKSUM + signature;
        let parts = held.get(..whole).and_then(|bytes| {
            let checked = bytes.get(field::checked(payload))?;
            let checksum = bytes.get(field::checksum(payload))?.first_chunk()?;
            Some((Frame::new(bytes)?, checked, u16::from_le_bytes(*checksum)))
        });
        let Some((frame, checked, sent_checksum)) = parts else {
            return Candidate::Incomplete;
        };
        let Some(seed) = checksum_seed(frame.message_id()) else {
            // Autopilots send many messages of their own dialects: skip the whole frame.
            count(&mut self.counters.unknown_message);
            return Candidate::Drop(whole);
        };
        let checksum = calculate_crc(checked, seed);
        if sent_checksum == checksum {
            if let Some(verifier) = &mut self.verifier {
                let refused = match verifier.verify(&frame) {
                    Verdict::Valid => None,
                    Verdict::Unsigned => Some(&mut self.counters.unsigned),
                    Verdict::Wrong => Some(&mut self.counters.bad_signature),
                    Verdict::Replayed => Some(&mut self.counters.replayed),
                };
                if let Some(counter) = refused {
                    count(counter);
                    return Candidate::Drop(whole);
                }
            }
            if let Some(sequences) = &mut self.sequences
                && sequences.is_late(frame.sender(), frame.sequence())
            {
                count(&mut self.counters.out_of_order);
                return Candidate::Drop(whole);
            }
            Candidate::Frame(whole)
        } else {
            // The start byte may have been payload: look for the next one inside.
            count(&mut self.counters.bad_checksum);
            Candidate::Drop(1)
        }
    }
}

//! MAVLink over a link: frames in both directions are checked, numbered and logged.

use std::collections::VecDeque;
use std::fmt;
use std::io::{self, Write};

use firmware_core::autopilot::wire::signing::{self, LinkSigning};
use firmware_core::time::Instant;
use firmware_core::{
    autopilot::wire::{Address, Decoder, Encoder, Frame, MAX_FRAME},
    counter::MavlinkCounters,
};
use mavlink::dialects::common::MavMessage;

use super::Link;
use super::tlog::{TlogWriter, wall_clock_us};

/// A link with a decoder, an encoder and a log.
pub struct Port {
    link: Box<dyn Link>,
    decoder: Decoder,
    encoder: Encoder,
    log: Option<TlogWriter<Box<dyn Write + Send>>>,
    received: VecDeque<(Address, MavMessage)>,
    piece: Vec<u8>,
}

impl fmt::Debug for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Port")
            .field("link", &self.link)
            .field("counters", &self.decoder.counters())
            .finish_non_exhaustive()
    }
}

impl Port {
    /// Creates a port that sends as `own` over `link`, until [`send_as`](Self::send_as) changes it.
    pub fn new(link: Box<dyn Link>, own: Address) -> Self {
        Self {
            link,
            decoder: Decoder::in_order(),
            encoder: Encoder::new(own),
            log: None,
            received: VecDeque::new(),
            piece: Vec::new(),
        }
    }

    /// Starts to log every frame that is sent or received.
    pub fn log_to(&mut self, log: TlogWriter<Box<dyn Write + Send>>) {
        self.log = Some(log);
    }

    /// Signs what is sent, and accepts only frames with a valid signature. The clock is that of the
    /// system.
    pub fn sign_with(&mut self, signing: LinkSigning) {
        signing::start(&mut self.decoder, &mut self.encoder, signing);
        self.set_signing_time();
    }

    fn set_signing_time(&mut self) {
        signing::set_time(&mut self.decoder, &mut self.encoder, wall_clock_us());
    }

    /// Sends as `own` from now on.
    pub fn send_as(&mut self, own: Address) {
        self.encoder.send_as(own);
    }

    /// Returns the counters of received frames.
    pub fn counters(&self) -> MavlinkCounters {
        self.decoder.counters()
    }

    /// Returns why the link is down, if it is known.
    pub fn last_error(&self) -> Option<String> {
        self.link.last_error()
    }

    /// Sends a message. Returns false if the link is down and the message was dropped.
    pub fn send(&mut self, now: Instant, message: &MavMessage) -> io::Result<bool> {
        let mut buffer = [0; MAX_FRAME];
        self.set_signing_time();
        let frame = self.encoder.encode(message, &mut buffer);
        if let Some(log) = &mut self.log {
            log.record(now, frame)?;
        }
        self.link.send(frame)
    }

    /// Returns the next message. If none has been received, waits at most `timeout` for bytes. A
    /// frame with invalid content (a value outside an enumeration) is logged and skipped.
    pub fn receive(
        &mut self,
        now: Instant,
        timeout: std::time::Duration,
    ) -> io::Result<Option<(Address, MavMessage)>> {
        if self.received.is_empty() && self.link.receive(&mut self.piece, timeout)? {
            self.set_signing_time();
            let mut bytes = &self.piece[..];
            while let Some(frame) = self.decoder.next_frame(&mut bytes) {
                take(frame, now, &mut self.log, &mut self.received)?;
            }
            if self.link.is_datagram() {
                while let Some(frame) = self.decoder.end_of_datagram() {
                    take(frame, now, &mut self.log, &mut self.received)?;
                }
            }
            signing::synchronize(&mut self.decoder, &mut self.encoder);
        }
        Ok(self.received.pop_front())
    }

    /// Flushes the log.
    pub fn flush(&mut self) -> io::Result<()> {
        self.log.as_mut().map_or(Ok(()), TlogWriter::flush)
    }
}

fn take(
    frame: Frame<'_>,
    now: Instant,
    log: &mut Option<TlogWriter<Box<dyn Write + Send>>>,
    received: &mut VecDeque<(Address, MavMessage)>,
) -> io::Result<()> {
    if let Some(log) = log {
        log.record(now, frame.bytes())?;
    }
    if let Ok(message) = frame.message() {
        received.push_back((frame.sender(), message));
    }
    Ok(())
}

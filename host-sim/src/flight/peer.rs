//! The vehicle's end of the MAVLink link, built in or elsewhere, and the log of what passes.

use std::{
    collections::VecDeque,
    fs::File,
    io::{self, BufWriter},
    path::Path,
    time::Duration as WallDuration,
};

use firmware_core::{Position, autopilot::wire::Decoder, time::Instant};

use crate::{
    link::{
        Link,
        tlog::{SIMULATED_EPOCH_US, TlogWriter, wall_clock_us},
    },
    vehicle::Vehicle,
};

/// The vehicle at the other end of the MAVLink link.
#[derive(Debug)]
pub struct Peer {
    vessel: Vessel,
    log: Option<TlogWriter<BufWriter<File>>>,
}

#[derive(Debug)]
enum Vessel {
    /// The vehicle of this process, in simulated time.
    BuiltIn(Box<Vehicle>),
    /// Whoever answers.
    Elsewhere {
        link: Box<dyn Link>,
        decoder: Box<Decoder>,
        /// Whole frames that have come and were not taken yet.
        frames: VecDeque<Vec<u8>>,
        piece: Vec<u8>,
    },
}

impl Peer {
    /// The vehicle of this process.
    pub fn built_in(vehicle: Vehicle) -> Self {
        Self {
            vessel: Vessel::BuiltIn(Box::new(vehicle)),
            log: None,
        }
    }

    /// Whoever answers on a link.
    pub fn elsewhere(link: Box<dyn Link>) -> Self {
        Self {
            vessel: Vessel::Elsewhere {
                link,
                decoder: Box::new(Decoder::new()),
                frames: VecDeque::new(),
                piece: Vec::new(),
            },
            log: None,
        }
    }

    /// Logs every frame in both directions into a `.tlog` file. Simulated flights are logged in
    /// simulated time from a fixed date, so that the same flight gives the same bytes.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn log_to(mut self, path: &Path) -> io::Result<Self> {
        let epoch_us = if self.is_built_in() {
            SIMULATED_EPOCH_US
        } else {
            wall_clock_us()
        };
        let file = BufWriter::new(File::create(path)?);
        self.log = Some(TlogWriter::new(file, epoch_us));
        Ok(self)
    }

    pub(super) fn is_built_in(&self) -> bool {
        matches!(self.vessel, Vessel::BuiltIn(_))
    }

    /// Lets time pass where it is simulated.
    pub(super) fn step(&mut self, now: Instant) {
        if let Vessel::BuiltIn(vehicle) = &mut self.vessel {
            vehicle.step(now);
        }
    }

    /// A frame from the vehicle, if there is one.
    pub(super) fn receive(&mut self, now: Instant) -> io::Result<Option<Vec<u8>>> {
        let frame = match &mut self.vessel {
            Vessel::BuiltIn(vehicle) => vehicle.next_frame(),
            Vessel::Elsewhere { frames, .. } => frames.pop_front(),
        };
        if let (Some(frame), Some(log)) = (&frame, &mut self.log) {
            log.record(now, frame)?;
        }
        Ok(frame)
    }

    /// A frame to the vehicle.
    pub(super) fn send(&mut self, now: Instant, frame: &[u8]) -> io::Result<()> {
        if let Some(log) = &mut self.log {
            log.record(now, frame)?;
        }
        match &mut self.vessel {
            Vessel::BuiltIn(vehicle) => vehicle.receive(now, frame),
            // A link that is down loses frames as a radio does; the failsafes see to it.
            Vessel::Elsewhere { link, .. } => {
                link.send(frame)?;
            }
        }
        Ok(())
    }

    /// Waits for something to come, at most so long.
    pub(super) fn wait(&mut self, longest: WallDuration) -> io::Result<()> {
        let Vessel::Elsewhere {
            link,
            decoder,
            frames,
            piece,
        } = &mut self.vessel
        else {
            return Ok(());
        };
        let mut patience = longest;
        while link.receive(piece, patience)? {
            patience = WallDuration::ZERO;
            let mut input = piece.as_slice();
            while let Some(frame) = decoder.next_frame(&mut input) {
                frames.push_back(frame.bytes().to_vec());
            }
            while link.is_datagram()
                && let Some(frame) = decoder.end_of_datagram()
            {
                frames.push_back(frame.bytes().to_vec());
            }
        }
        Ok(())
    }

    /// Where the vehicle truly is, where that is known.
    pub(super) fn true_position(&self) -> Option<Position<f64>> {
        match &self.vessel {
            Vessel::BuiltIn(vehicle) => Some(vehicle.true_position()),
            Vessel::Elsewhere { .. } => None,
        }
    }

    /// How high it truly is, metres, where that is known.
    pub(super) fn altitude_m(&self) -> Option<f64> {
        match &self.vessel {
            Vessel::BuiltIn(vehicle) => Some(vehicle.altitude_m()),
            Vessel::Elsewhere { .. } => None,
        }
    }

    /// Writes out what of the log is still held back.
    pub(super) fn finish(&mut self) -> io::Result<()> {
        match &mut self.log {
            Some(log) => log.flush(),
            None => Ok(()),
        }
    }
}

//! The vehicle's end of the MAVLink link, built in or external: the impairment of the link, the
//! ground stations that listen to it, and the log of its frames.

use std::{
    collections::VecDeque,
    fs::File,
    io::{self, BufWriter},
    path::Path,
    time::Duration as WallDuration,
};

use firmware_core::{Position, autopilot::wire::Decoder, time::Instant};

use super::observer::Observer;
use link::{
    GroundStationTap, Link,
    lossy::{Channel, Impairment},
    tlog::{SIMULATED_EPOCH_US, TlogWriter, wall_clock_us},
};
use vehicle::Vehicle;

/// The number of steps for which the true position of the built-in vehicle is kept: three seconds.
const TRACK: usize = 300;

/// The vehicle at the other end of the MAVLink link.
#[derive(Debug)]
pub struct Peer {
    remote: Remote,
    /// The channels to and from the vehicle, if the link is impaired.
    impaired: Option<(Channel, Channel)>,
    /// The ground stations that listen, each with the link as in `--also`.
    ground_stations: Vec<(String, GroundStationTap)>,
    /// The recent positions of the built-in vehicle: its clock and its true position, oldest first.
    track: VecDeque<(Instant, Position<f64>)>,
    log: Option<TlogWriter<BufWriter<File>>>,
    /// The reason why the log ends before the flight.
    log_failed: Option<io::Error>,
}

/// Where the vehicle is simulated or flown.
#[derive(Debug)]
enum Remote {
    /// The vehicle of this process, in simulated time.
    BuiltIn(Box<Vehicle>),
    /// An external vehicle.
    External {
        link: Box<dyn Link>,
        decoder: Box<Decoder>,
        /// The complete frames that were received and not taken yet.
        frames: VecDeque<Vec<u8>>,
        piece: Vec<u8>,
    },
}

impl Remote {
    fn next_frame(&mut self) -> Option<Vec<u8>> {
        match self {
            Self::BuiltIn(vehicle) => vehicle.next_frame(),
            Self::External { frames, .. } => frames.pop_front(),
        }
    }

    fn deliver(&mut self, now: Instant, frame: &[u8]) -> io::Result<()> {
        match self {
            Self::BuiltIn(vehicle) => {
                vehicle.receive(now, frame);
                vehicle.end_of_datagram(now);
            }
            // A link that is down loses frames as a radio does; the failsafes handle it.
            Self::External { link, .. } => {
                link.send(frame)?;
            }
        }
        Ok(())
    }
}

impl Peer {
    fn new(remote: Remote) -> Self {
        Self {
            remote,
            impaired: None,
            ground_stations: Vec::new(),
            track: VecDeque::new(),
            log: None,
            log_failed: None,
        }
    }

    /// Creates a peer with the vehicle of this process.
    pub fn built_in(vehicle: Vehicle) -> Self {
        Self::new(Remote::BuiltIn(Box::new(vehicle)))
    }

    /// Creates a peer with any vehicle that answers on a link.
    pub fn external(link: Box<dyn Link>) -> Self {
        Self::new(Remote::External {
            link,
            decoder: Box::new(Decoder::new()),
            frames: VecDeque::new(),
            piece: Vec::new(),
        })
    }

    /// Impairs the link in both directions, in the time of the flight.
    pub fn impaired(mut self, impairment: &Impairment) -> Self {
        self.impaired = Some(impairment.channels());
        self
    }

    /// Adds a ground station that listens to the link: it receives all frames that our client
    /// receives and sends, and its own frames are sent to the vehicle. `name` is used in the note
    /// if it was never reached.
    pub fn with_ground_station(mut self, name: &str, link: Box<dyn Link>) -> Self {
        self.ground_stations
            .push((name.to_owned(), GroundStationTap::new(link)));
        self
    }

    /// Returns a description of each listening ground station that was never reached.
    fn unreached(&self) -> impl Iterator<Item = String> + '_ {
        self.ground_stations.iter().filter_map(|(name, station)| {
            let reason = station.unreached()?;
            Some(match reason.strip_prefix(name.as_str()) {
                _ if reason.is_empty() => format!("no ground station was reached at {name}"),
                // The errors of links contain their own address.
                Some(reason) => format!("no ground station was reached at {name}{reason}"),
                None => format!("no ground station was reached at {name}: {reason}"),
            })
        })
    }

    /// Logs every frame in both directions into a `.tlog` file. Simulated flights are logged in
    /// simulated time from a fixed date, so that the same flight gives the same bytes.
    ///
    /// # Errors
    /// Returns an error if the file cannot be created.
    pub fn log_to(mut self, path: &Path) -> io::Result<Self> {
        let file = BufWriter::new(File::create(path)?);
        self.log = Some(TlogWriter::new(file, self.unix_us(Instant::ZERO)));
        Ok(self)
    }

    pub(super) fn is_built_in(&self) -> bool {
        matches!(self.remote, Remote::BuiltIn(_))
    }

    /// Returns the date, microseconds since 1970: the real date, or that of the simulation.
    pub(super) fn unix_us(&self, now: Instant) -> u64 {
        match self.remote {
            Remote::BuiltIn(_) => SIMULATED_EPOCH_US + now.as_micros(),
            Remote::External { .. } => wall_clock_us(),
        }
    }

    /// Advances simulated time, and delivers frames that are due at the vehicle.
    pub(super) fn step(&mut self, now: Instant) -> io::Result<()> {
        let unix_us = self.unix_us(now);
        if let Remote::BuiltIn(vehicle) = &mut self.remote {
            vehicle.set_signing_time(unix_us);
            vehicle.step(now);
            if self.track.len() >= TRACK {
                self.track.pop_front();
            }
            let place = (vehicle.boot_time(), vehicle.true_position());
            self.track.push_back(place);
        }
        if let Some((up, _)) = &mut self.impaired {
            while let Some(frame) = up.pop(now) {
                self.remote.deliver(now, &frame)?;
            }
        }
        for (_, station) in &self.ground_stations {
            while let Some(frame) = station.take_said() {
                record(&mut self.log, &mut self.log_failed, now, &frame);
                self.remote.deliver(now, &frame)?;
            }
        }
        Ok(())
    }

    /// Returns a frame from the vehicle, if there is one.
    pub(super) fn receive(&mut self, now: Instant) -> io::Result<Option<Vec<u8>>> {
        let frame = match &mut self.impaired {
            Some((_, down)) => {
                while let Some(frame) = self.remote.next_frame() {
                    down.push(now, &frame);
                }
                down.pop(now)
            }
            None => self.remote.next_frame(),
        };
        if let Some(frame) = &frame {
            self.pass(now, frame);
        }
        Ok(frame)
    }

    /// Sends a frame to the vehicle.
    pub(super) fn send(&mut self, now: Instant, frame: &[u8]) -> io::Result<()> {
        self.pass(now, frame);
        match &mut self.impaired {
            Some((up, _)) => {
                up.push(now, frame);
                while let Some(frame) = up.pop(now) {
                    self.remote.deliver(now, &frame)?;
                }
                Ok(())
            }
            None => self.remote.deliver(now, frame),
        }
    }

    /// Logs a frame and passes it to the listening ground stations.
    fn pass(&mut self, now: Instant, frame: &[u8]) {
        for (_, station) in &self.ground_stations {
            station.hear(frame);
        }
        record(&mut self.log, &mut self.log_failed, now, frame);
    }

    /// Waits until something is received, for at most `longest`.
    pub(super) fn wait(&mut self, longest: WallDuration) -> io::Result<()> {
        let Remote::External {
            link,
            decoder,
            frames,
            piece,
        } = &mut self.remote
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

    /// Returns the true position of the vehicle, if it is known.
    pub(super) fn true_position(&self) -> Option<Position<f64>> {
        match &self.remote {
            Remote::BuiltIn(vehicle) => Some(vehicle.true_position()),
            Remote::External { .. } => None,
        }
    }

    /// Returns the true position of the vehicle at a time of its clock, if it is known. Between two
    /// steps the motion is assumed to be straight; a vehicle of the paper's kinematics moves only
    /// when a setpoint is received, so its position is not interpolated.
    pub(super) fn true_position_at(&self, time: Instant) -> Option<Position<f64>> {
        let Remote::BuiltIn(vehicle) = &self.remote else {
            return None;
        };
        let after = self.track.iter().position(|(when, _)| *when >= time);
        let Some(after) = after.filter(|_| !vehicle.is_ideal()) else {
            return Some(vehicle.true_position());
        };
        let (end, there) = self.track[after];
        let (begin, here) = self.track[after.saturating_sub(1)];
        let span_s = (end - begin).as_secs_f64();
        let fraction = if span_s > 0.0 {
            (time - begin).as_secs_f64() / span_s
        } else {
            1.0
        };
        Some(here + (there - here) * fraction)
    }

    /// Returns the true altitude, metres, if it is known.
    pub(super) fn altitude_m(&self) -> Option<f64> {
        match &self.remote {
            Remote::BuiltIn(vehicle) => Some(vehicle.altitude_m()),
            Remote::External { .. } => None,
        }
    }

    /// Returns the reason why the link is down, if it is known.
    pub(super) fn last_error(&self) -> Option<String> {
        match &self.remote {
            Remote::BuiltIn(_) => None,
            Remote::External { link, .. } => link.last_error(),
        }
    }

    /// Flushes the log and reports further information to the observer.
    pub(super) fn finish(&mut self, observer: &mut impl Observer) {
        if let Some(Err(error)) = self.log.as_mut().map(TlogWriter::flush) {
            self.log_failed = Some(error);
        }
        if let Some(error) = &self.log_failed {
            observer.note(&format!("the MAVLink log is not complete: {error}"));
        }
        for words in self.unreached() {
            observer.note(&words);
        }
    }
}

/// Appends to the log. A full disk ends the log, not the flight.
fn record(
    log: &mut Option<TlogWriter<BufWriter<File>>>,
    failed: &mut Option<io::Error>,
    now: Instant,
    frame: &[u8],
) {
    if let Some(Err(error)) = log.as_mut().map(|log| log.record(now, frame)) {
        *failed = Some(error);
        *log = None;
    }
}

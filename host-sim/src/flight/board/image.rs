//! The image at the other end of three TCP connections: QEMU's serial lines.

use std::{
    collections::VecDeque,
    io::{self, Read, Write},
    net::TcpStream,
    thread::sleep,
    time::{Duration as WallDuration, Instant as WallInstant},
};

use firmware_core::{
    autopilot::wire::Decoder,
    console::{self, BoardReport, CONSOLE_FRAME_MAX, Call, Footprint, MissionOrder, Reports, Tick},
    time::Instant,
};

use super::{Board, Round};
use link::HostPort;

/// The longest time until a board is reachable, and until it answers.
const PATIENCE: WallDuration = WallDuration::from_secs(30);

/// A byte stream that counts the transferred bytes.
#[derive(Debug)]
struct Line {
    stream: TcpStream,
    sent: u32,
    received: u32,
}

impl Line {
    fn connect(to: &HostPort, offset: u16) -> io::Result<Self> {
        let port = to
            .port
            .checked_add(offset)
            .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "the ports end at 65535"))?;
        let begun = WallInstant::now();
        let stream = loop {
            match TcpStream::connect((to.host.as_str(), port)) {
                Ok(stream) => break stream,
                // The board may still be starting.
                Err(error) if begun.elapsed() > WallDuration::from_secs(10) => {
                    return Err(io::Error::new(
                        error.kind(),
                        format!("port {port}: {error}"),
                    ));
                }
                Err(_) => sleep(WallDuration::from_millis(50)),
            }
        };
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        stream.set_write_timeout(Some(PATIENCE))?;
        Ok(Self {
            stream,
            sent: 0,
            received: 0,
        })
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.stream.write_all(bytes)?;
        self.sent = self.sent.wrapping_add(bytes.len() as u32);
        Ok(())
    }

    /// Waits for some bytes and appends them.
    fn receive(&mut self, bytes: &mut Vec<u8>) -> io::Result<()> {
        let mut piece = [0; 1024];
        match self.stream.read(&mut piece) {
            Ok(0) => Err(io::Error::new(
                io::ErrorKind::UnexpectedEof,
                "the board has hung up",
            )),
            Ok(length) => {
                bytes.extend_from_slice(&piece[..length]);
                self.received = self.received.wrapping_add(length as u32);
                Ok(())
            }
            // This was a signal and not the end of the stream: the caller tries again.
            Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(()),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Err(io::Error::new(
                io::ErrorKind::TimedOut,
                format!("the board has not answered for {} s", PATIENCE.as_secs()),
            )),
            Err(error) => Err(error),
        }
    }

    /// Waits until this number of bytes has been received in total.
    fn receive_up_to(&mut self, count: u32) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        while self.received != count {
            self.receive(&mut bytes)?;
        }
        Ok(bytes)
    }
}

/// The image at the other end of three TCP connections: QEMU's serial lines.
#[derive(Debug)]
pub struct Image {
    ground: Line,
    mavlink: Line,
    console: Line,
    reports: Reports,
    /// The reports that were received and not taken yet.
    waiting: VecDeque<BoardReport>,
    frames: Decoder,
}

impl Image {
    /// Connects to the ground link at a port, to MAVLink at the next port and to the console at the
    /// one after it, and sends the mission order.
    ///
    /// # Errors
    /// Returns a message of one line if nothing is reachable, if there is no answer, or if the
    /// order is refused.
    pub fn connect(to: &HostPort, order: &MissionOrder) -> Result<Self, String> {
        let line = |offset| {
            Line::connect(to, offset).map_err(|error| format!("tcp:{to}: no board: {error}"))
        };
        let mut image = Self {
            ground: line(0)?,
            mavlink: line(1)?,
            console: line(2)?,
            reports: Reports::default(),
            waiting: VecDeque::new(),
            frames: Decoder::new(),
        };
        let answer = image
            .call(&Call::Order(order.clone()))
            .and_then(|()| image.report());
        match answer {
            Ok(BoardReport::Ready) => Ok(image),
            Ok(BoardReport::Refused(why) | BoardReport::BrokenOff(why)) => {
                Err(format!("tcp:{to}: the board refuses: {why}"))
            }
            Ok(other) => Err(format!("tcp:{to}: an answer out of turn: {other:?}")),
            Err(error) => Err(format!("tcp:{to}: {error}")),
        }
    }

    fn call(&mut self, call: &Call) -> io::Result<()> {
        let mut frame = [0; CONSOLE_FRAME_MAX];
        let frame = console::encode_call(call, &mut frame).map_err(io::Error::other)?;
        self.console.send(frame)
    }

    fn report(&mut self) -> io::Result<BoardReport> {
        let mut bytes = Vec::new();
        loop {
            if let Some(report) = self.waiting.pop_front() {
                return Ok(report);
            }
            bytes.clear();
            self.console.receive(&mut bytes)?;
            for &byte in &bytes {
                match self.reports.push(byte) {
                    Some(Ok(report)) => self.waiting.push_back(report),
                    Some(Err(error)) => {
                        return Err(io::Error::other(format!("console: {error}")));
                    }
                    None => {}
                }
            }
        }
    }
}

impl Board for Image {
    fn round(&mut self, now: Instant, vehicle: &[Vec<u8>], ground: &[u8]) -> io::Result<Round> {
        let vehicle = vehicle.concat();
        let total = |line: &Line, more: &[u8]| line.sent.wrapping_add(more.len() as u32);
        self.call(&Call::Tick(Tick {
            now,
            ground_bytes: total(&self.ground, ground),
            mavlink_bytes: total(&self.mavlink, &vehicle),
        }))?;
        self.ground.send(ground)?;
        self.mavlink.send(&vehicle)?;
        let (mut events, mut broken_off) = (Vec::new(), None);
        let tock = loop {
            match self.report()? {
                BoardReport::Tock(tock) => break tock,
                BoardReport::Event(words) => events.push(words.as_str().into()),
                BoardReport::BrokenOff(why) => broken_off = Some(why.as_str().into()),
                BoardReport::Ready | BoardReport::Refused(_) | BoardReport::Footprint(_) => {}
            }
        };
        let mut mavlink = Vec::new();
        let bytes = self.mavlink.receive_up_to(tock.mavlink_bytes)?;
        let mut input = bytes.as_slice();
        while let Some(frame) = self.frames.next_frame(&mut input) {
            mavlink.push(frame.bytes().to_vec());
        }
        let micros = |nanos: u32| f64::from(nanos) * 1e-3;
        Ok(Round {
            mavlink,
            ground: self.ground.receive_up_to(tock.ground_bytes)?,
            events,
            stage: tock.stage,
            phase: tock.phase,
            place: tock.place,
            broken_off,
            plan_us: micros(tock.cost.plan_ns),
            allocate_us: micros(tock.cost.allocate_ns),
        })
    }

    fn stop(&mut self) -> io::Result<()> {
        self.call(&Call::Stop)
    }

    fn footprint(&mut self) -> io::Result<Option<Footprint>> {
        self.call(&Call::Footprint)?;
        loop {
            if let BoardReport::Footprint(footprint) = self.report()? {
                return Ok(Some(footprint));
            }
        }
    }
}

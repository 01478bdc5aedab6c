//! The image at the other end of three TCP connections: QEMU's serial lines.

use std::{
    collections::VecDeque,
    io::{self, Read, Write},
    net::TcpStream,
    thread::sleep,
    time::{Duration as WallDuration, Instant as WallInstant},
};

use firmware_core::{
    autopilot::{
        Phase,
        wire::{Decoder, signing::SigningState},
    },
    console::{self, BoardReport, CONSOLE_FRAME_MAX, Call, Footprint, MissionOrder, Reports, Tick},
    onboard::Stage,
    time::Instant,
};

use super::{ComputerState, Notice, OnboardComputer, Round, RoundInput};
use crate::flight::outcome::FlightError;
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
    state: ComputerState,
    /// The events that were received and not taken yet, in words.
    events: VecDeque<String>,
    /// The reason why the mission was aborted.
    aborted_because: Option<String>,
    /// The digest of the mission that the policy in flash was trained for, if that is flown.
    scenario_digest: Option<String>,
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
            state: ComputerState::of_board(Stage::Preparing, Phase::Connecting, None),
            events: VecDeque::new(),
            aborted_because: None,
            scenario_digest: None,
        };
        let answer = image
            .call(&Call::Order(order.clone()))
            .and_then(|()| image.report());
        match answer {
            Ok(BoardReport::Ready { scenario_digest }) => {
                image.scenario_digest = scenario_digest.map(|digest| digest.as_str().into());
                Ok(image)
            }
            Ok(BoardReport::Refused(why) | BoardReport::Aborted(why)) => {
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

impl OnboardComputer for Image {
    type Precision = f32;

    fn round(&mut self, input: &RoundInput<'_>) -> Result<Round, FlightError> {
        let from_vehicle = input.from_vehicle.concat();
        let total = |line: &Line, more: &[u8]| line.sent.wrapping_add(more.len() as u32);
        self.call(&Call::Tick(Tick {
            now: input.now,
            ground_bytes: total(&self.ground, input.from_ground),
            mavlink_bytes: total(&self.mavlink, &from_vehicle),
        }))?;
        self.ground.send(input.from_ground)?;
        self.mavlink.send(&from_vehicle)?;
        let tock = loop {
            match self.report()? {
                BoardReport::Tock(tock) => break tock,
                BoardReport::Event(words) => self.events.push_back(words.as_str().into()),
                BoardReport::Aborted(why) => self.aborted_because = Some(why.as_str().into()),
                BoardReport::Ready { .. }
                | BoardReport::Refused(_)
                | BoardReport::Footprint(_)
                | BoardReport::Signing(_) => {}
            }
        };
        self.state = ComputerState::of_board(tock.stage, tock.phase, tock.place);
        let mut to_vehicle = Vec::new();
        let bytes = self.mavlink.receive_up_to(tock.mavlink_bytes)?;
        let mut bytes = bytes.as_slice();
        while let Some(frame) = self.frames.next_frame(&mut bytes) {
            to_vehicle.push(frame.bytes().to_vec());
        }
        let micros = |nanos: u32| f64::from(nanos) * 1e-3;
        Ok(Round {
            to_vehicle,
            to_ground: self.ground.receive_up_to(tock.ground_bytes)?,
            plan_us: micros(tock.cost.plan_ns),
            allocate_us: micros(tock.cost.allocate_ns),
        })
    }

    fn state(&self) -> ComputerState {
        self.state
    }

    fn take_notice(&mut self, _: Instant) -> Option<Notice> {
        Some(Notice::of_board(self.events.pop_front()?))
    }

    fn stop(&mut self, _: Instant) -> io::Result<Option<&'static str>> {
        self.call(&Call::Stop)?;
        let is_flying = self.state.phase != Phase::Connecting;
        Ok(is_flying.then_some("landing"))
    }

    fn aborted_because(&self) -> Option<String> {
        self.aborted_because.clone()
    }

    fn scenario_digest(&self) -> Option<&str> {
        self.scenario_digest.as_deref()
    }

    fn footprint(&mut self) -> io::Result<Option<Footprint>> {
        self.call(&Call::Footprint)?;
        loop {
            if let BoardReport::Footprint(footprint) = self.report()? {
                return Ok(Some(footprint));
            }
        }
    }

    fn signing_state(&mut self) -> io::Result<Option<SigningState>> {
        self.call(&Call::Signing)?;
        loop {
            if let BoardReport::Signing(state) = self.report()? {
                return Ok(state);
            }
        }
    }
}

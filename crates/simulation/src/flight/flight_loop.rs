//! The flight loop: carries the bytes of both links between ground, onboard computer and vehicle,
//! keeps the record, and processes ctrl-C.

use std::time::{Duration as WallDuration, Instant as WallInstant};

use firmware_core::{
    USERS_MAX,
    autopilot::Phase,
    link::Endpoint,
    onboard::Stage,
    policy::Policy,
    time::{Duration, Instant},
};
use link::NoHeartbeat;
use scenario::Scenario;

use super::{
    client::ClientSettings,
    clock::Clock,
    computer::{InProcess, Notice, OnboardComputer, RoundInput},
    ground::Ground,
    observer::Observer,
    outcome::{FailedFlight, FlightError, outcome_with_record},
    peer::Peer,
    settings::{CONNECT_PATIENCE, FlightSettings},
    stopwatch::Stopwatch,
};
use crate::{
    record::{FlightEvent, FlightNotes, FlightRecord, FlightTimes, PathSample},
    world::World,
};

/// The time that a second ctrl-C leaves for restoring the parameters: of the flight's clock and of
/// the wall clock, whichever is over first.
const END_PATIENCE: WallDuration = WallDuration::from_secs(3);

/// Flies `scenario` under `policy` in this process, with the vehicle at the other end of `peer`.
///
/// # Errors
/// Returns an error if the settings are invalid, a link fails, or the mission was aborted.
pub fn fly<P: Policy<f64, USERS_MAX>>(
    scenario: &Scenario,
    policy: P,
    settings: &FlightSettings,
    peer: Peer,
    observer: &mut impl Observer,
) -> Result<FlightRecord, FailedFlight> {
    let client = ClientSettings::default();
    let mut computer = InProcess::new(scenario, policy, settings, client, &peer)?;
    fly_with(scenario, &mut computer, settings, peer, observer)
}

/// Flies `scenario` with `computer` and the vehicle at the other end of `peer`. The `policy` of the
/// settings is a name for the record.
///
/// # Errors
/// Returns an error if the computer does not answer, a link fails, or the mission was aborted.
pub fn fly_with(
    scenario: &Scenario,
    computer: &mut impl OnboardComputer,
    settings: &FlightSettings,
    mut peer: Peer,
    observer: &mut impl Observer,
) -> Result<FlightRecord, FailedFlight> {
    let events = scenario.with_motion(&settings.events);
    let events = &events.map_err(FlightError::Events)?;
    let world = World::new(scenario, events, settings.seed, settings.symbols_per_slot);
    let mut flight = Flight {
        computer,
        ground: Ground::new(
            (world, events.clone()),
            settings.ignores_errors,
            settings.inner.method(&scenario.mission),
            settings
                .ground_link
                .clone()
                .map_or_else(Endpoint::new, Endpoint::ground),
        ),
        clock: Clock::new(settings.real_time_factor),
        stopwatch: Stopwatch::default(),
        uplink: Vec::new(),
        events: Vec::new(),
        path: Vec::new(),
        slots_s: Vec::new(),
        started: None,
        slots: scenario.mission.slots(),
        connected: false,
        stop_asked: false,
        leave_at: None,
    };
    let epoch_us = peer.unix_us(Instant::ZERO);
    let outcome = flight.run(&mut peer, observer);
    peer.finish(observer);
    if let Some(words) = flight.computer.left_over() {
        observer.duty(&words);
    }
    let profile = flight.computer.profile().unwrap_or(settings.profile);
    let record = FlightRecord {
        scenario: scenario.clone(),
        policy: settings.policy.clone(),
        inner: settings.inner.to_string(),
        profile: profile.name().into(),
        seed: settings.seed,
        link: flight.ground.link(),
        slots: flight.ground.into_slots(),
        path: flight.path,
        changes: events.clone(),
        ignores_errors: settings.ignores_errors,
        events: flight.events,
        times: FlightTimes {
            epoch_us,
            first_slot_s: flight.started.map_or(0.0, seconds),
            slots_s: flight.slots_s,
        },
        completed: false,
        ended: String::new(),
        notes: FlightNotes::default(),
    };
    outcome_with_record(outcome, flight.connected, record)
}

/// Returns the time since the client started, seconds.
fn seconds(now: Instant) -> f64 {
    now.duration_since(Instant::ZERO).as_secs_f64()
}

/// A mission in progress.
struct Flight<'c, C> {
    computer: &'c mut C,
    ground: Ground,
    clock: Clock,
    stopwatch: Stopwatch,
    /// The bytes of the ground for the computer's next round.
    uplink: Vec<u8>,
    events: Vec<FlightEvent>,
    path: Vec<PathSample>,
    /// When each slot was received, seconds.
    slots_s: Vec<f64>,
    /// The start of slot 1.
    started: Option<Instant>,
    /// `N`.
    slots: u32,
    /// The computer has received messages of a vehicle.
    connected: bool,
    /// The first ctrl-C has been processed.
    stop_asked: bool,
    /// The time at which we leave after a second ctrl-C, on the flight's clock and on the wall
    /// clock.
    leave_at: Option<(Instant, WallInstant)>,
}

impl<C: OnboardComputer> Flight<'_, C> {
    /// Runs until the vehicle has landed or can no longer be flown.
    fn run(&mut self, peer: &mut Peer, observer: &mut impl Observer) -> Result<(), FlightError> {
        loop {
            let now = self.clock.now();
            peer.step(now)?;
            let exchanged = self.exchange(now, peer, observer);
            self.connected |= self.computer.state().is_connected;
            exchanged?;
            self.note_path(now, peer);
            self.take_notices(now, observer);
            self.handle_stop(now, peer, observer)?;
            if self.computer.state().phase.is_final() {
                let is_finished = self.computer.is_finished(now, self.stop_asked);
                self.take_notices(now, observer);
                if is_finished {
                    return self.outcome(now, peer);
                }
            }
            let waited = now.duration_since(Instant::ZERO);
            if self.computer.state().phase == Phase::Connecting && waited > CONNECT_PATIENCE {
                return Err(FlightError::NoVehicle(NoHeartbeat {
                    waited_s: waited.as_secs_f64(),
                    refused: self.computer.refused_frames(),
                    last_error: peer.last_error(),
                }));
            }
            self.clock.advance(peer)?;
        }
    }

    /// Carries bytes in all directions until nothing is pending.
    fn exchange(
        &mut self,
        now: Instant,
        peer: &mut Peer,
        observer: &mut impl Observer,
    ) -> Result<(), FlightError> {
        let unix_us = peer.unix_us(now);
        loop {
            let mut from_vehicle = Vec::new();
            while let Some(frame) = peer.receive(now)? {
                from_vehicle.push(frame);
            }
            let from_ground = std::mem::take(&mut self.uplink);
            let round = self.computer.round(&RoundInput {
                now,
                unix_us,
                from_vehicle: &from_vehicle,
                from_ground: &from_ground,
            })?;
            self.stopwatch.add(round.plan_us, round.allocate_us);
            for frame in &round.to_vehicle {
                peer.send(now, frame)?;
            }
            let done = self.ground.slots().len();
            let truth = |time| peer.true_position_at(time);
            self.uplink = (self.ground).receive::<C::Precision>(now, &round.to_ground, truth);
            for slot in self.ground.slots_mut().iter_mut().skip(done) {
                self.stopwatch.note(slot);
                self.slots_s.push(seconds(now));
                observer.slot(slot);
            }
            if round.is_silent() && from_vehicle.is_empty() && from_ground.is_empty() {
                return Ok(());
            }
        }
    }

    /// Records the vehicle's path from the start of slot 1 to the end of slot N: the true one if it
    /// is known, otherwise the measured one.
    fn note_path(&mut self, now: Instant, peer: &Peer) {
        let state = self.computer.state();
        if !matches!(state.stage, Stage::Flying | Stage::Measuring) {
            return;
        }
        let started = *self.started.get_or_insert(now);
        let truth = peer.true_position().zip(peer.altitude_m());
        if let Some((position, altitude_m)) = truth.or(state.place) {
            self.path.push(PathSample {
                time_s: now.duration_since(started).as_secs_f64(),
                position,
                altitude_m,
            });
        }
    }

    /// Records the computer's events and shows its messages.
    fn take_notices(&mut self, now: Instant, observer: &mut impl Observer) {
        for words in self.ground.take_announcements() {
            self.note_event(now, words, true, observer);
        }
        while let Some(notice) = self.computer.take_notice(now) {
            match notice {
                Notice::Event { text, notable } => self.note_event(now, text, notable, observer),
                Notice::Duty(words) => observer.duty(&words),
                Notice::Note(words) => observer.note(&words),
                Notice::Waiting(words) => observer.waiting(&words),
            }
        }
    }

    fn note_event(
        &mut self,
        now: Instant,
        text: String,
        notable: bool,
        observer: &mut impl Observer,
    ) {
        let event = FlightEvent {
            time_s: seconds(now),
            text,
            notable,
        };
        observer.event(&event);
        self.events.push(event);
    }

    /// Processes ctrl-C. The first one lands the vehicle, or ends at once if there is nothing left
    /// to wait for; the second one restores the parameters if that takes little time, and leaves.
    fn handle_stop(
        &mut self,
        now: Instant,
        peer: &Peer,
        observer: &mut impl Observer,
    ) -> Result<(), FlightError> {
        if !self.stop_asked && observer.wants_stop() {
            self.stop_asked = true;
            if self.computer.state().phase.is_final() {
                return Ok(()); // `is_finished` ends the remaining waits
            }
            let silent = self.computer.silence(now).is_some();
            let doing = self.computer.stop(now)?;
            self.take_notices(now, observer);
            if silent {
                return Err(self.aborted(now, peer));
            }
            let Some(doing) = doing else {
                return Ok(());
            };
            let restoring = if self.computer.restores_parameters() {
                " and restores parameters if it can"
            } else {
                ""
            };
            observer.waiting(&format!(
                "ctrl-C: {doing}; waiting for the motors to stop (a second ctrl-C ends at once\
                 {restoring})"
            ));
        }
        if self.leave_at.is_none() && observer.wants_end() {
            self.computer.restore_now();
            let patience = Duration::from_secs_f64(END_PATIENCE.as_secs_f64());
            self.leave_at = Some((now + patience, WallInstant::now() + END_PATIENCE));
        }
        let Some((flight_time, our_time)) = self.leave_at else {
            return Ok(());
        };
        let overdue = now >= flight_time || WallInstant::now() >= our_time;
        if !(self.computer.may_be_left() || overdue) {
            return Ok(());
        }
        let state = self.computer.state().phase.to_string();
        self.computer.abandon_parameters();
        self.take_notices(now, observer);
        Err(FlightError::Ended {
            slots_done: self.ground.slots().len(),
            slots: self.slots,
            state,
        })
    }

    fn outcome(&self, now: Instant, peer: &Peer) -> Result<(), FlightError> {
        if self.computer.state().stage == Stage::Completed {
            return Ok(());
        }
        Err(self.aborted(now, peer))
    }

    /// Returns the error of a flight that was aborted, with its true cause.
    fn aborted(&self, now: Instant, peer: &Peer) -> FlightError {
        let mut reason = self
            .computer
            .aborted_because()
            .unwrap_or_else(|| self.computer.state().phase.to_string());
        if let Some(age) = self.computer.silence(now) {
            reason += &format!("; nothing heard for {:.0} s", age.as_secs_f64());
            if let Some(last_error) = peer.last_error() {
                reason += &format!(" ({last_error})");
            }
        }
        FlightError::Aborted {
            slots_done: self.ground.slots().len(),
            slots: self.slots,
            reason,
        }
    }
}

//! The flight loop with the onboard computer in this process.

use std::time::{Duration as WallDuration, Instant as WallInstant};

use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    autopilot::{
        self, Autopilot, Event, Finding, Phase,
        failsafe::Cause,
        wire::{
            MAX_FRAME,
            signing::{Signer, Verifier},
        },
    },
    controller::Controller,
    link::FRAME_MAX,
    onboard::{Onboard, OnboardSettings, Stage},
    policy::Policy,
    time::{Duration, Instant},
};

use crate::{
    journal::ParameterJournal,
    record::{FlightEvent, FlightNotes, FlightRecord, PathSample},
    world::World,
};
use link::NoHeartbeat;
use scenario::Scenario;
use vehicle::Profile;

use super::{
    airframe::ProfileChoice,
    clock::Clock,
    ground::Ground,
    observer::Observer,
    outcome::{FailedFlight, FlightError, outcome_with_record},
    peer::Peer,
    reason::{self, Reasons},
    settings::{CONNECT_PATIENCE, FlightSettings, autopilot_settings},
    stopwatch::Stopwatch,
};

/// The longest time that restoring the parameters may take once the flight is over and the motors
/// have stopped.
const RESTORE_PATIENCE: Duration = Duration::from_secs(30);

/// The time that a second ctrl-C leaves for restoring the parameters: of the flight's clock and of
/// the wall clock, whichever is over first.
const END_PATIENCE: WallDuration = WallDuration::from_secs(3);

/// The link id of the frames that we sign.
const SIGNING_LINK: u8 = 1;

type HostOnboard<P> = Onboard<f64, P, USERS_MAX, SENSORS_MAX>;

/// Flies `scenario` under `policy` with the vehicle at the other end of `peer`.
///
/// # Errors
/// Returns an error if the settings are invalid, a link fails, or the mission was aborted.
pub fn fly<P: Policy<f64, USERS_MAX>>(
    scenario: &Scenario,
    policy: P,
    settings: &FlightSettings,
    mut peer: Peer,
    observer: &mut impl Observer,
) -> Result<FlightRecord, FailedFlight> {
    if let Err(problem) = settings.inner.check(&scenario.mission) {
        return Err(FailedFlight {
            error: FlightError::Allocation(problem),
            record: None,
        });
    }
    let mut flight =
        Flight::new(scenario, policy, settings, &mut peer).map_err(|error| FailedFlight {
            error,
            record: None,
        })?;
    let outcome = flight.run(&mut peer, observer);
    peer.finish(observer);
    flight.say_what_is_left(observer);
    let connected = flight.onboard.autopilot().vehicle().is_some();
    outcome_with_record(outcome, connected, flight.record(scenario, settings))
}

/// A mission in progress.
struct Flight<P> {
    onboard: HostOnboard<P>,
    ground: Ground,
    clock: Clock,
    stopwatch: Stopwatch,
    events: Vec<FlightEvent>,
    path: Vec<PathSample>,
    profile: Profile,
    profile_choice: ProfileChoice,
    /// The start of slot 1.
    started: Option<Instant>,
    /// The end of the flight.
    ended: Option<Instant>,
    reasons: Reasons,
    /// The changed parameters of the vehicle; `None` if the vehicle is part of this process.
    journal: Option<ParameterJournal>,
    /// The parameters that an earlier run left changed have been processed.
    journal_read: bool,
    /// The reason why the journal could not be written.
    journal_failed: Option<String>,
    /// The first ctrl-C has been processed.
    stop_asked: bool,
    /// The time at which we leave after a second ctrl-C, on the flight's clock and on the wall
    /// clock.
    leave_at: Option<(Instant, WallInstant)>,
    /// The time at which the motors were first found stopped after the flight was over.
    disarmed: Option<Instant>,
    /// The message that the vehicle must be disarmed first was shown.
    wait_said: bool,
}

impl<P: Policy<f64, USERS_MAX>> Flight<P> {
    fn new(
        scenario: &Scenario,
        policy: P,
        settings: &FlightSettings,
        peer: &mut Peer,
    ) -> Result<Self, FlightError> {
        let method = settings.inner.method(&scenario.mission);
        let controller = Controller::new(scenario.mission.clone(), policy).with_method(method);
        let autopilot = Autopilot::new(autopilot::AutopilotSettings {
            set_parameters: peer.sets_parameters(),
            airframe_speed_mps: peer.airframe_speed_mps(),
            own: peer.own(),
            ..autopilot_settings(scenario, settings.profile)
        })?;
        let mut onboard = Onboard::new(OnboardSettings::default(), controller, autopilot);
        if let Some(key) = peer.key() {
            let unix_us = peer.unix_us(Instant::ZERO);
            let signer = Signer::new(key.clone(), SIGNING_LINK, unix_us);
            onboard.sign_with(signer, Verifier::new(key.clone(), unix_us));
        }
        let world = World::new(scenario, settings.seed, settings.symbols_per_slot);
        Ok(Self {
            onboard,
            ground: Ground::new(world, method),
            clock: Clock::new(settings.pace),
            stopwatch: Stopwatch::default(),
            events: Vec::new(),
            path: Vec::new(),
            profile: settings.profile,
            profile_choice: ProfileChoice::new(
                scenario,
                (!peer.names_profile()).then_some(settings.profile),
            ),
            started: None,
            ended: None,
            reasons: Reasons::default(),
            journal: peer.take_journal(),
            journal_read: false,
            journal_failed: None,
            stop_asked: false,
            leave_at: None,
            disarmed: None,
            wait_said: false,
        })
    }

    /// Runs until the vehicle has landed or can no longer be flown.
    fn run(&mut self, peer: &mut Peer, observer: &mut impl Observer) -> Result<(), FlightError> {
        self.onboard.autopilot_mut().launch(self.clock.now());
        loop {
            let now = self.clock.now();
            peer.step(now)?;
            self.onboard.set_signing_time(peer.unix_us(now));
            self.exchange(now, peer, observer)?;
            if let Some(profile) = self.profile_choice.settle(self.onboard.autopilot_mut())? {
                self.profile = profile;
            }
            self.note_path(now, peer);
            self.note_events(now, observer);
            self.heed_stop(now, peer, observer)?;
            if self.onboard.autopilot().phase().is_final() && self.is_tidy(now, peer, observer) {
                return self.verdict(now, peer);
            }
            let waited = now.duration_since(Instant::ZERO);
            if self.onboard.autopilot().phase() == Phase::Connecting && waited > CONNECT_PATIENCE {
                return Err(FlightError::NobodyThere(NoHeartbeat {
                    waited_s: waited.as_secs_f64(),
                    refused: self.onboard.status().mavlink.refused(),
                    last_error: peer.last_error(),
                }));
            }
            self.clock.advance(peer)?;
        }
    }

    /// Processes ctrl-C. The first one lands the vehicle, or ends at once if there is nothing left
    /// to wait for; the second one restores the parameters if that takes little time, and leaves.
    fn heed_stop(
        &mut self,
        now: Instant,
        peer: &Peer,
        observer: &mut impl Observer,
    ) -> Result<(), FlightError> {
        if !self.stop_asked && observer.wants_stop() {
            self.stop_asked = true;
            let client = self.onboard.autopilot_mut();
            if client.phase().is_final() {
                return Ok(()); // `is_tidy` ends the remaining waits
            }
            let silent = client.is_link_silent(now);
            client.stop(now);
            self.note_events(now, observer);
            if silent {
                return Err(self.broken_off(now, peer));
            }
            let doing = match self.onboard.autopilot().phase() {
                Phase::Landing => "landing",
                Phase::Disarming => "stopping the motors",
                _ => return Ok(()),
            };
            observer.waiting(&format!(
                "ctrl-C: {doing}; waiting for the motors to stop (a second ctrl-C ends at once and \
                 restores parameters if it can)"
            ));
        }
        if self.leave_at.is_none() && observer.wants_end() {
            self.onboard.autopilot_mut().restore_now();
            let patience = Duration::from_secs_f64(END_PATIENCE.as_secs_f64());
            self.leave_at = Some((now + patience, WallInstant::now() + END_PATIENCE));
        }
        let Some((flight_time, our_time)) = self.leave_at else {
            return Ok(());
        };
        let client = self.onboard.autopilot();
        let overdue = now >= flight_time || WallInstant::now() >= our_time;
        let done = client.is_restored() && !client.awaits_landing();
        if !(done || overdue) {
            return Ok(());
        }
        let state = client.phase().to_string();
        self.onboard.autopilot_mut().abandon_parameters();
        self.note_events(now, observer);
        Err(FlightError::Ended {
            slots_done: self.ground.slots().len(),
            slots: self.onboard.controller().mission().slots(),
            state,
        })
    }

    /// Returns whether nothing is left to do after the flight: its reason was received, and the
    /// parameters that were set are restored, or restoring them was abandoned and reported. If
    /// someone else flies the vehicle, this waits without limit, because parameters are only
    /// changed while the vehicle is disarmed.
    fn is_tidy(&mut self, now: Instant, peer: &Peer, observer: &mut impl Observer) -> bool {
        let ended = *self.ended.get_or_insert(now);
        let client = self.onboard.autopilot();
        let taken = matches!(
            client.fault(),
            Some(Cause::ControlTaken(_) | Cause::Disarmed)
        );
        if taken && now.duration_since(ended) < reason::AFTER && !self.stop_asked {
            return false;
        }
        if client.is_restored() {
            return true;
        }
        let given_up = if peer.is_built_in() {
            // The built-in vehicle ends with this process, and its parameters with it.
            now.duration_since(ended) > RESTORE_PATIENCE
        } else if client.is_link_dead(now) {
            true
        } else if client.is_armed() {
            self.disarmed = None;
            if !std::mem::replace(&mut self.wait_said, true) && !self.stop_asked {
                let names = client.changed_parameters().iter();
                let names: Vec<&str> = names.map(|change| change.name).collect();
                observer.waiting(&format!(
                    "waiting for the vehicle to be disarmed to put back {}; ctrl-C leaves them to \
                     `host-sim doctor --restore`",
                    names.join(", ")
                ));
            }
            self.stop_asked
        } else {
            let disarmed = *self.disarmed.get_or_insert(now);
            now.duration_since(disarmed) > RESTORE_PATIENCE
        };
        if given_up {
            self.onboard.autopilot_mut().abandon_parameters();
            self.note_events(now, observer);
        }
        given_up
    }

    /// Makes the client first restore the parameters that an earlier run left changed, and records
    /// each change before the message that makes it is sent.
    fn keep_journal(
        &mut self,
        now: Instant,
        peer: &Peer,
        observer: &mut impl Observer,
    ) -> Result<(), FlightError> {
        let client = self.onboard.autopilot_mut();
        let Some((journal, (address, firmware))) = self.journal.as_mut().zip(client.vehicle())
        else {
            return Ok(());
        };
        if !std::mem::replace(&mut self.journal_read, true) && !journal.is_empty() {
            let (names, file) = (journal.names(), journal.path().display());
            if journal.fits(address.system, firmware) {
                observer.waiting(&format!(
                    "putting back {names}, which an earlier run left changed ({file})"
                ));
                client.restore_first(&journal.changes());
            } else if peer.sets_parameters() {
                return Err(FlightError::WrongJournal {
                    journal: file.to_string(),
                    vehicle: journal.vehicle(),
                });
            } else {
                observer.note(&format!(
                    "{file} holds parameters of another vehicle ({}): {names}",
                    journal.vehicle()
                ));
            }
        }
        if self.journal_failed.is_none()
            && let Err(error) =
                journal.note((address.system, firmware), client.changed_parameters())
        {
            let file = journal.path().display();
            self.journal_failed = Some(format!("{file}: {error}; nothing is changed without it"));
            client.stop(now);
        }
        Ok(())
    }

    /// Reports the file that contains the parameters that were not restored.
    fn say_what_is_left(&self, observer: &mut impl Observer) {
        if let Some(journal) = self.journal.as_ref().filter(|journal| !journal.is_empty()) {
            observer.duty(&format!(
                "{} keeps what was not put back ({}): `host-sim doctor --restore --journal {0}`, \
                 or the next run with the same --out, puts it back",
                journal.path().display(),
                journal.names()
            ));
        }
    }

    /// Carries frames in both directions until no more are pending.
    fn exchange(
        &mut self,
        now: Instant,
        peer: &mut Peer,
        observer: &mut impl Observer,
    ) -> Result<(), FlightError> {
        let mut mavlink = [0; MAX_FRAME];
        let mut downlink = [0; FRAME_MAX];
        loop {
            let mut quiet = true;
            while let Some(datagram) = peer.receive(now)? {
                quiet = false;
                self.onboard.receive_mavlink(now, &datagram, true);
            }
            self.keep_journal(now, peer, observer)?;
            self.onboard.poll(now, &mut self.stopwatch);
            while let Some(frame) = self.onboard.take_mavlink_frame(now, &mut mavlink) {
                quiet = false;
                peer.send(now, frame)?;
            }
            while let Some(frame) = self.onboard.take_ground_frame(&mut downlink) {
                quiet = false;
                let done = self.ground.slots().len();
                let truth = |time| peer.true_position_at(time);
                let uplink = self.ground.receive(frame, truth);
                self.onboard.receive_ground(now, &uplink);
                for slot in self.ground.slots_mut().iter_mut().skip(done) {
                    self.stopwatch.note(slot);
                    observer.slot(slot);
                }
            }
            if quiet {
                // The last messages may have ended the flight.
                self.onboard.poll(now, &mut self.stopwatch);
                return Ok(());
            }
        }
    }

    /// Records the vehicle's path from the start of slot 1 to the end of slot N.
    fn note_path(&mut self, now: Instant, peer: &Peer) {
        if !matches!(self.onboard.stage(), Stage::Flying | Stage::Measuring) {
            return;
        }
        let started = *self.started.get_or_insert(now);
        let measured = self.onboard.autopilot().position();
        let place = peer
            .true_position()
            .map(|position| (position, peer.altitude_m()));
        let measured = measured.map(|sample| (sample.position, Some(sample.altitude_m)));
        if let Some((position, altitude_m)) = place.or(measured) {
            self.path.push(PathSample {
                time_s: now.duration_since(started).as_secs_f64(),
                position,
                altitude_m: altitude_m.unwrap_or_default(),
            });
        }
    }

    fn note_events(&mut self, now: Instant, observer: &mut impl Observer) {
        while let Some(event) = self.onboard.autopilot_mut().take_next_event() {
            match (&event, &mut self.journal) {
                (Event::Finding(left @ Finding::NotRestored { .. }), _) => {
                    observer.duty(&left.to_string());
                }
                (Event::Finding(Finding::Restored { name, .. }), Some(journal)) => {
                    if let Err(error) = journal.restored(name) {
                        observer.duty(&format!("{}: {error}", journal.path().display()));
                    }
                }
                _ => {}
            }
            self.reasons.note(now, &event);
            let event = FlightEvent {
                time_s: now.duration_since(Instant::ZERO).as_secs_f64(),
                text: event.to_string(),
                notable: reason::is_notable(&event),
            };
            observer.event(&event);
            self.events.push(event);
        }
    }

    fn verdict(&self, now: Instant, peer: &Peer) -> Result<(), FlightError> {
        if self.onboard.stage() == Stage::Completed {
            return Ok(());
        }
        Err(self.broken_off(now, peer))
    }

    /// Returns the error of a flight that was aborted, with its true cause.
    fn broken_off(&self, now: Instant, peer: &Peer) -> FlightError {
        let autopilot = self.onboard.autopilot();
        let refusal = autopilot.refusal().map(|refusal| refusal.to_string());
        let cause = autopilot
            .fault()
            .map(|cause| match (cause, autopilot.obstacle()) {
                (Cause::StageTimedOut, Some(obstacle)) => format!("{cause}: {obstacle}"),
                _ => cause.to_string(),
            });
        let cause = refusal.or(self.reasons.words()).or(cause);
        let reason = self.journal_failed.clone();
        let reason = reason.or_else(|| reason::first(self.onboard.fault(), cause));
        let mut reason = reason.unwrap_or_else(|| autopilot.phase().to_string());
        if let Some(age) = autopilot.heartbeat_age(now)
            && autopilot.is_link_silent(now)
        {
            reason += &format!("; nothing heard for {:.0} s", age.as_secs_f64());
            if let Some(last_error) = peer.last_error() {
                reason += &format!(" ({last_error})");
            }
        }
        FlightError::BrokenOff {
            slots_done: self.ground.slots().len(),
            slots: self.onboard.controller().mission().slots(),
            reason,
        }
    }

    fn record(self, scenario: &Scenario, settings: &FlightSettings) -> FlightRecord {
        FlightRecord {
            scenario: scenario.clone(),
            policy: settings.policy.clone(),
            inner: settings.inner.to_string(),
            profile: self.profile.name().into(),
            seed: settings.seed,
            link: self.ground.link(),
            slots: self.ground.into_slots(),
            path: self.path,
            events: self.events,
            completed: false,
            ended: String::new(),
            notes: FlightNotes::default(),
        }
    }
}

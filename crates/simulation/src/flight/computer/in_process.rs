//! The controller in this process, in double precision, with a MAVLink client that may sign frames
//! and set parameters.

use std::{collections::VecDeque, fmt, io};

use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    autopilot::{self, Autopilot, Phase, failsafe::Cause, wire::signing::SigningState},
    controller::Controller,
    inner::Method,
    onboard::{Onboard, OnboardSettings},
    policy::Policy,
    time::{Duration, Instant},
};
use scenario::Scenario;
use vehicle::Profile;

use super::{
    ComputerState, Notice, OnboardComputer, Round, RoundInput, parameters::ChangedParameters,
};
use crate::flight::{
    airframe::ProfileChoice,
    client::ClientSettings,
    outcome::FlightError,
    peer::Peer,
    reason::{self, Reasons},
    settings::{FlightSettings, autopilot_settings},
    stopwatch::Stopwatch,
};
use crate::signing::{SigningClock, SigningUpkeep};

/// The onboard computer in this process, which flies under the policy `P`.
pub struct InProcess<P> {
    onboard: Onboard<f64, P, USERS_MAX, SENSORS_MAX, Method<f64>>,
    /// The clock and the file of signatures.
    upkeep: SigningUpkeep,
    profile: Option<Profile>,
    profile_choice: ProfileChoice,
    parameters: ChangedParameters,
    reasons: Reasons,
    /// The notices that were not taken yet; those of the client's events are not among them.
    notices: VecDeque<Notice>,
}

impl<P> fmt::Debug for InProcess<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("InProcess").finish_non_exhaustive()
    }
}

impl<P: Policy<f64, USERS_MAX>> InProcess<P> {
    /// Creates a computer for the vehicle at the other end of `peer`.
    ///
    /// # Errors
    /// Returns an error if the settings are invalid for the mission.
    pub fn new(
        scenario: &Scenario,
        policy: P,
        settings: &FlightSettings,
        client: ClientSettings,
        peer: &Peer,
    ) -> Result<Self, FlightError> {
        let allowed = settings.inner.check(&scenario.mission);
        allowed.map_err(FlightError::Allocation)?;
        let method = settings.inner.method(&scenario.mission);
        let controller = Controller::with_solver(scenario.mission.clone(), policy, method);
        let autopilot = Autopilot::new(autopilot::AutopilotSettings {
            set_parameters: client.sets_parameters,
            airframe_speed_mps: client.airframe_speed_mps,
            own: client.own,
            ..autopilot_settings(scenario, settings.profile)
        })?;
        let mut onboard = Onboard::new(OnboardSettings::default(), controller, autopilot);
        let mut upkeep = SigningUpkeep::new(SigningClock::Unknown);
        if let Some((signing, of_signing)) = client.signing {
            onboard.sign_with(signing);
            upkeep = of_signing;
        }
        if let Some(credentials) = client.ground_link {
            onboard.authenticate_ground(credentials);
        }
        onboard.autopilot_mut().launch(Instant::ZERO);
        let given = (!client.profile_from_heartbeat).then_some(settings.profile);
        Ok(Self {
            onboard,
            upkeep,
            profile: None,
            profile_choice: ProfileChoice::new(scenario, given),
            parameters: ChangedParameters::new(
                client.journal,
                client.sets_parameters,
                peer.is_built_in(),
            ),
            reasons: Reasons::default(),
            notices: VecDeque::new(),
        })
    }
}

impl<P: Policy<f64, USERS_MAX>> OnboardComputer for InProcess<P> {
    type Precision = f64;

    fn round(&mut self, input: &RoundInput<'_>) -> Result<Round, FlightError> {
        let now = input.now;
        if let Some(unix_us) = self.upkeep.date(input.unix_us) {
            self.onboard.set_signing_time(unix_us);
        }
        self.onboard.receive_ground(now, input.from_ground);
        for datagram in input.from_vehicle {
            self.onboard.receive_mavlink(now, datagram, true);
        }
        let client = self.onboard.autopilot_mut();
        self.parameters
            .keep_journal(now, client, &mut self.notices)?;
        let mut stopwatch = Stopwatch::default();
        self.onboard.poll(now, &mut stopwatch);
        let mut round = Round::default();
        round.take_frames(now, &mut self.onboard);
        if input.from_vehicle.is_empty() && round.is_silent() {
            // Nothing is pending any more. The last messages may have ended the flight.
            self.onboard.poll(now, &mut stopwatch);
            let settled = self.profile_choice.settle(self.onboard.autopilot_mut())?;
            self.profile = settled.or(self.profile);
        }
        (round.plan_us, round.allocate_us) = stopwatch.totals_us();
        self.upkeep.note(|| self.onboard.signing_state());
        if let Some(error) = self.upkeep.take_error() {
            self.notices.push_back(Notice::Note(error.to_string()));
        }
        Ok(round)
    }

    fn state(&self) -> ComputerState {
        let client = self.onboard.autopilot();
        let place = client.position();
        ComputerState {
            stage: self.onboard.stage(),
            phase: client.phase(),
            place: place.map(|sample| (sample.position, sample.altitude_m)),
            is_connected: client.vehicle().is_some(),
        }
    }

    fn take_notice(&mut self, now: Instant) -> Option<Notice> {
        if let Some(notice) = self.notices.pop_front() {
            return Some(notice);
        }
        let event = self.onboard.autopilot_mut().take_next_event()?;
        let duty = self.parameters.note_event(&event);
        self.reasons.note(now, &event);
        let event = Notice::Event {
            text: event.to_string(),
            notable: reason::is_notable(&event),
        };
        match duty {
            Some(duty) => {
                self.notices.push_back(event);
                Some(duty)
            }
            None => Some(event),
        }
    }

    fn stop(&mut self, now: Instant) -> io::Result<Option<&'static str>> {
        let client = self.onboard.autopilot_mut();
        client.stop(now);
        Ok(match client.phase() {
            Phase::Landing => Some("landing"),
            Phase::Disarming => Some("stopping the motors"),
            _ => None,
        })
    }

    fn signing_state(&mut self) -> io::Result<Option<SigningState>> {
        Ok(self.onboard.signing_state())
    }

    fn aborted_because(&self) -> Option<String> {
        let client = self.onboard.autopilot();
        let refusal = client.refusal().map(|refusal| refusal.to_string());
        let cause = client
            .fault()
            .map(|cause| match (cause, client.obstacle()) {
                (Cause::StageTimedOut, Some(obstacle)) => format!("{cause}: {obstacle}"),
                _ => cause.to_string(),
            });
        let cause = refusal.or(self.reasons.words()).or(cause);
        let journal = self.parameters.journal_failed();
        journal.or_else(|| reason::first(self.onboard.fault(), cause))
    }

    fn profile(&self) -> Option<Profile> {
        self.profile
    }

    fn silence(&self, now: Instant) -> Option<Duration> {
        let client = self.onboard.autopilot();
        client
            .heartbeat_age(now)
            .filter(|_| client.is_link_silent(now))
    }

    fn refused_frames(&self) -> u32 {
        self.onboard.status().mavlink.refused()
    }

    fn restores_parameters(&self) -> bool {
        true
    }

    fn restore_now(&mut self) {
        self.onboard.autopilot_mut().restore_now();
    }

    fn may_be_left(&self) -> bool {
        let client = self.onboard.autopilot();
        client.is_restored() && !client.awaits_landing()
    }

    fn abandon_parameters(&mut self) {
        self.onboard.autopilot_mut().abandon_parameters();
    }

    fn is_finished(&mut self, now: Instant, stop_asked: bool) -> bool {
        let client = self.onboard.autopilot_mut();
        self.parameters
            .are_finished(now, client, stop_asked, &mut self.notices)
    }

    fn left_over(&self) -> Option<String> {
        self.parameters.left_over()
    }
}

//! The whole onboard computer: controller, MAVLink client and ground link in one slot cycle.
//!
//! The module has no I/O and no clock: bytes and time come in as arguments, bytes go out on
//! request.
//!
//! ```text
//!             ground bytes                                  MAVLink bytes
//!                 |  ^                                           |  ^
//!  receive_ground v  | take_ground_frame         receive_mavlink v  | take_mavlink_frame
//!        +--------------------------------------------------------------------+
//!        |  link::Decoder   ->   Controller: plan, allocate   ->   Autopilot  |
//!        +--------------------------------------------------------------------+
//! ```
//!
//! In a slot the computer plans from the measured position, flies the leg, reports the
//! [`Arrival`], receives the channel state that the ground answers with, allocates, and sends the
//! command and a [`VehicleStatus`]; then the next slot begins. Slot `n` ends at `t_0 + n delta` of
//! the vehicle's clock, where `t_0` is the moment at which slot 1 began: the exchange takes place
//! in the first part of the next slot, and no message moves the end of a slot. An arrival that is
//! not answered is sent again. Where no channel state is received within
//! [`OnboardSettings::channel_patience`], the last one, aged, is used instead, and the command
//! states its age. Everything that is received and not used is counted.

use serde::{Deserialize, Serialize};

use crate::{
    SENSORS_MAX, USERS_MAX,
    autopilot::{
        Autopilot, Leg, LegEnd, LegError, Phase,
        guidance::Limits,
        wire::{
            self, FrameBuffer,
            signing::{Signer, Verifier},
        },
    },
    controller::{ChannelSource, ChannelState, Controller, ControllerError, SlotCommand},
    counter::count,
    link::{
        self, Arrival, Decoder, FRAME_MAX, Message, NumberedChange, SlotCounters, VehicleStatus,
    },
    policy::Policy,
    scalar::{Position, Scalar},
    time::{Duration, Instant},
};

/// The fraction of the guidance's acceleration that the shield relies on for braking and turning.
/// The rest is needed for jerk and for following the reference.
const RELIABLE_FRACTION: f64 = 0.5;

/// Settings of the slot cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OnboardSettings {
    /// The longest time that the ground may take to answer an arrival; never longer than half a
    /// slot.
    pub channel_patience: Duration,
    /// The time without an answer after which the arrival is sent again.
    pub arrival_interval: Duration,
    /// The operations that the policy may spend on a better plan in a [`poll`](Onboard::poll)
    /// before slot 1, and on the way to a waypoint after a change of the mission.
    pub planning_operations: u64,
}

impl Default for OnboardSettings {
    fn default() -> Self {
        Self {
            channel_patience: Duration::from_millis(500),
            arrival_interval: Duration::from_millis(125),
            planning_operations: 500_000,
        }
    }
}

/// One of the two computations of a slot, for measurements of their duration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activity {
    /// Policy and shield.
    Plan,
    /// The slot problem.
    Allocate,
}

/// Measures how long an [`Activity`] takes. The core has no clock of its own.
pub trait Probe {
    /// Called when the activity begins.
    fn begin(&mut self, activity: Activity);
    /// Called when the activity has ended.
    fn end(&mut self, activity: Activity);
}

/// A probe that measures nothing.
impl Probe for () {
    fn begin(&mut self, _: Activity) {}
    fn end(&mut self, _: Activity) {}
}

/// The stage of the mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Stage {
    /// Before slot 1: connecting, checking, taking off, flying to the start.
    Preparing,
    /// On the way to the waypoint of a slot.
    Flying,
    /// At a slot's end, waiting for its channel state.
    Measuring,
    /// All slots done; landing.
    Landing,
    /// On the ground after a complete mission.
    Completed,
    /// The mission was aborted; the autopilot's phase, fault and events give the reason.
    Aborted,
}

/// Error that made the onboard computer, and not the autopilot client, abort a mission.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Fault {
    /// The controller returned an error.
    #[error("controller: {0}")]
    Controller(#[from] ControllerError),
    /// A leg could not be flown.
    #[error("leg: {0}")]
    Leg(#[from] LegError),
    /// The autopilot client has no measured position.
    #[error("no measured position")]
    NoPosition,
}

/// The end of a slot, while the computer waits for its channel state.
#[derive(Clone, Copy, Debug)]
struct Measuring<T: Scalar> {
    since: Instant,
    arrival: Arrival<T>,
    repeat_at: Instant,
}

/// The onboard computer.
#[derive(Debug)]
pub struct Onboard<T: Scalar, P, const M: usize = USERS_MAX, const J: usize = SENSORS_MAX> {
    settings: OnboardSettings,
    slot_duration_s: f64,
    controller: Controller<T, P, M, J>,
    autopilot: Autopilot<T>,
    stage: Stage,
    /// The flight starts as soon as the first plan is made.
    is_launch_due: bool,
    fault: Option<Fault>,
    measuring: Option<Measuring<T>>,
    /// `t_0`, when slot 1 began, on the vehicle's clock.
    began: Option<Instant>,
    mavlink_in: wire::Decoder,
    mavlink_out: wire::Encoder,
    ground_in: Decoder,
    channel_state: Option<ChannelState<T, M, J>>,
    arrival: Option<Arrival<T>>,
    command: Option<SlotCommand<T, J>>,
    status_due: bool,
    slots: SlotCounters,
    mavlink_unreadable: u32,
}

impl<T: Scalar, P: Policy<T, M>, const M: usize, const J: usize> Onboard<T, P, M, J> {
    /// Creates a computer before take-off that has received nothing from either side.
    pub fn new(
        settings: OnboardSettings,
        controller: Controller<T, P, M, J>,
        autopilot: Autopilot<T>,
    ) -> Self {
        let slot_duration_s = controller.mission().parameters().slot_duration_s.to_f64();
        // The exchange takes place in the next slot, which has to be flown as well.
        let half_slot = Duration::from_secs_f64(slot_duration_s / 2.0);
        let settings = OnboardSettings {
            channel_patience: settings.channel_patience.min(half_slot),
            ..settings
        };
        Self {
            settings,
            slot_duration_s,
            controller,
            mavlink_out: wire::Encoder::new(autopilot.own()),
            autopilot,
            stage: Stage::Preparing,
            is_launch_due: false,
            fault: None,
            measuring: None,
            began: None,
            mavlink_in: wire::Decoder::in_order(),
            ground_in: Decoder::new(),
            channel_state: None,
            arrival: None,
            command: None,
            status_due: false,
            slots: SlotCounters::default(),
            mavlink_unreadable: 0,
        }
    }

    /// Returns the stage of the mission.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// Returns why the onboard computer aborted the mission, if it did.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Returns the controller.
    pub fn controller(&self) -> &Controller<T, P, M, J> {
        &self.controller
    }

    /// Returns the MAVLink client.
    pub fn autopilot(&self) -> &Autopilot<T> {
        &self.autopilot
    }

    /// Returns the MAVLink client, to launch, to stop and to take its events.
    pub fn autopilot_mut(&mut self) -> &mut Autopilot<T> {
        &mut self.autopilot
    }

    /// Starts the flight: at once, or as soon as the policy's first plan is made. The operations of
    /// [`OnboardSettings::planning_operations`] are spent on it in each [`poll`](Self::poll).
    pub fn launch(&mut self, now: Instant) {
        self.is_launch_due = true;
        self.launch_if_planned(now);
    }

    fn launch_if_planned(&mut self, now: Instant) {
        let quality = self.controller.policy().quality();
        let is_planning = quality.is_some_and(|quality| quality.is_replanning);
        if self.is_launch_due && !is_planning {
            self.is_launch_due = false;
            self.autopilot.launch(now);
        }
    }

    /// Returns the counters of everything that was received, dropped or missing.
    pub fn status(&self) -> VehicleStatus {
        VehicleStatus {
            slots_done: self.controller.slots_done(),
            slots: SlotCounters {
                changes_refused: self.controller.changes_refused(),
                ..self.slots
            },
            link: *self.ground_in.counters(),
            mavlink: self.mavlink_in.counters(),
            mavlink_unreadable: self.mavlink_unreadable,
            plan: self.controller.policy().quality(),
        }
    }

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

    /// Returns when [`poll`](Self::poll) must be called next if nothing is received before.
    pub fn poll_at(&self, now: Instant) -> Instant {
        let next = self.autopilot.poll_at(now);
        match &self.measuring {
            Some(measuring) => next
                .min(measuring.since + self.settings.channel_patience)
                .min(measuring.repeat_at),
            None => next,
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

    /// Advances the slot cycle as far as what was received allows.
    pub fn poll(&mut self, now: Instant, probe: &mut impl Probe) {
        let phase = self.autopilot.phase();
        if phase.is_final() {
            let whole = matches!(self.stage, Stage::Landing | Stage::Completed);
            self.stage = if whole && phase == Phase::Landed {
                Stage::Completed
            } else {
                Stage::Aborted
            };
            return;
        }
        match self.stage {
            Stage::Preparing if self.autopilot.phase() == Phase::Ready => {
                // The limits that the vehicle's parameters impose are known by now; guidance uses
                // them.
                let limits = *self.autopilot.limits();
                self.controller.rely_on(&Limits {
                    acceleration_mps2: limits.acceleration_mps2 * T::of(RELIABLE_FRACTION),
                    ..limits
                });
                let measured = self.autopilot.position();
                self.begin_slot(now, measured.map(|sample| sample.position), probe);
            }
            Stage::Preparing => {
                let operations = self.settings.planning_operations;
                self.controller.improve_plan(operations);
                self.launch_if_planned(now);
            }
            Stage::Flying => {
                if let Some(end) = self.autopilot.leg_ended(now) {
                    self.end_leg(now, &end);
                } else {
                    let operations = self.settings.planning_operations;
                    self.controller.improve_plan(operations);
                }
            }
            Stage::Measuring => self.measure(now, probe),
            _ => {}
        }
    }

    /// Returns the tick that ends slot `n`, on the vehicle's clock.
    fn tick(&self, began: Instant, slot: u32) -> Instant {
        began + Duration::from_secs_f64(self.slot_duration_s * f64::from(slot))
    }

    /// Plans the next slot from where the last one ended, and starts its leg. The vehicle's present
    /// position is not used: eq:traj1 constrains the ends of slots, however long the exchange
    /// between them took.
    fn begin_slot(&mut self, now: Instant, from: Option<Position<T>>, probe: &mut impl Probe) {
        if self.controller.is_over() {
            self.stage = Stage::Landing;
            self.autopilot.land(now);
            return;
        }
        let Some(position) = from else {
            self.abort(now, Fault::NoPosition);
            return;
        };
        let vehicle_now = self.autopilot.vehicle_time(now);
        let Some(began) = self.began.or(vehicle_now) else {
            self.abort(now, Fault::NoPosition);
            return;
        };
        self.began = Some(began);
        probe.begin(Activity::Plan);
        let plan = self.controller.plan(position);
        probe.end(Activity::Plan);
        let flown = plan.map_err(Fault::from).and_then(|plan| {
            let leg = Leg {
                waypoint: plan.waypoint,
                end: self.tick(began, plan.slot),
            };
            self.autopilot.fly_leg(now, leg).map_err(Fault::from)
        });
        match flown {
            Ok(()) => self.stage = Stage::Flying,
            Err(fault) => self.abort(now, fault),
        }
    }

    /// Reports where the leg ended and waits for the channels there.
    fn end_leg(&mut self, now: Instant, end: &LegEnd<T>) {
        let Some(&plan) = self.controller.under_way() else {
            return;
        };
        let arrival = Arrival {
            plan,
            position: end.sample.position,
            tick: end.tick,
        };
        self.measuring = Some(Measuring {
            since: now,
            arrival,
            repeat_at: now + self.settings.arrival_interval,
        });
        self.stage = Stage::Measuring;
        self.report(arrival);
    }

    fn report(&mut self, arrival: Arrival<T>) {
        if self.arrival.replace(arrival).is_some() {
            count(&mut self.slots.unsent);
        }
    }

    /// Allocates as soon as the channel state is received, or has been missing for too long.
    fn measure(&mut self, now: Instant, probe: &mut impl Probe) {
        let Some(measuring) = &mut self.measuring else {
            return;
        };
        let arrival = measuring.arrival;
        let overdue = now.duration_since(measuring.since) >= self.settings.channel_patience;
        let state = self.channel_state.take();
        if state.is_none() && !overdue {
            if now >= measuring.repeat_at {
                measuring.repeat_at = now + self.settings.arrival_interval;
                count(&mut self.slots.arrivals_repeated);
                self.report(arrival);
            }
            return;
        }
        probe.begin(Activity::Allocate);
        let command = match &state {
            Some(state) => self.controller.allocate(state),
            None => self.controller.allocate_predicted(&arrival.position),
        };
        probe.end(Activity::Allocate);
        match command {
            Ok(command) => {
                self.measuring = None;
                // An answer is too late from here on, and so is the question.
                self.arrival = None;
                self.command_slot(arrival.plan.served_user, command);
                self.begin_slot(now, Some(arrival.position), probe);
            }
            Err(error) => self.abort(now, error.into()),
        }
    }

    /// Updates the counters for a slot's command and queues the command.
    fn command_slot(&mut self, planned_user: usize, command: SlotCommand<T, J>) {
        let slots = &mut self.slots;
        count(match command.source {
            ChannelSource::Measured => &mut slots.measured,
            ChannelSource::Predicted => &mut slots.stale,
        });
        match command.served_user {
            None => count(&mut slots.nobody_served),
            Some(user) if user != planned_user => count(&mut slots.user_replaced),
            Some(_) => {}
        }
        if !command.status.is_feasible() {
            count(&mut slots.infeasible);
        }
        let add = |counter: &mut u32, more: u16| *counter = counter.saturating_add(more.into());
        add(&mut slots.unheard_sensors, command.unheard_sensors);
        add(&mut slots.rejected_gains, command.rejected_gains);
        if self.command.replace(command).is_some() {
            count(&mut slots.unsent);
        }
        self.status_due = true;
    }

    fn abort(&mut self, now: Instant, fault: Fault) {
        self.fault = Some(fault);
        self.stage = Stage::Aborted;
        self.measuring = None;
        self.status_due = true;
        self.autopilot.land(now);
    }
}

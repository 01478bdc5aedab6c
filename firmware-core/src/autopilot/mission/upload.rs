// SPDX-License-Identifier: MIT OR Apache-2.0
//! The transfer of a mission to an autopilot.

// Autopilots still use the request that MAVLink has since deprecated.
#![allow(deprecated)]

use mavlink::dialects::common::{
    MISSION_ACK_DATA, MISSION_CLEAR_ALL_DATA, MISSION_COUNT_DATA, MISSION_REQUEST_INT_DATA,
    MISSION_REQUEST_LIST_DATA, MavMessage, MavMissionResult, MavMissionType,
};

use super::outcome::{Left, UploadError, UploadOutcome};
use super::plan::{MissionPlan, PlanError};
use crate::autopilot::command::{CommandOutcome, Patience, Pending, Request, Turn};
use crate::autopilot::profile::Firmware;
use crate::autopilot::wire::Address;
use crate::scalar::Scalar;
use crate::time::{Duration, Instant};

/// The stage of a transfer.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// The number of items is sent.
    Offer,
    /// This item, which the autopilot has requested last, is sent.
    Serve(u16),
    /// The number of items is read back.
    ReadCount,
    /// This item is read back.
    ReadItem(u16),
    /// The mission is started: this command is sent, in the order of
    /// [`start_step`](MissionUpload::start_step).
    Start(u8),
    /// The mission is cleared after this error.
    Clear(UploadError),
    /// The number of items is read to check that the mission was cleared after this error.
    CheckCleared(UploadError),
    /// The transfer has ended.
    Over(UploadOutcome),
}

/// The time without progress after which a message is repeated.
const ANSWER_TIME: Duration = Duration::from_millis(1_000);

/// The largest number of times that a message is sent without progress.
const ATTEMPTS: u8 = 8;

/// The number of times that the last item is sent before its effect is read back.
const LAST_ATTEMPTS: u8 = 4;

/// The longest time for which the upload is offered again to an autopilot that has no space for a
/// mission: ArduCopter answers so for some 15 s after it has booted.
pub const SPACE_PATIENCE: Duration = Duration::from_secs(30);

/// The time between two offers while the autopilot has no space.
const OFFER_AGAIN: Duration = Duration::from_secs(1);

/// A transfer of a mission; sans-IO like [`crate::autopilot::Autopilot`].
#[derive(Clone, Debug)]
pub struct MissionUpload<'a, T: Scalar> {
    plan: MissionPlan<'a, T>,
    to: Address,
    own: Address,
    start: bool,
    stage: Stage,
    due: Instant,
    attempts: u8,
    /// The offer was sent, after which the autopilot may have dropped the old mission.
    touched: bool,
    /// The final acknowledgement of a read-back is still to be sent.
    final_ack_is_due: bool,
    pending: Option<Pending>,
    patience: Patience,
    /// The time at which the autopilot first answered that it has no space for a mission.
    no_space_since: Option<Instant>,
}

impl<'a, T: Scalar> MissionUpload<'a, T> {
    /// Creates a transfer of `plan` to the autopilot `to`, with messages sent as `own`. With
    /// `start` the mission is flown as soon as it is uploaded.
    pub fn new(
        plan: MissionPlan<'a, T>,
        to: Address,
        own: Address,
        start: bool,
    ) -> Result<Self, PlanError> {
        plan.check()?;
        Ok(Self {
            plan,
            to,
            own,
            start,
            stage: Stage::Offer,
            due: Instant::ZERO,
            attempts: 0,
            touched: false,
            final_ack_is_due: false,
            pending: None,
            patience: Patience::default(),
            no_space_since: None,
        })
    }

    /// Returns whether the autopilot has answered that it has no space for a mission and the upload
    /// is offered again, for [`SPACE_PATIENCE`] at most.
    pub fn waits_for_space(&self) -> bool {
        self.stage == Stage::Offer && self.no_space_since.is_some()
    }

    /// Returns the outcome, once the upload has ended.
    pub fn outcome(&self) -> Option<UploadOutcome> {
        match self.stage {
            Stage::Over(outcome) => Some(outcome),
            _ => None,
        }
    }

    /// Returns the number of items that the autopilot has requested, and the number of all items.
    pub fn progress(&self) -> (u16, u16) {
        let count = self.plan.count();
        let done = match self.stage {
            Stage::Offer => 0,
            Stage::Serve(item) => item + 1,
            _ => count,
        };
        (done, count)
    }

    /// Cancels the upload; items that were already accepted are cleared.
    pub fn cancel(&mut self, now: Instant) {
        self.fail(now, UploadError::Cancelled);
    }

    fn enter(&mut self, now: Instant, stage: Stage) {
        self.stage = stage;
        self.due = now;
        self.attempts = 0;
    }

    fn fail(&mut self, now: Instant, error: UploadError) {
        match self.stage {
            Stage::Over(_) | Stage::Clear(_) | Stage::CheckCleared(_) => {}
            // Refused at the first offer: nothing was changed.
            Stage::Offer if matches!(error, UploadError::Refused(_)) => {
                self.stage = Stage::Over(Err((error, Left::Old)));
            }
            _ if self.touched => self.enter(now, Stage::Clear(error)),
            _ => self.stage = Stage::Over(Err((error, Left::Old))),
        }
    }

    /// Returns the next message to send. Call until `None`, and again within 50 ms or when
    /// something was received.
    pub fn poll(&mut self, now: Instant) -> Option<MavMessage> {
        if core::mem::take(&mut self.final_ack_is_due) {
            return Some(self.ack(MavMissionResult::MAV_MISSION_ACCEPTED));
        }
        if let Stage::Start(step) = self.stage {
            return self.poll_start(now, step);
        }
        if now < self.due || matches!(self.stage, Stage::Over(_)) {
            return None;
        }
        // The last acknowledgement is sent once and may be lost: read the mission back instead.
        if self.stage == Stage::Serve(self.plan.count() - 1) && self.attempts >= LAST_ATTEMPTS {
            self.enter(now, Stage::ReadCount);
        }
        if self.attempts >= ATTEMPTS {
            match self.stage {
                Stage::Clear(error) | Stage::CheckCleared(error) => {
                    self.stage = Stage::Over(Err((error, Left::Unknown)));
                    return None;
                }
                _ => self.fail(now, UploadError::Unanswered),
            }
            if matches!(self.stage, Stage::Over(_)) {
                return None;
            }
        }
        self.attempts += 1;
        self.due = now + ANSWER_TIME;
        self.touched = true;
        Some(match self.stage {
            Stage::Offer => MavMessage::MISSION_COUNT(MISSION_COUNT_DATA {
                count: self.plan.count(),
                target_system: self.to.system,
                target_component: self.to.component,
                mission_type: MavMissionType::MAV_MISSION_TYPE_MISSION,
                opaque_id: 0,
            }),
            Stage::Serve(sequence) => {
                MavMessage::MISSION_ITEM_INT(self.plan.item(sequence, self.to)?)
            }
            Stage::ReadCount | Stage::CheckCleared(_) => {
                MavMessage::MISSION_REQUEST_LIST(MISSION_REQUEST_LIST_DATA {
                    target_system: self.to.system,
                    target_component: self.to.component,
                    mission_type: MavMissionType::MAV_MISSION_TYPE_MISSION,
                })
            }
            Stage::ReadItem(seq) => MavMessage::MISSION_REQUEST_INT(MISSION_REQUEST_INT_DATA {
                seq,
                target_system: self.to.system,
                target_component: self.to.component,
                mission_type: MavMissionType::MAV_MISSION_TYPE_MISSION,
            }),
            Stage::Clear(_) => MavMessage::MISSION_CLEAR_ALL(MISSION_CLEAR_ALL_DATA {
                target_system: self.to.system,
                target_component: self.to.component,
                mission_type: MavMissionType::MAV_MISSION_TYPE_MISSION,
            }),
            Stage::Start(_) | Stage::Over(_) => return None,
        })
    }

    fn ack(&self, result: MavMissionResult) -> MavMessage {
        MavMessage::MISSION_ACK(MISSION_ACK_DATA {
            target_system: self.to.system,
            target_component: self.to.component,
            mavtype: result,
            mission_type: MavMissionType::MAV_MISSION_TYPE_MISSION,
            opaque_id: 0,
        })
    }

    /// Processes a message; only messages of the autopilot are used.
    pub fn receive(&mut self, now: Instant, from: Address, message: &MavMessage) {
        use MavMessage as M;
        if from != self.to {
            return;
        }
        let meant = |system: u8, component: u8| {
            [0, self.own.system].contains(&system) && [0, self.own.component].contains(&component)
        };
        match (message, self.stage) {
            (M::MISSION_REQUEST(r), _) if meant(r.target_system, r.target_component) => {
                self.serve(now, r.seq);
            }
            (M::MISSION_REQUEST_INT(r), _) if meant(r.target_system, r.target_component) => {
                self.serve(now, r.seq);
            }
            (M::MISSION_ACK(ack), stage) if meant(ack.target_system, ack.target_component) => {
                self.take_ack(now, ack.mavtype, stage);
            }
            (M::MISSION_COUNT(c), Stage::ReadCount)
                if meant(c.target_system, c.target_component) =>
            {
                let (got, sent) = (c.count, self.plan.count());
                if got == sent {
                    self.enter(now, Stage::ReadItem(0));
                } else {
                    self.fail(now, UploadError::Count { got, sent });
                }
            }
            (M::MISSION_COUNT(c), Stage::CheckCleared(error))
                if meant(c.target_system, c.target_component) =>
            {
                // ArduPilot may keep its home position as item 0.
                let left = if c.count <= 1 {
                    Left::Nothing
                } else {
                    Left::Unknown
                };
                self.final_ack_is_due = true;
                self.stage = Stage::Over(Err((error, left)));
            }
            (M::MISSION_ITEM_INT(item), Stage::ReadItem(sequence))
                if meant(item.target_system, item.target_component) && item.seq == sequence =>
            {
                if !self.plan.is_same(item, self.to) {
                    self.fail(now, UploadError::Different(sequence));
                } else if sequence + 1 < self.plan.count() {
                    self.enter(now, Stage::ReadItem(sequence + 1));
                } else {
                    self.final_ack_is_due = true;
                    if self.start {
                        self.enter(now, Stage::Start(0));
                    } else {
                        self.stage = Stage::Over(Ok(()));
                    }
                }
            }
            (M::COMMAND_ACK(answer), Stage::Start(step))
                if meant(answer.target_system, answer.target_component) =>
            {
                if let Some(pending) = &mut self.pending
                    && let Some(outcome) = pending.answer(now, answer, &self.patience)
                {
                    self.step_over(now, step, outcome);
                }
            }
            _ => {}
        }
    }

    /// Sends the item that the autopilot requests. It may request an item again, or restart.
    fn serve(&mut self, now: Instant, sequence: u16) {
        let serving = matches!(self.stage, Stage::Offer | Stage::Serve(_));
        if serving && sequence < self.plan.count() {
            // A repeated request does not count as progress.
            if self.stage == Stage::Serve(sequence) {
                self.due = now;
            } else {
                self.enter(now, Stage::Serve(sequence));
            }
        }
    }

    fn take_ack(&mut self, now: Instant, result: MavMissionResult, stage: Stage) {
        let accepted = result == MavMissionResult::MAV_MISSION_ACCEPTED;
        match stage {
            Stage::Offer if result == MavMissionResult::MAV_MISSION_NO_SPACE => {
                let since = *self.no_space_since.get_or_insert(now);
                if now - since < SPACE_PATIENCE {
                    self.attempts = 0;
                    self.due = now + OFFER_AGAIN;
                } else {
                    self.fail(now, UploadError::Refused(result));
                }
            }
            // An early "accepted" would mean an incomplete mission.
            Stage::Serve(sequence) if accepted && sequence + 1 == self.plan.count() => {
                self.enter(now, Stage::ReadCount);
            }
            Stage::Offer | Stage::Serve(_) | Stage::ReadCount | Stage::ReadItem(_) if !accepted => {
                self.fail(now, UploadError::Refused(result));
            }
            Stage::Clear(error) if accepted => self.enter(now, Stage::CheckCleared(error)),
            _ => {}
        }
    }

    /// Returns the commands that start a mission. ArduCopter takes off in AUTO only once it is
    /// armed, and arms in GUIDED.
    fn start_step(&self, step: u8) -> Option<Request> {
        let mode = match self.plan.firmware {
            Firmware::Px4 => self.plan.firmware.mission_mode(),
            _ => self.plan.firmware.control_mode(),
        };
        [Request::SetMode(mode), Request::Arm, Request::StartMission]
            .get(usize::from(step))
            .copied()
    }

    fn poll_start(&mut self, now: Instant, step: u8) -> Option<MavMessage> {
        let Some(request) = self.start_step(step) else {
            self.stage = Stage::Over(Ok(()));
            return None;
        };
        let pending = self.pending.get_or_insert(Pending::new(now, request));
        match pending.turn(now, &self.patience) {
            Turn::Wait => None,
            Turn::Send(_) => {
                let message = pending.message(self.plan.firmware, self.to);
                pending.sent(now, &self.patience);
                Some(MavMessage::COMMAND_LONG(message))
            }
            Turn::Over(outcome) => {
                self.step_over(now, step, outcome);
                None
            }
        }
    }

    fn step_over(&mut self, now: Instant, step: u8, outcome: CommandOutcome) {
        let name = self.pending.take().map_or("", |p| p.request.name());
        if outcome == CommandOutcome::Accepted {
            self.enter(now, Stage::Start(step + 1));
        } else {
            self.stage = Stage::Over(Err((UploadError::NotStarted(name), Left::Whole)));
        }
    }
}

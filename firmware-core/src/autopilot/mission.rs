//! Upload of a whole mission, which the autopilot then flies by itself.
//!
//! [`MissionPlan`] computes the mission items without storing them; [`MissionUpload`] transfers
//! them, reads them back, compares them, and starts the mission if requested. After a failed
//! transfer the autopilot has the old mission or none: an autopilot may keep and fly an incomplete
//! mission (ArduCopter does), so the mission is cleared after a failure, and the client checks that
//! it is.
//!
//! ```text
//! us:  COUNT ──────── ITEM k ──────────── REQUEST_LIST ──────── REQUEST_INT k ─────── ACK
//! it:        REQUEST(_INT) k ...     ACK               COUNT                 ITEM k ...
//! ```

// Autopilots still use the request that MAVLink has since deprecated.
#![allow(deprecated)]

use mavlink::dialects::common::{
    MISSION_ACK_DATA, MISSION_CLEAR_ALL_DATA, MISSION_COUNT_DATA, MISSION_ITEM_INT_DATA,
    MISSION_REQUEST_INT_DATA, MISSION_REQUEST_LIST_DATA, MavCmd, MavFrame, MavMessage,
    MavMissionResult, MavMissionType,
};
use thiserror::Error;

use super::command::{CommandOutcome, Patience, Pending, Request, Turn};
use super::frames::{Geodetic, MapFrame};
use super::profile::Firmware;
use super::wire::Address;
use crate::scalar::{Position, Scalar};
use crate::time::{Duration, Instant};

/// The end of a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// Lands at the last waypoint.
    Land,
    /// Returns to the place of take-off and lands there.
    Return,
}

/// A mission in the form in which the autopilot gets it.
#[derive(Clone, Copy, Debug)]
pub struct MissionPlan<'a, T: Scalar> {
    /// Determines whether item 0 is the home position (ArduPilot) or the take-off (PX4).
    pub firmware: Firmware,
    /// The position of the map.
    pub map: MapFrame<T>,
    /// Waypoints, m.
    pub waypoints: &'a [Position<T>],
    /// The altitude above the place of take-off, m.
    pub altitude_m: T,
    /// The speed between waypoints, m/s.
    pub speed_mps: T,
    /// The command after the last waypoint.
    pub ending: Ending,
}

/// Error returned when a plan cannot be uploaded.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PlanError {
    /// The plan has no waypoints.
    #[error("the mission has no way-points")]
    Empty,
    /// The plan has more items than the protocol can number.
    #[error("the mission has {0} way-points; at most 65 000 can be uploaded")]
    TooLong(usize),
    /// A waypoint has a coordinate that is not finite.
    #[error("way-point {0} is not finite")]
    NotFinite(usize),
    /// The altitude or the speed is not finite, or not above zero.
    #[error("{name} is {value}; it must be a number above 0")]
    NotPositive {
        /// The name of the value.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}

const LONGEST: usize = 65_000;

impl<T: Scalar> MissionPlan<'_, T> {
    fn check(&self) -> Result<(), PlanError> {
        if self.waypoints.is_empty() {
            return Err(PlanError::Empty);
        }
        if self.waypoints.len() > LONGEST {
            return Err(PlanError::TooLong(self.waypoints.len()));
        }
        for (name, number) in [
            ("altitude_m", self.altitude_m),
            ("speed_mps", self.speed_mps),
        ] {
            if !(number.finite() && number > T::zero()) {
                let value = number.to_f64();
                return Err(PlanError::NotPositive { name, value });
            }
        }
        let bad = |p: &Position<T>| !(p.x.finite() && p.y.finite());
        match self.waypoints.iter().position(bad) {
            Some(index) => Err(PlanError::NotFinite(index)),
            None => Ok(()),
        }
    }

    /// Returns the number of items before the first waypoint: home where there is one, take-off,
    /// speed.
    fn lead(&self) -> u16 {
        if self.firmware == Firmware::Px4 { 2 } else { 3 }
    }

    /// Returns the number of items.
    pub fn count(&self) -> u16 {
        // At most 65 004 by `check`.
        self.lead() + self.waypoints.len() as u16 + 1
    }

    /// Returns whether an item is number 0 of an autopilot that puts its home position there.
    fn is_home(&self, sequence: u16) -> bool {
        sequence == 0 && self.firmware != Firmware::Px4
    }

    /// Returns item `sequence`, addressed to `to`, or `None` past the end.
    ///
    /// Places are sent in the frame GLOBAL_RELATIVE_ALT; commands without a place in the frame
    /// MISSION, with zero coordinates: PX4 refuses them in any other frame
    /// (MAV_MISSION_UNSUPPORTED).
    pub fn item(&self, sequence: u16, to: Address) -> Option<MISSION_ITEM_INT_DATA> {
        use MavCmd as C;
        let lead = self.lead();
        let last = self.waypoints.len() - 1;
        let index = usize::from(sequence.saturating_sub(lead)).min(last);
        let mut parameters = [0.0; 4];
        let command = if self.is_home(sequence) {
            C::MAV_CMD_NAV_WAYPOINT
        } else if sequence + 2 == lead {
            C::MAV_CMD_NAV_TAKEOFF
        } else if sequence + 1 == lead {
            // Ground speed; the throttle is not changed.
            parameters = [1.0, self.speed_mps.to_f64() as f32, -1.0, 0.0];
            C::MAV_CMD_DO_CHANGE_SPEED
        } else if usize::from(sequence - lead) <= last {
            C::MAV_CMD_NAV_WAYPOINT
        } else if sequence + 1 == self.count() {
            match self.ending {
                Ending::Land => C::MAV_CMD_NAV_LAND,
                Ending::Return => C::MAV_CMD_NAV_RETURN_TO_LAUNCH,
            }
        } else {
            return None;
        };
        let has_place = !matches!(
            command,
            C::MAV_CMD_DO_CHANGE_SPEED | C::MAV_CMD_NAV_RETURN_TO_LAUNCH
        );
        let place = if has_place {
            self.map.to_geodetic(self.waypoints[index])
        } else {
            Geodetic::default()
        };
        let z = match command {
            C::MAV_CMD_NAV_LAND => 0.0,
            _ if self.is_home(sequence) || !has_place => 0.0,
            _ => self.altitude_m.to_f64() as f32,
        };
        let [param1, param2, param3, param4] = parameters;
        Some(MISSION_ITEM_INT_DATA {
            param1,
            param2,
            param3,
            param4,
            x: place.latitude_e7,
            y: place.longitude_e7,
            z,
            seq: sequence,
            command,
            target_system: to.system,
            target_component: to.component,
            frame: if has_place {
                MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT
            } else {
                MavFrame::MAV_FRAME_MISSION
            },
            current: 0,
            autocontinue: 1,
            mission_type: MavMissionType::MAV_MISSION_TYPE_MISSION,
        })
    }

    /// Returns whether an item that was read back is the one that was sent. Places may differ by
    /// rounding, and an autopilot may fill in the places of commands that have none.
    fn is_same(&self, got: &MISSION_ITEM_INT_DATA, to: Address) -> bool {
        let Some(meant) = self.item(got.seq, to) else {
            return false;
        };
        if self.is_home(got.seq) {
            return true;
        }
        let near = |a: i32, b: i32| a.abs_diff(b) <= 2;
        let placed = matches!(meant.command, MavCmd::MAV_CMD_NAV_WAYPOINT);
        let place =
            near(got.x, meant.x) && near(got.y, meant.y) && libm::fabsf(got.z - meant.z) <= 0.02;
        let speed = meant.command != MavCmd::MAV_CMD_DO_CHANGE_SPEED || got.param2 == meant.param2;
        got.command == meant.command && speed && (place || !placed)
    }
}

/// Error returned when an upload has failed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum UploadError {
    /// The autopilot stopped answering.
    #[error("no answer from the autopilot")]
    Unanswered,
    /// The autopilot refused the mission.
    #[error("the autopilot refused the mission ({0:?})")]
    Refused(MavMissionResult),
    /// An item that was read back differs from the one sent.
    #[error("item {0} read back differs from what was sent")]
    Different(u16),
    /// The autopilot has another number of items.
    #[error("{got} items read back, {sent} were sent")]
    Count {
        /// The number of items read back.
        got: u16,
        /// The number of items sent.
        sent: u16,
    },
    /// The caller cancelled the upload.
    #[error("cancelled")]
    Cancelled,
    /// The mission was uploaded, but not started.
    #[error("the mission was uploaded, but {0} failed")]
    NotStarted(&'static str),
}

/// The mission that is on the autopilot after a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Left {
    /// The old mission.
    Old,
    /// None: it was cleared, and the autopilot confirmed that.
    Nothing,
    /// The complete new mission.
    Whole,
    /// Unknown: the autopilot did not answer.
    Unknown,
}

/// The outcome of an upload.
pub type UploadOutcome = Result<(), (UploadError, Left)>;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    Offer,
    Serve(u16),
    ReadCount,
    ReadItem(u16),
    Start(u8),
    Clear(UploadError),
    CheckCleared(UploadError),
    Over(UploadOutcome),
}

/// The time without progress after which a message is repeated.
const ANSWER_TIME: Duration = Duration::from_millis(1_000);
const ATTEMPTS: u8 = 8;
/// The number of times that the last item is sent before its effect is read back.
const LAST_ATTEMPTS: u8 = 4;
/// The longest time for which the upload is offered again to an autopilot that has no space for a
/// mission: ArduCopter answers so for some 15 s after it has booted.
pub const SPACE_PATIENCE: Duration = Duration::from_secs(30);
/// The time between two offers while the autopilot has no space.
const OFFER_AGAIN: Duration = Duration::from_secs(1);

/// A transfer of a mission; sans-IO like [`super::Autopilot`].
#[derive(Clone, Debug)]
pub struct MissionUpload<'a, T: Scalar> {
    plan: MissionPlan<'a, T>,
    to: Address,
    own: Address,
    start: bool,
    stage: Stage,
    due: Instant,
    attempts: u8,
    /// The offer was sent: the autopilot may have dropped the old mission for it.
    touched: bool,
    /// The final acknowledgement of a read-back is still to be sent.
    farewell: bool,
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
            farewell: false,
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
        if core::mem::take(&mut self.farewell) {
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
                self.farewell = true;
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
                    self.farewell = true;
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

// SPDX-License-Identifier: MIT OR Apache-2.0
//! The onboard computer that a board creates from an order.

use core::mem::MaybeUninit;

use heapless::String;

use super::{
    order::{MissionOrder, OrderError, PolicyKind},
    protocol::BoardReport,
};
use crate::{
    Mission, SENSORS_MAX, USERS_MAX,
    autopilot::{Autopilot, AutopilotSettings, failsafe::Watch, preflight::Preflight},
    controller::Controller,
    inner::ExactSolver,
    mission::MissionChange,
    onboard::{Onboard, OnboardSettings},
    planner::{Capacity, Memory, OperationsInFlight, Planner, PlannerError},
    policy::{
        Action, MeasuredGains, Observation, PlanQuality, Policy, Provenance, StraightLine,
        mlp::Mlp,
        sets::{EvaluateSets, SetsPolicy},
    },
    time::Instant,
};

/// A mission in the board's precision.
pub type BoardMission = Mission<f32, USERS_MAX, SENSORS_MAX>;

/// The onboard computer of a board with its trained policy, `R`, and its planner, `P`.
pub type BoardComputer<R, P> = Onboard<f32, BoardPolicy<R, P>, USERS_MAX, SENSORS_MAX>;

/// The planner of a board, with the memory `S`.
pub type BoardPlanner<S> = Planner<f32, S, USERS_MAX, SENSORS_MAX>;

/// The capacity of a board's planner: missions of up to 150 slots, and any number of users.
pub const PLANNER_CAPACITY: Capacity = Capacity {
    slots: 150,
    users: USERS_MAX,
    ..Capacity::new(24, USERS_MAX)
};

/// The numbers that a board's planner needs as its memory.
pub type PlannerNumbers = [f32; PLANNER_CAPACITY.values()];

/// The bytes that a board's planner needs beside [`PlannerNumbers`].
pub type PlannerBytes = [u8; PLANNER_CAPACITY.indices()];

/// The operations that a board's planner may spend in one [`poll`](Onboard::poll): less than 2 x
/// 10^6 instructions of a Cortex-M7 together with the last step, which may exceed it.
pub const PLANNER_OPERATIONS_PER_POLL: u64 = 100_000;

/// The operations that a board's planner spends in all: on the first plan before take-off, on a new
/// plan after a change, and in each slot on correcting the plan for the vehicle's position.
const PLANNER_OPERATIONS: OperationsInFlight = OperationsInFlight {
    first_plan: 120_000_000,
    per_change: 25_000_000,
    per_correction: 10_000_000,
};

/// Creates the planner of a board, in `place`. It has the straight line as its plan, and improves it
/// in the [polls](Onboard::poll) before take-off.
///
/// # Errors
/// Returns an error if the mission exceeds [`PLANNER_CAPACITY`], or if the memory is too small.
pub fn board_planner<'p, S: Memory<f32>>(
    place: &'p mut Option<BoardPlanner<S>>,
    mission: &BoardMission,
    memory: S,
) -> Result<&'p mut BoardPlanner<S>, PlannerError> {
    let planner = Planner::new_in(place, mission, PLANNER_CAPACITY, memory)?;
    planner.set_operations_in_flight(&PLANNER_OPERATIONS);
    Ok(planner)
}

/// Returns the settings of a board's slot cycle.
fn board_settings() -> OnboardSettings {
    OnboardSettings {
        planning_operations: PLANNER_OPERATIONS_PER_POLL,
        ..OnboardSettings::default()
    }
}

/// A trained policy of a board.
pub trait TrainedPolicy: Policy<f32, USERS_MAX> {
    /// Returns the origin of a policy that was trained for one mission, or `None` for a policy for
    /// any mission.
    fn provenance(&self) -> Option<&Provenance>;
}

impl<B: AsRef<[u8]>> TrainedPolicy for Mlp<B> {
    fn provenance(&self) -> Option<&Provenance> {
        Some(self.provenance())
    }
}

/// The policy must have been created for the mission of the order.
impl<N: EvaluateSets> TrainedPolicy for SetsPolicy<f32, N, USERS_MAX, SENSORS_MAX> {
    fn provenance(&self) -> Option<&Provenance> {
        None
    }
}

impl<R: TrainedPolicy + ?Sized> TrainedPolicy for &mut R {
    fn provenance(&self) -> Option<&Provenance> {
        (**self).provenance()
    }
}

/// The policies of a board.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)] // no allocator
pub enum BoardPolicy<R, P> {
    /// The trained policy in flash, or a reference to it.
    Trained(R),
    /// The rule-based policy.
    StraightLine(StraightLine<f32, USERS_MAX>),
    /// The planner, or a reference to it: see [`board_planner`].
    Plan(P),
}

impl<R: TrainedPolicy, P: Policy<f32, USERS_MAX>> BoardPolicy<R, P> {
    /// Returns the digest of the mission that the policy was trained for, or `None` if it was not
    /// trained or is for any mission.
    pub fn scenario_digest(&self) -> Option<&String<64>> {
        match self {
            Self::Trained(policy) => Some(&policy.provenance()?.scenario_digest),
            Self::StraightLine(_) | Self::Plan(_) => None,
        }
    }

    fn chosen(&self) -> &dyn Policy<f32, USERS_MAX> {
        match self {
            Self::Trained(policy) => policy,
            Self::StraightLine(policy) => policy,
            Self::Plan(planner) => planner,
        }
    }

    fn chosen_mut(&mut self) -> &mut dyn Policy<f32, USERS_MAX> {
        match self {
            Self::Trained(policy) => policy,
            Self::StraightLine(policy) => policy,
            Self::Plan(planner) => planner,
        }
    }
}

impl<R: TrainedPolicy, P: Policy<f32, USERS_MAX>> Policy<f32, USERS_MAX> for BoardPolicy<R, P> {
    fn decide(&mut self, observation: &Observation<'_, f32>) -> Action<f32, USERS_MAX> {
        self.chosen_mut().decide(observation)
    }

    fn revise(&mut self, change: &MissionChange<f32>, slots_begun: u32) {
        self.chosen_mut().revise(change, slots_begun);
    }

    fn note_gains(&mut self, measured: &MeasuredGains<'_, f32>) {
        self.chosen_mut().note_gains(measured);
    }

    fn improve(&mut self, operations: u64) {
        self.chosen_mut().improve(operations);
    }

    fn quality(&self) -> Option<PlanQuality> {
        self.chosen().quality()
    }
}

/// Returns the report of a board whose order was accepted.
pub fn ready<R: TrainedPolicy, P: Policy<f32, USERS_MAX>>(
    computer: &BoardComputer<R, P>,
) -> BoardReport {
    let policy = computer.controller().policy();
    BoardReport::Ready {
        scenario_digest: policy.scenario_digest().cloned(),
    }
}

impl MissionOrder {
    /// Returns the settings of the autopilot client.
    fn flight(&self) -> AutopilotSettings<f32> {
        let p = &self.mission;
        AutopilotSettings {
            limits: self.limits,
            geofence: self.geofence,
            watch: Watch {
                ground: self.ground_patience,
                ..Watch::default()
            },
            preflight: Preflight::of(p),
            ..AutopilotSettings::new(self.map_origin, p.start, p.altitude_m, p.max_speed_mps)
        }
    }

    /// Checks mission and autopilot settings, all that may be refused beside the policy, and returns
    /// the mission, for which a [`board_planner`] can then be created.
    ///
    /// # Errors
    /// Returns an error if the mission or the autopilot settings are invalid.
    pub fn check(&self) -> Result<BoardMission, OrderError> {
        self.flight().check()?;
        Ok(BoardMission::new(self.mission.clone())?)
    }

    /// Creates the policy of this order.
    fn policy<R: TrainedPolicy, P>(
        &self,
        mission: &BoardMission,
        trained: Option<R>,
        planner: Option<P>,
    ) -> Result<BoardPolicy<R, P>, OrderError> {
        Ok(match self.policy_kind {
            PolicyKind::Trained => {
                let trained = trained.ok_or(OrderError::NoPolicy)?;
                if let Some(provenance) = trained.provenance() {
                    provenance.check(mission)?;
                }
                BoardPolicy::Trained(trained)
            }
            PolicyKind::StraightLine => BoardPolicy::StraightLine(StraightLine::new(mission)),
            PolicyKind::Plan => BoardPolicy::Plan(planner.ok_or(OrderError::NoPlanner)?),
        })
    }

    /// Creates the onboard computer that flies this order once it is [launched](Self::launch).
    /// `trained` is the policy in the flash of the board, if it has one, which is used where the
    /// order asks for [`PolicyKind::Trained`], and `planner` its planner, which is used where the
    /// order asks for [`PolicyKind::Plan`]. The planner, and a policy for any mission, must have been
    /// created for the mission of this order.
    ///
    /// # Errors
    /// Returns an error if the mission is invalid, if there is no such policy, if the policy is for
    /// another mission, or if the autopilot settings are invalid.
    pub fn build<R: TrainedPolicy, P: Policy<f32, USERS_MAX>>(
        &self,
        trained: Option<R>,
        planner: Option<P>,
    ) -> Result<BoardComputer<R, P>, OrderError> {
        let mission = BoardMission::new(self.mission.clone())?;
        let policy = self.policy(&mission, trained, planner)?;
        let autopilot = Autopilot::new(self.flight())?;
        let controller = Controller::new(mission, policy);
        let mut computer = Onboard::new(board_settings(), controller, autopilot);
        self.authenticate(&mut computer);
        Ok(computer)
    }

    /// As [`build`](Self::build), for a computer that stays in this memory: see [`Onboard::new_in`].
    /// The memory is taken unless the order is refused, so that another can be flown.
    ///
    /// # Errors
    /// As [`build`](Self::build), and if the memory is in use.
    pub fn build_in<'p, R: TrainedPolicy, P: Policy<f32, USERS_MAX>>(
        &self,
        memory: &mut Option<&'p mut MaybeUninit<BoardComputer<R, P>>>,
        trained: Option<R>,
        planner: Option<P>,
    ) -> Result<&'p mut BoardComputer<R, P>, OrderError> {
        let mission = BoardMission::new(self.mission.clone())?;
        let policy = self.policy(&mission, trained, planner)?;
        let flight = self.flight();
        flight.check()?;
        let place = memory.take().ok_or(OrderError::MemoryInUse)?;
        let parts = (policy, ExactSolver);
        let computer = Onboard::new_in(place, board_settings(), mission, parts, flight)?;
        self.authenticate(computer);
        Ok(computer)
    }

    fn authenticate<R: TrainedPolicy, P: Policy<f32, USERS_MAX>>(
        &self,
        computer: &mut BoardComputer<R, P>,
    ) {
        if let Some(credentials) = &self.ground_link {
            computer.authenticate_ground(credentials.clone());
        }
    }

    /// Launches the computer that was [built](Self::build) for this order, with the order's MAVLink
    /// key. This is not a part of `build`, so that the stack does not hold the computer twice.
    pub fn launch<R: TrainedPolicy, P: Policy<f32, USERS_MAX>>(
        &self,
        computer: &mut BoardComputer<R, P>,
        now: Instant,
    ) {
        if let Some(ordered) = &self.mavlink_key {
            computer.sign_with(ordered.clone().into());
        }
        computer.launch(now);
    }
}

//! The computer of a board, in this process: the same precision and the same steps as the image.

use std::{io, sync::Arc};

use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    autopilot::{Phase, wire::signing::SigningState},
    console::{
        BoardComputer, BoardPlanner, MissionOrder, OrderError, PLANNER_CAPACITY, PolicyKind,
        TrainedPolicy, board_planner,
    },
    mission::MissionChange,
    onboard::Stage,
    policy::{
        Action, MeasuredGains, Observation, PlanQuality, Policy, Provenance, format_version,
        mlp::Mlp,
        sets::{self, NetworkWithWork, SetsNetwork, SetsPolicy, SetsWork},
    },
    time::Instant,
};

use super::{ComputerState, Notice, OnboardComputer, Round, RoundInput};
use crate::flight::{outcome::FlightError, reason, stopwatch::Stopwatch};

/// The planner of a board, with memory from the heap.
type TwinPlanner = BoardPlanner<(Vec<f32>, Vec<u8>)>;

/// The policy for any mission of a board, with memory from the heap.
type TwinSetsPolicy =
    SetsPolicy<f32, NetworkWithWork<Arc<[u8]>, Box<SetsWork>>, USERS_MAX, SENSORS_MAX>;

/// The trained policy of a board.
#[derive(Debug)]
enum TwinTrained {
    /// For one mission.
    OneMission(Box<Mlp<Arc<[u8]>>>),
    /// For any mission.
    AnyMission(Box<TwinSetsPolicy>),
}

impl TwinTrained {
    /// Loads the policy of a board for the mission of an order.
    fn load(file: Arc<[u8]>, order: &MissionOrder) -> Result<Self, String> {
        let version = format_version(&file).map_err(|error| error.to_string())?;
        if version != sets::FORMAT_VERSION {
            // Other versions are refused there.
            let policy = Mlp::load(file).map_err(|error| error.to_string())?;
            return Ok(Self::OneMission(Box::new(policy)));
        }
        let mut work = Box::<SetsWork>::default();
        let network = SetsNetwork::load(file, &mut work).map_err(|error| error.to_string())?;
        let mission = order.check().map_err(|refusal| refusal.to_string())?;
        let policy = SetsPolicy::new(NetworkWithWork { network, work }, &mission);
        let policy = policy.map_err(|refusal| refusal.to_string())?;
        Ok(Self::AnyMission(Box::new(policy)))
    }

    fn chosen(&self) -> &dyn Policy<f32, USERS_MAX> {
        match self {
            Self::OneMission(policy) => &**policy,
            Self::AnyMission(policy) => &**policy,
        }
    }

    fn chosen_mut(&mut self) -> &mut dyn Policy<f32, USERS_MAX> {
        match self {
            Self::OneMission(policy) => &mut **policy,
            Self::AnyMission(policy) => &mut **policy,
        }
    }
}

impl Policy<f32, USERS_MAX> for TwinTrained {
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

impl TrainedPolicy for TwinTrained {
    fn provenance(&self) -> Option<&Provenance> {
        match self {
            Self::OneMission(policy) => Some(Mlp::provenance(policy)),
            Self::AnyMission(_) => None,
        }
    }
}

/// The computer of a board, in this process.
#[derive(Debug)]
pub struct Twin {
    computer: Box<BoardComputer<TwinTrained, TwinPlanner>>,
    stop_asked: bool,
    /// The reason why the mission was aborted, as it was known then.
    aborted_because: Option<String>,
}

impl Twin {
    /// Creates a twin that behaves like the image with this policy in its flash memory.
    ///
    /// # Errors
    /// Returns the reason if the order is refused, in words.
    pub fn new(order: &MissionOrder, policy: Option<Arc<[u8]>>) -> Result<Self, String> {
        let trained = policy.map(|file| TwinTrained::load(file, order));
        let trained = trained.transpose()?;
        let planner = match order.policy_kind {
            PolicyKind::Plan => Some(planner(order).map_err(|refusal| refusal.to_string())?),
            PolicyKind::Trained | PolicyKind::StraightLine => None,
        };
        let computer = order.build(trained, planner);
        let mut computer = computer.map_err(|refusal| refusal.to_string())?;
        order.launch(&mut computer, Instant::ZERO);
        Ok(Self {
            computer: Box::new(computer),
            stop_asked: false,
            aborted_because: None,
        })
    }
}

/// Creates the planner for an order.
fn planner(order: &MissionOrder) -> Result<TwinPlanner, OrderError> {
    let numbers = vec![0.0; PLANNER_CAPACITY.values()];
    let bytes = vec![0; PLANNER_CAPACITY.indices()];
    let mut place = None;
    board_planner(&mut place, &order.check()?, (numbers, bytes))?;
    place.ok_or(OrderError::NoPlanner)
}

impl OnboardComputer for Twin {
    type Precision = f32;

    fn round(&mut self, input: &RoundInput<'_>) -> Result<Round, FlightError> {
        let now = input.now;
        let computer = &mut *self.computer;
        computer.receive_ground(now, input.from_ground);
        for frame in input.from_vehicle {
            computer.receive_mavlink(now, frame, false);
        }
        if std::mem::take(&mut self.stop_asked) {
            computer.autopilot_mut().stop(now);
        }
        let mut stopwatch = Stopwatch::default();
        computer.poll(now, &mut stopwatch);
        let mut round = Round::default();
        round.take_frames(now, computer);
        (round.plan_us, round.allocate_us) = stopwatch.totals_us();
        if computer.stage() == Stage::Aborted && self.aborted_because.is_none() {
            let client = computer.autopilot();
            let cause = client.fault().map(|cause| cause.to_string());
            let refusal = client.refusal().map(|refusal| refusal.to_string());
            let reason = reason::first(computer.fault(), refusal.or(cause));
            self.aborted_because = Some(reason.unwrap_or_else(|| client.phase().to_string()));
        }
        Ok(round)
    }

    fn state(&self) -> ComputerState {
        let client = self.computer.autopilot();
        let place = client.position();
        ComputerState::of_board(
            self.computer.stage(),
            client.phase(),
            place.map(|sample| (sample.position, sample.altitude_m)),
        )
    }

    fn take_notice(&mut self, _: Instant) -> Option<Notice> {
        let event = self.computer.autopilot_mut().take_next_event()?;
        Some(Notice::of_board(event.to_string()))
    }

    fn stop(&mut self, _: Instant) -> io::Result<Option<&'static str>> {
        self.stop_asked = true;
        let is_flying = self.computer.autopilot().phase() != Phase::Connecting;
        Ok(is_flying.then_some("landing"))
    }

    fn signing_state(&mut self) -> io::Result<Option<SigningState>> {
        Ok(self.computer.signing_state())
    }

    fn aborted_because(&self) -> Option<String> {
        self.aborted_because.clone()
    }

    fn scenario_digest(&self) -> Option<&str> {
        let policy = self.computer.controller().policy();
        policy.scenario_digest().map(|digest| digest.as_str())
    }
}

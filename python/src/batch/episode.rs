//! An episode of a batch, and the environments that a thread steps episodes with.

use environment::{Action, Environment, EpisodeState, Step, UserSet};
use pyo3::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::{
    action::{EpisodeAction, Wanted},
    observation::{ObservationKind, Rows},
};
use crate::mission::value_error;

/// What happens after the last slot of an episode, as in Gymnasium's `AutoresetMode`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Autoreset {
    /// The next step starts a new episode, and its action is ignored.
    NextStep,
    /// The last step starts a new episode, and returns its first observation.
    SameStep,
    /// The caller resets.
    Disabled,
}

impl Autoreset {
    pub(super) fn named(name: &str) -> PyResult<Self> {
        match name {
            "NextStep" => Ok(Self::NextStep),
            "SameStep" => Ok(Self::SameStep),
            "Disabled" => Ok(Self::Disabled),
            _ => Err(value_error(format!(
                "autoreset_mode is {name:?}, but must be NextStep, SameStep or Disabled"
            ))),
        }
    }
}

/// How an episode ended.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Summary {
    pub(super) episode: environment::Episode,
    /// The number of slots in which the shield changed the displacement or the user.
    pub(super) interventions: u32,
    /// The index of the mission.
    pub(super) mission: usize,
}

/// An episode.
#[derive(Debug)]
pub(super) struct Episode {
    pub(super) mission: usize,
    /// The user that was served last.
    pub(super) served: usize,
    /// The last episode that ended.
    pub(super) last: Summary,
    state: EpisodeState<f64>,
    is_over: bool,
    interventions: u32,
    random: Pcg64Mcg,
}

impl Episode {
    pub(super) fn new(environment: &Environment<f64>, seed: u64) -> Self {
        Self {
            mission: 0,
            served: 0,
            last: Summary::default(),
            state: EpisodeState::start(environment.mission()),
            is_over: false,
            interventions: 0,
            random: Pcg64Mcg::seed_from_u64(seed),
        }
    }

    /// Restarts the choice of missions.
    pub(super) fn seed(&mut self, seed: u64) {
        self.random = Pcg64Mcg::seed_from_u64(seed);
    }

    /// Starts a new episode, of one of the missions.
    pub(super) fn start(&mut self, missions: &[Environment<f64>]) {
        if missions.len() > 1 {
            self.mission = self.random.random_range(0..missions.len());
        }
        self.state = EpisodeState::start(missions[self.mission].mission());
        self.is_over = false;
        self.interventions = 0;
    }

    pub(super) fn is_over(&self) -> bool {
        self.is_over
    }

    pub(super) fn slots_done(&self) -> i64 {
        self.state.slots_done().into()
    }

    pub(super) fn position_m(&self) -> [f64; 2] {
        self.state.position().coords.into()
    }

    /// Flies a slot.
    pub(super) fn step(&mut self, worker: &mut Stepped, action: &EpisodeAction<'_>) -> Step {
        let (environment, flown) = worker;
        environment.swap_state(&mut self.state);
        let (user, changed) = match action.wanted {
            Wanted::Scores(scores) => {
                let users = environment.mission().user_count();
                environment.choose_user(&scores[..users.min(scores.len())])
            }
            Wanted::User(user) => {
                let admissible = environment.admissible();
                match admissible >> user & 1 {
                    1 => (user, false),
                    _ => (admissible.trailing_zeros() as usize, true),
                }
            }
        };
        flown.user = user;
        flown.components.copy_from_slice(&action.displacement);
        let mut step = environment.step(flown);
        environment.swap_state(&mut self.state);
        step.intervention.user |= changed;
        self.served = user;
        self.interventions += u32::from(step.intervention.any());
        if step.last {
            self.is_over = true;
            self.last = Summary {
                episode: *self.state.episode(),
                interventions: self.interventions,
                mission: self.mission,
            };
        }
        step
    }

    /// Writes the observation.
    pub(super) fn observe(&mut self, worker: &mut Stepped, kind: ObservationKind, row: Rows<'_>) {
        let (environment, _) = worker;
        environment.swap_state(&mut self.state);
        kind.write(environment, row);
        environment.swap_state(&mut self.state);
    }

    /// Returns the users that may be served in the coming slot.
    pub(super) fn admissible(&mut self, worker: &mut Stepped) -> UserSet {
        let (environment, _) = worker;
        environment.swap_state(&mut self.state);
        let admissible = environment.admissible();
        environment.swap_state(&mut self.state);
        admissible
    }
}

/// The environment of a mission, and memory for an action.
type Stepped = (Environment<f64>, Action);

/// The environments of a thread.
#[derive(Debug)]
pub(super) struct Worker {
    /// By mission, made when they are first stepped.
    environments: Vec<Option<Box<Stepped>>>,
}

impl Worker {
    pub(super) fn new(missions: usize) -> Self {
        Self {
            environments: (0..missions).map(|_| None).collect(),
        }
    }

    /// Returns the environment of a mission, and memory for an action.
    pub(super) fn environment(
        &mut self,
        missions: &[Environment<f64>],
        mission: usize,
    ) -> &mut Stepped {
        self.environments[mission].get_or_insert_with(|| {
            let action = Action {
                components: vec![0.0; 2],
                user: 0,
            };
            Box::new((missions[mission].clone(), action))
        })
    }
}

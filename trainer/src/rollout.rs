//! Alg. 2's loop over the slots of an episode: act, store transitions, learn.

use environment::{Action, Dimensions, Environment, StepResult, UserSet};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use crate::{
    checkpoint::TrainingProgress,
    learner::{Learner, States},
    metrics::LossMeans,
    nn::padded,
    replay::{Replay, Transition, scatter},
};

/// A loss that is NaN or exceeds
/// [`TrainingSettings::loss_limit`](crate::settings::TrainingSettings::loss_limit).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Divergence {
    /// The name of the loss.
    pub(crate) name: &'static str,
    /// Its value.
    pub(crate) value: f32,
}

/// The environments that are stepped together, with the buffers for their states and actions.
#[derive(Debug)]
pub(crate) struct Rollout {
    environments: Vec<Environment<f64>>,
    states: States,
    actions: Vec<Action>,
    /// `s_n` and `s_{n+1}` of every environment.
    observations: [Vec<Vec<f32>>; 2],
}

impl Rollout {
    /// Creates `count` copies of an environment.
    pub(crate) fn new(environment: Environment<f64>, count: usize) -> Self {
        let Dimensions { observation, .. } = environment.dimensions();
        let rows = || vec![vec![0.0; observation]; count];
        Self {
            environments: vec![environment; count],
            states: States {
                len: count,
                width: padded(count),
                observation: vec![0.0; observation * padded(count)],
                admissible: vec![u64::MAX; padded(count)],
            },
            actions: vec![Action::default(); count],
            observations: [rows(), rows()],
        }
    }

    /// Returns the environments.
    pub(crate) fn environments(&self) -> &[Environment<f64>] {
        &self.environments
    }

    /// Flies one episode in every environment, with the gradient steps after every slot. Returns
    /// the mean losses, or the first loss that diverged.
    pub(crate) fn fly_episodes<L: Learner>(
        &mut self,
        learner: &mut L,
        replay: &mut Replay,
        progress: &mut TrainingProgress,
    ) -> Result<LossMeans, Divergence> {
        let TrainingProgress {
            settings,
            rng,
            global_step,
            ..
        } = progress;
        let mission = self.environments[0].mission();
        let (users, slots) = (mission.user_count(), mission.slots());
        let mut losses = LossMeans::default();
        let [now, next] = &mut self.observations;
        for (environment, state) in self.environments.iter_mut().zip(now.iter_mut()) {
            environment.reset();
            environment.observe(state);
        }
        for _ in 0..slots {
            let states = &mut self.states;
            for (s, environment) in self.environments.iter().enumerate() {
                scatter(&now[s], &mut states.observation, states.width, s);
                states.admissible[s] = environment.admissible();
            }
            if *global_step < settings.warmup_slots {
                for (s, action) in self.actions.iter_mut().enumerate() {
                    L::randomize(users, states.admissible[s], rng, action);
                }
            } else {
                learner.explore(states, rng, &mut self.actions);
            }
            for (s, environment) in self.environments.iter_mut().enumerate() {
                let (admissible, mask) = (states.admissible[s], environment.entropy_mask());
                let mut store = |action: &Action, next: &[f32], result: StepResult| {
                    replay.push(Transition {
                        observation: &now[s],
                        action: &action.components,
                        user: action.user as u8,
                        reward: result.step.reward.total as f32,
                        next_observation: next,
                        last: result.step.last,
                        admissible,
                        next_admissible: result.admissible,
                        entropy_mask: [mask, result.entropy_mask],
                    });
                };
                let action = &self.actions[s];
                let mut others = admissible & !(1 << action.user);
                for _ in 0..settings.alternative_users {
                    let Some(user) = remove_random(&mut others, rng) else {
                        break;
                    };
                    let components = action.components.clone();
                    let other = Action { components, user };
                    let result = environment.peek_step(&other, &mut next[s]);
                    store(&other, &next[s], result);
                }
                let result = environment.advance(action, &mut next[s]);
                store(action, &next[s], result);
                *global_step += 1;
            }
            std::mem::swap(now, next);
            if *global_step > settings.warmup_slots {
                let steps = settings.gradient_steps_per_slot as usize * settings.environments;
                for _ in 0..steps {
                    learner.learn(replay, rng);
                    let report = learner.losses();
                    losses.add(report);
                    let limit = settings.loss_limit;
                    let fault = report.iter().find(|(_, x)| x.is_nan() || x.abs() > limit);
                    if let Some(&(name, value)) = fault {
                        return Err(Divergence { name, value });
                    }
                }
            }
        }
        Ok(losses)
    }
}

/// Removes a uniformly random user from a set and returns it; returns `None` if the set is empty.
fn remove_random(set: &mut UserSet, rng: &mut Pcg64Mcg) -> Option<usize> {
    let count = set.count_ones();
    if count == 0 {
        return None;
    }
    let mut rest = *set;
    for _ in 0..rng.random_range(0..count) {
        rest &= rest - 1;
    }
    let user = rest.trailing_zeros() as usize;
    *set &= !(1 << user);
    Some(user)
}

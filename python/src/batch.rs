//! Many episodes that are stepped together: what both Gymnasium environments are made of.
//!
//! Python passes the arrays that results are written to, so nothing is copied. The episodes are
//! divided among threads; each thread has one environment per mission, whose state it exchanges for
//! that of each episode in turn, so that an episode costs a few hundred bytes. The numbers do not
//! depend on the number of threads.

mod action;
mod episode;
mod observation;
mod output;

use environment::{Allocation, Constraints, Environment, EnvironmentSettings};
use firmware_core::USERS_MAX;
use numpy::{PyArray1, PyArrayDyn, ToPyArray};
use pyo3::{
    prelude::*,
    types::{PyDict, PyList},
};
use rayon::prelude::*;

use crate::{
    arrays::{readable, rows, writable},
    mission::{Mission, value_error},
    threads,
};
use action::{ActionKind, Actions};
use episode::{Autoreset, Episode, Summary, Worker};
use observation::ObservationKind;
use output::{FLAGS, Outputs, TERMS};

/// The largest number of episodes in a batch.
const EPISODES_MAX: usize = 1 << 20;
/// The largest number of missions in a batch.
const MISSIONS_MAX: usize = 100_000;

/// Episodes that are stepped together.
#[pyclass(module = "aircomp_uav._native")]
#[derive(Debug)]
pub(crate) struct Batch {
    /// An environment of each mission, at its start.
    missions: Vec<Environment<f64>>,
    episodes: Vec<Episode>,
    workers: Vec<Worker>,
    observation: ObservationKind,
    actions: ActionKind,
    /// The displacements of discrete actions.
    directions: Vec<[f32; 2]>,
    autoreset: Autoreset,
    threads: usize,
    /// The length of the lists of users in actions and masks.
    users: usize,
}

/// The arrays that observations are written to: a list, because memory for a sequence would be
/// reserved for as many items as it claims to have.
type FloatArrays<'py> = Bound<'py, PyList>;

#[pymethods]
impl Batch {
    #[new]
    #[pyo3(signature = (
        missions, count, *, observation, normalize, action, directions, autoreset, constraints,
        inner, rate_weight, trajectory_weight, arrival_reward, threads = None
    ))]
    #[expect(clippy::too_many_arguments, reason = "they have names")]
    fn new(
        missions: &Bound<'_, PyList>,
        count: usize,
        observation: &str,
        normalize: bool,
        action: &str,
        directions: usize,
        autoreset: &str,
        constraints: &str,
        inner: &str,
        rate_weight: f32,
        trajectory_weight: f32,
        arrival_reward: f32,
        threads: Option<usize>,
    ) -> PyResult<Self> {
        let missions: Vec<Bound<'_, Mission>> = missions
            .iter()
            .map(|mission| Ok(mission.cast_into()?))
            .collect::<PyResult<_>>()?;
        let missions: Vec<&Mission> = missions.iter().map(Bound::get).collect();
        if !(1..=EPISODES_MAX).contains(&count) {
            return Err(value_error(format!(
                "num_envs is {count}, but must be 1 to {EPISODES_MAX}"
            )));
        }
        if !(1..=MISSIONS_MAX).contains(&missions.len()) {
            return Err(value_error(format!(
                "there are {} missions, but must be 1 to {MISSIONS_MAX}",
                missions.len()
            )));
        }
        let weights = [rate_weight, trajectory_weight, arrival_reward];
        let names = ["rate_weight", "trajectory_weight", "arrival_reward"];
        for (name, weight) in names.into_iter().zip(weights) {
            if !weight.is_finite() {
                return Err(value_error(format!(
                    "{name} is {weight}, but must be finite"
                )));
            }
        }
        let constraints = match constraints {
            "shielded" => Constraints::Shielded,
            "penalty" => Constraints::Penalty,
            _ => {
                return Err(value_error(format!(
                    "constraints is {constraints:?}, but must be shielded or penalty"
                )));
            }
        };
        let allocation: Allocation = inner
            .parse()
            .map_err(|problem| value_error(format!("inner is {inner:?}: {problem}")))?;
        let settings = EnvironmentSettings {
            rate_weight,
            trajectory_weight,
            arrival_reward,
            allocation,
            constraints,
            entropy_when_forced: true,
        };
        let observation = ObservationKind::named(observation, normalize)?;
        let mut users = USERS_MAX;
        if observation.is_of_one_size() {
            users = missions[0].mission().user_count();
            if let Some(other) = missions
                .iter()
                .find(|other| other.mission().user_count() != users)
            {
                return Err(value_error(format!(
                    "the missions have {users} and {} users; observation \"paper\" needs as many in \
                     each, \"sets\" and \"flat\" do not",
                    other.mission().user_count()
                )));
            }
        }
        let mut environments = Vec::with_capacity(missions.len());
        for mission in missions {
            let mission = mission.mission();
            allocation.check(mission).map_err(value_error)?;
            environments.push(Environment::new(mission.clone(), &settings));
        }
        let actions = ActionKind::named(action, directions)?;
        let first = &environments[0];
        let episodes = (0..count).map(|index| Episode::new(first, index as u64));
        Ok(Self {
            episodes: episodes.collect(),
            workers: Vec::new(),
            missions: environments,
            observation,
            directions: action::directions(actions),
            actions,
            autoreset: Autoreset::named(autoreset)?,
            threads: threads::count(threads),
            users,
        })
    }

    /// The number of episodes.
    #[getter]
    fn count(&self) -> usize {
        self.episodes.len()
    }

    /// The length of the lists of users in actions and masks.
    #[getter]
    fn users(&self) -> usize {
        self.users
    }

    /// The shapes of one episode's observation: of its only array, or of those of `sets`.
    #[getter]
    fn observation_shapes(&self) -> Vec<Vec<usize>> {
        self.observation.shapes(self.users)
    }

    /// The length of one action mask.
    #[getter]
    fn mask_length(&self) -> usize {
        self.actions.mask_length(self.users)
    }

    /// Starts new episodes, all of them or those that `mask` names, and writes their observations.
    /// `seeds`, one per episode, restart the choice of missions.
    #[pyo3(signature = (observation, mask = None, seeds = None))]
    fn reset<'py>(
        &mut self,
        py: Python<'py>,
        observation: FloatArrays<'py>,
        mask: Option<Bound<'py, PyArrayDyn<bool>>>,
        seeds: Option<Bound<'py, PyArrayDyn<u64>>>,
    ) -> PyResult<()> {
        let count = self.episodes.len();
        let mask = mask
            .map(|mask| readable("mask", &mask, &[count]))
            .transpose()?;
        let mask = mask.as_ref().map(|mask| mask.as_slice()).transpose()?;
        let seeds = seeds
            .map(|seeds| readable("seeds", &seeds, &[count]))
            .transpose()?;
        let seeds = seeds.as_ref().map(|seeds| seeds.as_slice()).transpose()?;
        let mut arrays = self.observation_arrays(&observation)?;
        let mut rows = observation::Rows::new(&mut arrays)?;
        Self::prepare(&mut self.workers, self.missions.len(), 1);
        let (missions, workers) = (&self.missions, &mut self.workers);
        let kind = self.observation;
        let episodes = &mut self.episodes;
        py.detach(move || {
            for (index, episode) in episodes.iter_mut().enumerate() {
                let row = rows.split_off(1);
                if mask.is_some_and(|mask| !mask[index]) {
                    continue;
                }
                if let Some(seeds) = seeds {
                    episode.seed(seeds[index]);
                }
                episode.start(missions);
                let environment = workers[0].environment(missions, episode.mission);
                episode.observe(environment, kind, row);
            }
        });
        Ok(())
    }

    /// Flies a slot in every episode, and returns how many ended. `first` and `second` are the
    /// arrays of the actions: the only one, or displacements and users.
    #[pyo3(signature = (
        first, second, observation, rewards, terminated, terms, flags, users,
        final_observation = None
    ))]
    #[expect(clippy::too_many_arguments, reason = "they are the arrays of a step")]
    fn step<'py>(
        &mut self,
        py: Python<'py>,
        first: &Bound<'py, PyAny>,
        second: Option<&Bound<'py, PyArrayDyn<i64>>>,
        observation: FloatArrays<'py>,
        rewards: &Bound<'py, PyArrayDyn<f64>>,
        terminated: &Bound<'py, PyArrayDyn<bool>>,
        terms: &Bound<'py, PyArrayDyn<f64>>,
        flags: &Bound<'py, PyArrayDyn<bool>>,
        users: &Bound<'py, PyArrayDyn<i64>>,
        final_observation: Option<FloatArrays<'py>>,
    ) -> PyResult<usize> {
        let count = self.episodes.len();
        let given = action::ActionArrays::new(self.actions, count, self.users, first, second)?;
        let actions = given.actions(self.actions, self.users, &self.directions)?;
        if let Some(problem) = actions.problem() {
            return Err(value_error(problem));
        }
        if self.autoreset == Autoreset::Disabled
            && let Some(index) = self.episodes.iter().position(Episode::is_over)
        {
            return Err(value_error(format!(
                "episode {index} is over, and must be reset before the next step"
            )));
        }
        let mut arrays = self.observation_arrays(&observation)?;
        let mut final_arrays = match &final_observation {
            Some(arrays) => self.observation_arrays(arrays)?,
            None if self.autoreset == Autoreset::SameStep => {
                return Err(value_error("final_observation is missing"));
            }
            None => Vec::new(),
        };
        let mut rewards = writable("rewards", rewards, &[count])?;
        let mut terminated = writable("terminated", terminated, &[count])?;
        let mut terms = writable("terms", terms, &[TERMS, count])?;
        let mut flags = writable("flags", flags, &[FLAGS, count])?;
        let mut served = writable("users", users, &[count])?;
        let outputs = Outputs {
            observation: observation::Rows::new(&mut arrays)?,
            final_observation: observation::Rows::new(&mut final_arrays)?,
            rewards: rewards.as_slice_mut()?,
            terminated: terminated.as_slice_mut()?,
            terms: rows(terms.as_slice_mut()?, count),
            flags: rows(flags.as_slice_mut()?, count),
            users: served.as_slice_mut()?,
        };
        let jobs = self.jobs();
        Self::prepare(&mut self.workers, self.missions.len(), jobs);
        let step = Step {
            missions: &self.missions,
            actions,
            autoreset: self.autoreset,
            observation: self.observation,
        };
        let (episodes, workers) = (&mut self.episodes[..], &mut self.workers[..]);
        if jobs == 1 {
            return Ok(if count < self.observation.episodes_per_job() {
                step.run(&mut workers[0], 0, episodes, outputs)
            } else {
                py.detach(|| step.run(&mut workers[0], 0, episodes, outputs))
            });
        }
        let pool = threads::pool(self.threads)?;
        Ok(py.detach(|| {
            let each = count.div_ceil(jobs);
            let mut parts = Vec::with_capacity(jobs);
            let mut outputs = outputs;
            for (episodes, worker) in episodes.chunks_mut(each).zip(workers) {
                let part = outputs.split_off(episodes.len());
                parts.push((parts.len() * each, worker, episodes, part));
            }
            pool.install(|| {
                let parts = parts.into_par_iter();
                let ended = parts.map(|(first, worker, episodes, outputs)| {
                    step.run(worker, first, episodes, outputs)
                });
                ended.sum()
            })
        }))
    }

    /// Writes the admissible actions of every episode.
    fn write_masks(&mut self, masks: &Bound<'_, PyArrayDyn<bool>>) -> PyResult<()> {
        let length = self.actions.mask_length(self.users);
        let mut masks = writable("masks", masks, &[self.episodes.len(), length])?;
        Self::prepare(&mut self.workers, self.missions.len(), 1);
        let rows = masks.as_slice_mut()?.chunks_mut(length);
        for (episode, row) in self.episodes.iter_mut().zip(rows) {
            let environment = self.workers[0].environment(&self.missions, episode.mission);
            let admissible = episode.admissible(environment);
            for (index, entry) in row.iter_mut().enumerate() {
                *entry = admissible >> (index % self.users) & 1 == 1;
            }
        }
        Ok(())
    }

    /// Returns the positions of the vehicles, metres, one after the other.
    fn positions<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let places = self.episodes.iter().flat_map(Episode::position_m);
        places.collect::<Vec<f64>>().to_pyarray(py)
    }

    /// Returns the mission of every episode, as an index.
    fn mission_indices<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        let indices = self.episodes.iter().map(|episode| episode.mission as i64);
        indices.collect::<Vec<i64>>().to_pyarray(py)
    }

    /// Returns the number of slots that are done in every episode.
    fn slots_done<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        let slots = self.episodes.iter().map(Episode::slots_done);
        slots.collect::<Vec<i64>>().to_pyarray(py)
    }

    /// Returns the sums of the last episode that ended, for each.
    fn summaries<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let dict = PyDict::new(py);
        let last = || self.episodes.iter().map(|episode| &episode.last);
        let floats = |value: fn(&Summary) -> f64| last().map(value).collect::<Vec<f64>>();
        let whole = |value: fn(&Summary) -> i64| last().map(value).collect::<Vec<i64>>();
        let truths = |value: fn(&Summary) -> bool| last().map(value).collect::<Vec<bool>>();
        dict.set_item("sum_rate", floats(|s| s.episode.sum_rate).to_pyarray(py))?;
        dict.set_item("return", floats(|s| s.episode.reward).to_pyarray(py))?;
        dict.set_item("arrived", truths(|s| s.episode.arrived).to_pyarray(py))?;
        dict.set_item("fair", truths(|s| s.episode.fair).to_pyarray(py))?;
        let violations = whole(|s| s.episode.mse_violations.into());
        dict.set_item("mse_violations", violations.to_pyarray(py))?;
        let interventions = whole(|s| s.interventions.into());
        dict.set_item("interventions", interventions.to_pyarray(py))?;
        dict.set_item("mission", whole(|s| s.mission as i64).to_pyarray(py))?;
        Ok(dict)
    }
}

/// What is the same for all episodes of a step.
struct Step<'a> {
    missions: &'a [Environment<f64>],
    actions: Actions<'a>,
    autoreset: Autoreset,
    observation: ObservationKind,
}

impl Step<'_> {
    /// Flies a slot in each of these episodes, and returns how many ended. `first` is the index of
    /// the first of them.
    fn run(
        &self,
        worker: &mut Worker,
        first: usize,
        episodes: &mut [Episode],
        mut outputs: Outputs<'_>,
    ) -> usize {
        let mut ended = 0;
        for (index, episode) in episodes.iter_mut().enumerate() {
            let mut output = outputs.split_off(1);
            if self.autoreset == Autoreset::NextStep && episode.is_over() {
                episode.start(self.missions);
                let environment = worker.environment(self.missions, episode.mission);
                episode.observe(environment, self.observation, output.observation);
                output.flags.iter_mut().for_each(|flag| flag[0] = false);
                output.terms.iter_mut().for_each(|term| term[0] = 0.0);
                (output.rewards[0], output.terminated[0], output.users[0]) = (0.0, false, -1);
                continue;
            }
            let action = self.actions.of(first + index);
            let environment = worker.environment(self.missions, episode.mission);
            let step = episode.step(environment, &action);
            output.write(&step, episode.served);
            let observed = match self.autoreset {
                Autoreset::SameStep if step.last => output.final_observation,
                _ => output.observation.split_off(1),
            };
            episode.observe(environment, self.observation, observed);
            ended += usize::from(step.last);
            if step.last && self.autoreset == Autoreset::SameStep {
                episode.start(self.missions);
                let environment = worker.environment(self.missions, episode.mission);
                episode.observe(environment, self.observation, output.observation);
            }
        }
        ended
    }
}

impl Batch {
    /// Returns the number of parts that a step is divided into.
    fn jobs(&self) -> usize {
        let most = self.episodes.len() / self.observation.episodes_per_job();
        match self.threads {
            1 => 1,
            // Parts of different lengths in time even out.
            threads => (4 * threads).min(most).max(1),
        }
    }

    /// Makes so many workers.
    fn prepare(workers: &mut Vec<Worker>, missions: usize, jobs: usize) {
        while workers.len() < jobs {
            workers.push(Worker::new(missions));
        }
    }

    /// Checks the arrays of observations.
    fn observation_arrays<'py>(
        &self,
        arrays: &FloatArrays<'py>,
    ) -> PyResult<Vec<numpy::PyReadwriteArrayDyn<'py, f32>>> {
        let shapes = self.observation.shapes(self.users);
        if arrays.len() != shapes.len() {
            return Err(value_error(format!(
                "there are {} arrays for observations, but must be {}",
                arrays.len(),
                shapes.len()
            )));
        }
        let arrays = arrays.iter().zip(shapes).map(|(array, shape)| {
            let shape: Vec<usize> = std::iter::once(self.episodes.len()).chain(shape).collect();
            writable("observation", array.cast::<PyArrayDyn<f32>>()?, &shape)
        });
        arrays.collect()
    }
}

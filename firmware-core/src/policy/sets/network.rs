// SPDX-License-Identifier: MIT OR Apache-2.0
//! The network: from an observation to a displacement and scores.

use super::{
    architecture::{Architecture, CANDIDATE_OUTPUTS, CANDIDATES, HIDDEN_MAX, WIDTH_MAX},
    attention::{PANELS, attend},
    columns::{SENSORS, USERS},
    error::SetsLoadError,
    features::{
        MISSION_FEATURES, SENSOR_FEATURES, USER_FEATURES, mission_features, sensor_features,
        user_features,
    },
    observation::SetsObservation,
    panel::{LANES, Lanes, Weight, Weights, add, normalize, read_lane, sigmoid, silu, write_lane},
};
use crate::policy::container::{self, Deviation};

/// The factor of the pulls before their softmax.
const PULL_FACTOR: f32 = 3.0;

/// The outputs of a policy for any mission.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetsOutput {
    /// The displacement to the east and north, metres, at most one slot's reach long.
    pub displacement_m: [f32; 2],
    /// A score per row of the observation's users; 0 beyond them.
    pub user_scores: [f32; USERS],
}

impl SetsOutput {
    /// Returns the displacement and the scores.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f32> + Clone {
        self.displacement_m.into_iter().chain(self.user_scores)
    }

    /// Compares the output for an observation with the numbers that a file expects: the displacement,
    /// metres, and a score per user.
    ///
    /// # Errors
    /// Returns the first number that differs by more than rounding.
    pub fn check(
        &self,
        observation: &SetsObservation,
        expected: impl Iterator<Item = f32> + Clone,
    ) -> Result<(), SetsLoadError> {
        match container::deviation(self.numbers(), expected, observation.reach_m()) {
            None => Ok(()),
            Some(Deviation {
                index,
                got,
                expected,
            }) => Err(SetsLoadError::SelfTest {
                index,
                got,
                expected,
            }),
        }
    }
}

/// The memory for evaluating a network of any admissible architecture: 30,720 bytes.
///
/// ```
/// assert_eq!(size_of::<firmware_core::policy::sets::SetsWork>(), 30_720);
/// ```
#[derive(Clone)]
pub struct SetsWork {
    tokens: [[Lanes; WIDTH_MAX]; PANELS],
    keys_values: [[Lanes; 2 * WIDTH_MAX]; PANELS],
    wide: [Lanes; HIDDEN_MAX],
    input: [Lanes; WIDTH_MAX],
    output: [Lanes; WIDTH_MAX],
}

impl Default for SetsWork {
    fn default() -> Self {
        Self::new()
    }
}

impl core::fmt::Debug for SetsWork {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("SetsWork").finish_non_exhaustive()
    }
}

impl AsMut<Self> for SetsWork {
    fn as_mut(&mut self) -> &mut Self {
        self
    }
}

impl SetsWork {
    /// Returns memory that contains zeros. As a constant it is written where it stays, and the stack
    /// does not hold it.
    pub const fn new() -> Self {
        Self {
            tokens: [[[0.0; LANES]; WIDTH_MAX]; PANELS],
            keys_values: [[[0.0; LANES]; 2 * WIDTH_MAX]; PANELS],
            wide: [[0.0; LANES]; HIDDEN_MAX],
            input: [[0.0; LANES]; WIDTH_MAX],
            output: [[0.0; LANES]; WIDTH_MAX],
        }
    }

    /// Evaluates the network. `None` means that the weights are not as many as the architecture
    /// needs.
    pub(super) fn evaluate<W: Weight>(
        &mut self,
        architecture: &Architecture,
        weights: &[W],
        observation: &SetsObservation,
    ) -> Option<SetsOutput> {
        let mut weights = Weights(weights);
        // The tokens of the users come first, then that of the mission.
        let users = observation.user_rows().len();
        let place = (users / LANES, users % LANES);
        let panels = users / LANES + 1;
        self.tokens.as_flattened_mut().fill([0.0; LANES]);
        let size = architecture.size();
        self.pool_sensors(&mut weights, size.width, observation)?;
        self.embed_mission(&mut weights, size.width, observation, place)?;
        self.embed_users(&mut weights, size.width, observation)?;
        for _ in 0..size.layers {
            self.attention_layer(&mut weights, size.width, (panels, users + 1))?;
            self.feed_forward_layer(&mut weights, (size.width, size.hidden), panels)?;
        }
        let scale = weights.take(size.width)?;
        for token in self.tokens.get_mut(..panels)? {
            normalize(scale, token, &mut self.output)?;
            copy(&self.output, token, size.width);
        }
        self.heads(&mut weights, size.width, observation, place)
    }

    /// Computes `[mean_j h_j; max_j h_j]` over the sensors into both halves of the first panel of
    /// keys and values, in its first lane.
    fn pool_sensors<W: Weight>(
        &mut self,
        weights: &mut Weights<'_, W>,
        width: usize,
        observation: &SetsObservation,
    ) -> Option<()> {
        let first = weights.linear(SENSOR_FEATURES, width)?;
        let second = weights.linear(width, width)?;
        let pool = self.keys_values.first_mut()?.get_mut(..2 * width)?;
        let (mean, largest) = pool.split_at_mut_checked(width)?;
        mean.fill([0.0; LANES]);
        largest.fill([f32::NEG_INFINITY; LANES]);
        let sensors = observation.sensor_rows();
        let fraction = 1.0 / sensors.len().max(1) as f32;
        for sensors in sensors.chunks(LANES) {
            for (lane, sensor) in sensors.iter().enumerate() {
                write_lane(&mut self.wide, lane, sensor_features(sensor));
            }
            first.apply(&self.wide, &mut self.input)?;
            silu(self.input.get_mut(..width)?);
            second.apply(&self.input, &mut self.output)?;
            for ((mean, largest), output) in mean.iter_mut().zip(&mut *largest).zip(&self.output) {
                let [mean, ..] = mean;
                let [largest, ..] = largest;
                for &output in output.iter().take(sensors.len()) {
                    *mean += fraction * output;
                    *largest = largest.max(output);
                }
            }
        }
        if sensors.is_empty() {
            largest.fill([0.0; LANES]);
        }
        Some(())
    }

    /// Computes the token of the mission at `place`, a panel and a lane.
    fn embed_mission<W: Weight>(
        &mut self,
        weights: &mut Weights<'_, W>,
        width: usize,
        observation: &SetsObservation,
        (panel, lane): (usize, usize),
    ) -> Option<()> {
        let linear = weights.linear(MISSION_FEATURES + 2 * width, width)?;
        let pool = self.keys_values.first()?.get(..2 * width)?;
        let features = mission_features(&observation.mission);
        let vector = features.into_iter().chain(read_lane(pool, 0));
        write_lane(&mut self.wide, 0, vector);
        linear.apply(&self.wide, &mut self.output)?;
        let output = read_lane(self.output.get(..width)?, 0);
        write_lane(self.tokens.get_mut(panel)?, lane, output);
        Some(())
    }

    /// Computes the tokens of the users.
    fn embed_users<W: Weight>(
        &mut self,
        weights: &mut Weights<'_, W>,
        width: usize,
        observation: &SetsObservation,
    ) -> Option<()> {
        let linear = weights.linear(USER_FEATURES, width)?;
        let rows = observation.user_rows();
        for (users, token) in rows.chunks(LANES).zip(&mut self.tokens) {
            for (lane, user) in users.iter().enumerate() {
                let features = user_features(&observation.mission, user);
                write_lane(&mut self.wide, lane, features);
            }
            linear.apply(&self.wide, &mut self.output)?;
            for lane in 0..users.len() {
                let output = read_lane(self.output.get(..width)?, lane);
                write_lane(token, lane, output);
            }
        }
        Some(())
    }

    fn attention_layer<W: Weight>(
        &mut self,
        weights: &mut Weights<'_, W>,
        width: usize,
        (panels, tokens): (usize, usize),
    ) -> Option<()> {
        let scale = weights.take(width)?;
        let linear = weights.linear(width, 3 * width)?;
        let merge = weights.linear(width, width)?;
        let (query, key_value) = (linear.outputs(0, width)?, linear.outputs(width, 2 * width)?);
        let keys_values = self.keys_values.get_mut(..panels)?;
        for (token, keys_values) in self.tokens.iter().zip(&mut *keys_values) {
            normalize(scale, token, &mut self.input)?;
            key_value.apply(&self.input, keys_values)?;
        }
        for token in self.tokens.get_mut(..panels)? {
            normalize(scale, token, &mut self.input)?;
            query.apply(&self.input, &mut self.output)?;
            attend(&self.output, keys_values, (tokens, width), &mut self.input)?;
            merge.apply(&self.input, &mut self.output)?;
            add(token.get_mut(..width)?, &self.output);
        }
        Some(())
    }

    fn feed_forward_layer<W: Weight>(
        &mut self,
        weights: &mut Weights<'_, W>,
        (width, hidden): (usize, usize),
        panels: usize,
    ) -> Option<()> {
        let scale = weights.take(width)?;
        let first = weights.linear(width, hidden)?;
        let second = weights.linear(hidden, width)?;
        for token in self.tokens.get_mut(..panels)? {
            normalize(scale, token, &mut self.input)?;
            first.apply(&self.input, &mut self.wide)?;
            silu(self.wide.get_mut(..hidden)?);
            second.apply(&self.wide, &mut self.output)?;
            add(token.get_mut(..width)?, &self.output);
        }
        Some(())
    }

    /// Computes the outputs from the tokens; that of the mission is in a lane of a panel.
    fn heads<W: Weight>(
        &mut self,
        weights: &mut Weights<'_, W>,
        width: usize,
        observation: &SetsObservation,
        (panel, lane): (usize, usize),
    ) -> Option<SetsOutput> {
        let first = weights.linear(width, width)?;
        let second = weights.linear(width, CANDIDATE_OUTPUTS * CANDIDATES)?;
        let mission = self.tokens.get(panel)?.get(..width)?;
        first.apply(mission, &mut self.input)?;
        silu(self.input.get_mut(..width)?);
        second.apply(&self.input, &mut self.output)?;
        let mut candidates = [[0.0; CANDIDATE_OUTPUTS]; CANDIDATES];
        let outputs = candidates.as_flattened_mut().iter_mut();
        for (candidate, output) in outputs.zip(read_lane(&self.output, lane)) {
            *candidate = output;
        }
        let (chosen, motion) = choose(candidates);
        let first = weights.linear(2 * width, width)?;
        let second = weights.linear(width, 1 + CANDIDATES)?;
        let [mut user_scores, mut pulls] = [[0.0_f32; USERS]; 2];
        let outputs = user_scores.iter_mut().zip(&mut pulls);
        let mut outputs = outputs.take(observation.user_rows().len());
        for token in &self.tokens {
            let (own, shared) = self.wide.split_at_mut_checked(width)?;
            copy(token, own, width);
            for (shared, entry) in shared.iter_mut().zip(mission) {
                *shared = [entry.get(lane).copied()?; LANES];
            }
            if outputs.len() == 0 {
                break;
            }
            first.apply(&self.wide, &mut self.input)?;
            silu(self.input.get_mut(..width)?);
            second.apply(&self.input, &mut self.output)?;
            let (score, pulls) = self.output.split_first()?;
            let pull = pulls.get(chosen)?;
            for ((score, pull), (user_score, user_pull)) in
                score.iter().zip(pull).zip(outputs.by_ref().take(LANES))
            {
                (*user_score, *user_pull) = (*score, *pull);
            }
        }
        Some(SetsOutput {
            displacement_m: displacement_m(observation, motion, &pulls),
            user_scores,
        })
    }
}

/// Returns the candidate with the largest logit, the first of equals, and its index.
fn choose(candidates: [[f32; CANDIDATE_OUTPUTS]; CANDIDATES]) -> (usize, [f32; CANDIDATE_OUTPUTS]) {
    let [mut best, ..] = candidates;
    let mut chosen = 0;
    for (index, candidate) in candidates.into_iter().enumerate() {
        let ([.., logit], [.., largest]) = (candidate, best);
        if logit > largest {
            (chosen, best) = (index, candidate);
        }
    }
    (chosen, best)
}

/// Returns the displacement, metres: towards a point among the users and towards the destination,
/// as far as two outputs say, and a free part; at most as long as the reach.
fn displacement_m(
    observation: &SetsObservation,
    [free_east, free_north, to_users, to_destination, _]: [f32; CANDIDATE_OUTPUTS],
    pulls: &[f32; USERS],
) -> [f32; 2] {
    let [destination_east_m, destination_north_m, ..] = observation.mission;
    let reach_m = observation.reach_m();
    let users = || observation.user_rows().iter().zip(pulls);
    let largest = users().fold(f32::NEG_INFINITY, |largest, (_, &pull)| largest.max(pull));
    // The sums of weights, and of weights times places.
    let mut sums = [0.0_f32; 3];
    for (&[east_m, north_m, ..], pull) in users() {
        let weight = libm::expf(PULL_FACTOR * (pull - largest));
        for (sum, x) in sums.iter_mut().zip([1.0, east_m, north_m]) {
            *sum += weight * x;
        }
    }
    let [total, east_m, north_m] = sums;
    let total = if total > 0.0 { total } else { 1.0 };
    let (to_users, to_destination) = (sigmoid(to_users), sigmoid(to_destination));
    let part = |users_m: f32, destination_m: f32, free: f32| {
        to_users * (users_m / total) / reach_m + to_destination * destination_m / reach_m + free
    };
    let east = part(east_m, destination_east_m, free_east);
    let north = part(north_m, destination_north_m, free_north);
    let factor = reach_m / libm::sqrtf(east * east + north * north).max(1.0);
    [factor * east, factor * north]
}

fn copy(from: &[Lanes], to: &mut [Lanes], count: usize) {
    for (to, from) in to.iter_mut().zip(from).take(count) {
        *to = *from;
    }
}

// Every input of a linear map fits.
const _: () = assert!(MISSION_FEATURES + 2 * WIDTH_MAX <= HIDDEN_MAX);
const _: () = assert!(USER_FEATURES <= HIDDEN_MAX && SENSORS > 0);

//! Random states of random missions, for comparing evaluations of a network.

use anyhow::anyhow;
use firmware_core::{
    Position,
    inner::Workspace,
    policy::{
        Observation,
        sets::{SetsObservation, SetsOutput},
    },
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use scenario::random;

use super::held_out::FIRST_SEED;

/// Number of states of a mission.
const STATES_PER_MISSION: usize = 20;

/// Calls `visit` with `count` states: vehicles anywhere in the area before any slot, with users that
/// have been served any number of times. The missions are held-out ones; the same seed gives the same
/// states.
///
/// # Errors
/// Returns the error of `visit`, or fails if a mission cannot be drawn.
pub fn random_states(
    count: usize,
    seed: u64,
    mut visit: impl FnMut(&SetsObservation) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut workspace = Workspace::default();
    let mut left = count;
    for mission_seed in FIRST_SEED.. {
        let scenario = random(mission_seed, None).map_err(|error| anyhow!(error))?;
        let mission = scenario.mission;
        let p = mission.parameters();
        for _ in 0..STATES_PER_MISSION {
            if left == 0 {
                return Ok(());
            }
            left -= 1;
            let slot = rng.random_range(1..=mission.slots());
            let mut counts = vec![0; mission.user_count()];
            for _ in 1..slot {
                let user = rng.random_range(0..counts.len());
                counts[user] += 1;
            }
            let east_m = rng.random_range(0.0..p.area.east_m);
            let north_m = rng.random_range(0.0..p.area.north_m);
            let observation = Observation {
                slot,
                counts: &counts,
                position: Position::new(east_m, north_m),
                ..Observation::at_start(&mission)
            };
            visit(&SetsObservation::new(
                &mission,
                &observation,
                &mut workspace,
            ))?;
        }
    }
    Ok(())
}

/// How far two evaluations of a network differ over many states.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Difference {
    /// Of the displacement, in units of the reach.
    displacement: f32,
    /// Of the scores.
    scores: f32,
    /// The largest magnitude of a score.
    largest_score: f32,
}

impl Difference {
    /// Takes the outputs for a state into account. A NaN is no agreement.
    pub fn note(&mut self, got: &SetsOutput, expected: &SetsOutput, reach_m: f32) {
        let worst = |worst: f32, x: f32| match x.is_finite() {
            true => worst.max(x),
            false => f32::INFINITY,
        };
        for (got, expected) in got.displacement_m.iter().zip(&expected.displacement_m) {
            self.displacement = worst(self.displacement, (got - expected).abs() / reach_m);
        }
        for (got, expected) in got.user_scores.iter().zip(&expected.user_scores) {
            self.scores = worst(self.scores, (got - expected).abs());
            self.largest_score = self.largest_score.max(expected.abs());
        }
    }

    /// Returns the largest difference in units of full scale: the reach, and the largest score of all
    /// states, at least 1.
    pub fn of_full_scale(&self) -> f32 {
        self.displacement
            .max(self.scores / self.largest_score.max(1.0))
    }
}

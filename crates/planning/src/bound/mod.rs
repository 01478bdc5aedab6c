//! A certified upper bound on the total rate of any admissible mission, over continuous positions,
//! and a feasible mission close to it (`docs/bound.md` has the proof).
//!
//! * The area is divided into square cells. [`rates`] bounds the rates at any point of a cell.
//! * [`tube`] contains the cells that each slot may end in and finds the best chain of cells by
//!   dynamic programming, with every move that some admissible displacement makes.
//! * Fairness (eq:a3) enters as prices. [`multipliers`] and [`bundle`] find the prices that give
//!   the least bound.
//! * Cells are dropped if the best chain through them is worth less than the best known mission, or
//!   if the vehicle cannot [reach] them. The remaining cells are [split](level) and the set of
//!   missions is [branched](tree), until bound and mission are close ([`certifier`]).
//!
//! The mission is found by [`crate::search`], which starts from the chains. The result is
//! deterministic for any number of threads, because work is bounded by counts and not by a clock.

mod bundle;
mod certifier;
mod disc;
mod error;
mod grid;
mod level;
mod multipliers;
mod rates;
mod reach;
mod settings;
mod table;
mod tree;
mod tube;
mod window;

use std::time::Instant;

use firmware_core::Mission;
use serde::Serialize;

use crate::search::Plan;
use certifier::Certifier;
use error::no_room;
use rates::RateBound;

pub use error::BoundError;
pub use settings::{BoundProgress, BoundSettings};

/// The result of a certification.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bound {
    /// The upper bound: no admissible mission has a larger sum of rates, bit/s/Hz.
    pub upper: f64,
    /// The sum of rates of `plan`, bit/s/Hz.
    pub lower: f64,
    /// `(upper - lower) / upper`, or 0 if the two differ only by rounding.
    pub gap: f64,
    /// The side of the smallest cells, metres.
    pub cell_m: f64,
    /// The number of leaves that the missions were divided into.
    pub leaves: usize,
    /// The fairness prices `lambda_m` over all missions, bit/s/Hz.
    pub multipliers: Vec<f64>,
    /// The time that the certification took, seconds.
    pub seconds: f64,
    /// An admissible mission that reaches `lower`.
    pub plan: Plan,
}

impl Bound {
    /// Returns whether no mission transmits any data, because no position within reach meets
    /// `Gamma`.
    pub fn carries_nothing(&self) -> bool {
        self.lower == 0.0 && self.gap == 0.0
    }
}

/// The work of [`search`], as [`BoundSettings::work_max`].
const SEARCH_WORK: usize = 20_000_000_000;

/// Bounds a mission. Calls `progress` after every step.
///
/// # Errors
/// Returns an error if the mission is too large, if only one path can be flown, or if the gain does
/// not fall with the distance.
pub fn certify<const M: usize, const J: usize>(
    mission: &Mission<f64, M, J>,
    settings: &BoundSettings,
    progress: impl FnMut(&BoundProgress),
) -> Result<Bound, BoundError> {
    certify_until(mission, settings, &|| false, progress)
}

/// Bounds a mission, and returns what is certified when `stop` returns true. It is polled many
/// times per second, by several threads. Even if it is true from the start, the result is a certified
/// bound, without prices, and an admissible mission.
///
/// # Errors
/// Returns the errors of [`certify`].
pub fn certify_until<const M: usize, const J: usize>(
    mission: &Mission<f64, M, J>,
    settings: &BoundSettings,
    stop: &(dyn Fn() -> bool + Sync),
    mut progress: impl FnMut(&BoundProgress),
) -> Result<Bound, BoundError> {
    let started = Instant::now();
    let rate_bound = RateBound::new(mission)?;
    let mut certifier = Certifier::new(mission, settings, &rate_bound, stop);
    certifier.start()?;
    let multipliers = certifier.leaves[0].multipliers.clone();
    progress(&certifier.progress(certifier.leaves[0].level.grid.side_m));
    let cell_m = certifier.divide(&mut progress);
    certifier.polish();
    let (lower, upper, gap) = (certifier.lower(), certifier.upper(), certifier.gap());
    let leaves = certifier.leaves.len();
    let plan = certifier.best.ok_or_else(|| no_room(mission))?;
    Ok(Bound {
        upper,
        lower,
        gap,
        cell_m,
        leaves,
        multipliers,
        seconds: started.elapsed().as_secs_f64(),
        plan,
    })
}

/// Returns the mission that [`certify`] finds at the default settings with a fifth of the work.
/// Calls `progress` after every step.
///
/// # Errors
/// Returns the errors of [`certify`].
pub fn search<const M: usize, const J: usize>(
    mission: &Mission<f64, M, J>,
    progress: impl FnMut(&BoundProgress),
) -> Result<Plan, BoundError> {
    let settings = BoundSettings {
        work_max: SEARCH_WORK,
        ..BoundSettings::default()
    };
    certify(mission, &settings, progress).map(|bound| bound.plan)
}

/// Returns the fairness prices of a mission, bit/s/Hz per user: those that [`certify`] starts with,
/// which give the least bound at cells of a quarter of `V_max delta`. Takes a few seconds of one
/// processor.
///
/// # Errors
/// Returns an error if the mission is too large or if the gain does not fall with the distance.
pub fn fairness_prices<const M: usize, const J: usize>(
    mission: &Mission<f64, M, J>,
) -> Result<Vec<f64>, BoundError> {
    let leaf = Certifier::new(
        mission,
        &BoundSettings::default(),
        &RateBound::new(mission)?,
        &|| false,
    )
    .whole()?;
    Ok(leaf.multipliers)
}

//! A certified upper bound on the total rate of any admissible mission, over continuous positions,
//! and a feasible mission close to it (`docs/bound.md` has the proof).
//!
//! * The area is divided into square cells. [`rates`] bounds the rates at any point of a cell.
//! * [`tube`] contains the cells that each slot may end in and finds the best chain of cells by
//!   dynamic programming, with every move that some admissible displacement makes.
//! * Fairness (eq:a3) enters as prices. [`multipliers`] finds the prices that give the least bound.
//! * Cells are dropped if the best chain through them is worth less than the best known mission.
//!   The remaining cells are [split](level) and the set of missions is [branched](tree), until
//!   bound and mission are close.
//!
//! The mission is found by [`crate::search`], which starts from the chains. The result is
//! deterministic for any number of threads, because work is bounded by counts and not by a clock.

mod grid;
mod level;
mod multipliers;
mod rates;
mod tree;
mod tube;

use std::time::Instant;

use firmware_core::Mission;
use serde::Serialize;

use crate::search::{PathRules, Plan, made_admissible, rearrange, refine};
use grid::Grid;
use level::Level;
use multipliers::Descent;
use rates::{RATE_ROUNDING, RateBound};
use tree::Leaf;

/// When a certification stops.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundSettings {
    /// The gap at which it stops, relative to the upper bound.
    pub gap: f64,
    /// The smallest side to which cells are split, metres.
    pub finest_cell_m: f64,
    /// The largest number of leaves that the missions are divided into.
    pub leaves_max: usize,
    /// The largest number of pairs of slot and cell that one leaf may store. It bounds the memory:
    /// about 10 bytes per pair while the leaf is processed, and 1 byte while it waits.
    pub pairs_max: usize,
    /// The largest number of pairs of slot and cell that are examined after branching. It bounds
    /// the time.
    pub work_max: usize,
}

impl Default for BoundSettings {
    fn default() -> Self {
        Self {
            gap: 0.005,
            finest_cell_m: 0.2,
            leaves_max: 40,
            pairs_max: 40_000_000,
            work_max: 100_000_000,
        }
    }
}

/// The progress of a certification.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundProgress {
    /// The side of the present cells, metres.
    pub cell_m: f64,
    /// The number of leaves that the missions are divided into.
    pub leaves: usize,
    /// The best upper bound so far, bit/s/Hz.
    pub upper: f64,
    /// The value of the best mission so far, bit/s/Hz.
    pub lower: f64,
}

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

/// Error returned when a mission cannot be bounded.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BoundError {
    /// The mission has too many slots, or its area is too large for its speed.
    #[error(
        "the mission has more than {pairs_max} pairs of slot and cell already at cells of \
         {cell_m} m; use fewer slots, a smaller area or a higher speed"
    )]
    TooLarge {
        /// The largest number of pairs that is allowed.
        pairs_max: usize,
        /// The side of the largest cells, metres.
        cell_m: f64,
    },
    /// The mission has more slots than the optimal assignment of users to slots supports.
    #[error(
        "the mission has {slots} slots, but the bound supports at most {max}, because the time to assign users is cubic in the slots"
    )]
    TooManySlots {
        /// The number of slots, `N`.
        slots: u32,
        /// The largest number that is allowed.
        max: u32,
    },
    /// The destination can only be reached on the straight line at full speed, so there is nothing
    /// to plan.
    #[error(
        "the destination is {distance_m} m from the start, and at most {reach_m} m can be flown: \
         only the straight path is possible, so there is nothing to search"
    )]
    StraightPathOnly {
        /// The distance from start to destination, metres.
        distance_m: f64,
        /// The largest distance that can be flown, `(N + 1) V_max delta`, metres.
        reach_m: f64,
    },
}

/// The number of slots above which the assignment, which is cubic in it, would take minutes.
const SLOTS_MAX: u32 = 1000;
/// The depth at which the set of missions is branched: cells of a quarter of `V_max delta`.
const BRANCHING_DEPTH: usize = 1;
/// The relative error that cells of that size cause in the shipped missions. If the bound of a leaf
/// is closer than this to the best mission, splitting its cells is more useful than branching.
const CELL_COST: f64 = 0.006;
/// The spacing down to which a path is refined as a trial, as a fraction of `V_max delta`.
const TRIAL_SPACING: f64 = 0.125;
/// The spacing down to which the best mission is refined, metres.
const FINAL_SPACING_M: f64 = 0.01;

/// Bounds a mission. Calls `progress` after every step.
///
/// # Errors
/// Returns an error if the mission is too large or if only one path can be flown.
pub fn certify<const M: usize, const J: usize>(
    mission: &Mission<f64, M, J>,
    settings: &BoundSettings,
    progress: impl FnMut(&BoundProgress),
) -> Result<Bound, BoundError> {
    let started = Instant::now();
    let rate_bound = RateBound::new(mission);
    let mut certifier = Certifier::new(mission, settings, &rate_bound, progress);
    certifier.start()?;
    let multipliers = certifier.leaves[0].multipliers.clone();
    certifier.part();
    certifier.polish();
    let cell_m = certifier.split();
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

/// Returns the mission that [`certify`] finds at the default settings, without closing the bound.
/// Calls `progress` after every step.
///
/// # Errors
/// Returns the errors of [`certify`].
pub fn search<const M: usize, const J: usize>(
    mission: &Mission<f64, M, J>,
    progress: impl FnMut(&BoundProgress),
) -> Result<Plan, BoundError> {
    let settings = BoundSettings {
        work_max: 0,
        ..BoundSettings::default()
    };
    certify(mission, &settings, progress).map(|bound| bound.plan)
}

/// Returns the fairness prices of a mission, bit/s/Hz per user: those that [`certify`] starts with,
/// which give the least bound at cells of a quarter of `V_max delta`. Takes a few seconds of one
/// processor.
///
/// # Errors
/// Returns an error if the mission is too large.
pub fn fairness_prices<const M: usize, const J: usize>(
    mission: &Mission<f64, M, J>,
) -> Result<Vec<f64>, BoundError> {
    let leaf = Certifier::new(
        mission,
        &BoundSettings::default(),
        &RateBound::new(mission),
        |_| (),
    )
    .whole()?;
    Ok(leaf.multipliers)
}

fn no_room<const M: usize, const J: usize>(mission: &Mission<f64, M, J>) -> BoundError {
    let p = mission.parameters();
    BoundError::StraightPathOnly {
        distance_m: (p.destination - p.start).norm(),
        reach_m: f64::from(mission.slots() + 1) * mission.reach_m(),
    }
}

/// The state of a certification.
struct Certifier<'a, F, const M: usize, const J: usize> {
    mission: &'a Mission<f64, M, J>,
    settings: &'a BoundSettings,
    rate_bound: &'a RateBound<'a, M, J>,
    rules: PathRules<'a, M, J>,
    best: Option<Plan>,
    leaves: Vec<Leaf>,
    progress: F,
}

impl<'a, F: FnMut(&BoundProgress), const M: usize, const J: usize> Certifier<'a, F, M, J> {
    fn new(
        mission: &'a Mission<f64, M, J>,
        settings: &'a BoundSettings,
        rate_bound: &'a RateBound<'a, M, J>,
        progress: F,
    ) -> Self {
        Self {
            mission,
            settings,
            rate_bound,
            rules: PathRules::new(mission),
            best: None,
            leaves: Vec::new(),
            progress,
        }
    }

    fn lower(&self) -> f64 {
        self.best.as_ref().map_or(0.0, |plan| plan.sum_rate)
    }

    /// Returns the upper bound of all missions: the larger of the best known mission and the
    /// largest bound of a leaf.
    fn upper(&self) -> f64 {
        let leaves = self.leaves.iter().map(|leaf| leaf.value);
        leaves.fold(self.lower(), f64::max)
    }

    fn report(&mut self, cell_m: f64) {
        let progress = BoundProgress {
            cell_m,
            leaves: self.leaves.len(),
            upper: self.upper(),
            lower: self.lower(),
        };
        (self.progress)(&progress);
    }

    fn is_close(&self) -> bool {
        self.gap() == 0.0 || self.upper() - self.lower() <= self.settings.gap * self.upper()
    }

    /// Returns the gap relative to the upper bound. It is 0 if the bounds differ by no more than
    /// rounding, which includes missions that transmit nothing.
    fn gap(&self) -> f64 {
        let (lower, upper) = (self.lower(), self.upper());
        let rounding = f64::from(self.mission.slots()) * 2.0 * RATE_ROUNDING;
        if upper - lower <= rounding {
            return 0.0;
        }
        (upper - lower) / upper
    }

    /// Prices may be negative if every mission meets each quota exactly.
    fn descent(&self, iterations: usize, ambition: f64, least_ambition: f64) -> Descent {
        Descent {
            iterations,
            ambition,
            least_ambition,
            free_sign: (self.mission.slots() as usize).is_multiple_of(self.mission.user_count()),
        }
    }

    /// Returns one leaf with all missions, at the depth where branching starts.
    fn whole(&self) -> Result<Leaf, BoundError> {
        let p = self.mission.parameters();
        let extent_m = p.area.east_m.max(p.area.north_m);
        // The side is slightly larger than V delta over a power of two, so that moves along the
        // axes are not longer than V delta (docs/bound.md).
        let side_m = self.mission.reach_m().min(extent_m) / 2.0 / (1.0 - 1e-9);
        let pairs_max = self.settings.pairs_max;
        let too_large = |cell_m: f64| BoundError::TooLarge { pairs_max, cell_m };
        if self.mission.slots() > SLOTS_MAX {
            return Err(BoundError::TooManySlots {
                slots: self.mission.slots(),
                max: SLOTS_MAX,
            });
        }
        if extent_m / side_m > 1e4 {
            return Err(too_large(side_m));
        }
        let grid = Grid::new(p.area, side_m);
        let level = Level::first(self.mission, self.rate_bound, grid, pairs_max)
            .ok_or_else(|| too_large(side_m))?;
        let free = vec![0.0; self.mission.user_count()];
        let mut leaf = Leaf::solve(level, free, &self.descent(150, 0.05, 1e-4), self.lower());
        while leaf.level.depth < BRANCHING_DEPTH {
            // Only cells that were not dropped are stored, so more than the limit may fit after
            // splitting.
            if 4 * leaf.level.tube.stored() > pairs_max {
                return Err(too_large(leaf.level.grid.side_m / 2.0));
            }
            let level = leaf.split(self.mission, self.rate_bound);
            let descent = self.descent(120, 0.02, 1e-4);
            leaf = Leaf::solve(level, leaf.multipliers, &descent, self.lower());
        }
        Ok(leaf)
    }

    fn start(&mut self) -> Result<(), BoundError> {
        let leaf = self.whole()?;
        let side_m = leaf.level.grid.side_m;
        self.try_paths(&leaf, 4);
        if self.best.is_none() {
            self.try_straight_line();
        }
        self.leaves.push(leaf);
        self.report(side_m);
        Ok(())
    }

    /// Searches for missions, starting from the paths of a leaf.
    fn try_paths(&mut self, leaf: &Leaf, most: usize) {
        let mut tried: Vec<f64> = Vec::new();
        for path in leaf.paths.iter().take(most) {
            let Some(path) = made_admissible(&self.rules, path) else {
                continue;
            };
            let plan = Plan::assigned(self.mission, path);
            if tried.contains(&plan.sum_rate) {
                continue;
            }
            tried.push(plan.sum_rate);
            let plan = refine(&self.rules, plan, TRIAL_SPACING * self.rules.reach_m);
            self.offer(plan);
        }
    }

    fn try_straight_line(&mut self) {
        let p = self.mission.parameters();
        let wished = vec![p.destination; self.mission.slots() as usize];
        if let Some(path) = made_admissible(&self.rules, &wished) {
            self.offer(Plan::assigned(self.mission, path));
        }
    }

    fn offer(&mut self, plan: Plan) {
        if plan.sum_rate > self.lower() || self.best.is_none() {
            self.best = Some(plan);
        }
    }

    /// Removes and returns the leaf with the largest bound among those that the predicate accepts.
    fn worst_leaf(&mut self, may_be: impl Fn(&Leaf) -> bool) -> Option<Leaf> {
        let leaves = self
            .leaves
            .iter()
            .enumerate()
            .filter(|(_, leaf)| may_be(leaf));
        let worst = leaves.fold(
            None,
            |worst: Option<(usize, f64)>, (index, leaf)| match worst {
                Some((_, value)) if value >= leaf.value => worst,
                _ => Some((index, leaf.value)),
            },
        );
        worst.map(|(index, _)| self.leaves.swap_remove(index))
    }

    /// Branches leaves, those with the largest bound first, and searches for missions in the
    /// results.
    fn part(&mut self) {
        let descent = self.descent(25, 0.01, 5e-4);
        while self.leaves.len() < self.settings.leaves_max && self.gap() > 0.0 {
            let Some(leaf) = self.worst_leaf(|leaf| !leaf.agreed) else {
                break;
            };
            if leaf.value - self.lower() <= (self.settings.gap + CELL_COST) * leaf.value {
                self.leaves.push(leaf);
                break;
            }
            let Some([a, b]) = leaf.branched() else {
                // The paths of the leaf agree, so the size of the cells limits its bound, not a
                // mixture of missions.
                self.leaves.push(Leaf {
                    agreed: true,
                    ..leaf
                });
                continue;
            };
            let lower = self.lower();
            let solve = |level| Leaf::solve(level, leaf.multipliers.clone(), &descent, lower);
            let (a, b) = rayon::join(|| solve(a), || solve(b));
            for part in [a, b] {
                // The bound of a part cannot exceed that of the whole leaf.
                let part = Leaf {
                    value: part.value.min(leaf.value),
                    ..part
                };
                self.try_paths(&part, 1);
                if part.value > self.lower() {
                    self.leaves.push(part);
                }
            }
            self.report(leaf.level.grid.side_m);
        }
    }

    /// Refines the best mission down to [`FINAL_SPACING_M`].
    fn polish(&mut self) {
        if let Some(plan) = self.best.clone() {
            let plan = rearrange(&self.rules, plan);
            self.offer(refine(&self.rules, plan, FINAL_SPACING_M));
        }
    }

    /// Splits the cells of leaves, those with the largest bound first. Returns the side of the
    /// smallest cells.
    fn split(&mut self) -> f64 {
        let mut work = 0;
        let sides = self.leaves.iter().map(|leaf| leaf.level.grid.side_m);
        let mut finest_m = sides.fold(f64::INFINITY, f64::min);
        while !self.is_close() {
            let Some(leaf) = self.worst_leaf(|_| true) else {
                break;
            };
            let side_m = leaf.level.grid.side_m / 2.0;
            let pairs = 4 * leaf.level.tube.stored();
            let affordable = side_m >= self.settings.finest_cell_m
                && pairs <= self.settings.pairs_max
                && work + pairs <= self.settings.work_max;
            if !affordable {
                // If the leaf with the largest bound cannot be split, splitting others does not
                // lower the bound.
                self.leaves.push(leaf);
                break;
            }
            let level = leaf.split(self.mission, self.rate_bound);
            work += pairs;
            finest_m = finest_m.min(side_m);
            let iterations = match level.depth {
                ..=2 => 20,
                3 => 6,
                _ => 0,
            };
            let descent = self.descent(iterations, 0.002, 1e-4);
            let part = Leaf::solve(level, leaf.multipliers, &descent, self.lower());
            if part.value > self.lower() {
                let value = part.value.min(leaf.value);
                self.leaves.push(Leaf { value, ..part });
            }
            self.report(side_m);
        }
        finest_m
    }
}

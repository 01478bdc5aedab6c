//! A certified upper bound on the total rate of any admissible mission, over continuous
//! positions, and a feasible mission close to it (`docs/bound.md` has the proof).
//!
//! * The area is cut into square cells; [`rates`] bounds what any point of a cell can give.
//! * [`tube`] holds the cells that each slot may be in and finds the best chain of cells by
//!   dynamic programming, with every move that some admissible displacement makes.
//! * Fairness (eq:a3) is priced; [`multipliers`] finds the prices of the least bound.
//! * What a chain through a cell is worth at most, against the best known mission, drops most
//!   cells; the rest are [split](level), and the missions [parted](tree), until bound and
//!   mission are close.
//!
//! The mission comes from [`crate::search`], started from the chains. Everything is
//! deterministic, on any number of threads: the work is bounded by counts, not by a clock.

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

/// How far to go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Done when the gap is at most this, relative to the upper bound.
    pub gap: f64,
    /// Cells are split no further than to this side, metres.
    pub finest_cell_m: f64,
    /// The most parts that the missions are divided into.
    pub leaves_max: usize,
    /// The most pairs of slot and cell that one leaf may store: bounds memory (about 10 bytes
    /// each while it is worked on, 1 while it waits).
    pub pairs_max: usize,
    /// The most pairs of slot and cell that are looked at after parting: bounds time.
    pub work_max: usize,
}

impl Default for Settings {
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

/// Where the work is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Side of the cells at hand, metres.
    pub cell_m: f64,
    /// Parts that the missions are divided into.
    pub leaves: usize,
    /// The best upper bound so far, bit/s/Hz.
    pub upper: f64,
    /// The best mission so far, bit/s/Hz.
    pub lower: f64,
}

/// The certificate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Bound {
    /// No admissible mission has a larger sum of rates, bit/s/Hz.
    pub upper: f64,
    /// The sum of rates of `plan`, bit/s/Hz.
    pub lower: f64,
    /// `(upper - lower) / upper`; 0 where only rounding lies between them.
    pub gap: f64,
    /// Side of the smallest cells, metres.
    pub cell_m: f64,
    /// Parts that the missions were divided into.
    pub leaves: usize,
    /// The prices of fairness `lambda_m` over all missions, bit/s/Hz.
    pub multipliers: Vec<f64>,
    /// What it took, seconds.
    pub seconds: f64,
    /// An admissible mission that reaches `lower`.
    pub plan: Plan,
}

impl Bound {
    /// Whether no mission carries anything, because no place that one can reach meets `Gamma`.
    pub fn carries_nothing(&self) -> bool {
        self.lower == 0.0 && self.gap == 0.0
    }
}

/// Why a mission is not bounded.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BoundError {
    /// Too many slots, or too large an area for the speed.
    #[error(
        "the mission has more than {pairs_max} pairs of slot and cell already at cells of \
         {cell_m} m: fewer slots, a smaller area or a higher speed would do"
    )]
    TooLarge {
        /// What is allowed.
        pairs_max: usize,
        /// Side of the largest cells, metres.
        cell_m: f64,
    },
    /// More slots than the assignment of users to them can be optimal for.
    #[error(
        "the mission has {slots} slots, but at most {max} are bounded: the assignment of users is cubic in them"
    )]
    TooManySlots {
        /// `N`.
        slots: u32,
        /// What is allowed.
        max: u32,
    },
    /// The straight line at full speed is all that there is.
    #[error(
        "the destination is {distance_m} m from the start and {reach_m} m can be flown: no room \
         is left to search in"
    )]
    NoRoom {
        /// From start to destination, metres.
        distance_m: f64,
        /// `(N + 1) V_max delta`, metres.
        reach_m: f64,
    },
}

/// Slots above which the assignment, cubic in them, would take minutes.
const SLOTS_MAX: u32 = 1000;
/// Depth at which the missions are parted: cells of a quarter of `V_max delta`.
const PARTING_DEPTH: usize = 1;
/// What cells of that size cost, relative, in the shipped missions: a leaf that is nearer to the
/// best mission is better split than parted.
const CELL_COST: f64 = 0.006;
/// Spacing down to which a path is tried out, as a fraction of `V_max delta`.
const TRIAL_SPACING: f64 = 0.125;
/// Spacing down to which the best mission is polished, metres.
const FINAL_SPACING_M: f64 = 0.01;

/// Bounds a mission. Calls `progress` after every step.
///
/// # Errors
/// A mission that is too large, or that leaves no room.
pub fn certify<const M: usize, const J: usize>(
    mission: &Mission<f64, M, J>,
    settings: &Settings,
    progress: impl FnMut(&Progress),
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

/// The mission of [`certify`] at the default settings, without closing the bound. Calls
/// `progress` after every step.
///
/// # Errors
/// As [`certify`].
pub fn search<const M: usize, const J: usize>(
    mission: &Mission<f64, M, J>,
    progress: impl FnMut(&Progress),
) -> Result<Plan, BoundError> {
    let settings = Settings {
        work_max: 0,
        ..Settings::default()
    };
    certify(mission, &settings, progress).map(|bound| bound.plan)
}

/// The prices of fairness of a mission, bit/s/Hz per user: those at which [`certify`] starts, of
/// the least bound at cells of a quarter of `V_max delta`. A few seconds of one processor.
///
/// # Errors
/// A mission that is too large.
pub fn fairness_prices<const M: usize, const J: usize>(
    mission: &Mission<f64, M, J>,
) -> Result<Vec<f64>, BoundError> {
    let leaf = Certifier::new(
        mission,
        &Settings::default(),
        &RateBound::new(mission),
        |_| (),
    )
    .whole()?;
    Ok(leaf.multipliers)
}

fn no_room<const M: usize, const J: usize>(mission: &Mission<f64, M, J>) -> BoundError {
    let p = mission.parameters();
    BoundError::NoRoom {
        distance_m: (p.destination - p.start).norm(),
        reach_m: f64::from(mission.slots() + 1) * mission.reach_m(),
    }
}

/// The state of a certification.
struct Certifier<'a, F, const M: usize, const J: usize> {
    mission: &'a Mission<f64, M, J>,
    settings: &'a Settings,
    rate_bound: &'a RateBound<'a, M, J>,
    rules: PathRules<'a, M, J>,
    best: Option<Plan>,
    leaves: Vec<Leaf>,
    progress: F,
}

impl<'a, F: FnMut(&Progress), const M: usize, const J: usize> Certifier<'a, F, M, J> {
    fn new(
        mission: &'a Mission<f64, M, J>,
        settings: &'a Settings,
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

    /// No mission is better than the best known or the best bound of a leaf.
    fn upper(&self) -> f64 {
        let leaves = self.leaves.iter().map(|leaf| leaf.value);
        leaves.fold(self.lower(), f64::max)
    }

    fn report(&mut self, cell_m: f64) {
        let progress = Progress {
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

    /// Relative to the upper bound; 0 where no more than rounding lies between the bounds, as
    /// where nothing is carried at all.
    fn gap(&self) -> f64 {
        let (lower, upper) = (self.lower(), self.upper());
        let rounding = f64::from(self.mission.slots()) * 2.0 * RATE_ROUNDING;
        if upper - lower <= rounding {
            return 0.0;
        }
        (upper - lower) / upper
    }

    /// Prices may be negative where every mission meets each quota exactly.
    fn descent(&self, iterations: usize, ambition: f64, least_ambition: f64) -> Descent {
        Descent {
            iterations,
            ambition,
            least_ambition,
            free_sign: (self.mission.slots() as usize).is_multiple_of(self.mission.user_count()),
        }
    }

    /// One leaf with all missions, at the depth where they are parted.
    fn whole(&self) -> Result<Leaf, BoundError> {
        let p = self.mission.parameters();
        let extent_m = p.area.east_m.max(p.area.north_m);
        // A side a hair above V delta over a power of two: then moves along the axes are not
        // longer than V delta (docs/bound.md).
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
        while leaf.level.depth < PARTING_DEPTH {
            // What is stored is what was not dropped: more than the limit may fit once split.
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

    /// Missions from a leaf's paths.
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

    /// The leaf with the largest value among those that may be chosen, taken out.
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

    /// Parts leaves, the worst first, and looks for missions in the parts.
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
            let Some([a, b]) = leaf.parted() else {
                // Its paths agree: cells, not mixtures, are what keeps it up.
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
                // A part's bound cannot be worse than the whole's.
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

    /// The best mission, down to the last centimetre.
    fn polish(&mut self) {
        if let Some(plan) = self.best.clone() {
            let plan = rearrange(&self.rules, plan);
            self.offer(refine(&self.rules, plan, FINAL_SPACING_M));
        }
    }

    /// Splits the cells of leaves, the worst first. Returns the side of the smallest cells.
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
                // What the worst leaf cannot gain, no other can.
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

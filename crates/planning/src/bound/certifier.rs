//! A certification: bounds all missions, and divides them until bound and best mission are close.
//!
//! The missions are a set of [leaves](super::tree). In each round the leaves with the largest
//! bounds are divided further. Where cells are what is loose, they are split; where the best paths
//! disagree, the set is branched. New paths are starts for the search.

use firmware_core::Mission;
use rayon::prelude::*;

use super::{
    bundle::Bundle,
    error::BoundError,
    grid::Grid,
    level::Level,
    multipliers::Descent,
    rates::{RATE_ROUNDING, RateBound},
    settings::{BoundProgress, BoundSettings},
    table::RateTable,
    tree::{Leaf, PriceSearch, Stop},
    window::Window,
};
use crate::search::{PathRules, Plan, made_admissible, rearrange, refine};

/// The number of slots above which the assignment, which is cubic in it, would take minutes.
const SLOTS_MAX: u32 = 1000;
/// The depth at which the set of missions is branched: cells of a quarter of `V_max delta`.
const BRANCHING_DEPTH: usize = 1;
/// The relative error that cells of that size cause in the shipped missions. It is replaced by what
/// splitting them is seen to gain.
const CELL_COST: f64 = 0.006;
/// A leaf whose last branchings gained less than this fraction of what its cells cost is split: the
/// last one counts in full, the one before by half, and so on.
const BRANCHING_GAIN: f64 = 0.25;
/// The largest number of leaves that are divided in a round. It does not depend on the number of
/// threads, and neither does the result.
const LEAVES_PER_ROUND: usize = 4;
/// The number of pairs of waiting leaves, as a multiple of what one leaf may store.
const WAITING_PAIRS: usize = 20;
/// The spacing down to which a path is refined as a trial, as a fraction of `V_max delta`.
const TRIAL_SPACING: f64 = 0.125;
/// The number of paths per round that are refined.
const TRIALS_PER_ROUND: usize = 1;
/// The number of paths per leaf that are assigned, as candidates for a trial.
const PATHS_PER_LEAF: usize = 2;
/// The spacing down to which the best mission is refined, metres.
const FINAL_SPACING_M: f64 = 0.01;
/// The number of comparisons that take as long as the rate bounds of one cell.
const WORK_PER_RATE: usize = 10_000;
/// The number of comparisons that take as long as the trials of a round, per slot.
const WORK_PER_TRIAL_SLOT: usize = 2_000_000;

/// The state of a certification.
pub(crate) struct Certifier<'a, const M: usize, const J: usize> {
    mission: &'a Mission<f64, M, J>,
    settings: &'a BoundSettings,
    rate_bound: &'a RateBound<'a, M, J>,
    rules: PathRules<'a, M, J>,
    pub(crate) best: Option<Plan>,
    pub(crate) leaves: Vec<Leaf>,
    /// The rates of the cells of each depth.
    tables: Vec<RateTable>,
    /// The relative error that the cells of each depth are seen to cause.
    cell_cost: Vec<f64>,
    /// The sums of the rates that trials started from.
    tried: Vec<f64>,
    /// The number of pairs that the first leaf stored.
    pairs_at_start: usize,
    /// The number of comparisons so far.
    work: usize,
    /// Whether the best mission was refined down to [`FINAL_SPACING_M`].
    polished: bool,
    stop: &'a Stop<'a>,
}

/// A way to divide a leaf.
enum Division {
    /// Over smaller cells.
    Split(Level),
    /// Into two sets of missions.
    Branch([Level; 2]),
}

impl<'a, const M: usize, const J: usize> Certifier<'a, M, J> {
    pub(crate) fn new(
        mission: &'a Mission<f64, M, J>,
        settings: &'a BoundSettings,
        rate_bound: &'a RateBound<'a, M, J>,
        stop: &'a Stop<'a>,
    ) -> Self {
        Self {
            mission,
            settings,
            rate_bound,
            rules: PathRules::new(mission),
            best: None,
            leaves: Vec::new(),
            tables: Vec::new(),
            cell_cost: Vec::new(),
            tried: Vec::new(),
            pairs_at_start: 0,
            work: 0,
            polished: false,
            stop,
        }
    }

    pub(crate) fn lower(&self) -> f64 {
        self.best.as_ref().map_or(0.0, |plan| plan.sum_rate)
    }

    /// Returns the upper bound of all missions: the larger of the best known mission and the
    /// largest bound of a leaf.
    pub(crate) fn upper(&self) -> f64 {
        let leaves = self.leaves.iter().map(|leaf| leaf.value);
        leaves.fold(self.lower(), f64::max)
    }

    /// Returns the gap relative to the upper bound. It is 0 if the bounds differ by no more than
    /// rounding, which includes missions that transmit nothing.
    pub(crate) fn gap(&self) -> f64 {
        let (lower, upper) = (self.lower(), self.upper());
        let rounding = f64::from(self.mission.slots()) * 2.0 * RATE_ROUNDING;
        if upper - lower <= rounding {
            return 0.0;
        }
        (upper - lower) / upper
    }

    fn is_close(&self) -> bool {
        self.gap() == 0.0 || self.upper() - self.lower() <= self.settings.gap * self.upper()
    }

    /// Returns the largest bound at which a leaf is close to the best mission.
    fn target(&self) -> f64 {
        self.lower() / (1.0 - self.settings.gap)
    }

    pub(crate) fn progress(&self, cell_m: f64) -> BoundProgress {
        BoundProgress {
            cell_m,
            leaves: self.leaves.len(),
            upper: self.upper(),
            lower: self.lower(),
        }
    }

    /// Prices may be negative if every mission meets each quota exactly.
    fn descent(&self, iterations: usize, ambition: f64, least_ambition: f64) -> Descent {
        Descent {
            iterations,
            ambition,
            least_ambition,
            enough: f64::NEG_INFINITY,
            free_sign: (self.mission.slots() as usize).is_multiple_of(self.mission.user_count()),
        }
    }

    /// The search for the prices of parts, which ends when the part is close to the best mission.
    fn bundle(&self, evaluations: usize, first_step: f64) -> Bundle {
        Bundle {
            evaluations,
            first_step,
            accuracy: 1e-4,
            enough: self.target(),
            free_sign: self.descent(0, 0.0, 0.0).free_sign,
        }
    }

    /// Enters the rates of a level's cells into the table of its depth.
    fn enter_rates(&mut self, level: &Level) {
        if level.depth == self.tables.len() {
            // All later levels of this depth are made from leaves that are known now.
            let hull = self.leaves.iter().map(|leaf| {
                let halvings = level.depth - leaf.level.depth;
                leaf.level.tube.hull().split(halvings)
            });
            let hull = Window::hull(hull.chain([level.tube.hull()]));
            let users = self.mission.user_count();
            self.tables.push(RateTable::new(hull, users));
        }
        let table = &mut self.tables[level.depth];
        let rates = table.extend(self.rate_bound, &level.grid, &level.tube);
        self.work += rates * WORK_PER_RATE;
    }

    /// Returns one leaf with all missions, at the depth where branching starts.
    pub(crate) fn whole(&mut self) -> Result<Leaf, BoundError> {
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
        let level = Level::first(self.mission, grid, pairs_max).ok_or_else(|| too_large(side_m))?;
        let free = vec![0.0; self.mission.user_count()];
        let mut leaf = self.solved(level, free, self.descent(150, 0.05, 1e-4));
        self.cell_cost.push(CELL_COST);
        while leaf.level.depth < BRANCHING_DEPTH {
            // Only cells that were not dropped are stored, so more than the limit may fit after
            // splitting.
            if 4 * leaf.level.tube.stored() > pairs_max {
                return Err(too_large(leaf.level.grid.side_m / 2.0));
            }
            let level = leaf.level.split(self.mission);
            let descent = self.descent(120, 0.02, 1e-4);
            let before = leaf.value;
            leaf = self.solved(level, leaf.multipliers, descent);
            self.cell_cost.push((before - leaf.value) / before);
        }
        Ok(leaf)
    }

    fn solved(&mut self, level: Level, multipliers: Vec<f64>, descent: Descent) -> Leaf {
        let descent = PriceSearch::Descent(descent);
        self.enter_rates(&level);
        let table = &self.tables[level.depth];
        let leaf = Leaf::solve(level, table, multipliers, &descent, self.lower(), self.stop);
        self.work += leaf.work;
        leaf
    }

    /// Bounds all missions at once, and searches for the first mission.
    pub(crate) fn start(&mut self) -> Result<(), BoundError> {
        let leaf = self.whole()?;
        self.try_paths(&leaf, 4);
        if self.best.is_none() {
            self.try_straight_line();
        }
        self.pairs_at_start = leaf.level.tube.stored();
        self.polish();
        self.leaves.push(leaf);
        if !self.is_close()
            && !(self.stop)()
            && let Some(leaf) = self.leaves.pop()
        {
            let leaf = self.with_better_prices(leaf);
            self.leaves.push(leaf);
        }
        Ok(())
    }

    /// Improves the prices of the first leaf.
    fn with_better_prices(&mut self, leaf: Leaf) -> Leaf {
        let search = PriceSearch::Bundle(self.bundle(100, 0.005));
        let table = &self.tables[leaf.level.depth];
        let (prices, lower) = (leaf.multipliers.clone(), self.lower());
        let better = Leaf::solve(leaf.level.clone(), table, prices, &search, lower, self.stop);
        self.work += better.work;
        Leaf {
            value: better.value.min(leaf.value),
            branching_gain: self.cell_cost[better.level.depth],
            ..better
        }
    }

    /// Searches for missions, starting from the paths of a leaf.
    fn try_paths(&mut self, leaf: &Leaf, most: usize) {
        let mut tried: Vec<f64> = Vec::new();
        for path in leaf.paths.iter().take(most) {
            if (self.stop)() {
                break;
            }
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
        self.tried.extend(tried);
    }

    /// Searches for missions, starting from the best of the paths of several leaves.
    fn try_best_paths(&mut self, leaves: &[Leaf]) {
        let paths = leaves
            .iter()
            .flat_map(|leaf| leaf.paths.iter().take(PATHS_PER_LEAF));
        let paths: Vec<_> = paths.collect();
        let (rules, mission) = (&self.rules, self.mission);
        let plans = paths.par_iter().filter_map(|path| {
            let path = made_admissible(rules, path)?;
            Some(Plan::assigned(mission, path))
        });
        let mut plans: Vec<Plan> = plans.collect();
        plans.sort_by(|a, b| b.sum_rate.total_cmp(&a.sum_rate));
        plans.retain(|plan| !self.tried.contains(&plan.sum_rate));
        plans.truncate(TRIALS_PER_ROUND);
        self.tried.extend(plans.iter().map(|plan| plan.sum_rate));
        let finest_m = TRIAL_SPACING * rules.reach_m;
        let plans = plans
            .into_par_iter()
            .map(|plan| refine(rules, plan, finest_m));
        let plans: Vec<Plan> = plans.collect();
        self.work += plans.len() * self.mission.slots() as usize * WORK_PER_TRIAL_SLOT;
        for plan in plans {
            self.offer(plan);
        }
    }

    pub(crate) fn try_straight_line(&mut self) {
        let p = self.mission.parameters();
        let wished = vec![p.destination; self.mission.slots() as usize];
        if let Some(path) = made_admissible(&self.rules, &wished) {
            self.offer(Plan::assigned(self.mission, path));
        }
    }

    fn offer(&mut self, plan: Plan) {
        if plan.sum_rate > self.lower() || self.best.is_none() {
            self.best = Some(plan);
            self.polished = false;
        }
    }

    /// Refines the best mission down to [`FINAL_SPACING_M`].
    pub(crate) fn polish(&mut self) {
        if let Some(plan) = self.best.clone()
            && !self.polished
            && !(self.stop)()
        {
            let plan = rearrange(&self.rules, plan);
            self.offer(refine(&self.rules, plan, FINAL_SPACING_M));
            self.polished = true;
        }
    }

    /// Removes and returns the leaves that the next round divides: those with the largest bounds,
    /// as many as can be processed at once. The first one decides the bound.
    fn worst_leaves(&mut self) -> Vec<Leaf> {
        self.leaves.sort_by(|a, b| b.value.total_cmp(&a.value));
        let mut pairs = 0;
        let target = self.target();
        let chosen = self
            .leaves
            .iter()
            .take(LEAVES_PER_ROUND)
            .take_while(|leaf| {
                pairs += 4 * leaf.level.tube.stored();
                leaf.value > target && pairs <= self.settings.pairs_max
            });
        let chosen = chosen.count().clamp(1, self.leaves.len());
        self.leaves.drain(..chosen).collect()
    }

    /// Returns how to divide a leaf, or `None` if the settings do not allow it.
    fn division(&self, leaf: &Leaf) -> Option<Division> {
        let waiting: usize = self
            .leaves
            .iter()
            .map(|leaf| leaf.level.tube.stored())
            .sum();
        let side_m = leaf.level.grid.side_m / 2.0;
        let may_split = side_m >= self.settings.finest_cell_m
            && 4 * leaf.level.tube.stored() <= self.settings.pairs_max
            && self.work + 16 * leaf.level.pass_cost() <= self.settings.work_max;
        let split = || may_split.then(|| Division::Split(leaf.level.split(self.mission)));
        let branch = || {
            (self.leaves.len() < self.settings.leaves_max
                && waiting < WAITING_PAIRS * self.settings.pairs_max)
                .then(|| leaf.branched().map(Division::Branch))
                .flatten()
        };
        let cell_cost = self.cell_cost[leaf.level.depth];
        if leaf.value - self.target() <= cell_cost * leaf.value
            || leaf.branching_gain < BRANCHING_GAIN * cell_cost
            || 4 * leaf.level.tube.stored() <= self.pairs_at_start
        {
            split().or_else(branch)
        } else {
            branch().or_else(split)
        }
    }

    /// Divides the leaves with the largest bounds until the gap is closed or a limit is reached.
    /// Returns the side of the smallest cells.
    pub(crate) fn divide(&mut self, mut progress: impl FnMut(&BoundProgress)) -> f64 {
        let mut finest_m = self.leaves[0].level.grid.side_m;
        while !self.is_close() && self.work < self.settings.work_max && !(self.stop)() {
            let worst = self.worst_leaves();
            let divisions: Vec<Option<Division>> =
                worst.par_iter().map(|leaf| self.division(leaf)).collect();
            let stuck = divisions[0].is_none();
            let mut jobs: Vec<(Level, &Leaf)> = Vec::new();
            for (leaf, division) in worst.iter().zip(divisions) {
                match division {
                    Some(Division::Split(mut level)) => {
                        level.drop_unreachable();
                        jobs.push((level, leaf));
                    }
                    Some(Division::Branch(levels)) => {
                        jobs.extend(levels.into_iter().map(|level| (level, leaf)));
                    }
                    None => self.leaves.push(leaf.clone()),
                }
            }
            for (level, _) in &jobs {
                finest_m = finest_m.min(level.grid.side_m);
                self.enter_rates(level);
            }
            let this = &*self;
            let solved = jobs.into_par_iter().map(|(level, parent)| {
                let part = this.solved_part(level, parent);
                (part, parent)
            });
            let solved: Vec<(Leaf, &Leaf)> = solved.collect();
            let mut parts = Vec::new();
            for (part, parent) in solved {
                self.work += part.work;
                self.learn_cell_cost(parent, &part);
                parts.push(part);
            }
            if !(self.stop)() {
                self.try_best_paths(&parts);
            }
            let lower = self.lower();
            self.leaves
                .extend(parts.into_iter().filter(|part| part.value > lower));
            progress(&self.progress(finest_m));
            if stuck {
                // If the leaf with the largest bound cannot be divided, dividing others does not
                // lower the bound.
                break;
            }
        }
        finest_m
    }

    /// Solves a part of a leaf.
    fn solved_part(&self, level: Level, parent: &Leaf) -> Leaf {
        let branched = level.depth == parent.level.depth;
        let (evaluations, first_step) = match level.depth {
            _ if branched => (25, 0.01),
            ..=2 => (20, 0.002),
            3 => (10, 0.002),
            _ => (5, 0.002),
        };
        let search = PriceSearch::Bundle(self.bundle(evaluations, first_step));
        let table = &self.tables[level.depth];
        let prices = parent.multipliers.clone();
        let part = Leaf::solve(level, table, prices, &search, self.lower(), self.stop);
        // The best prices of the whole leaf may still be better for one of its parts.
        let paths = if part.paths.is_empty() {
            parent.paths.clone()
        } else {
            part.paths
        };
        Leaf {
            value: part.value.min(parent.value),
            branching_gain: if branched {
                let gain = (parent.value - part.value).max(0.0) / parent.value;
                gain + 0.5 * parent.branching_gain
            } else {
                self.cell_cost[parent.level.depth]
            },
            paths,
            ..part
        }
    }

    /// Notes how much a bound fell because cells were split. The rest of their error is as much
    /// again, because it is proportional to their side.
    fn learn_cell_cost(&mut self, parent: &Leaf, part: &Leaf) {
        let depth = part.level.depth;
        if depth == parent.level.depth {
            return;
        }
        let cost = ((parent.value - part.value) / parent.value).max(0.0);
        match self.cell_cost.get_mut(depth) {
            Some(known) => *known = 0.5 * (*known + cost),
            None => self.cell_cost.push(cost),
        }
    }
}

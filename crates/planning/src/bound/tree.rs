//! Branch and bound: the set of missions is divided into leaves, each with its own prices and
//! cells.
//!
//! If the best paths at the best prices disagree about the position of the vehicle in some slot,
//! prices alone cannot distinguish them: the bound is that of a mixture of missions. Branching on
//! that slot makes the mixture inadmissible in both leaves. Branching tightens the bound and, more
//! importantly, leads the search to missions that a single vector of prices does not find.

use firmware_core::Position;

use super::{bundle::Bundle, level::Level, multipliers::Descent, table::RateTable};

/// A subset of the missions, and what is known about it.
#[derive(Clone, Debug)]
pub(crate) struct Leaf {
    pub(crate) level: Level,
    pub(crate) multipliers: Vec<f64>,
    /// An upper bound on every mission of the leaf, bit/s/Hz.
    pub(crate) value: f64,
    /// The best paths at prices near the best prices, those with the smallest dual value first.
    pub(crate) paths: Vec<Vec<Position<f64>>>,
    /// How much the bound fell by the last branchings, relative to the bound and weighted; at first,
    /// and after its cells were split, what the cells cost.
    pub(crate) branching_gain: f64,
    /// The number of comparisons that solving the leaf took.
    pub(crate) work: usize,
}

/// How prices are found.
#[derive(Clone, Copy, Debug)]
pub(crate) enum PriceSearch {
    Descent(Descent),
    Bundle(Bundle),
}

impl PriceSearch {
    fn evaluations(&self) -> usize {
        match self {
            Self::Descent(descent) => descent.iterations,
            Self::Bundle(bundle) => bundle.evaluations,
        }
    }
}

/// Returns whether the caller wants a computation to end.
pub(crate) type Stop<'a> = dyn Fn() -> bool + Sync + 'a;

/// The number of paths that are stored per leaf.
const PATHS_KEPT: usize = 16;

/// A line across the map that divides the waypoints of one slot.
#[derive(Clone, Copy, Debug)]
struct Branching {
    slot: usize,
    normal: nalgebra::Vector2<f64>,
    offset_m: f64,
}

impl Leaf {
    /// Finds prices for a level's missions, starting from `multipliers`, and drops the cells from
    /// which `lower` cannot be reached. Ends early, with a valid bound, when `stop` returns true.
    pub(crate) fn solve(
        mut level: Level,
        table: &RateTable,
        mut multipliers: Vec<f64>,
        search: &PriceSearch,
        lower: f64,
        stop: &Stop<'_>,
    ) -> Self {
        let mut seen: Vec<(f64, Vec<Position<f64>>)> = Vec::new();
        if search.evaluations() > 0 {
            let rated = level.with_rates(table);
            let dual = |multipliers: &[f64]| {
                let (point, path) = rated.dual(multipliers);
                seen.push((point.value, path));
                point
            };
            match search {
                PriceSearch::Descent(descent) => descent.run(&mut multipliers, dual, stop),
                PriceSearch::Bundle(bundle) => bundle.run(&mut multipliers, dual, stop),
            };
        }
        seen.sort_by(|a, b| a.0.total_cmp(&b.0));
        let work = (seen.len() + 2) * level.pass_cost();
        seen.truncate(PATHS_KEPT);
        let value = level.prune(table, &multipliers, lower);
        Self {
            level,
            multipliers,
            value,
            paths: seen.into_iter().map(|(_, path)| path).collect(),
            branching_gain: 0.0,
            work,
        }
    }

    /// Branches the leaf into two levels where its paths disagree most, or returns `None` if they
    /// agree to within a cell.
    pub(crate) fn branched(&self) -> Option<[Level; 2]> {
        let branching = self.widest_disagreement()?;
        Some(self.level.branched(branching.slot, |place| {
            branching.normal.dot(&place.coords) - branching.offset_m
        }))
    }

    fn widest_disagreement(&self) -> Option<Branching> {
        let diagonal = std::f64::consts::FRAC_1_SQRT_2;
        let normals = [
            (1.0, 0.0),
            (0.0, 1.0),
            (diagonal, diagonal),
            (diagonal, -diagonal),
        ];
        let count = self.paths.len() as f64;
        let mut widest = (self.level.grid.side_m.powi(2), None);
        for slot in 0..self.level.tube.layers.len() {
            for (x, y) in normals {
                let normal = nalgebra::Vector2::new(x, y);
                let places = self.paths.iter().filter_map(|path| path.get(slot));
                let offsets: Vec<f64> = places.map(|place| normal.dot(&place.coords)).collect();
                let mean = offsets.iter().sum::<f64>() / count;
                let variance = offsets.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count;
                if variance > widest.0 {
                    widest = (
                        variance,
                        Some(Branching {
                            slot,
                            normal,
                            offset_m: mean,
                        }),
                    );
                }
            }
        }
        widest.1
    }
}

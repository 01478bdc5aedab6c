// SPDX-License-Identifier: MIT OR Apache-2.0
//! The planner's work, divided into small steps, and the order of these steps.
//!
//! ```text
//! gain table -> first plan -> node rates -> [ prices -> settle -> polish -> order of service ] x rounds
//!            -> polish -> order of service -> polish
//! ```
//!
//! *Prices*: backward over the stages, forward from the vehicle, assignment of users, subgradient
//! step; the best path of a round is kept. *Settle*: the same dynamic programme for that path's
//! order of service instead of prices, in turn with the assignment. *Polish*: stencils around the
//! waypoints. *Order of service*: exchanges, each with its best path.

use super::{
    PlannerSettings, assignment,
    inertia::Inertia,
    learned_gains::LearnedGains,
    memory::{Capacity, Parts},
    order::{self, Change, Tables},
    place_rates::{GAIN_ENTRIES, GainScale, PlaceRates, TableGains, operations_per_place},
    polish::{self, Chains},
    polish_pairs::PairChains,
    prices::Prices,
    route::Route,
    stages::{Stages, Worth},
};
use crate::{
    inner::{SlotLimits, Workspace},
    mission::Mission,
    scalar::{Position, Scalar},
};

/// The number of stages in successive rounds, as fractions of the capacity: each division finds
/// other paths.
const STAGE_FRACTIONS: [f64; 4] = [1.0, 0.4, 0.7, 0.55];
/// The spacing of the first stencils of a polish, as a fraction of the longest step.
const FIRST_SPACING: f64 = 0.5;
/// The spacing of the stencils in which the order of service is changed.
const ORDER_SPACING: f64 = 0.3;
const ORDER_SPACING_AT_LAST: f64 = 0.15;
/// The number of alternations of the dynamic programme for a given order with the assignment, per
/// round.
const SETTLES: u32 = 4;
/// The relative gain below which a polish halves its spacing, in the rounds and in the last one.
const WORTHWHILE: f64 = 2e-4;
const WORTHWHILE_AT_LAST: f64 = 3e-5;
/// The relative gain of a round below which it counts as fruitless, and how many of those in a row
/// end the rounds.
const FRUITFUL: f64 = 1e-4;
const FRUITLESS_ROUNDS: u32 = 3;
/// The relative gain below which a change of order is not made.
const WORTH_CHANGING: f64 = 1e-4;
/// The number of nodes, or entries of the gain table, in one step.
const NODES_PER_STEP: usize = 4;
const ENTRIES_PER_STEP: usize = 8;

/// The purpose of a trial plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Trial {
    /// The first plan.
    First,
    Priced,
    Settled,
    Polished,
    Reordered,
}

/// The work of the next step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Gains {
        entry: usize,
    },
    Nodes {
        node: usize,
    },
    /// Computes the prices of the nodes.
    Price,
    Backward {
        worth: Worth,
        left: usize,
    },
    Forward {
        worth: Worth,
        stage: usize,
    },
    /// Computes the rates along the trial plan.
    Rate {
        slot: usize,
        trial: Trial,
    },
    /// Assigns users to the trial plan and compares it.
    Assign {
        trial: Trial,
    },
    Polish {
        slot: usize,
    },
    Fill {
        slot: usize,
    },
    FillAhead {
        left: usize,
    },
    Change {
        a: usize,
        b: usize,
        unchanged: usize,
    },
    Earn {
        slot: usize,
    },
    /// Improves the best plan of all rounds once more.
    Last,
    Done,
}

/// The data of the search, and its progress.
#[derive(Clone, Debug)]
pub(super) struct Search<T: Scalar, const M: usize, const J: usize> {
    pub(super) mission: Mission<T, M, J>,
    pub(super) settings: PlannerSettings,
    pub(super) capacity: Capacity,
    limits: SlotLimits<T>,
    workspace: Workspace<T, J>,
    gains: GainScale<T>,
    pub(super) learned: LearnedGains<T, M, J>,
    pub(super) route: Route<T>,
    /// The slots that each user must still be served in for its quota.
    pub(super) least: [u32; M],
    pub(super) stages: Stages<T>,
    pub(super) prices: Prices<T, M>,
    loss_per_m: T,
    phase: Phase,
    round: u32,
    iteration: u32,
    settles: u32,
    /// The number of rounds in a row that gained little, and the value before the present one.
    fruitless: u32,
    value_before: T,
    /// Whether the rounds are over and the best plan is being improved once more.
    is_last: bool,
    spacing_m: T,
    chains: Chains<T>,
    pairs: PairChains<T>,
    /// The value of the plan that is given out; `None` while it is not known.
    pub(super) best_total: Option<T>,
    current_total: T,
    /// What the present path loses by inertia, bit/s/Hz; it is subtracted from the totals.
    current_loss: T,
    /// Whether the gain table is that of the mission.
    gains_ready: bool,
    /// Whether the node rates are those of the mission and the grid.
    nodes_ready: bool,
    /// Whether the first plan is an earlier one, which is improved before new ones are made.
    continued: bool,
}

impl<T: Scalar, const M: usize, const J: usize> Search<T, M, J> {
    pub(super) fn new(
        mission: &Mission<T, M, J>,
        capacity: Capacity,
        settings: PlannerSettings,
        route: Route<T>,
    ) -> Self {
        Self {
            limits: SlotLimits::of_mission(mission),
            workspace: Workspace::default(),
            gains: GainScale::new(mission),
            learned: LearnedGains::new(),
            mission: mission.clone(),
            settings,
            capacity,
            least: [0; M],
            stages: Stages::new(&route, capacity.nodes, capacity.stages),
            prices: Prices::new(),
            loss_per_m: T::zero(),
            phase: Phase::Gains { entry: 0 },
            round: 0,
            iteration: 0,
            settles: 0,
            fruitless: 0,
            value_before: T::zero(),
            is_last: false,
            spacing_m: T::zero(),
            chains: Chains::start(&route),
            pairs: PairChains::new(&route),
            route,
            best_total: None,
            current_total: T::zero(),
            current_loss: T::zero(),
            gains_ready: false,
            nodes_ready: false,
            continued: false,
        }
    }

    /// Takes over another mission (positions, thresholds, powers) and keeps the prices.
    pub(super) fn replace_mission(&mut self, mission: &Mission<T, M, J>) {
        self.mission = mission.clone();
        self.limits = SlotLimits::of_mission(mission);
        self.gains = GainScale::new(mission);
        self.gains_ready = false;
    }

    /// Starts the work for a new route. `parts.trial` holds the first plan; `continued` says
    /// whether it is an earlier one.
    pub(super) fn start(&mut self, route: Route<T>, continued: bool) {
        self.continued = continued;
        self.nodes_ready = false;
        self.stages = Stages::new(&route, self.capacity.nodes, self.capacity.stages);
        self.route = route;
        self.prices.restart();
        self.round = 0;
        self.iteration = 0;
        self.settles = 0;
        self.fruitless = 0;
        self.value_before = T::zero();
        self.is_last = false;
        self.best_total = None;
        self.current_total = T::zero();
        self.phase = match (route.slots, self.gains_ready) {
            (0, _) => Phase::Done,
            (_, true) => rating(Trial::First),
            (_, false) => Phase::Gains { entry: 0 },
        };
    }

    pub(super) fn is_done(&self) -> bool {
        self.phase == Phase::Done
    }

    pub(super) fn users(&self) -> usize {
        self.mission.user_count()
    }

    /// Returns whether every slot is needed for a quota.
    fn is_tight(&self) -> bool {
        let owed: u32 = self.least.iter().sum();
        owed as usize >= self.route.slots
    }

    fn place_rates<'a>(&'a mut self, table: &'a [T]) -> PlaceRates<'a, T, M, J> {
        PlaceRates {
            mission: &self.mission,
            limits: &self.limits,
            gains: TableGains {
                scale: &self.gains,
                learned: &self.learned,
                table,
            },
            workspace: &mut self.workspace,
        }
    }

    /// Returns the operations of the largest step.
    pub(super) fn largest_step(&self) -> u64 {
        let rates = operations_per_place(&self.mission);
        let (slots, users) = (self.route.slots, self.users());
        let nodes = self.stages.lattice.len();
        [
            self.stages.backward_operations(),
            self.stages.forward_operations(),
            rates * polish::PLACES as u64 + Chains::<T>::OPERATIONS,
            rates * super::memory::PLACES as u64 + PairChains::<T>::OPERATIONS,
            assignment::operations(slots, users),
            (2 * nodes * users.max(8) + slots) as u64,
            (ENTRIES_PER_STEP * 600) as u64,
            (3 * order::SPAN * order_operations()) as u64,
        ]
        .into_iter()
        .fold(0, u64::max)
    }

    /// Carries out one step. Returns the operations that it took, at most
    /// [`largest_step`](Self::largest_step).
    pub(super) fn step(&mut self, parts: &mut Parts<'_, T>) -> u64 {
        let rates = operations_per_place(&self.mission);
        match self.phase {
            Phase::Gains { entry } => {
                for entry in entry..entry + ENTRIES_PER_STEP {
                    self.gains.fill(&self.mission, parts.gains, entry);
                }
                self.phase = if entry + ENTRIES_PER_STEP < GAIN_ENTRIES {
                    Phase::Gains {
                        entry: entry + ENTRIES_PER_STEP,
                    }
                } else {
                    self.gains_ready = true;
                    rating(Trial::First)
                };
                (ENTRIES_PER_STEP * 600) as u64
            }
            Phase::Nodes { node } => {
                self.rate_nodes(node, parts);
                rates * NODES_PER_STEP as u64
            }
            Phase::Price => self.price(parts),
            Phase::Backward { worth, left } => self.backward(worth, left, parts),
            Phase::Forward { worth, stage } => self.forward(worth, stage, parts),
            Phase::Rate { slot, trial } => {
                let users = self.users();
                let place = parts.trial.place(slot);
                if let Some(row) = parts.slot_rates.get_mut(slot * users..(slot + 1) * users) {
                    self.place_rates(parts.gains).write(&place, row);
                }
                self.phase = if slot + 1 < self.route.slots {
                    Phase::Rate {
                        slot: slot + 1,
                        trial,
                    }
                } else {
                    self.begin_assignment(trial, parts);
                    Phase::Assign { trial }
                };
                rates
            }
            Phase::Assign { trial } => self.assign(trial, parts),
            Phase::Polish { slot } => self.polish(slot, parts),
            Phase::Fill { slot } => {
                let spacing_m = self.order_spacing_m();
                let (route, users) = (self.route, self.users());
                let mut rates_at = self.place_rates(parts.gains);
                let mut tables = Tables {
                    rows: parts.shared,
                    users,
                };
                tables.fill(&route, &mut rates_at, &parts.current, slot, spacing_m);
                self.phase = if slot + 1 < self.route.slots {
                    Phase::Fill { slot: slot + 1 }
                } else {
                    Phase::FillAhead {
                        left: self.route.slots,
                    }
                };
                (rates + 100) * super::memory::PLACES as u64
            }
            Phase::FillAhead { left } => {
                let mut tables = Tables {
                    rows: parts.shared,
                    users: self.users(),
                };
                tables.fill_ahead(&self.route, &parts.current, left - 1);
                self.phase = if left > 1 {
                    Phase::FillAhead { left: left - 1 }
                } else {
                    Phase::Change {
                        a: self.iteration as usize % self.route.slots.max(1),
                        b: 0,
                        unchanged: 0,
                    }
                };
                order_operations() as u64
            }
            Phase::Change { a, b, unchanged } => self.change(a, b, unchanged, parts),
            Phase::Earn { slot } => {
                let mut tables = Tables {
                    rows: parts.shared,
                    users: self.users(),
                };
                tables.earn(&parts.trial, slot);
                self.phase = if slot + 1 < self.route.slots {
                    Phase::Earn { slot: slot + 1 }
                } else if tables.trace(&self.route, &mut parts.trial, self.order_spacing_m()) {
                    rating(Trial::Reordered)
                } else {
                    self.end_round()
                };
                order_operations() as u64
            }
            Phase::Last => {
                self.is_last = true;
                self.settles = 0;
                self.current_total = self.best_total.unwrap_or(T::zero());
                parts.current.copy_from(&parts.best);
                self.phase = self.begin_polish(FIRST_SPACING);
                self.route.slots as u64
            }
            Phase::Done => 0,
        }
    }

    fn order_spacing_m(&self) -> T {
        self.stencil_step_m()
            * T::of(if self.is_last {
                ORDER_SPACING_AT_LAST
            } else {
                ORDER_SPACING
            })
    }

    /// Returns the longest step, limited to the extent of the places that can be visited.
    fn stencil_step_m(&self) -> T {
        self.route.step_m.min(self.stages.lattice.across_m())
    }

    fn rate_nodes(&mut self, node: usize, parts: &mut Parts<'_, T>) {
        let nodes = self.stages.lattice.len();
        let end = (node + NODES_PER_STEP).min(nodes);
        let (users, lattice, route) = (self.users(), self.stages.lattice, self.route);
        let mut place_rates = self.place_rates(parts.gains);
        for node in node..end {
            let place = route.inside(&lattice.node(node));
            place_rates.each(&place, 0..users, |user, rate| {
                if let Some(entry) = parts.rates.get_mut(user * nodes + node) {
                    *entry = rate;
                }
            });
        }
        self.phase = if end < nodes {
            Phase::Nodes { node: end }
        } else {
            self.nodes_ready = true;
            Phase::Price
        };
    }

    /// Computes the largest priced rate of every node.
    fn price(&mut self, parts: &mut Parts<'_, T>) -> u64 {
        let (nodes, users) = (self.stages.lattice.len(), self.users());
        let Some(worth) = parts.worth.get_mut(..nodes) else {
            self.phase = Phase::Done;
            return 1;
        };
        worth.fill(T::of(f64::NEG_INFINITY));
        let rates = parts.rates.chunks_exact(nodes.max(1)).take(users);
        for (rates, &price) in rates.zip(&self.prices.values) {
            for (worth, &rate) in worth.iter_mut().zip(rates) {
                let priced = rate + price;
                *worth = if priced > *worth { priced } else { *worth };
            }
        }
        let (mut low, mut high) = (T::of(f64::INFINITY), T::of(f64::NEG_INFINITY));
        for &worth in worth.iter() {
            low = low.min(worth);
            high = high.max(worth);
        }
        let span = (high - low).max(T::of(0.1));
        self.loss_per_m = span * T::of(2.0) / self.route.step_m.max(T::of(1e-6));
        self.phase = Phase::Backward {
            worth: Worth::Priced,
            left: self.stages.count.get(),
        };
        (2 * nodes * users) as u64
    }

    fn backward(&mut self, worth: Worth, left: usize, parts: &mut Parts<'_, T>) -> u64 {
        if left == self.stages.count.get() {
            self.stages
                .finish(&self.route, self.loss_per_m, parts.value);
        }
        self.stages.backward(worth, left - 1, parts);
        self.phase = if left > 1 {
            Phase::Backward {
                worth,
                left: left - 1,
            }
        } else {
            Phase::Forward { worth, stage: 0 }
        };
        self.stages.backward_operations()
    }

    fn forward(&mut self, worth: Worth, stage: usize, parts: &mut Parts<'_, T>) -> u64 {
        self.stages.forward(&self.route, stage, parts);
        self.phase = if stage + 1 < self.stages.count.get() {
            Phase::Forward {
                worth,
                stage: stage + 1,
            }
        } else {
            for slot in 0..self.route.slots {
                let waypoint = self.stages.waypoint(parts.points, slot);
                parts.trial.set_place(slot, waypoint);
            }
            self.route.anchor(&mut parts.trial);
            rating(match worth {
                Worth::Priced => Trial::Priced,
                Worth::Ordered => Trial::Settled,
            })
        };
        self.stages.forward_operations()
    }

    /// Called when the rates along the trial plan are known: takes a step of the prices, and
    /// assigns every slot to its best user.
    fn begin_assignment(&mut self, trial: Trial, parts: &mut Parts<'_, T>) {
        let (slots, users) = (self.route.slots, self.users());
        let rates = parts.slot_rates.get(..slots * users).unwrap_or(&[]);
        if trial == Trial::Priced {
            let mut counts = [0; M];
            for row in rates.chunks_exact(users.max(1)) {
                let mut best = (0, T::of(f64::NEG_INFINITY));
                for (user, (&rate, &price)) in row.iter().zip(&self.prices.values).enumerate() {
                    if rate + price > best.1 {
                        best = (user, rate + price);
                    }
                }
                if let Some(count) = counts.get_mut(best.0) {
                    *count += 1;
                }
            }
            let owed = self.least.iter().zip(&self.prices.values);
            let owed = owed.fold(T::zero(), |sum, (&least, &price)| {
                sum + T::count(least as usize) * price
            });
            let dual = self.stages.value(parts, &self.route.from) - owed;
            let tight = self.is_tight();
            self.prices.step(&counts, &self.least, users, dual, tight);
        }
        let assigned = parts.trial.users.get_mut(..slots).unwrap_or(&mut []);
        assignment::assign_best(rates, users, assigned);
    }

    /// Gives one more user a slot for its quota; then compares the trial plan.
    fn assign(&mut self, trial: Trial, parts: &mut Parts<'_, T>) -> u64 {
        let (slots, users) = (self.route.slots, self.users());
        let rates = parts.slot_rates.get(..slots * users).unwrap_or(&[]);
        let assigned = parts.trial.users.get_mut(..slots).unwrap_or(&mut []);
        let operations = assignment::operations(slots, users);
        if assignment::augment::<T, M>(rates, users, &self.least, assigned) {
            return operations;
        }
        let mut total = T::zero();
        for (row, &user) in rates.chunks_exact(users.max(1)).zip(&*assigned) {
            total += row.get(usize::from(user)).copied().unwrap_or(T::zero());
        }
        let inertia = self.route.inertia.as_ref();
        let loss = inertia.map_or(T::zero(), |inertia| inertia.loss(&parts.trial));
        total -= loss;
        let gain = total - self.current_total;
        let adopted = gain > T::zero() || trial == Trial::First;
        if adopted {
            self.current_total = total;
            self.current_loss = loss;
            parts.current.copy_from(&parts.trial);
        }
        if self.best_total.is_none_or(|best| total > best) {
            self.best_total = Some(total);
            parts.best.copy_from(&parts.trial);
        }
        self.phase = self.after(trial, adopted, gain);
        operations
    }

    /// Returns the phase that follows a trial plan.
    fn after(&mut self, trial: Trial, adopted: bool, gain: T) -> Phase {
        // The total can be below zero where much is lost by inertia; the rates cannot.
        let rates = self.current_total + self.current_loss;
        let worthwhile = |fraction: f64| gain > rates * T::of(fraction);
        match trial {
            Trial::First if !self.route.has_choice() => Phase::Done,
            Trial::First if self.continued => self.begin_polish(FIRST_SPACING * 0.25),
            Trial::First => Phase::Nodes { node: 0 },
            Trial::Priced => {
                self.iteration += 1;
                if self.iteration < self.settings.iterations(self.round) {
                    return Phase::Price;
                }
                self.settles = 0;
                self.settle()
            }
            Trial::Settled => {
                if worthwhile(WORTHWHILE) && self.settles < SETTLES {
                    self.settle()
                } else {
                    self.begin_polish(FIRST_SPACING)
                }
            }
            Trial::Polished => {
                let least = if self.is_last {
                    WORTHWHILE_AT_LAST
                } else {
                    WORTHWHILE
                };
                if !worthwhile(least) {
                    self.spacing_m *= T::of(0.5);
                }
                let finest_m = self.stencil_step_m() * T::of(self.settings.finest_spacing);
                if self.spacing_m >= finest_m {
                    Phase::Polish { slot: 0 }
                } else if self.settles <= SETTLES {
                    // The order has not been changed in this round yet.
                    self.settles = SETTLES + 1;
                    self.iteration = 0;
                    Phase::Fill { slot: 0 }
                } else {
                    self.end_round()
                }
            }
            Trial::Reordered => {
                let made = adopted && worthwhile(WORTH_CHANGING * 0.5);
                if made && self.iteration < self.settings.changes {
                    self.iteration += 1;
                    Phase::Fill { slot: 0 }
                } else {
                    self.begin_polish(FIRST_SPACING * 0.25)
                }
            }
        }
    }

    fn settle(&mut self) -> Phase {
        self.settles += 1;
        let limit = self.mission.slot_rate_limit().max(T::of(0.1));
        self.loss_per_m = limit * T::of(2.0) / self.route.step_m.max(T::of(1e-6));
        Phase::Backward {
            worth: Worth::Ordered,
            left: self.stages.count.get(),
        }
    }

    fn begin_polish(&mut self, spacing: f64) -> Phase {
        self.spacing_m = self.stencil_step_m() * T::of(spacing);
        Phase::Polish { slot: 0 }
    }

    fn end_round(&mut self) -> Phase {
        self.iteration = 0;
        if !self.nodes_ready && !self.is_last {
            // Only an earlier plan has been improved so far.
            self.current_total = T::zero();
            return Phase::Nodes { node: 0 };
        }
        if self.is_last {
            return Phase::Done;
        }
        self.round += 1;
        let value = self.best_total.unwrap_or(T::zero());
        let least = self.value_before + self.value_before.abs() * T::of(FRUITFUL);
        let fruitful = value > least;
        self.fruitless = if fruitful { 0 } else { self.fruitless + 1 };
        self.value_before = value;
        if self.round >= self.settings.rounds || self.fruitless >= FRUITLESS_ROUNDS {
            return Phase::Last;
        }
        let fraction = STAGE_FRACTIONS[self.round as usize % STAGE_FRACTIONS.len()];
        let stages = T::count(self.capacity.stages) * T::of(fraction);
        self.stages.divide(&self.route, stages.ceil().whole());
        // The best path of the next round is polished even if it is not yet better than this one.
        self.current_total = T::zero();
        Phase::Price
    }

    fn polish(&mut self, slot: usize, parts: &mut Parts<'_, T>) -> u64 {
        if let Some(inertia) = self.route.inertia {
            return self.polish_pairs(&inertia, slot, parts);
        }
        if slot == 0 {
            self.chains = Chains::start(&self.route);
        }
        let (route, spacing_m) = (self.route, self.spacing_m);
        let mut chains = self.chains;
        let mut rates = self.place_rates(parts.gains);
        chains.extend(
            &route,
            &mut rates,
            &parts.current,
            (slot, spacing_m),
            parts.back,
        );
        self.chains = chains;
        self.phase = if slot + 1 < route.slots {
            Phase::Polish { slot: slot + 1 }
        } else if chains.trace(
            &route,
            spacing_m,
            &parts.current,
            parts.back,
            &mut parts.trial,
        ) {
            rating(Trial::Polished)
        } else {
            self.end_round()
        };
        let rates = operations_per_place(&self.mission);
        rates * polish::PLACES as u64 + Chains::<T>::OPERATIONS
    }

    /// As [`polish`](Self::polish), for a vehicle with inertia.
    fn polish_pairs(&mut self, inertia: &Inertia<T>, slot: usize, parts: &mut Parts<'_, T>) -> u64 {
        if slot == 0 {
            self.pairs = PairChains::start(&self.route, inertia);
        }
        let (route, spacing_m) = (self.route, self.spacing_m);
        let mut pairs = self.pairs;
        let mut rates = self.place_rates(parts.gains);
        let at = (slot, spacing_m);
        pairs.extend(
            (&route, inertia),
            &mut rates,
            &parts.current,
            at,
            parts.back,
        );
        self.pairs = pairs;
        let (current, trial) = (&parts.current, &mut parts.trial);
        self.phase = if slot + 1 < route.slots {
            Phase::Polish { slot: slot + 1 }
        } else if pairs.trace(&route, spacing_m, current, parts.back, trial) {
            rating(Trial::Polished)
        } else {
            self.end_round()
        };
        let rates = operations_per_place(&self.mission);
        rates * super::memory::PLACES as u64 + PairChains::<T>::OPERATIONS
    }

    /// Tries the changes of slots `a` and `a + 1 + b`, and makes the first that is worthwhile.
    fn change(&mut self, a: usize, b: usize, unchanged: usize, parts: &mut Parts<'_, T>) -> u64 {
        let slots = self.route.slots;
        let last = a + 1 + b;
        if last >= slots || b >= order::SPAN {
            self.phase = if unchanged + 1 < slots {
                Phase::Change {
                    a: (a + 1) % slots.max(1),
                    b: 0,
                    unchanged: unchanged + 1,
                }
            } else {
                // All changes have been tried since the last that was made.
                self.begin_polish(FIRST_SPACING * 0.25)
            };
            return 20;
        }
        let tables = Tables {
            rows: parts.shared,
            users: self.users(),
        };
        let users = parts.current.users.get(..slots).unwrap_or(&[]);
        // The tables leave inertia out.
        let rates = self.current_total + self.current_loss;
        let least = rates * T::of(1.0 + WORTH_CHANGING);
        let mut operations = 20;
        for change in Change::ALL {
            if !change.alters(users, a, last) {
                continue;
            }
            operations += ((b + 2) * order_operations()) as u64;
            if tables.changed(change, users, a, last) > least {
                parts.trial.copy_from(&parts.current);
                if let Some(users) = parts.trial.users.get_mut(..slots) {
                    change.apply(users, a, last);
                }
                self.phase = Phase::Earn { slot: 0 };
                return operations;
            }
        }
        self.phase = Phase::Change {
            a,
            b: b + 1,
            unchanged,
        };
        operations
    }

    /// Returns the position from which the plan starts.
    pub(super) fn from(&self) -> Position<T> {
        self.route.from
    }
}

fn rating(trial: Trial) -> Phase {
    Phase::Rate { slot: 0, trial }
}

/// Returns the operations for one slot of a chain.
const fn order_operations() -> usize {
    4 * super::memory::PLACES * super::memory::PLACES
}

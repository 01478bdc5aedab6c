// SPDX-License-Identifier: MIT OR Apache-2.0
//! The paper's Alg. 1 (alg:1): alternate between powers and coefficients for a given `eta` (eq:inn1)
//! and `eta` for given powers and coefficients (eq:inn2, solved by eq:opteta and eq:eta_), with the
//! corrections of `docs/mathematics.md`. It is here to be compared with: [`exact`](super::exact) gives the
//! optimum that this approaches, in one step.
//!
//! Each outer step fixes `eta` and bounds the interference by `Psi >= E` (eq:psi, which turns eq:inn1
//! into eq:p_pb1 and eq:p_pb1_r). It then repeats `t = 1/Psi` (eq:t) and the convex problem eq:p_pbp
//! in `b`, `p` and `Psi`. In noise-normalized units (`e = eta sigma`, `psi = Psi / e^2`) that is
//!
//! ```text
//! maximise   ln(q + psi) - psi / psi_before
//! subject to q <= B = (2 A - kappa / e) / e - E,   0 <= q <= Q,   E <= psi,   0 <= y_j <= a_j
//! ```
//!
//! It asks for little energy `E` and for little misalignment `sum (e y_j - 1)^2`, a weighted sum
//! of which is least at `y_j = min(c, a_j)` with one `c <= 1/e`: again one level. Along it `B`
//! and `E` rise, so the best level is the least of three: where the derivative vanishes,
//! `c (2 A - kappa/e) = psi_before`; where `q` reaches `Q`; and `1/e`. Between two neighbouring
//! `a_j` each is the root of a quadratic. `psi` is `E`, or `psi_before - q` where that is larger
//! (the constraint on it is slack).
//!
//! Worst case: `outer_max x inner_max` subproblems of `3 log2 J` comparisons, three quadratics
//! and `J` terms of the stop rule; no allocation. Single precision suffices for Table I, but not
//! where the user arrives below rounding of what the sensors can send: with `eta` fixed, its
//! budget `B` is a difference. The exact solver has no such difference.

use super::{
    LimitedBy, SlotError, Solution, Status,
    level::{Level, Segment, SensorField},
    weighted::Sorted,
};
use crate::{scalar::Scalar, units::PowerGain};
use serde::{Deserialize, Serialize};

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AlternatingSettings<T> {
    /// `xi`: a loop ends when no variable moves further than this. Compared are dimensionless
    /// variables, `x_j = eta |b_j h_j|`, `eta^2 |g|^2 p` and the relative change of `eta`; the
    /// paper compares powers, coefficients and `eta`, ten orders apart.
    pub tolerance: T,
    /// The most values of `eta` that are tried.
    pub outer_max: u32,
    /// The most subproblems per value of `eta`.
    pub inner_max: u32,
}

impl<T: Scalar> Default for AlternatingSettings<T> {
    /// `xi = 0.001` (Table I); the caps are ours.
    fn default() -> Self {
        Self {
            tolerance: T::of(1e-3),
            outer_max: 20_000,
            inner_max: 2_000,
        }
    }
}

/// How the iteration ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AlternatingOutcome {
    /// The outer loop moved no further than `xi`.
    Converged,
    /// A cap came first. What was reached keeps all constraints.
    IterationLimit,
    /// No choice meets `Gamma`; nothing was iterated.
    Infeasible,
}

/// The answer of Alg. 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlternatingReport<T> {
    /// The powers, coefficients and `eta` reached.
    pub solution: Solution<T>,
    /// How it ended.
    pub outcome: AlternatingOutcome,
    /// Values of `eta` tried.
    pub outer_steps: u32,
    /// Subproblems (eq:p_pbp) solved in all.
    pub subproblems: u32,
}

/// What an outer step reached.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<T> {
    /// `l`, from 1.
    pub outer_step: u32,
    /// The number of subproblems solved so far.
    pub subproblems: u32,
    /// `R`, bit/s/Hz; never less than after the step before.
    pub rate: T,
}

/// Amplitudes, user signal and `eta`, noise-normalized.
#[derive(Clone, Copy, Debug)]
struct Point<T> {
    level: Level<T>,
    signal: T,
    eta: T,
}

/// The result of the inner loop.
#[derive(Clone, Copy, Debug)]
struct InnerLoop<T> {
    level: Level<T>,
    signal: T,
    subproblems: u32,
    converged: bool,
}

impl<T: Scalar> SensorField<'_, T> {
    /// Runs Alg. 1 for a user of gain `|g|^2`; `observe` is called after every outer step.
    ///
    /// The iteration starts at the least MSE, where `eta = A(c*) / E(c*)`: most other values make
    /// the first subproblem infeasible.
    ///
    /// # Errors
    /// Returns an error if a gain is NaN, infinite or negative.
    pub fn alternate(
        &self,
        user: Option<PowerGain<T>>,
        settings: &AlternatingSettings<T>,
        mut observe: impl FnMut(Step<T>),
    ) -> Result<AlternatingReport<T>, SlotError<T>> {
        let gain = SlotError::check_user(user)?;
        let budget = self.normalized_budget(gain);
        let mut report = AlternatingReport {
            solution: self.solution(
                Status::Optimal {
                    limited_by: LimitedBy::None,
                },
                &self.peak,
                T::zero(),
                gain,
            ),
            outcome: AlternatingOutcome::Converged,
            outer_steps: 0,
            subproblems: 0,
        };
        if !self.is_feasible() {
            report.solution.status = self.infeasible(self.least_mse());
            report.outcome = AlternatingOutcome::Infeasible;
            return Ok(report);
        }
        if budget <= T::zero() {
            // Nothing to maximise: every solver returns the least MSE.
            return Ok(report);
        }
        let mut here = Point {
            level: self.peak,
            signal: T::zero(),
            eta: self.peak.sum / self.peak.energy,
        };
        report.outcome = AlternatingOutcome::IterationLimit;
        for outer_step in 1..=settings.outer_max {
            let inner = self.fixed_eta(&here, budget, settings);
            report.outer_steps = outer_step;
            report.subproblems += inner.subproblems;
            let (level, signal) = (inner.level, inner.signal);
            let next = Point {
                level,
                signal,
                // eq:eta_
                eta: level.sum / (signal + level.energy),
            };
            let relative = (next.eta - here.eta) / next.eta;
            let moved = self.squared_distance(&here, &next) + relative * relative;
            here = next;
            observe(Step {
                outer_step,
                subproblems: report.subproblems,
                rate: self.rate_of(here.signal, &here.level),
            });
            if moved <= settings.tolerance * settings.tolerance {
                if inner.converged {
                    report.outcome = AlternatingOutcome::Converged;
                }
                break;
            }
        }
        let limited_by = if here.signal >= budget {
            LimitedBy::Power
        } else {
            LimitedBy::Accuracy
        };
        let status = match report.outcome {
            AlternatingOutcome::Converged => Status::Converged { limited_by },
            _ => Status::IterationLimit { limited_by },
        };
        report.solution = self.solution(status, &here.level, here.signal, gain);
        Ok(report)
    }

    /// Solves eq:p_pb2 for the `eta` of `here`: alternates `t` with the other variables until
    /// neither moves nor `Psi` is slack, and returns the best amplitudes and signal found.
    fn fixed_eta(
        &self,
        here: &Point<T>,
        budget: T,
        settings: &AlternatingSettings<T>,
    ) -> InnerLoop<T> {
        let mut best = *here;
        let mut point = *here;
        let mut subproblems = 0;
        let mut converged = false;
        // This is feasible and tight: eq:eta_ only lowered the MSE of the point before.
        let mut psi = point.level.energy;
        while subproblems < settings.inner_max && !converged {
            subproblems += 1;
            let (level, signal) = self.subproblem(point.eta, psi, budget);
            let next = Point {
                level,
                signal,
                ..point
            };
            let slack = psi - signal;
            let is_slack = slack > level.energy * (T::one() + settings.tolerance);
            psi = slack.max(level.energy);
            let moved = self.squared_distance(&point, &next);
            point = next;
            if point.signal * best.level.energy > best.signal * point.level.energy {
                best = point;
            }
            converged = moved <= settings.tolerance * settings.tolerance && !is_slack;
        }
        InnerLoop {
            level: best.level,
            signal: best.signal,
            subproblems,
            converged,
        }
    }

    /// Solves eq:p_pbp for given `eta` and `t = 1/psi`, all noise-normalized. Returns the level of
    /// the amplitudes and the user's signal.
    fn subproblem(&self, eta: T, psi: T, budget: T) -> (Level<T>, T) {
        let two = T::of(2.0);
        let deficit = self.kappa / eta;
        // The largest signal that the MSE allows at a level, for this eta.
        let room = |level: &Level<T>| (two * level.sum - deficit) / eta - level.energy;
        let ceiling = (T::one() / eta).min(self.strongest());
        let stationary = self.first_level(
            ceiling,
            |segment, c| c * (two * segment.level(c).sum - deficit) >= psi,
            |Segment { strong, below }| {
                let half = below.amplitude - deficit / two;
                let root = (half * half + two * strong * psi).sqrt();
                if half > T::zero() {
                    psi / (half + root)
                } else {
                    (root - half) / (two * strong)
                }
            },
        );
        let least_for = |signal: T| {
            self.first_level(
                ceiling,
                |segment, c| room(&segment.level(c)) >= signal,
                |Segment { strong, below }| {
                    let rest =
                        T::one() + below.energy + signal - (two * below.amplitude - deficit) / eta;
                    let (rest, top) = (rest / strong, T::one() / eta);
                    rest / (top + (top * top - rest).max(T::zero()).sqrt())
                },
            )
        };
        let full_power = least_for(budget);
        let level = if full_power.c < stationary.c {
            full_power
        } else {
            stationary
        };
        let signal = room(&level);
        if signal >= T::zero() {
            return (level, signal.min(budget));
        }
        // The accuracy alone needs a higher level than the rate does.
        let level = least_for(T::zero());
        (level, room(&level).max(T::zero()).min(budget))
    }

    /// Returns the squared distance of two points, in the variables `x_j = eta y_j` and `eta^2 q`; where
    /// channels are not known exactly, in variables that move no less than these.
    fn squared_distance(&self, from: &Point<T>, to: &Point<T>) -> T {
        let signal = to.eta * to.eta * to.signal - from.eta * from.eta * from.signal;
        let add = |sum, a| {
            let moved = to.eta * to.level.c.min(a) - from.eta * from.level.c.min(a);
            sum + moved * moved
        };
        let squared = signal * signal;
        match self.sorted {
            Sorted::Known(sensors) => sensors.iter().fold(squared, |sum, &a| add(sum, a)),
            Sorted::Weighted(sensors, _) => {
                (sensors.iter()).fold(squared, |sum, sensor| add(sum, sensor.amplitude))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::{
        inner::{SlotLimits, Workspace},
        units::Watt,
    };

    /// No feasible point of eq:p_pbp, drawn at random or close around the answer, has a higher
    /// objective: the problem is convex, so that is optimality.
    #[test]
    fn a_subproblem_is_solved_to_its_optimum() {
        let mut random = Pcg64Mcg::seed_from_u64(7);
        let mut rivals = 0;
        for _ in 0..2_000 {
            let sensors = random.random_range(1..=12);
            let gains: Vec<_> = (0..sensors)
                .map(|_| PowerGain(random.random_range(-3.0_f64..2.0).exp()))
                .collect();
            let limits = SlotLimits {
                sensor_power_max: Watt(1.0),
                user_power_max: Watt(random.random_range(-5.0_f64..3.0).exp()),
                noise_power: Watt(0.1),
                mse_threshold: random.random_range(0.3..0.95) / sensors as f64,
            };
            let mut workspace = Workspace::<f64, 12>::default();
            let field = workspace.sensors(&limits, &gains).expect("a slot problem");
            if !field.is_feasible() {
                continue;
            }
            let budget = field.normalized_budget(PowerGain(1.0));
            let eta = field.peak.sum / field.peak.energy;
            let before = field.peak.energy * random.random_range(0.3..3.0);
            let (level, signal) = field.subproblem(eta, before, budget);
            let objective = |signal: f64, psi: f64| (signal + psi).ln() - psi / before;
            let best = objective(signal, level.energy.max(before - signal));
            for _ in 0..100 {
                let spread = random.random_range(-12.0_f64..0.0).exp();
                let (mut sum, mut energy) = (0.0, 1.0);
                let Sorted::Known(amplitudes) = field.sorted else {
                    panic!("no statistics were given");
                };
                for &a in amplitudes {
                    let near = level.c.min(a) + spread * random.random_range(-1.0..1.0);
                    let y = near.clamp(0.0, a);
                    sum += y;
                    energy += y * y;
                }
                let room = (2.0 * sum - field.kappa / eta) / eta - energy;
                if room < 0.0 {
                    continue;
                }
                rivals += 1;
                let q = room.min(budget) * [1.0, random.random_range(0.0..1.0)][rivals % 2];
                for psi in [energy, energy.max(before - q), energy + spread] {
                    assert!(objective(q, psi) <= best + 1e-12, "{limits:?} {gains:?}");
                }
            }
        }
        assert!(rivals > 20_000, "{rivals}");
    }
}

//! The slot problem solved by a general convex solver, [Clarabel](clarabel): the reference
//! implementation that the closed form is compared with, and the paper's own method for eq:p_pbp.
//!
//! * [`bisect`] solves eq:p1 itself. For a given SINR the slot problem is a second-order-cone
//!   problem (`docs/mathematics.md`, section 3): minimize `||(1, y)||` for a given sum of
//!   amplitudes. Bisection over the SINR gives the global optimum.
//!   Where channels are not known exactly it takes their error statistics (section 10).
//! * [`alternate`] is Alg. 1 with eq:p_pbp as printed: an exponential cone for the logarithm,
//!   second-order cones for the MSE and `Psi`.
//!
//! The only part shared with the closed form is the grid search for a scale: Clarabel needs numbers
//! near 1, while gains are near 1e-12. No result of Clarabel is used unchecked. Whatever its
//! status, the returned point is moved into its bounds, the user's power is what the MSE allows for
//! exactly these coefficients, and a point that does not meet `Gamma` is not a solution.

mod program;
mod slot;
mod solution;

use firmware_core::{
    PowerGain,
    inner::{SlotLimits, alternating::AlternatingSettings},
    uncertainty::SlotUncertainty,
};

use program::{is_infeasible, is_solution};
use slot::{Point, Slot};

pub use solution::{ConicSolution, ConicStatus};

/// The relative width at which the bisection over the SINR ends.
const SINR_TOLERANCE: f64 = 1e-10;
/// A bisection from `J / kappa` to [`SINR_TOLERANCE`] takes about 50 steps.
const BISECTIONS_MAX: u32 = 200;

/// Solves eq:p1 by bisection over the SINR, with one second-order-cone problem per step. With a
/// gain of `None`, no user is served; with statistics of `None`, the channels are known exactly.
///
/// The slot must be one that [`firmware_core`] accepts.
pub fn bisect(
    limits: &SlotLimits<f64>,
    gains: &[PowerGain<f64>],
    user: Option<PowerGain<f64>>,
    uncertainty: Option<&SlotUncertainty<'_, f64>>,
) -> ConicSolution {
    let slot = Slot::new(limits, gains, user, uncertainty);
    let mut solves = 0;
    let peak = match slot.peak(&mut solves) {
        Ok(peak) => peak,
        Err(report) => return report,
    };
    if slot.budget <= 0.0 {
        return slot.solution(ConicStatus::Solved, &peak, &peak, solves);
    }
    let scale = slot.scale();
    let mut best = slot.with_signal(peak.amplitude.clone());
    let (mut low, mut high) = (slot.sinr(&best), slot.sinr_max());
    let mut failure = None;
    for _ in 0..BISECTIONS_MAX {
        if high - low <= SINR_TOLERANCE * high {
            break;
        }
        let sinr = 0.5 * (low + high);
        solves += 1;
        // The bound is tightened by more than the largest error of Clarabel, because the returned
        // point must reach this SINR exactly.
        let energy_max = slot.energy_max(sinr) * (1.0 - 2e-9);
        let (status, rival) = slot.least_energy(scale, Some(energy_max));
        let rival = rival.map(|amplitude| slot.with_signal(amplitude));
        match rival {
            Some(rival) if slot.sinr(&rival) > slot.sinr(&best) => best = rival,
            _ => {}
        }
        low = low.max(slot.sinr(&best));
        if slot.sinr(&best) < sinr {
            high = sinr;
            if !(is_solution(status) || is_infeasible(status)) {
                failure = Some(status);
            }
        }
    }
    let status = match failure {
        Some(status) => ConicStatus::SolverFailed(status),
        None if high - low <= SINR_TOLERANCE * high => ConicStatus::Solved,
        None => ConicStatus::IterationLimit,
    };
    slot.solution(status, &best, &peak, solves)
}

/// Solves Alg. 1 with eq:p_pbp solved by Clarabel. `settings` are those of
/// [`alternating`](firmware_core::inner::alternating).
pub fn alternate(
    limits: &SlotLimits<f64>,
    gains: &[PowerGain<f64>],
    user: Option<PowerGain<f64>>,
    uncertainty: Option<&SlotUncertainty<'_, f64>>,
    settings: &AlternatingSettings<f64>,
) -> ConicSolution {
    let slot = Slot::new(limits, gains, user, uncertainty);
    let mut solves = 0;
    let peak = match slot.peak(&mut solves) {
        Ok(peak) => peak,
        Err(report) => return report,
    };
    if slot.budget <= 0.0 {
        return slot.solution(ConicStatus::Solved, &peak, &peak, solves);
    }
    let tolerance = settings.tolerance;
    let mut here = peak.clone();
    let mut status = ConicStatus::IterationLimit;
    for _ in 0..settings.outer_max {
        let eta = here.eta();
        let (mut best, mut point) = (here.clone(), here.clone());
        let mut psi = point.energy;
        let mut at_rest = false;
        let mut failed = None;
        for _ in 0..settings.inner_max {
            solves += 1;
            let (status, next) = slot.subproblem(eta, psi);
            let objective = |p: &Point| {
                let psi_after = (psi - p.signal).max(p.energy);
                (p.signal + psi_after).ln() - psi_after / psi
            };
            // Clarabel may not reach its own tolerance although the point is good. The point is
            // accepted if the objective of eq:p_pbp did not decrease by more than that tolerance.
            let Some(next) =
                next.filter(|next| is_solution(status) || objective(next) >= objective(&point))
            else {
                failed = Some(status);
                break;
            };
            let slack = psi - next.signal;
            let is_slack = slack > next.energy * (1.0 + tolerance);
            psi = slack.max(next.energy);
            at_rest = distance(eta, &point, eta, &next) <= tolerance && !is_slack;
            point = next;
            if slot.sinr(&point) > slot.sinr(&best) {
                best = point.clone();
            }
            if at_rest {
                break;
            }
        }
        let change = (best.eta() - eta) / best.eta();
        let moved = distance(eta, &here, best.eta(), &best).hypot(change);
        here = best;
        if let Some(failure) = failed {
            status = ConicStatus::SolverFailed(failure);
            break;
        }
        if moved <= tolerance {
            if at_rest {
                status = ConicStatus::Solved;
            }
            break;
        }
    }
    slot.solution(status, &here, &peak, solves)
}

/// Returns the distance between two points in the variables of the stopping rule, `x_j = eta y_j`
/// and `eta^2 q`.
fn distance(eta: f64, from: &Point, eta_to: f64, to: &Point) -> f64 {
    let signal = eta_to * eta_to * to.signal - eta * eta * from.signal;
    let pairs = from.amplitude.iter().zip(&to.amplitude);
    pairs
        .fold(signal * signal, |sum, (a, b)| {
            let moved = eta_to * b - eta * a;
            sum + moved * moved
        })
        .sqrt()
}

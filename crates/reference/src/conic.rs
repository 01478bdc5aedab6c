//! The slot problem solved by a general convex solver, [Clarabel](clarabel): the reference
//! implementation that the closed form is compared with, and the paper's own method for eq:p_pbp.
//!
//! * [`bisect`] solves eq:p1 itself. For a given SINR the slot problem is a second-order-cone
//!   problem (`docs/mathematics.md`, section 3): minimize `||(1, y)||` for a given sum of
//!   amplitudes. Bisection over the SINR gives the global optimum.
//! * [`alternate`] is Alg. 1 with eq:p_pbp as printed: an exponential cone for the logarithm,
//!   second-order cones for the MSE and `Psi`.
//!
//! The only part shared with the closed form is the grid search for a scale: Clarabel needs numbers
//! near 1, while gains are near 1e-12. No result of Clarabel is used unchecked. Whatever its
//! status, the returned point is moved into its bounds, the user's power is what the MSE allows for
//! exactly these coefficients, and a point that does not meet `Gamma` is not a solution.

mod program;

use clarabel::solver::{
    SolverStatus,
    SupportedConeT::{ExponentialConeT, NonnegativeConeT, SecondOrderConeT, ZeroConeT},
};
use firmware_core::{
    PowerGain,
    inner::{LimitedBy, SlotLimits, alternating::AlternatingSettings},
};

use program::{Program, is_infeasible, is_solution};

/// The status of a solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ConicStatus {
    /// The optimum to the solver's accuracy ([`bisect`]), or the point where the iteration
    /// converged ([`alternate`]).
    Solved,
    /// The limit on iterations was reached; the constraints hold.
    IterationLimit,
    /// `Gamma` cannot be met.
    Infeasible,
    /// Clarabel gave up; the constraints hold for the best point before that.
    SolverFailed(SolverStatus),
}

/// A solution whose constraints were verified.
#[derive(Clone, Debug, PartialEq)]
pub struct ConicSolution {
    /// The status of the solution.
    pub status: ConicStatus,
    /// The rate `R`, bit/s/Hz.
    pub rate: f64,
    /// The user's power `p`, watts.
    pub user_power_w: f64,
    /// The sensors' coefficients `|b_j|`, square root of watts.
    pub sensor_coefficients: Vec<f64>,
    /// The normalizing factor `eta`, one over square root of watts.
    pub normalizing_factor: f64,
    /// The least MSE that the channels allow, as found by the solver.
    pub least_mse: f64,
    /// The constraint that limits the rate.
    pub limited_by: LimitedBy,
    /// The number of convex problems that were solved.
    pub solves: u32,
}

/// A slot problem in noise-normalized units.
#[derive(Clone, Debug)]
struct Slot<'a> {
    limits: &'a SlotLimits<f64>,
    gains: &'a [PowerGain<f64>],
    user_gain: f64,
    /// The largest amplitudes `a_j`, in the order of the gains.
    amplitude: Vec<f64>,
    /// The signal budget `Q`.
    budget: f64,
    kappa: f64,
}

/// A vector of amplitudes and the quantities computed from it.
#[derive(Clone, Debug)]
struct Point {
    amplitude: Vec<f64>,
    sum: f64,
    energy: f64,
    signal: f64,
}

impl Point {
    fn efficiency(&self) -> f64 {
        self.sum * (self.sum / self.energy)
    }

    fn sinr(&self) -> f64 {
        self.signal / self.energy
    }

    fn eta(&self) -> f64 {
        self.sum / (self.signal + self.energy)
    }
}

/// The relative width at which the bisection over the SINR ends.
const SINR_TOLERANCE: f64 = 1e-10;
/// A bisection from `J / kappa` to [`SINR_TOLERANCE`] takes about 50 steps.
const BISECTIONS_MAX: u32 = 200;

/// Solves eq:p1 by bisection over the SINR, with one second-order-cone problem per step. With a
/// gain of `None`, no user is served.
///
/// The slot must be one that [`firmware_core`] accepts.
pub fn bisect(
    limits: &SlotLimits<f64>,
    gains: &[PowerGain<f64>],
    user: Option<PowerGain<f64>>,
) -> ConicSolution {
    let slot = Slot::new(limits, gains, user);
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
    let (mut low, mut high) = (best.sinr(), slot.gains.len() as f64 / slot.kappa - 1.0);
    let mut failure = None;
    for _ in 0..BISECTIONS_MAX {
        if high - low <= SINR_TOLERANCE * high {
            break;
        }
        let sinr = 0.5 * (low + high);
        solves += 1;
        // The bound is tightened by more than the largest error of Clarabel, because the returned
        // point must reach this SINR exactly.
        let energy_max = slot.budget / sinr * (1.0 - 2e-9);
        let (status, rival) = slot.least_energy(scale, Some(energy_max));
        let rival = rival.map(|amplitude| slot.with_signal(amplitude));
        match rival {
            Some(rival) if rival.sinr() > best.sinr() => best = rival,
            _ => {}
        }
        low = low.max(best.sinr());
        if best.sinr() < sinr {
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
    settings: &AlternatingSettings<f64>,
) -> ConicSolution {
    let slot = Slot::new(limits, gains, user);
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
            if point.sinr() > best.sinr() {
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

impl<'a> Slot<'a> {
    fn new(
        limits: &'a SlotLimits<f64>,
        gains: &'a [PowerGain<f64>],
        user: Option<PowerGain<f64>>,
    ) -> Self {
        let per_noise = 1.0 / limits.noise_power.0;
        let amplitude =
            |gain: &PowerGain<f64>| (limits.sensor_power_max.0 * gain.0 * per_noise).sqrt();
        let user_gain = user.map_or(0.0, |gain| gain.0);
        Self {
            limits,
            gains,
            user_gain,
            amplitude: gains.iter().map(amplitude).collect(),
            budget: limits.user_power_max.0 * user_gain * per_noise,
            kappa: limits.kappa(gains.len()),
        }
    }

    /// Moves amplitudes into their bounds and returns the point with its sums, with no user served.
    fn silent(&self, mut amplitude: Vec<f64>) -> Point {
        for (y, &a) in amplitude.iter_mut().zip(&self.amplitude) {
            // `clamp` cannot be used, because it panics if an amplitude overflowed to NaN.
            *y = y.max(0.0).min(a);
        }
        Point {
            sum: amplitude.iter().sum(),
            energy: 1.0 + amplitude.iter().map(|y| y * y).sum::<f64>(),
            signal: 0.0,
            amplitude,
        }
    }

    /// Returns the point with the largest signal that the MSE allows for these amplitudes, or 0 if
    /// it allows none.
    fn with_signal(&self, amplitude: Vec<f64>) -> Point {
        let point = self.silent(amplitude);
        let slack = (point.efficiency() / self.kappa - 1.0) * point.energy;
        Point {
            signal: slack.min(self.budget).max(0.0),
            ..point
        }
    }

    /// Returns a common amplitude of the same order of magnitude as the solution: the best of a
    /// grid.
    fn scale(&self) -> f64 {
        let audible = || self.amplitude.iter().copied().filter(|&a| a > 0.0);
        let weakest = audible().fold(f64::INFINITY, f64::min);
        let strongest = audible().fold(0.0, f64::max);
        let steps = (strongest / weakest).log2().ceil().clamp(0.0, 200.0);
        let mut best = (0.0, 1.0);
        let mut level = weakest;
        for _ in 0..=steps as u32 {
            let capped = self.amplitude.iter().map(|a| a.min(level)).collect();
            let efficiency = self.silent(capped).efficiency();
            if efficiency > best.0 {
                best = (efficiency, level);
            }
            level *= 2.0;
        }
        best.1
    }

    /// Returns the amplitudes of least MSE, or the report of a slot that is infeasible.
    fn peak(&self, solves: &mut u32) -> Result<Point, ConicSolution> {
        let nothing = self.silent(vec![0.0; self.gains.len()]);
        if self.amplitude.iter().all(|&a| a <= 0.0) {
            return Err(self.solution(ConicStatus::Infeasible, &nothing, &nothing, *solves));
        }
        *solves += 1;
        let (status, amplitude) = self.least_energy(self.scale(), None);
        let Some(amplitude) = amplitude else {
            let status = ConicStatus::SolverFailed(status);
            return Err(self.solution(status, &nothing, &nothing, *solves));
        };
        let peak = self.silent(amplitude);
        if peak.efficiency() >= self.kappa {
            return Ok(peak);
        }
        let status = if is_solution(status) {
            ConicStatus::Infeasible
        } else {
            ConicStatus::SolverFailed(status)
        };
        Err(self.solution(status, &peak, &peak, *solves))
    }

    /// Returns the amplitudes of highest `A^2 / E`, with `E <= energy_max` if that is given.
    ///
    /// In `y = scale u / tau` (so that only ratios matter): minimize `n` with `sum u = J'`,
    /// `||(tau / scale, u)|| <= n`, `n <= sqrt(energy_max) / scale tau`, `0 <= u <= a / scale tau`,
    /// over the `J'` sensors that can be heard.
    fn least_energy(
        &self,
        scale: f64,
        energy_max: Option<f64>,
    ) -> (SolverStatus, Option<Vec<f64>>) {
        let heard: Vec<usize> = (0..self.amplitude.len())
            .filter(|&j| self.amplitude[j] > 0.0)
            .collect();
        let count = heard.len();
        let (tau, norm) = (count, count + 1);
        let mut program = Program::new(count + 2);
        program.objective[norm] = 1.0;
        program.row(
            &(0..count).map(|j| (j, 1.0)).collect::<Vec<_>>(),
            count as f64,
        );
        program.cone(ZeroConeT(1));
        for (u, &j) in heard.iter().enumerate() {
            program.row(&[(u, -1.0)], 0.0);
            program.row(&[(u, 1.0), (tau, -self.amplitude[j] / scale)], 0.0);
        }
        let mut bounds = 2 * count;
        if let Some(energy) = energy_max {
            program.row(&[(norm, 1.0), (tau, -energy.sqrt() / scale)], 0.0);
            bounds += 1;
        }
        program.cone(NonnegativeConeT(bounds));
        program.row(&[(norm, -1.0)], 0.0);
        program.row(&[(tau, -1.0 / scale)], 0.0);
        for u in 0..count {
            program.row(&[(u, -1.0)], 0.0);
        }
        program.cone(SecondOrderConeT(count + 2));
        let (status, x) = program.solve(1e-10);
        let usable = x.iter().all(|v| v.is_finite()) && x[tau] > 0.0 && !is_infeasible(status);
        let amplitude = usable.then(|| {
            let mut amplitude = vec![0.0; self.amplitude.len()];
            for (u, &j) in heard.iter().enumerate() {
                amplitude[j] = scale * x[u] / x[tau];
            }
            amplitude
        });
        (status, amplitude)
    }

    /// Solves eq:p_pbp as printed, for a given `eta` and `t = 1 / psi_before`, in `x_j = eta y_j`,
    /// `z = eta^2 q` and `Psi = eta^2 psi`: minimize `t Psi - w` with `w <= ln(z + Psi)`,
    /// `sum (x - 1)^2 + z + nu <= J^2 Gamma`, `sum x^2 + nu <= Psi` and the bounds.
    fn subproblem(&self, eta: f64, psi_before: f64) -> (SolverStatus, Option<Point>) {
        let sensors = self.amplitude.len();
        let (z, psi, w) = (sensors, sensors + 1, sensors + 2);
        let noise = eta * eta;
        let mut program = Program::new(sensors + 3);
        program.objective[psi] = 1.0 / (noise * psi_before);
        program.objective[w] = -1.0;
        for (j, &a) in self.amplitude.iter().enumerate() {
            program.row(&[(j, -1.0)], 0.0);
            // Above 1 + sqrt(J^2 Gamma), the MSE alone exceeds the threshold.
            program.row(&[(j, 1.0)], (eta * a).min(2.0 + (sensors as f64).sqrt()));
        }
        program.row(&[(z, -1.0)], 0.0);
        // The same holds for the interference.
        program.row(&[(z, 1.0)], (noise * self.budget).min(sensors as f64));
        program.cone(NonnegativeConeT(2 * sensors + 2));
        // ||v||^2 <= r is equivalent to ||(2 v, r - 1)|| <= r + 1.
        let slack = sensors as f64 - self.kappa - noise;
        program.row(&[(z, 1.0)], slack + 1.0);
        program.row(&[(z, 1.0)], slack - 1.0);
        for j in 0..sensors {
            program.row(&[(j, -2.0)], -2.0);
        }
        program.cone(SecondOrderConeT(sensors + 2));
        program.row(&[(psi, -1.0)], 1.0);
        program.row(&[(psi, -1.0)], -1.0);
        program.row(&[], 2.0 * eta);
        for j in 0..sensors {
            program.row(&[(j, -2.0)], 0.0);
        }
        program.cone(SecondOrderConeT(sensors + 3));
        // (w, 1, z + Psi): e^w <= z + Psi.
        program.row(&[(w, -1.0)], 0.0);
        program.row(&[], 1.0);
        program.row(&[(z, -1.0), (psi, -1.0)], 0.0);
        program.cone(ExponentialConeT());
        let (status, x) = program.solve(1e-8);
        if is_infeasible(status) || !x.iter().all(|v| v.is_finite()) {
            return (status, None);
        }
        let point = self.silent(x[..sensors].iter().map(|x| x / eta).collect());
        // The signal that this eta allows for exactly these amplitudes. Clarabel's own value may
        // exceed it by its tolerance.
        let slack = (2.0 * point.sum - self.kappa / eta) / eta - point.energy;
        let signal = (x[z] / noise).min(slack).min(self.budget).max(0.0);
        (status, Some(Point { signal, ..point }))
    }

    /// Returns the verified solution in watts. The user is silent unless the MSE of exactly these
    /// coefficients allows it to send.
    fn solution(
        &self,
        status: ConicStatus,
        point: &Point,
        peak: &Point,
        solves: u32,
    ) -> ConicSolution {
        let sensors = self.gains.len() as f64;
        let noise = self.limits.noise_power.0.sqrt();
        let b_max = self.limits.coefficient_max();
        let coefficient = |(y, gain): (&f64, &PowerGain<f64>)| {
            let amplitude = gain.amplitude();
            if amplitude > 0.0 {
                (y * noise / amplitude).min(b_max)
            } else {
                0.0
            }
        };
        let kept = point.efficiency() / self.kappa >= (1.0 + point.sinr()) * (1.0 - 1e-12);
        // A "solved" point that does not satisfy the threshold is not a solution.
        let status = if kept || status == ConicStatus::Infeasible {
            status
        } else {
            ConicStatus::SolverFailed(SolverStatus::NumericalError)
        };
        let feasible = kept && status != ConicStatus::Infeasible;
        let signal = if feasible { point.signal } else { 0.0 };
        let power = if self.user_gain > 0.0 {
            signal * self.limits.noise_power.0 / self.user_gain
        } else {
            0.0
        };
        ConicSolution {
            status,
            rate: (signal / point.energy).ln_1p() / core::f64::consts::LN_2,
            user_power_w: power.min(self.limits.user_power_max.0),
            sensor_coefficients: point
                .amplitude
                .iter()
                .zip(self.gains)
                .map(coefficient)
                .collect(),
            normalizing_factor: point.sum / ((signal + point.energy) * noise),
            least_mse: (sensors - peak.efficiency()) / (sensors * sensors),
            limited_by: if signal <= 0.0 {
                LimitedBy::None
            } else if signal >= self.budget {
                LimitedBy::Power
            } else {
                LimitedBy::Accuracy
            },
            solves,
        }
    }
}

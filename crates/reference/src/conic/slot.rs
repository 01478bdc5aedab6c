//! A slot problem in noise-normalized units, its cone programs, and the verified solution in watts.

use clarabel::solver::{
    SolverStatus,
    SupportedConeT::{ExponentialConeT, NonnegativeConeT, SecondOrderConeT, ZeroConeT},
};
use firmware_core::{
    PowerGain,
    inner::{LimitedBy, SlotLimits},
    uncertainty::{SensorUncertainty, SlotUncertainty},
};

use super::{
    program::{Program, is_infeasible, is_solution},
    solution::{ConicSolution, ConicStatus},
};

/// A slot problem in noise-normalized units. Where channels are not known exactly, the amplitudes are
/// `y'_j = sqrt(1 + eps_j) y_j`, each counts `w_j = rho_j / sqrt(1 + eps_j)` in the sum, and signals are
/// `(1 + eps_g) q`.
#[derive(Clone, Debug)]
pub(super) struct Slot<'a> {
    pub(super) limits: &'a SlotLimits<f64>,
    pub(super) gains: &'a [PowerGain<f64>],
    pub(super) user_gain: f64,
    /// The largest amplitudes, in the order of the gains.
    pub(super) amplitude: Vec<f64>,
    /// `sqrt(1 + eps_j)`.
    spread: Vec<f64>,
    /// `w_j`.
    weight: Vec<f64>,
    /// `eps_g`.
    user_error_variance: f64,
    /// The signal budget `(1 + eps_g) Q`.
    pub(super) budget: f64,
    pub(super) kappa: f64,
}

/// A vector of amplitudes and the quantities computed from it.
#[derive(Clone, Debug)]
pub(super) struct Point {
    pub(super) amplitude: Vec<f64>,
    pub(super) sum: f64,
    pub(super) energy: f64,
    pub(super) signal: f64,
}

impl Point {
    pub(super) fn efficiency(&self) -> f64 {
        self.sum * (self.sum / self.energy)
    }

    pub(super) fn eta(&self) -> f64 {
        self.sum / (self.signal + self.energy)
    }
}

impl<'a> Slot<'a> {
    pub(super) fn new(
        limits: &'a SlotLimits<f64>,
        gains: &'a [PowerGain<f64>],
        user: Option<PowerGain<f64>>,
        uncertainty: Option<&SlotUncertainty<'_, f64>>,
    ) -> Self {
        let per_noise = 1.0 / limits.noise_power.0;
        let sensors = match uncertainty {
            Some(uncertainty) => uncertainty.sensors().to_vec(),
            None => vec![SensorUncertainty::exactly_known(); gains.len()],
        };
        let spread: Vec<f64> = (sensors.iter())
            .map(|sensor| (1.0 + sensor.error_variance()).sqrt())
            .collect();
        let weight = (sensors.iter().zip(&spread))
            .map(|(sensor, spread)| sensor.coherence() / spread)
            .collect();
        let amplitude = |(gain, spread): (&PowerGain<f64>, &f64)| {
            spread * (limits.sensor_power_max.0 * gain.0 * per_noise).sqrt()
        };
        let user_error_variance = uncertainty.map_or(0.0, SlotUncertainty::user_error_variance);
        let user_gain = user.map_or(0.0, |gain| gain.0);
        Self {
            limits,
            gains,
            user_gain,
            amplitude: gains.iter().zip(&spread).map(amplitude).collect(),
            spread,
            weight,
            user_error_variance,
            budget: limits.user_power_max.0 * user_gain * per_noise * (1.0 + user_error_variance),
            kappa: limits.kappa(gains.len()),
        }
    }

    /// Returns the SINR `q / (E + eps_g q)` of a point.
    pub(super) fn sinr(&self, point: &Point) -> f64 {
        let q = point.signal / (1.0 + self.user_error_variance);
        q / (point.energy + self.user_error_variance * q)
    }

    /// Returns the largest SINR that any amplitudes allow.
    pub(super) fn sinr_max(&self) -> f64 {
        let signal_per_energy = self.gains.len() as f64 / self.kappa - 1.0;
        let q = signal_per_energy / (1.0 + self.user_error_variance);
        q / (1.0 + self.user_error_variance * q)
    }

    /// Returns the largest `E` with which the user's power allows this SINR.
    pub(super) fn energy_max(&self, sinr: f64) -> f64 {
        // q = sinr E / (1 - eps_g sinr) is at most Q.
        let excess = 1.0 + self.user_error_variance;
        self.budget * (1.0 - self.user_error_variance * sinr) / (excess * sinr)
    }

    /// Returns the status of a slot in which `Gamma` cannot be met.
    fn infeasible(&self) -> ConicStatus {
        // J - sum w_j^2, term by term: 0 where the channels are known exactly.
        let missing: f64 = self.weight.iter().map(|w| 1.0 - w * w).sum();
        if missing > 0.0 && missing >= self.gains.len() as f64 - self.kappa {
            ConicStatus::ErrorFloor
        } else {
            ConicStatus::Infeasible
        }
    }

    /// Moves amplitudes into their bounds and returns the point with its sums, with no user served.
    fn silent(&self, mut amplitude: Vec<f64>) -> Point {
        for (y, &a) in amplitude.iter_mut().zip(&self.amplitude) {
            // `clamp` cannot be used, because it panics if an amplitude overflowed to NaN.
            *y = y.max(0.0).min(a);
        }
        Point {
            sum: (amplitude.iter().zip(&self.weight))
                .map(|(y, w)| w * y)
                .sum(),
            energy: 1.0 + amplitude.iter().map(|y| y * y).sum::<f64>(),
            signal: 0.0,
            amplitude,
        }
    }

    /// Returns the point with the largest signal that the MSE allows for these amplitudes, or 0 if
    /// it allows none.
    pub(super) fn with_signal(&self, amplitude: Vec<f64>) -> Point {
        let point = self.silent(amplitude);
        let slack = (point.efficiency() / self.kappa - 1.0) * point.energy;
        Point {
            signal: slack.min(self.budget).max(0.0),
            ..point
        }
    }

    /// Returns a common amplitude of the same order of magnitude as the solution: the best of a
    /// grid.
    pub(super) fn scale(&self) -> f64 {
        let levels = || self.amplitude.iter().zip(&self.weight).map(|(a, w)| a / w);
        let audible = || levels().filter(|&level| level > 0.0 && level.is_finite());
        let weakest = audible().fold(f64::INFINITY, f64::min);
        let strongest = audible().fold(0.0, f64::max);
        let steps = (strongest / weakest).log2().ceil().clamp(0.0, 200.0);
        let mut best = (0.0, 1.0);
        let mut level = weakest;
        for _ in 0..=steps as u32 {
            let capped = (self.amplitude.iter().zip(&self.weight))
                .map(|(a, w)| a.min(level * w))
                .collect();
            let efficiency = self.silent(capped).efficiency();
            if efficiency > best.0 {
                best = (efficiency, level);
            }
            level *= 2.0;
        }
        best.1
    }

    /// Returns the amplitudes of least MSE, or the report of a slot that is infeasible.
    pub(super) fn peak(&self, solves: &mut u32) -> Result<Point, ConicSolution> {
        let nothing = self.silent(vec![0.0; self.gains.len()]);
        if self.amplitude.iter().all(|&a| a <= 0.0) {
            return Err(self.solution(self.infeasible(), &nothing, &nothing, *solves));
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
            self.infeasible()
        } else {
            ConicStatus::SolverFailed(status)
        };
        Err(self.solution(status, &peak, &peak, *solves))
    }

    /// Returns the amplitudes of highest `A^2 / E`, with `E <= energy_max` if that is given.
    ///
    /// In `y' = scale u / tau` (so that only ratios matter): minimize `n` with `sum w u = J'`,
    /// `||(tau / scale, u)|| <= n`, `n <= sqrt(energy_max) / scale tau`, `0 <= u <= a / scale tau`,
    /// over the `J'` sensors that can be heard.
    pub(super) fn least_energy(
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
            &(heard.iter().enumerate())
                .map(|(u, &j)| (u, self.weight[j]))
                .collect::<Vec<_>>(),
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
    /// `sum (x - 1)^2 + z + nu <= J^2 Gamma`, `sum x^2 + nu <= Psi` and the bounds. With errors the
    /// MSE's bound is `sum (x'_j - w_j)^2 + z + nu <= J^2 Gamma - sum (1 - w_j^2)`.
    pub(super) fn subproblem(&self, eta: f64, psi_before: f64) -> (SolverStatus, Option<Point>) {
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
        let weights: f64 = self.weight.iter().map(|w| w * w).sum();
        let slack = weights - self.kappa - noise;
        program.row(&[(z, 1.0)], slack + 1.0);
        program.row(&[(z, 1.0)], slack - 1.0);
        for (j, w) in self.weight.iter().enumerate() {
            program.row(&[(j, -2.0)], -2.0 * w);
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
    pub(super) fn solution(
        &self,
        status: ConicStatus,
        point: &Point,
        peak: &Point,
        solves: u32,
    ) -> ConicSolution {
        let sensors = self.gains.len() as f64;
        let noise = self.limits.noise_power.0.sqrt();
        let b_max = self.limits.coefficient_max();
        let coefficient = |((y, gain), spread): ((&f64, &PowerGain<f64>), &f64)| {
            let amplitude = gain.amplitude() * spread;
            if amplitude > 0.0 {
                (y * noise / amplitude).min(b_max)
            } else {
                0.0
            }
        };
        let kept =
            point.efficiency() / self.kappa >= (1.0 + point.signal / point.energy) * (1.0 - 1e-12);
        // A "solved" point that does not satisfy the threshold is not a solution.
        let status = if kept || status.is_infeasible() {
            status
        } else {
            ConicStatus::SolverFailed(SolverStatus::NumericalError)
        };
        let feasible = kept && !status.is_infeasible();
        let signal = if feasible { point.signal } else { 0.0 };
        let power = if self.user_gain > 0.0 {
            signal / (1.0 + self.user_error_variance) * self.limits.noise_power.0 / self.user_gain
        } else {
            0.0
        };
        ConicSolution {
            status,
            rate: self
                .sinr(&Point {
                    signal,
                    ..point.clone()
                })
                .ln_1p()
                / core::f64::consts::LN_2,
            user_power_w: power.min(self.limits.user_power_max.0),
            sensor_coefficients: point
                .amplitude
                .iter()
                .zip(self.gains)
                .zip(&self.spread)
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

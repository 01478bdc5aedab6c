//! The signals of one slot, drawn and superposed as in eq:yr.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

use firmware_core::aircomp;
use nalgebra::Complex;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// The statistics of the difference between a true channel and its estimate. The difference is drawn
/// independently for each symbol, so the mean over many symbols tends to the expectation of
/// docs/mathematics.md, section 10.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ChannelError {
    /// The variance of the error, relative to the gain of the estimate.
    pub(super) variance: f64,
    /// The standard deviation of the phase error, rad.
    pub(super) phase_rad: f64,
}

impl ChannelError {
    /// Returns the true channel over its estimate, in one symbol. Without errors nothing is drawn.
    fn draw(&self, random: &mut Pcg64) -> Complex<f64> {
        let mut factor = Complex::new(1.0, 0.0);
        if self.variance > 0.0 {
            factor += unit_symbol(random) * self.variance.sqrt();
        }
        if self.phase_rad > 0.0 {
            let normal: f64 = StandardNormal.sample(random);
            factor *= polar(1.0, normal * self.phase_rad);
        }
        factor
    }
}

/// The channels of one slot as complex numbers.
pub(super) struct Air {
    /// `b_j h_j` with the estimated channels, including the phases.
    sensors: Vec<Complex<f64>>,
    /// `g sqrt(p)`.
    user: Complex<f64>,
    /// `sigma`.
    noise_amplitude: f64,
    /// The errors of the sensors' estimates; empty if they have none.
    errors: Vec<ChannelError>,
    user_error: ChannelError,
}

impl Air {
    /// Draws the phases. The coefficient of each sensor has the conjugate phase of its estimated
    /// channel.
    pub(super) fn new(
        slot: &aircomp::Slot<'_, f64>,
        (errors, user_error): (Vec<ChannelError>, ChannelError),
        random: &mut Pcg64,
    ) -> Self {
        let mut phase = || random.random_range(0.0..TAU);
        let sensors = slot.sensor_gains.iter().zip(slot.sensor_coefficients);
        let sensors = sensors
            .map(|(gain, &coefficient)| {
                let phase = phase();
                let h = polar(gain.amplitude(), phase);
                let b = polar(coefficient, -phase);
                b * h
            })
            .collect();
        Self {
            sensors,
            user: polar(slot.user_gain.amplitude(), phase()) * slot.user_power.0.sqrt(),
            noise_amplitude: slot.noise_power.0.sqrt(),
            errors,
            user_error,
        }
    }

    /// Returns the received signal of eq:yr: the sensors send `symbols`, the user sends a symbol of
    /// its own, and the receiver adds noise.
    pub(super) fn superpose(&self, symbols: &[Complex<f64>], random: &mut Pcg64) -> Complex<f64> {
        let signals = self.sensors.iter().zip(symbols).map(|(a, o)| a * o);
        let sensors: Complex<f64> = match self.errors.as_slice() {
            [] => signals.sum(),
            errors => (signals.zip(errors))
                .map(|(signal, error)| signal * error.draw(random))
                .sum(),
        };
        let user = match self.user_error.variance > 0.0 {
            true => self.user * self.user_error.draw(random),
            false => self.user,
        };
        sensors + user * unit_symbol(random) + unit_symbol(random) * self.noise_amplitude
    }
}

/// Returns `magnitude e^(i phase)`.
fn polar(magnitude: f64, phase: f64) -> Complex<f64> {
    Complex::new(phase.cos(), phase.sin()) * magnitude
}

/// Draws a circular complex Gaussian of mean 0 and variance 1.
pub(super) fn unit_symbol(random: &mut Pcg64) -> Complex<f64> {
    let mut part = || -> f64 { StandardNormal.sample(&mut *random) };
    Complex::new(part(), part()) * FRAC_1_SQRT_2
}

//! Random fields over the position of the vehicle. The channel depends on the position alone: a vehicle
//! that returns to a position has the same channel there, and one that hovers does not fade.
//!
//! A field is a sum of plane waves whose directions, wave numbers and phases are drawn once. With
//! many waves it is Gaussian (central limit), with mean 0, variance 1 and the covariance whose spectrum
//! the wave numbers are drawn from.

use std::f64::consts::TAU;

use firmware_core::Position;
use nalgebra::Complex;
use rand::RngExt;
use rand_pcg::Pcg64;

/// The number of plane waves. The fourth moment is `3 - 1.5 / WAVES`; a Gaussian's is 3.
const WAVES: usize = 64;

/// A plane wave.
#[derive(Clone, Copy, Debug)]
struct Wave {
    /// The wave vector, rad/m.
    east: f64,
    north: f64,
    /// The phase at `[0, 0]`, rad.
    phase: f64,
}

impl Wave {
    fn draw(wave_number: f64, random: &mut Pcg64) -> Self {
        let (north, east) = random.random_range(0.0..TAU).sin_cos();
        Self {
            east: wave_number * east,
            north: wave_number * north,
            phase: random.random_range(0.0..TAU),
        }
    }

    /// Returns its phase at a place, rad.
    fn phase_at(&self, place: &Position<f64>) -> f64 {
        self.east * place.x + self.north * place.y + self.phase
    }
}

/// A real field whose covariance is `exp(-d / decorrelation)`, Gudmundson's model of shadowing.
#[derive(Clone, Debug)]
pub(super) struct Shadowing {
    waves: [Wave; WAVES],
}

impl Shadowing {
    /// Draws a field. The spectrum of `exp(-d / D)` in the plane is proportional to `(1 + (k D)^2)^(-3/2)`:
    /// a wave number is at least `k` with probability `(1 + (k D)^2)^(-1/2)`.
    pub(super) fn draw(decorrelation_m: f64, random: &mut Pcg64) -> Self {
        let waves = std::array::from_fn(|index| {
            // One draw of each of equal parts of the distribution: fewer waves suffice.
            let share = (index as f64 + random.random::<f64>()) / WAVES as f64;
            let tail = (1.0 - share).max(1e-6);
            let wave_number = (tail.powi(-2) - 1.0).sqrt() / decorrelation_m;
            Wave::draw(wave_number, random)
        });
        Self { waves }
    }

    /// Returns the field at a place, in standard deviations.
    pub(super) fn at(&self, place: &Position<f64>) -> f64 {
        let sum: f64 = self
            .waves
            .iter()
            .map(|wave| wave.phase_at(place).cos())
            .sum();
        sum * (2.0 / WAVES as f64).sqrt()
    }
}

/// A complex field of scattered paths from all directions (Clarke's model): its covariance is
/// `J_0(2 pi d / wavelength)`, which is first 0 at 0.38 wavelengths.
#[derive(Clone, Debug)]
pub(super) struct Scattering {
    waves: [Wave; WAVES],
}

impl Scattering {
    /// Draws a field whose wavelength is twice `decorrelation_m`.
    pub(super) fn draw(decorrelation_m: f64, random: &mut Pcg64) -> Self {
        let wave_number = TAU / (2.0 * decorrelation_m);
        Self {
            waves: std::array::from_fn(|_| Wave::draw(wave_number, random)),
        }
    }

    /// Returns the field at a place; the mean of its squared magnitude is 1.
    pub(super) fn at(&self, place: &Position<f64>) -> Complex<f64> {
        let sum: Complex<f64> = self
            .waves
            .iter()
            .map(|wave| {
                let (im, re) = wave.phase_at(place).sin_cos();
                Complex::new(re, im)
            })
            .sum();
        sum / (WAVES as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    const FIELDS: u64 = 4000;

    fn fields<F>(draw: impl Fn(&mut Pcg64) -> F) -> Vec<F> {
        (0..FIELDS)
            .map(|seed| draw(&mut Pcg64::seed_from_u64(seed)))
            .collect()
    }

    /// Mean, variance, kurtosis and covariance over many fields, at places anywhere.
    #[test]
    fn shadowing_is_gaussian_with_an_exponential_covariance() {
        let fields = fields(|random| Shadowing::draw(50.0, random));
        let mean =
            |f: &dyn Fn(&Shadowing) -> f64| fields.iter().map(f).sum::<f64>() / fields.len() as f64;
        let here = Position::new(730.0, 210.0);
        let tolerance = 5.0 / (FIELDS as f64).sqrt();
        assert!(mean(&|field| field.at(&here)).abs() < tolerance);
        assert!((mean(&|field| field.at(&here).powi(2)) - 1.0).abs() < 1.5 * tolerance);
        assert!((mean(&|field| field.at(&here).powi(4)) - 3.0).abs() < 10.0 * tolerance);
        for distance_m in [5.0, 25.0, 50.0, 100.0, 400.0] {
            let there = here + nalgebra::Vector2::new(0.6, 0.8) * distance_m;
            let covariance = mean(&|field| field.at(&here) * field.at(&there));
            let expected = (-distance_m / 50.0_f64).exp();
            assert!(
                (covariance - expected).abs() < tolerance,
                "{distance_m}: {covariance}"
            );
        }
    }

    #[test]
    fn scattering_has_unit_power_and_clarkes_correlation() {
        let fields = fields(|random| Scattering::draw(0.06, random));
        let here = Position::new(10.0, 20.0);
        let correlation = |distance_m: f64| {
            let there = here + nalgebra::Vector2::new(distance_m, 0.0);
            let products = fields.iter().map(|f| f.at(&here) * f.at(&there).conj());
            products.sum::<Complex<f64>>() / fields.len() as f64
        };
        assert!((correlation(0.0).re - 1.0).abs() < 0.08);
        // J_0 at pi/2 and pi.
        assert!((correlation(0.03).re - 0.472).abs() < 0.08);
        assert!((correlation(0.06).re + 0.304).abs() < 0.08);
        assert!(correlation(5.0).norm() < 0.08);
    }
}

//! Pre-processing and post-processing of a nomographic function (eq:F): `psi` at every sensor and
//! `Xi` at the vehicle, before and after the average that is computed over the air.
//!
//! Over-the-air computation needs symbols of mean 0 and variance 1, and gives `F-hat`, an estimate
//! of their average. With `u_j` the quantity whose arithmetic mean is wanted,
//!
//! ```text
//! psi_j(d) = (u_j(d) - mean) / deviation        Xi(F) = v( mean + deviation * F )
//!
//! mean            u_j(d) = d               v(a) = a
//! weighted mean   u_j(d) = J w_j d         v(a) = a         weights scaled to a sum of 1
//! geometric mean  u_j(d) = ln d            v(a) = e^a
//! ```
//!
//! `mean` and `deviation` are those of all measurements of the mission: statistics that a network
//! knows in advance.

use scenario::Function;

/// `psi` and `Xi` for one mission.
#[derive(Clone, Debug, PartialEq)]
pub struct Nomographic {
    function: Function,
    /// `J w_j` for the weighted mean, otherwise 1.
    scale: Vec<f64>,
    mean: f64,
    deviation: f64,
}

impl Nomographic {
    /// Creates the processing for a function (with its weights, if it has any) of these
    /// measurements, indexed by slot and sensor.
    pub fn new(function: Function, weights: &[f64], measurements: &[Vec<f64>]) -> Self {
        let sensors = measurements.first().map_or(0, Vec::len);
        let scale = if function == Function::WeightedMean {
            let total: f64 = weights.iter().sum();
            let scaled = weights.iter().map(|weight| weight / total * sensors as f64);
            scaled.collect()
        } else {
            vec![1.0; sensors]
        };
        let mut this = Self {
            function,
            scale,
            mean: 0.0,
            deviation: 1.0,
        };
        let quantities: Vec<f64> = measurements
            .iter()
            .flat_map(|row| this.quantities(row))
            .collect();
        let count = quantities.len().max(1) as f64;
        this.mean = quantities.iter().sum::<f64>() / count;
        let squares = quantities.iter().map(|u| (u - this.mean).powi(2));
        let deviation = (squares.sum::<f64>() / count).sqrt();
        // A constant field has a deviation of zero; any scale is valid then.
        this.deviation = if deviation > 0.0 { deviation } else { 1.0 };
        this
    }

    /// Returns `u_j(d_j)` of a slot's measurements.
    fn quantities(&self, measured: &[f64]) -> Vec<f64> {
        let value = |(d, scale): (&f64, &f64)| match self.function {
            Function::GeometricMean => d.ln(),
            Function::Mean | Function::WeightedMean => scale * d,
        };
        measured.iter().zip(&self.scale).map(value).collect()
    }

    /// Returns `o_j = psi_j(d_j)`, the symbols of a slot's measurements.
    pub fn pre_process(&self, measured: &[f64]) -> Vec<f64> {
        let symbol = |u: f64| (u - self.mean) / self.deviation;
        self.quantities(measured).into_iter().map(symbol).collect()
    }

    /// Applies `Xi`: converts the average of the symbols to the scenario's unit.
    pub fn post_process(&self, average: f64) -> f64 {
        let average = self.mean + self.deviation * average;
        match self.function {
            Function::GeometricMean => average.exp(),
            Function::Mean | Function::WeightedMean => average,
        }
    }

    /// Returns the value that a receiver without noise would compute.
    pub fn true_value(&self, measured: &[f64]) -> f64 {
        let symbols = self.pre_process(measured);
        self.post_process(symbols.iter().sum::<f64>() / symbols.len().max(1) as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_function_comes_back_in_its_unit() {
        let rows = [vec![1.0, 2.0, 4.0], vec![3.0, 5.0, 7.0]];
        let cases = [
            (Function::Mean, vec![], 7.0 / 3.0),
            (Function::WeightedMean, vec![2.0, 1.0, 1.0], 2.0),
            (Function::GeometricMean, vec![], 2.0),
        ];
        for (function, weights, expected) in cases {
            let function = Nomographic::new(function, &weights, &rows);
            assert!((function.true_value(&rows[0]) - expected).abs() < 1e-12);
            let symbols: Vec<f64> = rows
                .iter()
                .flat_map(|row| function.pre_process(row))
                .collect();
            let mean = symbols.iter().sum::<f64>() / 6.0;
            let variance = symbols.iter().map(|o| o * o).sum::<f64>() / 6.0;
            assert!(mean.abs() < 1e-12 && (variance - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_constant_field_is_carried() {
        let rows = [vec![5.0, 5.0]];
        let function = Nomographic::new(Function::Mean, &[], &rows);
        assert_eq!(function.true_value(&rows[0]), 5.0);
    }
}

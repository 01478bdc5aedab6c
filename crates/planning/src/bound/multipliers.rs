//! The fairness prices: minimizes the dual function over the multipliers.
//!
//! The dual function is convex and piecewise linear. Its subgradient at a best path is, for each
//! user, the number of slots that the path assigns to the user minus the user's quota. Steps follow
//! Polyak's rule towards a target slightly below the best value so far, along deflected
//! subgradients (Camerini, Fratta and Maffioli), which do not zigzag across the function's creases.
//! The distance to the target shrinks whenever the value does not improve.

/// A value of the dual function and a subgradient at the same point.
#[derive(Clone, Debug)]
pub(crate) struct DualPoint {
    pub(crate) value: f64,
    pub(crate) subgradient: Vec<f64>,
}

/// The stopping criteria of a descent.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Descent {
    pub(crate) iterations: usize,
    /// The first distance to the target, relative to the value.
    pub(crate) ambition: f64,
    /// The descent ends when the relative distance falls below this value.
    pub(crate) least_ambition: f64,
    /// The descent ends when the value is at most this.
    pub(crate) enough: f64,
    /// Whether multipliers may be negative: true if every mission meets each quota exactly.
    pub(crate) free_sign: bool,
}

/// The number of iterations without progress after which the distance is halved.
const PATIENCE: usize = 4;

impl Descent {
    /// Improves `multipliers`. Returns the best value found, with `multipliers` set to where it was
    /// found. Ends early when `stop` returns true.
    pub(crate) fn run(
        &self,
        multipliers: &mut Vec<f64>,
        mut dual: impl FnMut(&[f64]) -> DualPoint,
        stop: impl Fn() -> bool,
    ) -> f64 {
        let mut here = multipliers.clone();
        let mut best = dual(&here);
        let mut point = best.clone();
        let mut direction = vec![0.0; here.len()];
        let mut ambition = self.ambition;
        let mut fruitless = 0;
        for _ in 1..self.iterations {
            if best.value <= self.enough || stop() {
                break;
            }
            self.step(&mut here, &mut direction, &point, best.value, ambition);
            point = dual(&here);
            if best.value - point.value > 0.1 * ambition * best.value.abs() {
                fruitless = 0;
            } else {
                fruitless += 1;
            }
            if point.value < best.value {
                best = point.clone();
                multipliers.clone_from(&here);
            }
            if fruitless > PATIENCE {
                fruitless = 0;
                ambition *= 0.5;
                if ambition < self.least_ambition {
                    break;
                }
                here.clone_from(multipliers);
                point = best.clone();
                direction.fill(0.0);
            }
        }
        best.value
    }

    fn step(
        &self,
        here: &mut [f64],
        direction: &mut [f64],
        point: &DualPoint,
        best: f64,
        ambition: f64,
    ) {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let length = dot(direction, direction);
        let against = dot(&point.subgradient, direction);
        let keep = if length > 0.0 {
            (-1.5 * against / length).max(0.0)
        } else {
            0.0
        };
        for (direction, slope) in direction.iter_mut().zip(&point.subgradient) {
            *direction = slope + keep * *direction;
        }
        let length = dot(direction, direction);
        if length <= 0.0 {
            return;
        }
        let target = best - ambition * best.abs();
        let step = (point.value - target) / length;
        for (multiplier, direction) in here.iter_mut().zip(direction.iter()) {
            *multiplier -= step * direction;
            if !self.free_sign {
                *multiplier = multiplier.max(0.0);
            }
        }
        if self.free_sign {
            // A common shift does not change the value. Subtracting the mean keeps the numbers
            // small.
            let mean = here.iter().sum::<f64>() / here.len() as f64;
            here.iter_mut().for_each(|multiplier| *multiplier -= mean);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The maximum of a few planes in two dimensions, with its minimum at the origin.
    #[test]
    fn finds_the_bottom_of_a_crease() {
        let planes = [[1.0, 0.2], [-1.0, 0.1], [0.1, 1.0], [0.0, -1.0]];
        let dual = |at: &[f64]| {
            let value = |plane: &[f64; 2]| 10.0 + plane[0] * at[0] + plane[1] * at[1];
            let steepest = planes
                .iter()
                .max_by(|a, b| value(a).total_cmp(&value(b)))
                .unwrap_or(&planes[0]);
            DualPoint {
                value: value(steepest),
                subgradient: steepest.to_vec(),
            }
        };
        let descent = Descent {
            iterations: 500,
            ambition: 0.1,
            least_ambition: 1e-7,
            enough: f64::NEG_INFINITY,
            free_sign: false,
        };
        let mut multipliers = vec![3.0, 2.0];
        assert!(descent.run(&mut multipliers, dual, || false) < 10.0 + 1e-3);
    }
}

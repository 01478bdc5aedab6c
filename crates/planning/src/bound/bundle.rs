//! A bundle method for the fairness prices: few evaluations, for leaves that are solved often.
//!
//! Every evaluation of the dual function gives a plane below it (a *cut*). The next prices minimize
//! the largest cut plus a proximity term `||lambda - center||^2 / (2 t)`. Where the dual function
//! falls by a good part of what the cuts promise, they become the center, and `t` grows; otherwise
//! the new cut makes the model better there, and `t` may fall. (Kiwiel, Proximity control in bundle
//! methods, 1990.)

use super::multipliers::DualPoint;

/// The stopping criteria of a bundle descent.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bundle {
    /// The largest number of evaluations.
    pub(crate) evaluations: usize,
    /// The decrease of the value that the first step aims at, relative to the value.
    pub(crate) first_step: f64,
    /// The descent ends when the cuts promise less than this, relative to the value.
    pub(crate) accuracy: f64,
    /// The descent ends when the value is at most this.
    pub(crate) enough: f64,
    /// Whether multipliers may be negative.
    pub(crate) free_sign: bool,
}

/// A plane below the dual function: `offset + slope . lambda`.
struct Cut {
    offset: f64,
    slope: Vec<f64>,
    /// Its weight in the solution of the proximal problem. The weights sum to 1.
    weight: f64,
}

/// The part of the promised decrease that moves the center.
const SERIOUS: f64 = 0.1;
/// The factor of the step where the cuts promise too little within it.
const RECOVERY: f64 = 8.0;
/// The step, relative to the first one, at which the descent ends if the cuts promise too little.
const LARGEST_STEP: f64 = 1e4;
/// The largest number of exchanges of weight in one proximal problem.
const EXCHANGES: usize = 400;

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Cut {
    fn at(&self, multipliers: &[f64]) -> f64 {
        self.offset + dot(&self.slope, multipliers)
    }
}

impl Bundle {
    /// Improves `multipliers`. Returns the best value found, with `multipliers` set to where it was
    /// found. Ends early when `stop` returns true.
    pub(crate) fn run(
        &self,
        multipliers: &mut Vec<f64>,
        mut dual: impl FnMut(&[f64]) -> DualPoint,
        stop: impl Fn() -> bool,
    ) -> f64 {
        let point = dual(multipliers);
        let mut best = point.value;
        let length = dot(&point.subgradient, &point.subgradient);
        if length <= 0.0 {
            return best;
        }
        let mut step = self.first_step * best.abs() / length;
        let largest_step = LARGEST_STEP * step;
        let mut cuts = vec![cut(&point, multipliers, 1.0)];
        let mut nulls = 0;
        for _ in 1..self.evaluations {
            if best <= self.enough || stop() {
                break;
            }
            let next = self.proximal(&mut cuts, multipliers, step);
            let model = cuts
                .iter()
                .map(|cut| cut.at(&next))
                .fold(f64::MIN, f64::max);
            let promised = best - model;
            if promised <= self.accuracy * best.abs() {
                // A short step promises little, whatever the cuts say of prices further away.
                if step >= largest_step {
                    break;
                }
                step = (step * RECOVERY).min(largest_step);
                continue;
            }
            let point = dual(&next);
            cuts.push(cut(&point, &next, 0.0));
            if best - point.value >= SERIOUS * promised {
                if best - point.value >= 0.5 * promised {
                    step *= 2.0;
                }
                best = point.value;
                *multipliers = next;
                nulls = 0;
            } else {
                nulls += 1;
                if nulls % 3 == 0 {
                    step *= 0.6;
                }
                if point.value < best {
                    best = point.value;
                    *multipliers = next;
                }
            }
        }
        best
    }

    /// Solves the proximal problem in its dual form: exchanges weight between the cut that is
    /// largest at the present solution and the smallest one that has weight.
    fn proximal(&self, cuts: &mut [Cut], center: &[f64], step: f64) -> Vec<f64> {
        let mut slope = vec![0.0; center.len()];
        for cut in cuts.iter() {
            for (slope, own) in slope.iter_mut().zip(&cut.slope) {
                *slope += cut.weight * own;
            }
        }
        let solution = |slope: &[f64]| -> Vec<f64> {
            let moved = center
                .iter()
                .zip(slope)
                .map(|(center, slope)| center - step * slope);
            moved
                .map(|x| if self.free_sign { x } else { x.max(0.0) })
                .collect()
        };
        let mut at = solution(&slope);
        for _ in 0..EXCHANGES {
            let (mut high, mut low) = ((0, f64::MIN), (0, f64::MAX));
            for (index, cut) in cuts.iter().enumerate() {
                let value = cut.at(&at);
                if value > high.1 {
                    high = (index, value);
                }
                if cut.weight > 0.0 && value < low.1 {
                    low = (index, value);
                }
            }
            let excess = high.1 - low.1;
            if excess <= 0.1 * self.accuracy * high.1.abs() || high.0 == low.0 {
                break;
            }
            let difference: Vec<f64> = cuts[high.0]
                .slope
                .iter()
                .zip(&cuts[low.0].slope)
                .map(|(high, low)| high - low)
                .collect();
            let curvature = step * dot(&difference, &difference);
            let most = cuts[low.0].weight;
            let moved = if curvature > 0.0 {
                (excess / curvature).min(most)
            } else {
                most
            };
            cuts[high.0].weight += moved;
            cuts[low.0].weight = if moved >= most { 0.0 } else { most - moved };
            for (slope, difference) in slope.iter_mut().zip(&difference) {
                *slope += moved * difference;
            }
            at = solution(&slope);
        }
        at
    }
}

fn cut(point: &DualPoint, at: &[f64], weight: f64) -> Cut {
    Cut {
        offset: point.value - dot(&point.subgradient, at),
        slope: point.subgradient.clone(),
        weight,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// The largest of many random planes in twelve dimensions, whose least value is known: the
    /// slopes come in opposite pairs, so that the minimum is where all pairs meet.
    #[test]
    fn comes_near_the_least_value_in_few_evaluations() {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(7);
        for free_sign in [true, false] {
            let bottom: Vec<f64> = (0..12).map(|_| rng.random_range(0.1..1.0)).collect();
            let slopes: Vec<Vec<f64>> = (0..40)
                .map(|_| (0..12).map(|_| rng.random_range(-5.0..5.0)).collect())
                .collect();
            let dual = |at: &[f64]| {
                let away: Vec<f64> = at.iter().zip(&bottom).map(|(a, b)| a - b).collect();
                let rises = slopes.iter().map(|slope| (dot(slope, &away), slope));
                let (rise, slope) = rises
                    .max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
                    .expect("planes");
                DualPoint {
                    value: 100.0 + rise.abs(),
                    subgradient: slope.iter().map(|slope| slope * rise.signum()).collect(),
                }
            };
            let bundle = Bundle {
                evaluations: 100,
                first_step: 0.01,
                accuracy: 1e-5,
                enough: f64::NEG_INFINITY,
                free_sign,
            };
            let mut multipliers = vec![0.0; 12];
            let first = dual(&multipliers).value;
            let best = bundle.run(&mut multipliers, dual, || false);
            assert_eq!(best, dual(&multipliers).value);
            assert!(free_sign || multipliers.iter().all(|&price| price >= 0.0));
            assert!(first > 105.0 && best < 100.5, "{first} {best}");
        }
    }

    /// The dual function falls steeply at first and then slowly along a valley: the short step that
    /// the steep wall asks for does not end the descent.
    #[test]
    fn a_short_step_does_not_end_the_descent() {
        let dual = |at: &[f64]| {
            let planes = [
                (1000.0 * at[0], vec![1000.0, 0.0]),
                (-1000.0 * at[0], vec![-1000.0, 0.0]),
                (1.0 - at[1], vec![0.0, -1.0]),
                (at[1] - 1.0, vec![0.0, 1.0]),
            ];
            let highest = planes.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
            let (rise, subgradient) = highest.expect("planes");
            DualPoint {
                value: 100.0 + rise,
                subgradient,
            }
        };
        let bundle = Bundle {
            evaluations: 100,
            first_step: 0.01,
            accuracy: 1e-3,
            enough: f64::NEG_INFINITY,
            free_sign: true,
        };
        let best = bundle.run(&mut vec![5.0, -20.0], dual, || false);
        assert!(best < 100.2, "{best}");
    }

    /// A descent that is stopped, or whose value is small enough, has evaluated once.
    #[test]
    fn ends_early() {
        let bundle = Bundle {
            evaluations: 100,
            first_step: 0.01,
            accuracy: 1e-5,
            enough: f64::NEG_INFINITY,
            free_sign: false,
        };
        for (enough, stopped) in [(2.0, false), (f64::NEG_INFINITY, true)] {
            let mut evaluations = 0;
            let dual = |at: &[f64]| {
                evaluations += 1;
                DualPoint {
                    value: 1.0 + at[0],
                    subgradient: vec![1.0],
                }
            };
            let best = Bundle { enough, ..bundle }.run(&mut vec![1.0], dual, || stopped);
            assert_eq!((best, evaluations), (2.0, 1));
        }
    }
}

// SPDX-License-Identifier: MIT OR Apache-2.0
//! The slot problem: constraints, optimality and guarantees.

use firmware_core::{
    PowerGain, Watt,
    aircomp::Slot,
    inner::{
        Method, SlotLimits, Status, Workspace,
        bounded::{GainBounds, Guarantee},
    },
};

use crate::choices::{Choices, each};

const SENSORS: usize = 3;
const GAINS: [f64; 5] = [0.0, 1e-14, 4e-12, 1e-9, 1.0];
/// Coefficients and powers, as fractions of the largest.
const FRACTIONS: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// What rounding may change.
const TOLERANCE: f64 = 1e-9;

fn limits(choices: &mut Choices) -> SlotLimits<f64> {
    SlotLimits {
        sensor_power_max: Watt(0.05),
        user_power_max: Watt(0.2),
        noise_power: Watt(3.162e-13),
        mse_threshold: choices.of(&[0.01, 0.1, 0.3]),
    }
}

fn gains(choices: &mut Choices, most: usize) -> Vec<f64> {
    let count = 1 + choices.below(most);
    (0..count).map(|_| choices.of(&GAINS)).collect()
}

/// Returns MSE and rate as the paper prints them.
fn evaluate(
    limits: &SlotLimits<f64>,
    (user_gain, user_power): (f64, f64),
    sensors: &[(f64, f64)],
    normalizing_factor: Option<f64>,
) -> (f64, f64) {
    let (gains, coefficients): (Vec<_>, Vec<_>) =
        (sensors.iter().map(|&(gain, b)| (PowerGain(gain), b))).unzip();
    let slot = Slot {
        sensor_gains: &gains,
        sensor_coefficients: &coefficients,
        user_gain: PowerGain(user_gain),
        user_power: Watt(user_power),
        noise_power: limits.noise_power,
    };
    let eta = normalizing_factor.unwrap_or_else(|| slot.normalizing_factor());
    (slot.mse(eta), slot.rate())
}

/// The solution keeps every constraint, does not depend on the order of the sensors, and no choice on
/// a grid that keeps the constraints has a higher rate.
#[cfg_attr(not(kani), test)]
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(40))]
fn the_exact_solution_is_admissible_and_optimal() {
    each(|choices| {
        let limits = limits(choices);
        let gains = gains(choices, SENSORS);
        let user = choices.of(&[None, Some(0.0), Some(1e-14), Some(2e-12), Some(1.0)]);
        let solve = |gains: &[f64]| {
            let powers: Vec<_> = gains.iter().copied().map(PowerGain).collect();
            let mut workspace = Workspace::<f64, SENSORS>::default();
            let field = workspace.sensors(&limits, &powers).expect("a slot problem");
            field.solve(user.map(PowerGain)).expect("a slot problem")
        };
        let solution = solve(&gains);
        let mut turned = gains.clone();
        turned.rotate_left(1);
        assert_eq!(solve(&turned), solution);

        let largest = limits.sensor_power_max.0.sqrt();
        let sensors: Vec<_> = gains
            .iter()
            .map(|&gain| (gain, solution.coefficient(PowerGain(gain))))
            .collect();
        for (_, coefficient) in &sensors {
            assert!((0.0..=largest).contains(coefficient));
        }
        let power = solution.user_power.0;
        assert!((0.0..=limits.user_power_max.0).contains(&power));
        assert!(solution.normalizing_factor >= 0.0 && solution.normalizing_factor.is_finite());
        let user_gain = user.unwrap_or(0.0);
        let eta = Some(solution.normalizing_factor);
        let (mse, rate) = evaluate(&limits, (user_gain, power), &sensors, eta);
        assert!((rate - solution.rate).abs() <= TOLERANCE * (1.0 + rate));
        match solution.status {
            Status::Infeasible { least_mse } => {
                assert!(power == 0.0 && least_mse > limits.mse_threshold);
                assert!((mse - least_mse).abs() <= TOLERANCE);
            }
            _ => assert!(mse <= limits.mse_threshold * (1.0 + TOLERANCE)),
        }

        // No better choice on a grid.
        let mut indices = vec![0; gains.len() + 1];
        loop {
            let chosen: Vec<_> = gains
                .iter()
                .zip(&indices)
                .map(|(&gain, &index)| (gain, FRACTIONS[index] * largest))
                .collect();
            let power = FRACTIONS[indices[gains.len()]] * limits.user_power_max.0;
            let (mse, rate) = evaluate(&limits, (user_gain, power), &chosen, None);
            if mse <= limits.mse_threshold {
                assert!(solution.status.is_feasible());
                assert!(rate <= solution.rate + TOLERANCE * (1.0 + rate), "{rate}");
            }
            let Some(place) = indices
                .iter()
                .position(|&index| index + 1 < FRACTIONS.len())
            else {
                break;
            };
            indices[..place].fill(0);
            indices[place] += 1;
        }
    });
}

/// Every method keeps the constraints, and none is better than the exact one.
#[cfg_attr(not(kani), test)]
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(300))]
fn no_method_is_better_than_the_exact_one() {
    each(|choices| {
        let limits = limits(choices);
        let amplitudes: Vec<f64> = gains(choices, 2).iter().map(|gain| gain.sqrt()).collect();
        let user = Some(PowerGain(choices.of(&GAINS)));
        let method = choices.of(&[
            Method::Alternating(Default::default()),
            Method::FixedUserPower(Watt(0.1)),
            Method::FixedSensorPower(Watt(0.02)),
        ]);
        let mut workspace = Workspace::<f64, SENSORS>::default();
        let field = workspace.sensors_of_amplitude(&limits, &amplitudes);
        let field = field.expect("a slot problem");
        let mut coefficients = [0.0; SENSORS];
        let best = field.solve(user).expect("a slot problem");
        let allocation = field.allocate(&method, &amplitudes, user, &mut coefficients);
        let allocation = allocation.expect("a slot problem");
        let solution = allocation.solution;
        assert!(solution.rate <= best.rate + TOLERANCE * (1.0 + best.rate));
        assert!((0.0..=limits.user_power_max.0).contains(&solution.user_power.0));
        for coefficient in coefficients {
            assert!(coefficient * coefficient <= limits.sensor_power_max.0);
        }
        if solution.status.is_feasible() {
            assert!(allocation.mse <= limits.mse_threshold * (1.0 + TOLERANCE));
        }
    });
}

/// A guarantee holds for every combination of the ends of the bounds.
#[cfg_attr(not(kani), test)]
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(60))]
fn a_guarantee_holds_at_all_ends_of_the_bounds() {
    const ENDS: [f64; 4] = [0.0, 1e-12, 4e-12, 1e-9];
    let bounds = |choices: &mut Choices| {
        let least = choices.below(ENDS.len());
        let most = least + choices.below(ENDS.len() - least);
        [ENDS[least], ENDS[most]]
    };
    let as_bounds = |[least, most]: [f64; 2]| GainBounds {
        least: PowerGain(least),
        most: PowerGain(most),
    };
    each(|choices| {
        let limits = limits(choices);
        let count = 1 + choices.below(2);
        let sensors: Vec<[f64; 2]> = (0..count).map(|_| bounds(choices)).collect();
        let user = bounds(choices);
        let gains: Vec<_> = sensors.iter().copied().map(as_bounds).collect();
        let mut workspace = Workspace::<f64, SENSORS>::default();
        let guarantee: Guarantee<f64> = workspace
            .guarantee(&limits, &gains, Some(as_bounds(user)))
            .expect("a slot problem");
        if guarantee.status.is_feasible() {
            assert!(guarantee.mse <= limits.mse_threshold * (1.0 + TOLERANCE));
        } else {
            assert!(guarantee.user_power.0 == 0.0 && guarantee.rate == 0.0);
        }
        for ends in 0..2_usize << count {
            let end = |index: usize| ends >> index & 1;
            let actual: Vec<_> = sensors
                .iter()
                .zip(&gains)
                .enumerate()
                .map(|(index, (sensor, gain))| (sensor[end(index)], guarantee.coefficient(gain)))
                .collect();
            let user = (user[end(count)], guarantee.user_power.0);
            let eta = Some(guarantee.normalizing_factor);
            let (mse, rate) = evaluate(&limits, user, &actual, eta);
            assert!(mse <= guarantee.mse + TOLERANCE, "{mse} {guarantee:?}");
            assert!(rate >= guarantee.rate - TOLERANCE, "{rate} {guarantee:?}");
        }
    });
}

/// A gain that is none is an error that names it.
#[cfg_attr(not(kani), test)]
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(40))]
fn an_invalid_gain_is_refused() {
    each(|choices| {
        let limits = limits(choices);
        let mut gains: Vec<_> = gains(choices, SENSORS).into_iter().map(PowerGain).collect();
        let index = choices.below(gains.len());
        let bad = choices.of(&[f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1e-300]);
        let mut workspace = Workspace::<f64, SENSORS>::default();
        let field = workspace.sensors(&limits, &gains).expect("a slot problem");
        assert!(field.solve(Some(PowerGain(bad))).is_err());
        gains[index].0 = bad;
        let refused = workspace.sensors(&limits, &gains).expect_err("a bad gain");
        assert!(
            refused
                .to_string()
                .starts_with(&format!("sensor_gain[{index}]"))
        );
    });
}

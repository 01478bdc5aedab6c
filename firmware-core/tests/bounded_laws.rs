// SPDX-License-Identifier: MIT OR Apache-2.0
//! Guarantees for gains within bounds, tested with gains drawn from the bounds: MSE and rate are
//! computed by the printed formulas (`aircomp`).

mod random_slots;

use firmware_core::{
    PowerGain, Scalar, Watt,
    aircomp::Slot,
    inner::{LimitedBy, Status, Workspace, bounded::GainBounds},
};
use rand::{Rng, RngExt};
use random_slots::{Problem, generator, log_uniform};

/// Bounds around the gains of a problem, from rounding to two orders wide.
fn widen(problem: &Problem, random: &mut impl Rng) -> (Vec<GainBounds<f64>>, GainBounds<f64>) {
    let widest = log_uniform(random, 1e-9, 5.0);
    let mut around = |gain: PowerGain<f64>| GainBounds {
        least: PowerGain(gain.0 * (-random.random_range(0.0..widest)).exp()),
        most: PowerGain(gain.0 * random.random_range(0.0..widest).exp()),
    };
    let sensors = problem.sensor_gains.iter().map(|&gain| around(gain));
    (sensors.collect(), around(problem.user_gain))
}

/// A gain within bounds, most often at an end.
fn within(bounds: &GainBounds<f64>, random: &mut impl Rng) -> PowerGain<f64> {
    let (least, most) = (bounds.least.0, bounds.most.0);
    PowerGain(match random.random_range(0..3) {
        0 => least,
        1 => most,
        _ => least + (most - least) * random.random_range(0.0..=1.0),
    })
}

fn narrow<T: Scalar>(bounds: &GainBounds<f64>) -> GainBounds<T> {
    GainBounds {
        least: PowerGain(T::of(bounds.least.0)),
        most: PowerGain(T::of(bounds.most.0)),
    }
}

/// Tests guarantees in `T` over `cases` slots with ten draws each. Returns how many were feasible.
fn promises_hold<T: Scalar>(seed: u64, cases: u32) -> u32 {
    let mut random = generator(seed);
    let mut feasible = 0;
    let tolerance = T::CONSTRAINT_TOLERANCE.to_f64();
    for _ in 0..cases {
        let problem = Problem::draw(&mut random);
        let (sensors, user) = widen(&problem, &mut random);
        let narrowed: Vec<GainBounds<T>> = sensors.iter().map(narrow).collect();
        let mut workspace = Workspace::<T, 64>::default();
        let promise = workspace
            .guarantee(&problem.limits_in(), &narrowed, Some(narrow(&user)))
            .unwrap_or_else(|error| panic!("{error} in {problem:?}"));
        let context = || format!("{promise:?} of {problem:?} within {sensors:?}");
        let coefficients: Vec<f64> = narrowed
            .iter()
            .map(|gain| promise.coefficient(gain).to_f64())
            .collect();
        let limits = problem.limits_in::<T>();
        for b in &coefficients {
            let square = T::of(*b) * T::of(*b);
            assert!(
                *b >= 0.0 && square <= limits.sensor_power_max.0,
                "{b}: {}",
                context()
            );
        }
        let power = promise.user_power;
        assert!(
            power.0 >= T::zero() && power <= limits.user_power_max,
            "{}",
            context()
        );
        match promise.status {
            Status::Guaranteed { .. } => {
                feasible += 1;
                let most = limits.mse_threshold * (T::one() + T::CONSTRAINT_TOLERANCE);
                assert!(promise.mse <= most, "{}", context());
            }
            Status::Infeasible { least_mse } => {
                assert!(
                    power.0 == T::zero() && promise.mse == least_mse,
                    "{}",
                    context()
                );
                assert!(least_mse > limits.mse_threshold);
            }
            _ => panic!("not a promise: {}", context()),
        }
        for _ in 0..10 {
            let gains: Vec<_> = sensors.iter().map(|b| within(b, &mut random)).collect();
            let slot = Slot {
                sensor_gains: &gains,
                sensor_coefficients: &coefficients,
                user_gain: within(&user, &mut random),
                user_power: Watt(power.0.to_f64()),
                noise_power: problem.limits.noise_power,
            };
            let mse = slot.mse(promise.normalizing_factor.to_f64());
            let most = promise.mse.to_f64() * (1.0 + tolerance);
            assert!(mse <= most, "{mse} > {most}: {}", context());
            if promise.status.is_feasible() {
                let most = problem.limits.mse_threshold * (1.0 + tolerance);
                assert!(mse <= most, "{mse} > Gamma: {}", context());
            }
            let (rate, least) = (slot.rate(), promise.rate.to_f64());
            assert!(
                rate >= least * (1.0 - 10.0 * tolerance),
                "{rate} < {least}: {}",
                context()
            );
        }
    }
    feasible
}

#[test]
fn promises_hold_within_the_bounds() {
    let double = promises_hold::<f64>(31, 20_000);
    let single = promises_hold::<f32>(32, 20_000);
    // Both outcomes, often.
    assert!((5_000..18_000).contains(&double), "{double}");
    assert!((5_000..18_000).contains(&single), "{single}");
}

/// Where the bounds coincide, the guarantee is the optimum.
#[test]
fn known_gains_cost_nothing() {
    let mut random = generator(33);
    let mut compared = 0;
    for _ in 0..20_000 {
        let problem = Problem::draw(&mut random);
        let exactly = |&gain: &PowerGain<f64>| GainBounds::exactly(gain);
        let sensors: Vec<_> = problem.sensor_gains.iter().map(exactly).collect();
        let mut workspace = Workspace::<f64, 64>::default();
        let best = workspace
            .sensors(&problem.limits, &problem.sensor_gains)
            .and_then(|field| field.solve(Some(problem.user_gain)))
            .expect("a slot problem");
        let promise = workspace
            .guarantee(&problem.limits, &sensors, Some(exactly(&problem.user_gain)))
            .expect("a slot problem");
        if best.rate < 1e-6 {
            continue;
        }
        compared += 1;
        assert!(
            promise.status.is_feasible(),
            "{best:?} {promise:?} {problem:?}"
        );
        assert!(
            (promise.rate / best.rate - 1.0).abs() < 1e-6,
            "{best:?} {promise:?} {problem:?}"
        );
    }
    assert!(compared > 10_000, "{compared}");
}

/// Without a user to serve, the result is the least worst-case MSE. No choice of `eta` on a fine grid has less.
#[test]
fn the_quietest_choice_is_the_quietest() {
    let mut random = generator(34);
    let mut compared = 0;
    for _ in 0..2_000 {
        let problem = Problem::draw(&mut random);
        let (sensors, _) = widen(&problem, &mut random);
        let mut workspace = Workspace::<f64, 64>::default();
        let promise = workspace
            .guarantee(&problem.limits, &sensors, None)
            .expect("a slot problem");
        assert!(matches!(
            promise.status,
            Status::Infeasible { .. }
                | Status::Guaranteed {
                    limited_by: LimitedBy::None
                }
        ));
        let b_max = problem.limits.coefficient_max();
        // The `eta` at which the strongest sensor begins to reduce its power, not that of the
        // promise: beside a wrong one there would be no rivals.
        let strongest = sensors
            .iter()
            .map(|gain| gain.least.amplitude() + gain.most.amplitude())
            .fold(0.0, f64::max);
        if strongest == 0.0 {
            continue;
        }
        compared += 1;
        for _ in 0..200 {
            let eta = 2.0 / (b_max * strongest) * log_uniform(&mut random, 1e-3, 1e3);
            let noise = eta * eta * problem.limits.noise_power.0;
            let error = sensors.iter().fold(noise, |sum, gain| {
                let (low, high) = (gain.least.amplitude(), gain.most.amplitude());
                let b = (2.0 / (eta * (low + high))).min(b_max);
                let error = (1.0 - eta * b * low).max(eta * b * high - 1.0);
                sum + error * error
            });
            let rival = error / (problem.sensors() as f64).powi(2);
            assert!(
                rival >= promise.mse * (1.0 - 1e-9),
                "{rival} {promise:?} {problem:?}"
            );
        }
    }
    assert!(compared > 1_000, "{compared}");
}

/// The rate is at least that of the quietest choice with the power that it leaves to the user.
#[test]
fn the_better_of_two_choices_is_kept() {
    let mut random = generator(36);
    let mut kept = 0;
    for _ in 0..2_000 {
        let problem = Problem::draw(&mut random);
        let (sensors, user) = widen(&problem, &mut random);
        let mut workspace = Workspace::<f64, 64>::default();
        let mut guarantee = |user| {
            workspace
                .guarantee(&problem.limits, &sensors, user)
                .expect("a slot problem")
        };
        let (promise, quietest) = (guarantee(Some(user)), guarantee(None));
        assert!(promise.status.is_feasible() || !quietest.status.is_feasible());
        let noise_power = problem.limits.noise_power.0;
        let room = problem.limits.mse_threshold * (1.0 - 1e-12) - quietest.mse;
        let count = problem.sensors() as f64;
        let eta = quietest.normalizing_factor;
        if room <= 0.0 || user.least.0 <= 0.0 || eta <= 0.0 {
            continue;
        }
        let affordable = room * count * count / (eta * eta * user.most.0);
        let power = affordable.min(problem.limits.user_power_max.0);
        let energy = sensors.iter().fold(noise_power, |sum, gain| {
            sum + quietest.coefficient(gain).powi(2) * gain.most.0
        });
        let rate = (user.least.0 * power / energy).ln_1p() / std::f64::consts::LN_2;
        assert!(
            promise.rate >= rate * (1.0 - 1e-6) - 1e-9,
            "{rate} {promise:?} {problem:?}"
        );
        kept += u32::from(rate > 1e-6 && (promise.rate / rate - 1.0).abs() < 1e-6);
    }
    assert!(kept > 5, "{kept}");
}

#[test]
fn what_cannot_be_heard_or_is_no_bound() {
    let mut random = generator(35);
    let problem = Problem::draw_with(&mut random, 4);
    let mut workspace = Workspace::<f64, 4>::default();
    let silent = [GainBounds::default(); 4];
    let promise = workspace
        .guarantee(&problem.limits, &silent, None)
        .expect("a slot problem");
    assert_eq!(promise.status, Status::Infeasible { least_mse: 0.25 });
    assert_eq!(promise.normalizing_factor, 0.0);
    assert_eq!(promise.coefficient(&silent[0]), 0.0);
    // Heard at best: in the worst case its symbol is missing whatever it sends.
    let mut partly = [GainBounds::exactly(PowerGain(1e-8)); 4];
    partly[1].least.0 = 0.0;
    let promise = workspace
        .guarantee(&problem.limits, &partly, None)
        .expect("a slot problem");
    assert!(promise.coefficient(&partly[0]) > 0.0);
    assert_eq!(promise.coefficient(&partly[1]), 0.0);
    for bad in [f64::NAN, f64::INFINITY, -1.0] {
        let gain = PowerGain(1e-11);
        let mut sensors = [GainBounds::exactly(gain); 4];
        sensors[2].most.0 = bad;
        assert!(
            workspace
                .guarantee(&problem.limits, &sensors, None)
                .is_err()
        );
        let user = GainBounds {
            least: gain,
            most: PowerGain(bad),
        };
        let sensors = [GainBounds::exactly(gain); 4];
        assert!(
            workspace
                .guarantee(&problem.limits, &sensors, Some(user))
                .is_err()
        );
    }
    let five = [GainBounds::exactly(PowerGain(1e-11)); 5];
    assert!(workspace.guarantee(&problem.limits, &five, None).is_err());
}

/// Where the worst case leaves the range of the number type, the user gets no power, and no number
/// of the guarantee is NaN or infinite.
#[test]
fn gains_at_the_end_of_the_type_promise_nothing() {
    let mut random = generator(37);
    let problem = Problem::draw_with(&mut random, 4).with(|limits| {
        limits.mse_threshold = 0.2;
        limits.noise_power.0 = 1e-13;
    });
    let sensors = [GainBounds::exactly(PowerGain(1e-8_f32)); 4];
    let user = GainBounds {
        least: PowerGain(1e-11),
        most: PowerGain(f32::MAX),
    };
    let promise = Workspace::<f32, 4>::default()
        .guarantee(&problem.limits_in(), &sensors, Some(user))
        .expect("a slot problem");
    assert!(promise.status.is_feasible(), "{promise:?}");
    assert!(promise.mse.is_finite() && promise.rate.is_finite());
    assert_eq!((promise.user_power.0, promise.rate), (0.0, 0.0));
}

// SPDX-License-Identifier: MIT OR Apache-2.0
//! The laws of `docs/mathematics.md`, section 3, on 100,000 random slots and at the corners of
//! the domain. MSE and rate are always recomputed from the returned powers and coefficients
//! with the printed formulas (`aircomp`).

mod random_slots;

use firmware_core::{
    PowerGain, Scalar, Watt,
    inner::{LimitedBy, SlotError, SlotLimits, Solution, Status, Workspace},
};
use rand::{Rng, RngExt};
use random_slots::{Problem, generator, log_uniform};

fn solve_in<T: Scalar>(problem: &Problem) -> Solution<T> {
    let mut workspace = Workspace::<T, 64>::default();
    let user = PowerGain(T::of(problem.user_gain.0));
    workspace
        .sensors(&problem.limits_in(), &problem.gains_in())
        .and_then(|field| field.solve(Some(user)))
        .unwrap_or_else(|error| panic!("{error} in {problem:?}"))
}

fn solve(problem: &Problem) -> Solution<f64> {
    solve_in(problem)
}

/// The rate without the rest of the solution.
fn rate_alone(problem: &Problem) -> f64 {
    let mut workspace = Workspace::<f64, 64>::default();
    let field = workspace.sensors(&problem.limits, &problem.sensor_gains);
    field.expect("a slot problem").rate(problem.user_gain)
}

/// `f(c*) / kappa` of a problem, from the least MSE.
fn headroom(problem: &Problem) -> f64 {
    let mut workspace = Workspace::<f64, 64>::default();
    let field = workspace
        .sensors(&problem.limits, &problem.sensor_gains)
        .expect("a slot problem");
    let sensors = problem.sensors() as f64;
    (sensors - field.least_mse() * sensors * sensors) / problem.limits.kappa(problem.sensors())
}

/// Checks what every solution must satisfy.
fn check(problem: &Problem) -> Solution<f64> {
    let solution = solve(problem);
    assert_eq!(rate_alone(problem), solution.rate, "{problem:?}");
    let SlotLimits {
        sensor_power_max,
        user_power_max,
        mse_threshold,
        ..
    } = problem.limits;
    let coefficients = problem.coefficients(&solution);
    let context = || format!("{solution:?} of {problem:?}");
    for b in &coefficients {
        assert!(
            *b >= 0.0 && b * b <= sensor_power_max.0,
            "{b}: {}",
            context()
        );
    }
    let power = solution.user_power;
    assert!(power.0 >= 0.0 && power <= user_power_max, "{}", context());
    let slot = problem.slot(&coefficients, power);
    let eta = slot.normalizing_factor();
    assert!(
        (solution.normalizing_factor - eta).abs() <= 1e-9 * eta,
        "{}",
        context()
    );
    let mse = slot.mse(solution.normalizing_factor);
    assert!(
        (solution.rate - slot.rate()).abs() <= 1e-9 * slot.rate(),
        "{}",
        context()
    );
    match solution.status {
        Status::Optimal { limited_by } => {
            assert!(mse <= mse_threshold * (1.0 + 1e-9), "{mse}: {}", context());
            let binds = (mse / mse_threshold - 1.0).abs() <= 1e-9;
            let heard = problem.user_gain.0 * user_power_max.0 > 0.0;
            match limited_by {
                LimitedBy::Accuracy => assert!(heard && binds, "{mse}: {}", context()),
                LimitedBy::Power => {
                    assert!(
                        heard && binds && power == user_power_max,
                        "{mse}: {}",
                        context()
                    );
                }
                LimitedBy::None => assert!(!heard && solution.rate == 0.0, "{}", context()),
            }
            let limit = -(1.0 - problem.sensors() as f64 * mse_threshold).log2();
            assert!(solution.rate <= limit * (1.0 + 1e-9), "{}", context());
        }
        Status::Infeasible { least_mse } => {
            assert!(least_mse > mse_threshold * (1.0 - 1e-9), "{}", context());
            assert!(
                (mse - least_mse).abs() <= 1e-9 * mse,
                "{mse}: {}",
                context()
            );
            assert!(power.0 == 0.0 && solution.rate == 0.0, "{}", context());
        }
        _ => panic!("not the exact solver's: {}", context()),
    }
    solution
}

/// A random choice of coefficients, and the most user power that keeps `Gamma` with them.
fn random_rate(problem: &Problem, best: &Solution<f64>, random: &mut impl Rng) -> Option<f64> {
    let b_max = problem.limits.coefficient_max();
    let near = random.random_bool(0.6);
    let spread = log_uniform(random, 1e-7, 0.5);
    let level = random.random_range(0.0..1.0);
    let mut coefficients = problem.coefficients(best);
    for b in &mut coefficients {
        *b = if near {
            (*b * (1.0 + random.random_range(-spread..spread))).min(b_max)
        } else {
            b_max * random.random_range(level..=1.0)
        };
    }
    let amplitudes = || {
        let gains = problem.sensor_gains.iter().zip(&coefficients);
        gains.map(|(gain, b)| b * gain.amplitude())
    };
    let sum: f64 = amplitudes().sum();
    let energy = amplitudes().map(|y| y * y).sum::<f64>() + problem.limits.noise_power.0;
    let signal = sum * sum / problem.limits.kappa(problem.sensors()) - energy;
    if signal < 0.0 || problem.user_gain.0 <= 0.0 {
        return None;
    }
    let power = (signal / problem.user_gain.0).min(problem.limits.user_power_max.0);
    Some(problem.slot(&coefficients, Watt(power)).rate())
}

#[test]
fn answers_keep_the_constraints_and_no_random_point_is_better() {
    let mut random = generator(1);
    let (mut feasible, mut rivals) = (0, 0);
    for _ in 0..100_000 {
        let problem = Problem::draw(&mut random);
        let solution = check(&problem);
        feasible += u32::from(solution.status.is_feasible());
        for _ in 0..4 {
            let Some(rate) = random_rate(&problem, &solution, &mut random) else {
                continue;
            };
            rivals += 1;
            assert!(solution.status.is_feasible(), "rival {rate}: {problem:?}");
            // A rival is itself computed to rounding: near the border its SINR is a difference.
            let slack = 1e-9 * solution.rate + 1e-13 * problem.sensors() as f64;
            assert!(
                rate <= solution.rate + slack,
                "{rate} > {solution:?}: {problem:?}"
            );
        }
    }
    // The draws must exercise both outcomes for the test to mean anything.
    assert!((30_000..95_000).contains(&feasible), "{feasible} feasible");
    assert!(rivals > 50_000, "{rivals} rivals");
}

#[test]
fn more_freedom_never_costs_rate() {
    let mut random = generator(2);
    let mut at_border = 0;
    for _ in 0..20_000 {
        let problem = Problem::draw(&mut random);
        let before = check(&problem);
        let factor = 1.0 + log_uniform(&mut random, 1e-6, 1.0);
        let looser = 1.0 / problem.sensors() as f64;
        for freer in [
            problem.with(|l| {
                let weight = 1.0 / factor;
                l.mse_threshold = l.mse_threshold * weight + 0.9995 * looser * (1.0 - weight);
            }),
            problem.with(|l| l.user_power_max.0 *= factor),
            problem.with(|l| l.sensor_power_max.0 *= factor),
            problem.with(|l| l.noise_power.0 /= factor),
        ] {
            let after = check(&freer);
            assert!(
                after.rate >= before.rate * (1.0 - 1e-9) - 1e-13 * problem.sensors() as f64,
                "{before:?} {after:?} {problem:?}"
            );
            // Rounding may take a slot that is feasible by a hair to the other side.
            if before.status.is_feasible() && !after.status.is_feasible() {
                at_border += 1;
                assert!(headroom(&freer) > 1.0 - 1e-12, "{problem:?}");
            }
        }
    }
    assert!(at_border <= 10, "{at_border} of 80,000 crossed the border");
}

/// Single precision, on channels as they are: it must agree wherever the border of feasibility
/// is not within its rounding.
#[test]
fn single_precision_follows_double() {
    let mut random = generator(3);
    let mut at_border = 0;
    for _ in 0..50_000 {
        let problem = Problem::draw(&mut random);
        let (double, single) = (solve(&problem), solve_in::<f32>(&problem));
        let slack = 1.0 - problem.sensors() as f64 * problem.limits.mse_threshold;
        // kappa = J (1 - J Gamma) and the sums lose a few digits of seven.
        let rounding = 4e-6 / slack;
        if (headroom(&problem) - 1.0).abs() < rounding {
            at_border += 1;
            continue;
        }
        assert_eq!(
            double.status.is_feasible(),
            single.status.is_feasible(),
            "{problem:?}"
        );
        let (d, s) = (double.rate, f64::from(single.rate));
        assert!(
            (d - s).abs() <= 2e-4 * d + 3.0 * rounding,
            "{d} {s} {problem:?}"
        );
        for &gain in &problem.gains_in::<f32>() {
            let b = single.coefficient(gain);
            assert!(b >= 0.0 && b * b <= problem.limits.sensor_power_max.0 as f32);
        }
        assert!(single.user_power.0 <= problem.limits.user_power_max.0 as f32);
    }
    assert!(at_border <= 10, "{at_border} of 50,000 not compared");
}

/// Table I with given gains.
fn table_one(sensor_gains: &[f64], user_gain: f64, mse_threshold: f64) -> Problem {
    Problem {
        limits: SlotLimits {
            sensor_power_max: Watt(0.05),
            user_power_max: Watt(0.2),
            noise_power: Watt(3.162e-13),
            mse_threshold,
        },
        sensor_gains: sensor_gains.iter().copied().map(PowerGain).collect(),
        user_gain: PowerGain(user_gain),
    }
}

/// One sensor: `b` is all or what accuracy allows, by hand. `f(c*) = a^2/(1 + a^2)`.
#[test]
fn one_sensor_by_hand() {
    let problem = table_one(&[1e-10], 1e-9, 0.2);
    let a2: f64 = 0.05 * 1e-10 / 3.162e-13;
    let sinr = a2 / (1.0 + a2) / 0.8 - 1.0;
    let solution = check(&problem);
    assert_eq!(
        solution.status,
        Status::Optimal {
            limited_by: LimitedBy::Accuracy
        }
    );
    assert!((solution.rate - (1.0 + sinr).log2()).abs() < 1e-12);
    // Weak user: y^2 = kappa (Q + S + y^2).
    let weak = table_one(&[1e-10], 1e-15, 0.2);
    let solution = check(&weak);
    let received = 0.8 * (0.2 * 1e-15 + 3.162e-13) / 0.2;
    let b = solution.coefficient(PowerGain(1e-10));
    assert!((b * b * 1e-10 / received - 1.0).abs() < 1e-12);
}

#[test]
fn equal_gains_share_the_level() {
    for sensors in [1, 2, 36, 64] {
        for gain in [1e-13, 1e-11, 1e-6] {
            check(&table_one(
                &vec![gain; sensors],
                1e-11,
                0.5 / sensors as f64,
            ));
        }
    }
}

#[test]
fn gains_apart_by_twelve_orders() {
    let gains: Vec<f64> = (0..36)
        .map(|j| 1e-18 * 10f64.powf(12.0 * f64::from(j) / 35.0))
        .collect();
    for fraction in [0.3, 0.54, 0.9, 0.999] {
        check(&table_one(&gains, 1e-11, fraction / 36.0));
    }
}

/// Sensors that cannot be heard stay silent and count in `J`: with `k` of `J` silent, the least
/// MSE is at least `k / J^2`.
#[test]
fn sensors_without_gain() {
    let mut gains = vec![1e-8; 36];
    gains[..12].fill(0.0);
    let tight = check(&table_one(&gains, 1e-11, 0.009));
    assert!(!tight.status.is_feasible());
    let loose = check(&table_one(&gains, 1e-11, 0.015));
    assert!(loose.status.is_feasible() && loose.rate > 0.0);
    assert_eq!(loose.coefficient(PowerGain(0.0)), 0.0);
    let none = check(&table_one(&[0.0; 36], 1e-11, 0.015));
    assert_eq!(
        none.status,
        Status::Infeasible {
            least_mse: 1.0 / 36.0
        }
    );
    assert_eq!(none.normalizing_factor, 0.0);
}

/// No user signal is possible, for three reasons: the slot is used for the least MSE.
#[test]
fn without_user_signal_the_average_is_best() {
    let problem = table_one(&[1e-11; 36], 0.0, 0.02);
    let deaf = check(&problem);
    let mut workspace = Workspace::<f64, 64>::default();
    let field = workspace
        .sensors(&problem.limits, &problem.sensor_gains)
        .expect("a slot problem");
    let nobody = field.solve(None).expect("no gain to be wrong");
    assert_eq!(deaf, nobody);
    let mut powerless = problem.with(|l| l.user_power_max.0 = 0.0);
    powerless.user_gain = PowerGain(1e-11);
    assert_eq!(check(&powerless), nobody);
    let coefficients = problem.coefficients(&nobody);
    let mse = problem
        .slot(&coefficients, Watt(0.0))
        .mse(nobody.normalizing_factor);
    assert!((mse / field.least_mse() - 1.0).abs() < 1e-12);
}

#[test]
fn powerless_sensors_are_infeasible() {
    let problem = table_one(&[1e-9; 4], 1e-11, 0.1).with(|l| l.sensor_power_max.0 = 0.0);
    assert!(!check(&problem).status.is_feasible());
}

/// `Gamma` slightly above and below the least MSE.
#[test]
fn the_border_of_feasibility() {
    let mut random = generator(4);
    let mut undecided = 0;
    for _ in 0..5_000 {
        let problem = Problem::draw(&mut random);
        let sensors = problem.sensors() as f64;
        let f = headroom(&problem) * problem.limits.kappa(problem.sensors());
        // Nothing left to decide where the sensors cannot be heard or the noise cannot.
        if !(1e-3..=0.999).contains(&(f / sensors)) {
            undecided += 1;
            continue;
        }
        for (factor, feasible) in [(1.0 - 1e-9, true), (1.0 + 1e-9, false)] {
            let at_border =
                problem.with(|l| l.mse_threshold = (1.0 - factor * f / sensors) / sensors);
            let solution = check(&at_border);
            assert_eq!(
                solution.status.is_feasible(),
                feasible,
                "{factor} {at_border:?}"
            );
            assert!(solution.rate <= 1e-9 * 1.5, "{solution:?}");
        }
    }
    assert!(undecided <= 750, "{undecided} of 5,000 have no border");
}

/// Numbers at the end of the type: no NaN, no infinity, still the right answer.
#[test]
fn numbers_that_leave_the_range() {
    let loud = table_one(&[1e-12, 1e25, 1e-3, 1e25], 1e30, 0.1);
    let mut workspace = Workspace::<f32, 64>::default();
    let field = workspace
        .sensors(&loud.limits_in(), &loud.gains_in())
        .expect("a slot problem");
    let solution = field.solve(Some(PowerGain(1e30_f32))).expect("a gain");
    assert_eq!(
        solution.status,
        Status::Optimal {
            limited_by: LimitedBy::Accuracy
        }
    );
    let expected = check(&loud).rate;
    assert!(
        (f64::from(solution.rate) / expected - 1.0).abs() < 2e-4,
        "{solution:?} {expected}"
    );
    let power = f64::from(solution.user_power.0);
    assert!(power.is_finite() && power >= 0.0);

    let mut extreme = table_one(&[1e300, 1e-300, 1e150], 1e300, 0.2);
    extreme.limits.noise_power.0 = 1e-300;
    let solution = solve(&extreme);
    assert!(
        solution.rate.is_finite() && solution.rate > 0.0,
        "{solution:?}"
    );
    assert!(solution.normalizing_factor.is_finite());
}

#[test]
fn what_is_not_a_slot_problem_is_refused() {
    let good = table_one(&[1e-11; 3], 1e-11, 0.1);
    let error = |problem: &Problem| {
        let mut workspace = Workspace::<f64, 3>::default();
        workspace
            .sensors(&problem.limits, &problem.sensor_gains)
            .and_then(|field| field.solve(Some(problem.user_gain)))
            .expect_err("refused")
            .to_string()
    };
    let limited = |change: fn(&mut SlotLimits<f64>)| error(&good.with(change));
    assert!(limited(|l| l.mse_threshold = 1.0 / 3.0).starts_with("mse_threshold is 0.333"));
    assert!(limited(|l| l.mse_threshold = 0.0).starts_with("mse_threshold is 0,"));
    assert!(limited(|l| l.mse_threshold = f64::NAN).starts_with("mse_threshold is NaN"));
    assert!(limited(|l| l.noise_power.0 = 0.0).starts_with("noise_power is 0,"));
    assert!(limited(|l| l.user_power_max.0 = -1.0).starts_with("user_power_max is -1,"));
    assert!(
        limited(|l| l.sensor_power_max.0 = f64::INFINITY).starts_with("sensor_power_max is inf")
    );
    for bad in [f64::NAN, f64::INFINITY, -1e-12] {
        let mut sensors = good.clone();
        sensors.sensor_gains[1].0 = bad;
        assert!(error(&sensors).starts_with("sensor_gain[1] is "));
        let mut user = good.clone();
        user.user_gain.0 = bad;
        assert!(error(&user).starts_with("user_gain is "));
        assert_eq!(rate_alone(&user), 0.0);
    }
    assert!(error(&table_one(&[], 1e-11, 0.1)).starts_with("sensor_gain is empty"));
    let four = error(&table_one(&[1e-11; 4], 1e-11, 0.1));
    assert_eq!(four, "there are 4 sensors, but the capacity is 3");
    assert!(matches!(
        Workspace::<f64, 2>::default().sensors(&good.limits, &good.sensor_gains),
        Err(SlotError::TooManySensors {
            sensors: 3,
            capacity: 2
        })
    ));
}

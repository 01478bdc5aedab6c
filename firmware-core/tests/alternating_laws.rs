// SPDX-License-Identifier: MIT OR Apache-2.0
//! Alg. 1 compared with the exact optimum, and the comparison schemes with their optima.

mod random_slots;

use firmware_core::{
    PowerGain, Watt,
    inner::{
        LimitedBy, Method, SensorField, Solution, Status, Workspace,
        alternating::{AlternatingOutcome, AlternatingSettings},
    },
};
use rand::RngExt;
use random_slots::{Problem, generator};

fn with_field<R>(problem: &Problem, ask: impl FnOnce(&SensorField<'_, f64>) -> R) -> R {
    let mut workspace = Workspace::<f64, 64>::default();
    let field = workspace.sensors(&problem.limits, &problem.sensor_gains);
    ask(&field.unwrap_or_else(|error| panic!("{error} in {problem:?}")))
}

fn solve(problem: &Problem, method: Method<f64>) -> Solution<f64> {
    let solved = with_field(problem, |field| {
        method.solve(field, Some(problem.user_gain))
    });
    solved.unwrap_or_else(|error| panic!("{error} in {problem:?}"))
}

/// Bounds exactly, and the MSE by the printed formula.
fn check_constraints(problem: &Problem, solution: &Solution<f64>) {
    let coefficients = problem.coefficients(solution);
    let limits = &problem.limits;
    for b in &coefficients {
        assert!(
            *b >= 0.0 && b * b <= limits.sensor_power_max.0,
            "{b} {problem:?}"
        );
    }
    assert!(solution.user_power.0 >= 0.0 && solution.user_power <= limits.user_power_max);
    let slot = problem.slot(&coefficients, solution.user_power);
    let mse = slot.mse(solution.normalizing_factor);
    if solution.status.is_feasible() {
        let limit = limits.mse_threshold * (1.0 + 1e-9);
        assert!(mse <= limit, "{mse} {solution:?} {problem:?}");
        assert!((solution.rate - slot.rate()).abs() <= 1e-9 * slot.rate() + 1e-15);
    } else {
        assert!(
            solution.rate == 0.0 && solution.user_power.0 == 0.0,
            "{solution:?}"
        );
        assert!(
            mse >= limits.mse_threshold * (1.0 - 1e-9),
            "{mse} {solution:?} {problem:?}"
        );
    }
}

/// The status says how the iteration ended, and what limits the rate.
fn check_end(problem: &Problem, outcome: AlternatingOutcome, solution: &Solution<f64>) {
    let heard = problem.user_gain.0 * problem.limits.user_power_max.0 > 0.0;
    let context = || format!("{outcome:?} {solution:?} {problem:?}");
    match solution.status {
        Status::Converged { limited_by } | Status::IterationLimit { limited_by } => {
            let converged = matches!(solution.status, Status::Converged { .. });
            let expected = if converged {
                AlternatingOutcome::Converged
            } else {
                AlternatingOutcome::IterationLimit
            };
            assert_eq!(outcome, expected);
            let (power, most) = (solution.user_power.0, problem.limits.user_power_max.0);
            assert!(
                limited_by != LimitedBy::Power || power == most,
                "{}",
                context()
            );
            let below = power < most * (1.0 - 1e-9);
            assert!(!below || limited_by == LimitedBy::Accuracy, "{}", context());
            assert!(heard, "{}", context());
        }
        Status::Optimal { limited_by } => {
            assert!(!heard && limited_by == LimitedBy::None, "{}", context());
        }
        Status::Infeasible { .. } => assert_eq!(outcome, AlternatingOutcome::Infeasible),
        Status::Guaranteed { .. } | Status::ErrorFloor { .. } => {
            panic!("of another solver: {}", context())
        }
    }
}

/// At least 0.99 of the optimum at `xi = 1e-3` and 0.9999 at `1e-6`, on every feasible slot; the
/// objective never falls; infeasible slots are the same ones.
#[test]
fn alternating_approaches_the_optimum() {
    for (tolerance, fraction) in [(1e-3, 0.99), (1e-6, 0.9999)] {
        let settings = AlternatingSettings {
            tolerance,
            ..AlternatingSettings::default()
        };
        let mut random = generator(5);
        let (mut least, mut most_work, mut cut) = (1.0_f64, 0, 0);
        for _ in 0..3_000 {
            let problem = Problem::draw(&mut random);
            let best = solve(&problem, Method::Exact);
            let mut last = 0.0;
            let report = with_field(&problem, |field| {
                field.alternate(Some(problem.user_gain), &settings, |step| {
                    assert!(step.rate >= last, "{last} {step:?} {problem:?}");
                    last = step.rate;
                })
            })
            .expect("a gain");
            let solution = report.solution;
            assert_eq!(solution.status.is_feasible(), best.status.is_feasible());
            assert_eq!(
                report.outcome == AlternatingOutcome::Infeasible,
                !best.status.is_feasible()
            );
            check_constraints(&problem, &solution);
            assert!(report.subproblems >= report.outer_steps);
            check_end(&problem, report.outcome, &solution);
            cut += u32::from(report.outcome == AlternatingOutcome::IterationLimit);
            let rounding = 1e-9 * best.rate + 1e-13 * problem.sensors() as f64;
            assert!(
                solution.rate <= best.rate + rounding,
                "{solution:?} {best:?} {problem:?}"
            );
            assert!(
                solution.rate >= fraction * best.rate - rounding,
                "{tolerance}: {report:?} {best:?} {problem:?}"
            );
            most_work = most_work.max(report.subproblems);
            if best.rate > 1e-6 {
                least = least.min(solution.rate / best.rate);
            }
        }
        assert!(cut <= 10, "{cut} of 3,000 did not converge");
        println!(
            "xi = {tolerance:e}: at least {least} of the optimum, at most {most_work} subproblems"
        );
    }
}

/// The stop rule: the steps and subproblems that 100 slots take. A change of these numbers is a
/// change of the algorithm.
#[test]
fn the_steps_are_those_of_the_stop_rule() {
    for (tolerance, expected) in [
        (1e-2, (465, 32_868)),
        (1e-3, (1240, 39_425)),
        (1e-5, (4265, 84_223)),
    ] {
        let settings = AlternatingSettings {
            tolerance,
            ..AlternatingSettings::default()
        };
        let mut random = generator(11);
        let (mut outer_steps, mut subproblems) = (0, 0);
        for _ in 0..100 {
            let problem = Problem::draw(&mut random);
            let mut seen = 0;
            let report = with_field(&problem, |field| {
                field.alternate(Some(problem.user_gain), &settings, |step| {
                    assert!(step.subproblems > seen, "{step:?}");
                    seen = step.subproblems;
                })
            })
            .expect("a gain");
            assert_eq!(report.subproblems, seen);
            outer_steps += report.outer_steps;
            subproblems += report.subproblems;
        }
        assert_eq!((outer_steps, subproblems), expected, "{tolerance}");
    }
}

/// The iteration begins where its first subproblem is feasible: the first step serves the user.
#[test]
fn the_first_step_has_a_rate() {
    let settings = AlternatingSettings {
        outer_max: 1,
        ..AlternatingSettings::default()
    };
    let mut random = generator(12);
    let mut served = 0;
    for _ in 0..1_000 {
        let problem = Problem::draw(&mut random);
        let best = solve(&problem, Method::Exact);
        if best.rate > 1e-3 {
            served += 1;
            let first = solve(&problem, Method::Alternating(settings));
            assert!(first.rate > 0.0, "{first:?} {best:?} {problem:?}");
        }
    }
    assert!(served > 100, "{served}");
}

/// An iteration that is stopped at any step keeps the constraints and reports the limit.
#[test]
fn a_cap_ends_the_iteration_with_a_usable_answer() {
    let mut random = generator(6);
    let mut cut = 0;
    for _ in 0..2_000 {
        let problem = Problem::draw(&mut random);
        for (outer_max, inner_max) in [(1, 1), (1, 20), (3, 2), (0, 5)] {
            let settings = AlternatingSettings {
                tolerance: 1e-12,
                outer_max,
                inner_max,
            };
            let solution = solve(&problem, Method::Alternating(settings));
            check_constraints(&problem, &solution);
            cut += u32::from(matches!(solution.status, Status::IterationLimit { .. }));
            let report = with_field(&problem, |field| {
                field.alternate(Some(problem.user_gain), &settings, |_| {})
            })
            .expect("a gain");
            assert!(report.outer_steps <= outer_max);
            assert!(report.subproblems <= outer_max * inner_max);
        }
    }
    assert!(cut > 1_000, "{cut}");
}

/// Single precision suffices at the powers and noise of Table I. (Not in general: with `eta`
/// fixed, a user far below the sensors is a difference of large numbers. `exact` has no such
/// difference.)
#[test]
fn alternating_in_single_precision() {
    let mut random = generator(8);
    let mut compared = 0;
    for _ in 0..3_000 {
        let problem = Problem::draw(&mut random).with(|limits| {
            limits.sensor_power_max.0 = 0.05;
            limits.user_power_max.0 = 0.2;
            limits.noise_power.0 = 3.162e-13;
        });
        let best = solve(&problem, Method::Exact);
        let mut workspace = Workspace::<f32, 64>::default();
        let (limits, gains) = (problem.limits_in(), problem.gains_in());
        let field = workspace.sensors(&limits, &gains).expect("a slot problem");
        let method = Method::Alternating(AlternatingSettings::default());
        let user = PowerGain(problem.user_gain.0 as f32);
        let solution = method.solve(&field, Some(user)).expect("a gain");
        assert!(solution.rate.is_finite() && solution.rate >= 0.0);
        let fraction = problem.sensors() as f64 * problem.limits.mse_threshold;
        let loudest = problem
            .sensor_gains
            .iter()
            .fold(0.0_f64, |most, gain| most.max(gain.0));
        if best.rate > 0.05 && fraction < 0.99 && loudest < 1e-9 {
            compared += 1;
            let fraction = f64::from(solution.rate) / best.rate;
            assert!((0.985..1.001).contains(&fraction), "{fraction} {problem:?}");
        }
    }
    assert!(compared > 300, "{compared}");
}

#[test]
fn fixed_user_power_is_optimal_among_its_kind() {
    let mut random = generator(9);
    let mut unheard = 0;
    for _ in 0..20_000 {
        let problem = Problem::draw(&mut random);
        let best = solve(&problem, Method::Exact);
        let fraction = random.random_range(0.01..=1.0);
        let power = Watt(problem.limits.user_power_max.0 * fraction);
        let fixed = solve(&problem, Method::FixedUserPower(power));
        check_constraints(&problem, &fixed);
        assert!(
            fixed.rate <= best.rate * (1.0 + 1e-9) + 1e-12,
            "{fixed:?} {best:?} {problem:?}"
        );
        let off = fixed.user_power.0 == 0.0;
        if problem.user_gain.0 == 0.0 {
            unheard += 1;
            assert_eq!(fixed, best, "{problem:?}");
        }
        assert!(off || (fixed.user_power.0 / power.0 - 1.0).abs() < 1e-12);
        // The power that the optimum uses is as good fixed as free.
        let same = solve(
            &problem,
            Method::FixedUserPower(Watt(best.user_power.0 * (1.0 - 1e-12))),
        );
        assert!(
            (same.rate - best.rate).abs() <= 1e-6 * best.rate,
            "{same:?} {best:?} {problem:?}"
        );
        // With this power as the most allowed, the optimum is the fixed slot or cannot afford it.
        let capped = solve(&problem.with(|l| l.user_power_max = power), Method::Exact);
        if !off {
            assert!((capped.rate - fixed.rate).abs() <= 1e-9 * fixed.rate);
        } else if best.status.is_feasible() && problem.user_gain.0 > 0.0 {
            assert_eq!(
                capped.status,
                Status::Optimal {
                    limited_by: LimitedBy::Accuracy
                }
            );
        }
    }
    assert!(unheard > 100, "{unheard}");
}

#[test]
fn fixed_sensor_power_is_optimal_among_its_kind() {
    let mut random = generator(10);
    let mut feasible = 0;
    for _ in 0..20_000 {
        let problem = Problem::draw(&mut random);
        let best = solve(&problem, Method::Exact);
        let power = Watt(problem.limits.sensor_power_max.0 * random.random_range(0.01..=1.0));
        let fixed = solve(&problem, Method::FixedSensorPower(power));
        check_constraints(&problem, &fixed);
        assert!(
            fixed.rate <= best.rate * (1.0 + 1e-9) + 1e-12,
            "{fixed:?} {best:?} {problem:?}"
        );
        for (b, gain) in problem
            .coefficients(&fixed)
            .iter()
            .zip(&problem.sensor_gains)
        {
            assert!(gain.0 == 0.0 || (b * b / power.0 - 1.0).abs() < 1e-12);
        }
        feasible += u32::from(fixed.status.is_feasible());
        match fixed.status {
            Status::Infeasible { least_mse } => {
                let mse = problem
                    .slot(&problem.coefficients(&fixed), Watt(0.0))
                    .mse(fixed.normalizing_factor);
                assert!(
                    (mse - least_mse).abs() <= 1e-9 * mse,
                    "{fixed:?} {problem:?}"
                );
            }
            status => {
                let heard = problem.user_gain.0 * problem.limits.user_power_max.0 > 0.0;
                assert_eq!(status.limited_by() == LimitedBy::None, !heard);
            }
        }
        // A little more user power would break the accuracy or the bound.
        if fixed.status.limited_by() == LimitedBy::Accuracy && fixed.rate > 1e-6 {
            let coefficients = problem.coefficients(&fixed);
            let slot = problem.slot(&coefficients, Watt(fixed.user_power.0 * (1.0 + 1e-6)));
            assert!(slot.mse(slot.normalizing_factor()) > problem.limits.mse_threshold);
        }
    }
    assert!(feasible > 1_000, "{feasible}");
}

/// A fixed sensor power is kept by a sensor beside which the noise is below rounding, and is no
/// power at all where sensors have none.
#[test]
fn fixed_sensor_power_at_the_ends_of_the_range() {
    let mut random = generator(13);
    let mut problem = Problem::draw_with(&mut random, 4);
    problem.sensor_gains = [1e25, 1e-3, 1e-12, 1e25].map(PowerGain).to_vec();
    let power = Watt(problem.limits.sensor_power_max.0 * 0.25);
    let fixed = solve(&problem, Method::FixedSensorPower(power));
    for b in problem.coefficients(&fixed) {
        assert!((b * b / power.0 - 1.0).abs() < 1e-12, "{b}");
    }
    let silent = problem.with(|limits| limits.sensor_power_max.0 = 0.0);
    let fixed = solve(&silent, Method::FixedSensorPower(power));
    assert_eq!(fixed.status, Status::Infeasible { least_mse: 0.25 });
    assert_eq!(silent.coefficients(&fixed), [0.0; 4]);
}

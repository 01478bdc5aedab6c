// SPDX-License-Identifier: MIT OR Apache-2.0
//! Solves a given number of slots by a given method: what `.ci/instruction-count` runs under
//! callgrind, with 0 and with many slots, to count instructions per slot.

#[path = "../tests/random_slots/mod.rs"]
mod random_slots;

use std::{env, process::ExitCode};

use firmware_core::{
    PowerGain, Scalar,
    inner::{Method, UncertainWorkspace, Workspace, alternating},
    uncertainty::{SensorUncertainty, Uncertainty},
};
use rand::RngExt;
use random_slots::{Problem, generator};

/// Slots as over the default mission, `J = 36`.
fn slots<T: Scalar>() -> Vec<(Problem, Vec<PowerGain<T>>)> {
    let mut random = generator(36);
    let drawn = (0..64).map(|_| {
        let problem = Problem::draw_with(&mut random, 36).with(|limits| {
            limits.sensor_power_max.0 = 0.05;
            limits.user_power_max.0 = 0.2;
            limits.noise_power.0 = 3.162e-13;
            limits.mse_threshold = 0.015;
        });
        let gains = problem.gains_in();
        (problem, gains)
    });
    drawn.collect()
}

/// A sum over everything that was computed, so that nothing is left out.
fn solve<T: Scalar>(method: &Method<T>, count: usize) -> f64 {
    let slots = slots::<T>();
    let mut workspace = Workspace::<T, 64>::default();
    let mut checksum = 0.0;
    for (problem, gains) in slots.iter().cycle().take(count) {
        let user = PowerGain(T::of(problem.user_gain.0));
        let solution = workspace
            .sensors(&problem.limits_in(), gains)
            .and_then(|field| method.solve(&field, Some(user)))
            .expect("a slot problem");
        let coefficients = gains.iter().map(|&gain| solution.coefficient(gain));
        let sum = coefficients.fold(solution.rate, |sum, b| sum + b);
        checksum += sum.to_f64();
    }
    checksum
}

/// Solves slots by the exact method whose channels are known up to errors, which differ from sensor
/// to sensor.
fn solve_uncertain<T: Scalar>(count: usize) -> f64 {
    let slots = slots::<T>();
    let mut random = generator(37);
    let mut sensor = || {
        let (variance, phase) = (random.random_range(0.0..0.1), random.random_range(0.0..0.4));
        SensorUncertainty::with_phase_error(T::of(variance), T::of(phase)).expect("in range")
    };
    let sensors: Vec<_> = (0..36).map(|_| sensor()).collect();
    let uncertainty = Uncertainty::<T, 64>::new(&sensors, T::of(0.05)).expect("in range");
    let uncertainty = uncertainty.of_slot();
    let mut workspace = UncertainWorkspace::<T, 64>::default();
    let mut checksum = 0.0;
    for (problem, gains) in slots.iter().cycle().take(count) {
        let user = PowerGain(T::of(problem.user_gain.0));
        let solution = workspace
            .sensors(&problem.limits_in(), gains, &uncertainty)
            .and_then(|field| field.solve(Some(user)))
            .expect("a slot problem");
        let known = gains.iter().zip(uncertainty.sensors());
        let coefficients =
            known.map(|(&gain, sensor)| solution.uncertain_coefficient(gain, sensor));
        let sum = coefficients.fold(solution.rate, |sum, b| sum + b);
        checksum += sum.to_f64();
    }
    checksum
}

/// Rates of 15 users over the same sensors.
fn rates(count: usize) -> f64 {
    let slots = slots::<f64>();
    let mut workspace = Workspace::<f64, 64>::default();
    let mut checksum = 0.0;
    for (problem, gains) in slots.iter().cycle().take(count) {
        let field = workspace
            .sensors(&problem.limits, gains)
            .expect("a slot problem");
        let users = slots.iter().take(15).map(|(other, _)| other.user_gain);
        checksum += users.map(|user| field.rate(user)).sum::<f64>();
    }
    checksum
}

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [what, count] = arguments.as_slice() else {
        eprintln!(
            "usage: inner_instructions exact-f64|exact-f32|uncertain-f64|uncertain-f32|rates-f64|alternating-f64 COUNT"
        );
        return ExitCode::from(2);
    };
    let Ok(count) = count.parse() else {
        eprintln!("COUNT is {count}, but must be a whole number");
        return ExitCode::from(2);
    };
    let checksum = match what.as_str() {
        "exact-f64" => solve::<f64>(&Method::Exact, count),
        "exact-f32" => solve::<f32>(&Method::Exact, count),
        "uncertain-f64" => solve_uncertain::<f64>(count),
        "uncertain-f32" => solve_uncertain::<f32>(count),
        "rates-f64" => rates(count),
        "alternating-f64" => solve::<f64>(
            &Method::Alternating(alternating::AlternatingSettings::default()),
            count,
        ),
        _ => {
            eprintln!(
                "{what} is none of exact-f64, exact-f32, uncertain-f64, uncertain-f32, rates-f64, alternating-f64"
            );
            return ExitCode::from(2);
        }
    };
    println!("{checksum}");
    ExitCode::SUCCESS
}

// SPDX-License-Identifier: MIT OR Apache-2.0
//! Time of the slot solvers on this machine: `cargo bench -p firmware-core --bench inner`.
//!
//! Every figure includes reading the gains and sorting them, and, where a whole slot is
//! solved, all coefficients. Slots differ from one iteration to the next, so that no branch
//! predictor learns them.

#[path = "../tests/random_slots/mod.rs"]
mod random_slots;

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use firmware_core::{
    PowerGain, Scalar,
    inner::{PrefixSum, SensorField, SlotLimits, Workspace, alternating::AlternatingSettings},
};
use random_slots::{Problem, generator, log_uniform};

const DISTINCT: usize = 512;

struct Slot<T> {
    limits: SlotLimits<T>,
    sensor_gains: Vec<PowerGain<T>>,
    user_gains: Vec<PowerGain<T>>,
}

fn slots<T: Scalar>(count: usize, sensors: usize) -> Vec<Slot<T>> {
    let mut random = generator(36);
    let slot = |_| {
        let problem = Problem::draw_with(&mut random, sensors);
        let mut user = || PowerGain(T::of(log_uniform(&mut random, 1e-12, 1e-9)));
        Slot {
            user_gains: (0..15).map(|_| user()).collect(),
            limits: problem.limits_in(),
            sensor_gains: problem.gains_in(),
        }
    };
    (0..count).map(slot).collect()
}

/// One slot at the paper's size, and the rates of all its users: what a controller computes.
fn paper_size<T: Scalar>(criterion: &mut Criterion, precision: &str) {
    let slots = slots::<T>(DISTINCT, 36);
    let mut group = criterion.benchmark_group(format!("exact/{precision}"));
    let mut workspace = Workspace::<T, 64>::default();
    let mut next = (0..DISTINCT).cycle();
    group.bench_function("slot with all coefficients, J = 36", |bencher| {
        bencher.iter(|| {
            let slot = &slots[next.next().unwrap_or(0)];
            let solution = workspace
                .sensors(&slot.limits, &slot.sensor_gains)
                .and_then(|field| field.solve(Some(slot.user_gains[0])))
                .expect("a slot problem");
            let mut coefficients = [T::zero(); 64];
            for (b, &gain) in coefficients.iter_mut().zip(&slot.sensor_gains) {
                *b = solution.coefficient(gain);
            }
            (solution, coefficients)
        });
    });
    group.bench_function("rates of 15 users, J = 36", |bencher| {
        bencher.iter(|| {
            let slot = &slots[next.next().unwrap_or(0)];
            let field = workspace
                .sensors(&slot.limits, &slot.sensor_gains)
                .expect("a slot problem");
            let mut rates = [T::zero(); 16];
            for (rate, &gain) in rates.iter_mut().zip(&slot.user_gains) {
                *rate = field.rate(gain);
            }
            rates
        });
    });
    group.finish();
}

/// On the host, with the memory on the heap: `O(J log J)`.
fn scaling(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("exact/scaling");
    for sensors in [
        16, 36, 64, 256, 1024, 4096, 16_384, 65_536, 262_144, 1_000_000,
    ] {
        let slots = slots::<f64>((65_536 / sensors).clamp(2, DISTINCT), sensors);
        let mut amplitude = vec![0.0; sensors];
        let mut sums = vec![PrefixSum::default(); sensors];
        let mut next = (0..slots.len()).cycle();
        group.throughput(Throughput::Elements(sensors as u64));
        group.sample_size(if sensors > 10_000 { 10 } else { 50 });
        group.bench_function(BenchmarkId::from_parameter(sensors), |bencher| {
            bencher.iter(|| {
                let slot = &slots[next.next().unwrap_or(0)];
                let sensor_gains = black_box(&slot.sensor_gains);
                SensorField::new(&slot.limits, sensor_gains, &mut amplitude, &mut sums)
                    .and_then(|field| field.solve(Some(slot.user_gains[0])))
                    .expect("a slot problem")
            });
        });
    }
    group.finish();
}

/// Alg. 1 on slots as over the default mission, feasible ones.
fn alternating(criterion: &mut Criterion) {
    let mut random = generator(37);
    let mut workspace = Workspace::<f64, 64>::default();
    let mut slots = Vec::new();
    while slots.len() < DISTINCT {
        let problem = Problem::draw_with(&mut random, 36).with(|limits| {
            limits.sensor_power_max.0 = 0.05;
            limits.user_power_max.0 = 0.2;
            limits.noise_power.0 = 3.162e-13;
            limits.mse_threshold = 0.015;
        });
        let field = workspace.sensors(&problem.limits, &problem.sensor_gains);
        if field.is_ok_and(|field| field.is_feasible()) {
            slots.push(problem);
        }
    }
    let mut group = criterion.benchmark_group("alternating");
    for tolerance in [1e-3, 1e-6] {
        let settings = AlternatingSettings {
            tolerance,
            ..AlternatingSettings::default()
        };
        let mut next = (0..DISTINCT).cycle();
        group.bench_function(BenchmarkId::new("slot, J = 36, xi", tolerance), |bencher| {
            bencher.iter(|| {
                let slot = &slots[next.next().unwrap_or(0)];
                workspace
                    .sensors(&slot.limits, &slot.sensor_gains)
                    .and_then(|field| field.alternate(Some(slot.user_gain), &settings, |_| {}))
                    .expect("a slot problem")
            });
        });
    }
    group.finish();
}

fn exact(criterion: &mut Criterion) {
    paper_size::<f64>(criterion, "f64");
    paper_size::<f32>(criterion, "f32");
    scaling(criterion);
}

criterion_group!(benches, exact, alternating);
criterion_main!(benches);

//! Time of a decision on the host: `cargo bench -p trainer --features onnx --bench plan`.
//!
//! Measures the shipped policy in tract and in the allocator-free MLP, and the slowest of 100,000
//! decisions in tract.

use std::{hint::black_box, time::Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use firmware_core::{
    Position, USERS_MAX,
    policy::{Observation, Policy, mlp::Mlp, onnx::OnnxPolicy},
    shield::Agility,
};
use trainer::onnx;

const FILE: &[u8] = include_bytes!("../../models/separated-sac.onnx");

fn decide(policy: &mut impl Policy<f64, USERS_MAX>) {
    let counts = [2; 15];
    black_box(policy.decide(black_box(&Observation {
        slot: 31,
        counts: &counts,
        rate: 1.0,
        mse: 0.015,
        position: Position::new(480.0, 510.0),
        agility: Agility {
            step_m: 30.0,
            reach_m: 30.0,
            velocity_change_m: f64::INFINITY,
            drift_m: [0.0; 2],
        },
    })));
}

fn plan(criterion: &mut Criterion) {
    let mut tract = OnnxPolicy::load(FILE).expect("sound");
    let actor = onnx::read::parse(FILE).expect("sound");
    let mut mlp = Mlp::load(actor.to_policy_file().expect("fits")).expect("sound");
    let mut group = criterion.benchmark_group("plan");
    group.bench_function("tract", |bencher| bencher.iter(|| decide(&mut tract)));
    group.bench_function("mlp", |bencher| bencher.iter(|| decide(&mut mlp)));
    group.finish();

    let mut micros: Vec<f64> = (0..100_000)
        .map(|_| {
            let start = Instant::now();
            decide(&mut tract);
            start.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    micros.sort_by(f64::total_cmp);
    println!(
        "tract of 100,000: median {:.1} us, 99.9 % {:.1} us, worst {:.1} us",
        micros[50_000], micros[99_900], micros[99_999]
    );
}

criterion_group!(benches, plan);
criterion_main!(benches);

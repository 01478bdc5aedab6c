//! Time of Clarabel on the slot problem: `cargo bench -p host-sim --bench conic`. One slot of the
//! default mission, over its centre.

use criterion::{Criterion, criterion_group, criterion_main};
use firmware_core::{
    Position,
    controller::ChannelState,
    inner::{SlotLimits, alternating::AlternatingSettings},
};
use reference::conic;
use scenario::Scenario;

fn slot(criterion: &mut Criterion) {
    let scenario = Scenario::shipped("separated").expect("shipped");
    let limits = SlotLimits::of_mission(&scenario.mission);
    let state = ChannelState::predicted(&scenario.mission, 1, &Position::new(500.0, 500.0));
    let user = Some(state.user_gains[0]);
    let settings = AlternatingSettings::default();
    let mut group = criterion.benchmark_group("conic, J = 36");
    group.sample_size(10);
    group.bench_function("(a) Alg. 1, eq:p_pbp by Clarabel", |bencher| {
        bencher.iter(|| conic::alternate(&limits, &state.sensor_gains, user, None, &settings));
    });
    group.bench_function("(b) eq:p1 by bisection", |bencher| {
        bencher.iter(|| conic::bisect(&limits, &state.sensor_gains, user, None));
    });
    group.finish();
}

criterion_group!(benches, slot);
criterion_main!(benches);

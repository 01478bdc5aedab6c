//! More users and sensors than a slot command can count.
use firmware_core::{Mission, controller::Controller, policy::StraightLine};

type Policy = StraightLine<f32, 40_000>;

fn create(mission: Mission<f32, 40_000, 40_000>) -> Controller<f32, Policy, 40_000, 40_000> {
    let policy = StraightLine::new(&mission);
    Controller::new(mission, policy)
}

fn main() {
    std::hint::black_box(create as fn(_) -> _);
}

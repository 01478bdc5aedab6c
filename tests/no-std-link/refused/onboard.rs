//! 200 sensors, but an onboard computer whose frames are long enough for 64 only.
use firmware_core::{
    autopilot::Autopilot,
    controller::Controller,
    onboard::{Onboard, OnboardSettings},
    policy::StraightLine,
};

fn create(
    controller: Controller<f32, StraightLine<f32, 16>, 16, 200>,
    autopilot: Autopilot<f32>,
) -> Onboard<f32, StraightLine<f32, 16>, 16, 200> {
    Onboard::new(OnboardSettings::default(), controller, autopilot)
}

fn main() {
    std::hint::black_box(create as fn(_, _) -> _);
}

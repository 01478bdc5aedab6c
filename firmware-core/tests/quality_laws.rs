// SPDX-License-Identifier: MIT OR Apache-2.0
//! The controller with channels that are not known exactly: it allocates as the slot solver with the
//! statistics that the ground has sent, and without errors as it does without statistics.
//! `change_laws.rs` has the laws in flights whose missions change.

#[path = "../src/test_missions.rs"]
mod test_missions;

use firmware_core::{
    Mission, Position, PowerGain, Scalar, Watt, aircomp,
    controller::{
        ChannelQuality, ChannelState, Controller, SensorQuality, SlotCommand, UserQuality,
    },
    inner::{Method, SlotLimits, Status, UncertainWorkspace, alternating::AlternatingSettings},
    mission::MissionParameters,
    policy::StraightLine,
    uncertainty::{SlotUncertainty, Uncertainty},
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use test_missions::{table_one, table_one_parameters};

type Quality = ChannelQuality<16, 64>;
type Controlled<T> = Controller<T, StraightLine<T, 16>, 16, 64, Method<T>>;

fn controller<T: Scalar>(mission: &Mission<T, 16, 64>, method: Method<T>) -> Controlled<T> {
    Controller::with_solver(mission.clone(), StraightLine::new(mission), method)
}

fn uniform<T: Scalar>(mission: &Mission<T, 16, 64>, variance: f64, phase_rad: f64) -> Quality {
    let user = UserQuality::new(variance).expect("valid");
    let sensor = SensorQuality::new(variance, phase_rad).expect("valid");
    Quality::uniform(mission, 1, user, sensor)
}

fn statistics<T: Scalar>(
    quality: &Quality,
    user: Option<usize>,
    sensors: usize,
) -> Uncertainty<T, 64> {
    let sensors: Vec<_> = (0..sensors)
        .map(|j| quality.sensor(j).uncertainty())
        .collect();
    let user = user.map_or(T::zero(), |user| quality.user(user).error_variance());
    Uncertainty::new(&sensors, user).expect("valid statistics")
}

/// Returns expected MSE and achievable rate of a command.
fn expected<T: Scalar>(
    mission: &Mission<T, 16, 64>,
    state: &ChannelState<T, 16, 64>,
    command: &SlotCommand<T, 64>,
    errors: &SlotUncertainty<'_, T>,
) -> (T, T) {
    let user = command.served_user.expect("a user is heard");
    let slot = aircomp::Slot {
        sensor_gains: &state.sensor_gains,
        sensor_coefficients: &command.sensor_coefficients,
        user_gain: state.user_gains[user],
        user_power: command.user_power,
        noise_power: mission.parameters().noise_power,
    };
    let mse = slot.expected_mse(errors, command.normalizing_factor);
    (mse, slot.achievable_rate(errors))
}

fn draw<T: Scalar>(mission: &Mission<T, 16, 64>, slot: u32, random: &mut Pcg64Mcg) -> Quality {
    let largest = [0.01, 0.1, 0.3][random.random_range(0..3)];
    let mut error = || random.random_range(0.0..=largest);
    let users = 0..mission.user_count();
    let sensors = 0..mission.sensor_count();
    Quality {
        slot,
        users: users
            .map(|_| UserQuality::new(error()).expect("valid"))
            .collect(),
        sensors: sensors
            .map(|_| SensorQuality::new(error(), error()).expect("valid"))
            .collect(),
    }
}

/// Whatever the method, MSE and rate of each command are those of its powers in expectation, and
/// `Gamma` is kept where the slot is feasible. The exact method gives the solver's own answer.
fn commands_hold_in_expectation<T: Scalar>(tolerance: f64) {
    let mission = table_one::<T>();
    let p = mission.parameters();
    let mut random = Pcg64Mcg::seed_from_u64(31);
    let methods = [
        Method::Exact,
        Method::Alternating(AlternatingSettings::default()),
        Method::FixedUserPower(p.user_power_max),
        Method::FixedSensorPower(Watt(p.sensor_power_max.0 * T::of(0.1))),
    ];
    let mut feasible = 0;
    for method in methods {
        let mut controller = controller(&mission, method);
        let mut here = p.start;
        while !controller.is_over() {
            let plan = controller.plan(here).expect("at rest");
            here = plan.waypoint;
            let quality = draw(&mission, plan.slot, &mut random);
            controller.note_quality(&quality).expect("in turn");
            let mut state = ChannelState::predicted(&mission, plan.slot, &here);
            for gain in state.user_gains.iter_mut().chain(&mut state.sensor_gains) {
                gain.0 *= T::of(random.random_range(0.5..20.0));
            }
            let command = controller.allocate(&state).expect("under way");
            command.check(&mission).expect("keeps the rules");
            let errors = statistics(&quality, command.served_user, p.sensors.len());
            let (mse, rate) = expected(&mission, &state, &command, &errors.of_slot());
            let close = |a: T, b: T| (a - b).abs() <= b * T::of(tolerance);
            assert!(close(mse, command.mse), "{method:?}: {mse} {}", command.mse);
            assert!(
                close(rate, command.rate),
                "{method:?}: {rate} {}",
                command.rate
            );
            feasible += u32::from(command.status.is_feasible() && command.rate > T::zero());
            if method == Method::Exact {
                let mut workspace = UncertainWorkspace::<T, 64>::default();
                let errors = errors.of_slot();
                let limits = SlotLimits::of_mission(&mission);
                let field = workspace
                    .sensors(&limits, &state.sensor_gains, &errors)
                    .expect("valid");
                let user = state.user_gains[command.served_user.expect("heard")];
                let solution = field.solve(Some(user)).expect("valid");
                assert_eq!(solution.rate, command.rate);
                assert_eq!(solution.status, command.status);
            }
        }
    }
    assert!(feasible > 100, "{feasible}");
}

#[test]
fn commands_hold_in_expectation_with_every_method() {
    commands_hold_in_expectation::<f64>(1e-9);
    commands_hold_in_expectation::<f32>(2e-4);
}

/// A quality without errors is none, to the bit, also after one with errors.
fn exact_quality_is_none<T: Scalar>() {
    let mission = table_one::<T>();
    let fly = |qualities: &[(u32, Quality)]| {
        let mut controller = controller(&mission, Method::Exact);
        let mut here = mission.parameters().start;
        let mut commands = Vec::new();
        while !controller.is_over() {
            let plan = controller.plan(here).expect("at rest");
            here = plan.waypoint;
            for (slot, quality) in qualities.iter().filter(|(slot, _)| *slot == plan.slot) {
                let quality = Quality {
                    slot: *slot,
                    ..quality.clone()
                };
                controller.note_quality(&quality).expect("in turn");
            }
            commands.push(if plan.slot % 5 == 0 {
                controller.allocate_predicted(&here).expect("under way")
            } else {
                let state = ChannelState::predicted(&mission, plan.slot, &here);
                controller.allocate(&state).expect("under way")
            });
        }
        commands
    };
    let (exact, uncertain) = (uniform(&mission, 0.0, 0.0), uniform(&mission, 0.05, 0.2));
    let without = fly(&[]);
    assert_eq!(fly(&[(1, exact.clone())]), without);
    let some = fly(&[(20, uncertain), (31, exact)]);
    assert_eq!(some[..19], without[..19]);
    assert_eq!(some[30..], without[30..]);
    // The errors cost rate in each slot of a channel state that has any, and change the guarantees.
    for (with, without) in some.iter().zip(&without).take(30).skip(19) {
        assert!(
            with.rate <= without.rate && with != without,
            "{with:?} {without:?}"
        );
    }
}

#[test]
fn an_exact_quality_is_none() {
    exact_quality_is_none::<f64>();
    exact_quality_is_none::<f32>();
}

/// A mission over whose sensors `Gamma` can be met with errors: the threshold is twice that of Table I.
fn lenient_mission() -> Mission<f64, 16, 64> {
    let p = table_one_parameters();
    let p = MissionParameters {
        mse_threshold: 0.02,
        ..p
    };
    Mission::new(p).expect("valid")
}

/// Allocates slot 1 at a position.
fn command_at(
    over: Position<f64>,
    mission: &Mission<f64, 16, 64>,
    quality: Option<&Quality>,
) -> (ChannelState<f64, 16, 64>, SlotCommand<f64, 64>) {
    let mut controller = controller(mission, Method::Exact);
    controller
        .plan(mission.parameters().start)
        .expect("at rest");
    if let Some(quality) = quality {
        controller.note_quality(quality).expect("in turn");
    }
    let state = ChannelState::predicted(mission, 1, &over);
    let command = controller.allocate(&state).expect("under way");
    command.check(mission).expect("keeps the rules");
    (state, command)
}

/// With an error variance of 0.05 and a phase error of 0.3 rad, an allocation that ignores the errors
/// is above `Gamma` in expectation, and one that knows them is not.
#[test]
fn naive_allocation_breaks_the_threshold_and_robust_does_not() {
    let mission = lenient_mission();
    let gamma = mission.parameters().mse_threshold;
    let over = Position::new(725.0, 235.0);
    let quality = uniform(&mission, 0.05, 0.3);
    let (state, naive) = command_at(over, &mission, None);
    let errors = statistics(&quality, naive.served_user, 36);
    let (mse, _) = expected(&mission, &state, &naive, &errors.of_slot());
    assert!(
        naive.mse <= gamma && mse > 1.05 * gamma,
        "{} {mse}",
        naive.mse
    );
    let (_, robust) = command_at(over, &mission, Some(&quality));
    let (mse, _) = expected(&mission, &state, &robust, &errors.of_slot());
    assert!(
        robust.status.is_feasible() && mse <= gamma * (1.0 + 1e-12),
        "{mse}"
    );
    assert!(robust.rate > 0.0 && robust.rate < naive.rate);
}

/// Too large an error is told apart from too little power.
#[test]
fn the_status_names_the_error_floor() {
    let mission = lenient_mission();
    let over = mission.parameters().start;
    // 36 sensors of weight m: the floor (1 - m) / 36 is above Gamma from m = 0.28 on downwards.
    let (_, hopeless) = command_at(over, &mission, Some(&uniform(&mission, 0.05, 1.2)));
    assert!(
        matches!(hopeless.status, Status::ErrorFloor { .. }),
        "{:?}",
        hopeless.status
    );
    assert_eq!((hopeless.user_power, hopeless.rate), (Watt(0.0), 0.0));
    // As large an error is no floor where sensors are many times louder: power is what is missing.
    let (_, weak) = command_at(over, &mission, Some(&uniform(&mission, 0.05, 1.08)));
    let p = mission.parameters();
    let strong = MissionParameters {
        sensor_power_max: Watt(p.sensor_power_max.0 * 1e4),
        ..p.clone()
    };
    let strong = Mission::new(strong).expect("valid");
    assert!(
        matches!(weak.status, Status::Infeasible { .. }),
        "{:?}",
        weak.status
    );
    let (_, loud) = command_at(over, &strong, Some(&uniform(&strong, 0.05, 1.08)));
    assert!(loud.status.is_feasible(), "{:?}", loud.status);
    // The guarantee without a state says the same.
    let mut controller = controller(&mission, Method::Exact);
    controller.plan(p.start).expect("at rest");
    controller
        .note_quality(&uniform(&mission, 0.05, 1.2))
        .expect("in turn");
    let blind = controller.allocate_predicted(&p.start).expect("under way");
    blind.check(&mission).expect("keeps the rules");
    assert!(
        matches!(blind.status, Status::ErrorFloor { .. }),
        "{:?}",
        blind.status
    );
}

/// Where a state is missing, what is guaranteed in expectation holds for links that are a constant
/// factor from the model.
fn guarantees_hold<T: Scalar>() {
    let p = MissionParameters {
        mse_threshold: T::of(0.024),
        sensor_power_max: Watt(T::of(5.0)),
        ..table_one_parameters::<T>()
    };
    let mission = Mission::new(p).expect("valid");
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let mut promised = 0;
    for _ in 0..20 {
        let mut controller = controller(&mission, Method::Exact);
        let mut factor = || T::of(random.random_range(0.3..3.0));
        let users: Vec<_> = (0..16).map(|_| factor()).collect();
        let sensors: Vec<_> = (0..64).map(|_| factor()).collect();
        let mut here = mission.parameters().start;
        while !controller.is_over() {
            let plan = controller.plan(here).expect("at rest");
            here = plan.waypoint;
            let quality = draw(&mission, plan.slot, &mut random);
            controller.note_quality(&quality).expect("in turn");
            let mut state = ChannelState::predicted(&mission, plan.slot, &here);
            let scale = |gains: &mut [PowerGain<T>], factors: &[T]| {
                for (gain, &factor) in gains.iter_mut().zip(factors) {
                    gain.0 *= factor;
                }
            };
            scale(&mut state.user_gains, &users);
            scale(&mut state.sensor_gains, &sensors);
            if plan.slot % 2 == 1 {
                controller.allocate(&state).expect("under way");
                continue;
            }
            let command = controller.allocate_predicted(&here).expect("under way");
            command.check(&mission).expect("keeps the rules");
            let errors = statistics(&quality, command.served_user, 36);
            let (mse, rate) = expected(&mission, &state, &command, &errors.of_slot());
            let close = T::one() + T::of(1e-4);
            assert!(mse <= command.mse * close, "{mse} {}", command.mse);
            assert!(rate * close >= command.rate, "{rate} {}", command.rate);
            promised += u32::from(command.rate > T::zero());
        }
    }
    assert!(promised > 100, "{promised}");
}

#[test]
fn guarantees_without_a_state_hold_in_expectation() {
    guarantees_hold::<f64>();
    guarantees_hold::<f32>();
}

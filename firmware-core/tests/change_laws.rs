// SPDX-License-Identifier: MIT OR Apache-2.0
//! Laws of a mission whose knowledge changes in flight: whatever changes, valid or not, every slot
//! keeps its constraints, those who are there are treated fairly, and nothing panics. All of it also
//! holds where channels are known up to errors whose statistics change, in expectation.

#[path = "../src/test_missions.rs"]
mod test_missions;

use firmware_core::{
    Mission, Position, PowerGain, Scalar, Watt, aircomp,
    controller::{
        ChannelQuality, ChannelState, Controller, DatedChange, SensorQuality, SlotCommand,
        UserQuality,
    },
    inner::{LimitedBy, Status},
    mission::{Area, MissionChange, MissionParameters, rounding_m},
    planner::{Capacity, Planner},
    policy::{Policy, StraightLine},
    uncertainty::Uncertainty,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use test_missions::table_one_without_nodes;

const M: usize = 6;
const J: usize = 9;

fn place<T: Scalar>(random: &mut Pcg64Mcg) -> Position<T> {
    let mut along = || T::of(random.random_range(0.0..=600.0));
    Position::new(along(), along())
}

fn mission<T: Scalar>(random: &mut Pcg64Mcg) -> Mission<T, M, J> {
    let users = random.random_range(1..=M);
    let sensors = random.random_range(1..=J);
    Mission::new(MissionParameters {
        slots: random.random_range(1..30),
        start: place(random),
        destination: place(random),
        area: Area {
            east_m: T::of(600.0),
            north_m: T::of(600.0),
        },
        max_speed_mps: T::of(random.random_range(500.0..900.0)),
        mse_threshold: T::of(random.random_range(0.1..0.95) / sensors as f64),
        users: (0..users).map(|_| place(random)).collect(),
        sensors: (0..sensors).map(|_| place(random)).collect(),
        ..table_one_without_nodes()
    })
    .expect("a valid mission")
}

/// Any change; about one in three is refused by most missions.
fn change<T: Scalar>(random: &mut Pcg64Mcg) -> MissionChange<T> {
    let user = random.random_range(0..M as u16 + 2);
    let sensor = random.random_range(0..J as u16 + 2);
    let position_m = match random.random_range(0..8) {
        0 => Position::new(T::of(f64::NAN), T::zero()),
        1 => Position::new(T::of(-1.0), T::of(700.0)),
        _ => place(random),
    };
    match random.random_range(0..8) {
        0 => MissionChange::User { user, position_m },
        1 => MissionChange::UserLeft { user },
        2 => MissionChange::Sensor { sensor, position_m },
        3 => MissionChange::SensorLeft { sensor },
        4 => MissionChange::MseThreshold(T::of(random.random_range(-0.01..0.2))),
        5 => MissionChange::NoisePower(Watt::from_dbm(T::of(random.random_range(-110.0..-70.0)))),
        6 => MissionChange::MaxSpeed(T::of(random.random_range(-10.0..900.0))),
        _ => MissionChange::Slots(random.random_range(0..35)),
    }
}

/// Checks a command against the mission as it is now, with the average over the sensors that are
/// there.
fn check_command<T: Scalar>(
    mission: &Mission<T, M, J>,
    known: Known<'_, T>,
    command: &SlotCommand<T, J>,
) {
    command.check(mission).expect("keeps the rules");
    let user = command.served_user.expect("every gain is heard");
    assert!(mission.has_user(user), "user {user} has left");
    let coefficients = &command.sensor_coefficients;
    for (sensor, &coefficient) in coefficients.iter().enumerate() {
        assert!(mission.has_sensor(sensor) || coefficient == T::zero());
    }
    let (mse, rate) = expected(mission, known, command);
    for (expected, stated) in [(mse, command.mse), (rate, command.rate)] {
        let difference = (expected - stated).abs();
        assert!(difference <= stated * T::of(1e-4), "{expected} {stated}");
    }
}

/// A channel state and its quality.
type Known<'a, T> = (&'a ChannelState<T, M, J>, &'a ChannelQuality<M, J>);

/// Returns expected MSE and achievable rate over the sensors that are there, for a state of some
/// quality.
fn expected<T: Scalar>(
    mission: &Mission<T, M, J>,
    (state, quality): Known<'_, T>,
    command: &SlotCommand<T, J>,
) -> (T, T) {
    let coefficients = &command.sensor_coefficients;
    let present = mission.sensors().map(|(sensor, _)| sensor);
    let gains: Vec<PowerGain<T>> = present.clone().map(|j| state.sensor_gains[j]).collect();
    let coefficients: Vec<T> = present.map(|j| coefficients[j]).collect();
    let slot = aircomp::Slot {
        sensor_gains: &gains,
        sensor_coefficients: &coefficients,
        user_gain: command
            .served_user
            .map_or(PowerGain(T::zero()), |m| state.user_gains[m]),
        user_power: command.user_power,
        noise_power: mission.parameters().noise_power,
    };
    let sensors: Vec<_> = (mission.sensors())
        .map(|(j, _)| quality.sensor(j).uncertainty::<T>())
        .collect();
    let user = command.served_user.unwrap_or(0);
    let errors = Uncertainty::<T, J>::new(&sensors, quality.user(user).error_variance());
    let errors = errors.expect("valid statistics");
    (
        slot.expected_mse(&errors.of_slot(), command.normalizing_factor),
        slot.achievable_rate(&errors.of_slot()),
    )
}

/// A quality for a slot, with errors of about every second node; for any number of nodes once in a
/// while, which is refused.
fn draw_quality<T: Scalar>(
    mission: &Mission<T, M, J>,
    slot: u32,
    random: &mut Pcg64Mcg,
) -> ChannelQuality<M, J> {
    let largest = [0.0, 0.01, 0.1, 1.0][random.random_range(0..4)];
    let mut error = || match random.random_bool(0.5) {
        true => random.random_range(0.0..=largest),
        false => 0.0,
    };
    let mut quality = ChannelQuality {
        slot,
        users: (0..mission.user_count())
            .map(|_| UserQuality::new(error()).expect("valid"))
            .collect(),
        sensors: (0..mission.sensor_count())
            .map(|_| SensorQuality::new(error(), error()).expect("valid"))
            .collect(),
    };
    if random.random_bool(0.05) {
        quality.users.truncate(random.random_range(0..=M));
    }
    quality
}

/// What a flight has shown.
#[derive(Default)]
struct Seen {
    changes: u32,
    refused: u32,
    joined: u32,
    out_of_reach: u32,
    /// Slots with an error floor above `Gamma`, without enough power, limited by either, and with a
    /// guarantee.
    error_floor: u32,
    infeasible: u32,
    optimal: u32,
    guaranteed: u32,
}

fn fly<T: Scalar>(
    policy: impl FnOnce(&Mission<T, M, J>) -> Box<dyn Policy<T, M>>,
    random: &mut Pcg64Mcg,
    with_errors: bool,
    seen: &mut Seen,
) {
    let mut known = ChannelQuality::default();
    let mission = mission::<T>(random);
    let users_before = mission.user_count();
    let mut controller = Controller::new(mission.clone(), BoxedPolicy(policy(&mission)));
    let mut here = mission.parameters().start;
    let mut reachable = true;
    while !controller.is_over() {
        let slots_left = controller.mission().slots() - controller.slots_done();
        let reach_m = controller.mission().reach_m();
        let way_m = (here - mission.parameters().destination).norm();
        reachable &= way_m <= T::count(slots_left as usize + 1) * reach_m;
        let plan = controller.plan(here).expect("at rest");
        let slack_m = rounding_m(&mission.parameters().area, reach_m) * T::of(4.0);
        let step_m = (plan.waypoint - here).norm();
        assert!(step_m <= reach_m + slack_m, "{step_m} m of {reach_m} m");
        assert!(mission.parameters().area.contains(&plan.waypoint));
        assert!(controller.mission().has_user(plan.served_user));
        here = plan.waypoint;
        for _ in 0..random.random_range(0..3) {
            let change = DatedChange {
                from_slot: plan.slot + random.random_range(0..3),
                change: change(random),
            };
            seen.changes += u32::from(controller.note_change(&change));
        }
        controller.improve_plan(20_000);
        let quality = controller.policy().quality();
        assert!(quality.is_none_or(|quality| quality.value.is_finite()));
        let state = ChannelState::predicted(controller.mission(), plan.slot, &here);
        let before = controller.mission().clone();
        if with_errors && random.random_bool(0.3) {
            let noted = draw_quality(&before, plan.slot, random);
            let fits = noted.users.len() == before.user_count();
            assert_eq!(controller.note_quality(&noted).is_ok(), fits);
            if fits {
                known = noted;
            }
        }
        let mut see = |status: Status<T>| match status {
            Status::ErrorFloor { .. } => seen.error_floor += 1,
            Status::Infeasible { .. } => seen.infeasible += 1,
            Status::Optimal {
                limited_by: LimitedBy::Accuracy | LimitedBy::Power,
            } => seen.optimal += 1,
            Status::Guaranteed { .. } => seen.guaranteed += 1,
            _ => {}
        };
        if random.random_range(0..4) == 0 {
            // The state is lost. What is promised without it holds at the true gains, wherever users
            // and sensors have moved to.
            let command = controller.allocate_predicted(&here).expect("finite");
            command.check(&before).expect("keeps the rules");
            let promised = command.mse;
            let (mse, rate) = expected(&before, (&state, &known), &command);
            assert!(mse <= promised * T::of(1.0 + 1e-4), "{mse} {promised}");
            assert!(
                rate >= command.rate * T::of(1.0 - 1e-4),
                "{rate} {}",
                command.rate
            );
            see(command.status);
            continue;
        }
        let command = controller.allocate(&state).expect("under way");
        check_command(&before, (&state, &known), &command);
        see(command.status);
    }
    // The last change may have taken the slots that were left.
    let slots_left = controller.mission().slots() - controller.slots_done();
    let way_m = (here - mission.parameters().destination).norm();
    let reach_m = controller.mission().reach_m();
    reachable &= way_m <= T::count(slots_left as usize + 1) * reach_m;
    if reachable {
        assert!(
            controller.mission().has_arrived(&here),
            "{way_m} m of {reach_m} m"
        );
    }
    assert!(
        controller.fairness().is_fair(),
        "{:?}",
        controller.fairness()
    );
    seen.refused += controller.changes_refused();
    seen.joined += u32::from(controller.mission().user_count() > users_before);
    seen.out_of_reach += u32::from(!reachable);
}

struct BoxedPolicy<T: Scalar>(Box<dyn Policy<T, M>>);

impl<T: Scalar> Policy<T, M> for BoxedPolicy<T> {
    fn decide(
        &mut self,
        observation: &firmware_core::policy::Observation<'_, T>,
    ) -> firmware_core::policy::Action<T, M> {
        self.0.decide(observation)
    }

    fn revise(&mut self, change: &MissionChange<T>, slots_done: u32) {
        self.0.revise(change, slots_done);
    }

    fn note_gains(&mut self, measured: &firmware_core::policy::MeasuredGains<'_, T>) {
        self.0.note_gains(measured);
    }

    fn improve(&mut self, operations: u64) {
        self.0.improve(operations);
    }

    fn quality(&self) -> Option<firmware_core::policy::PlanQuality> {
        self.0.quality()
    }
}

fn with_planner<T: Scalar + 'static>(mission: &Mission<T, M, J>) -> Box<dyn Policy<T, M>> {
    let capacity = Capacity {
        nodes: 9 * 9,
        stages: 12,
        ..Capacity::new(35, M)
    };
    let memory = (
        vec![T::zero(); capacity.values()],
        vec![0; capacity.indices()],
    );
    let mut planner = Planner::new(mission, capacity, memory).expect("enough memory");
    planner.advance(200_000);
    Box::new(planner.with_operations_per_slot(20_000))
}

fn with_straight_line<T: Scalar + 'static>(mission: &Mission<T, M, J>) -> Box<dyn Policy<T, M>> {
    Box::new(StraightLine::new(mission))
}

#[test]
fn whatever_changes_the_constraints_hold() {
    let mut random = Pcg64Mcg::seed_from_u64(16);
    let mut seen = Seen::default();
    for _ in 0..300 {
        fly::<f64>(with_planner, &mut random, false, &mut seen);
        fly::<f32>(with_planner, &mut random, false, &mut seen);
        fly::<f64>(with_straight_line, &mut random, false, &mut seen);
        fly::<f32>(with_straight_line, &mut random, false, &mut seen);
    }
    // The flights have shown what they are meant to show.
    assert!(
        seen.changes > 5_000 && seen.joined > 100,
        "{} {}",
        seen.changes,
        seen.joined
    );
    assert!(
        seen.refused > 500 && seen.refused < seen.changes / 2,
        "{}",
        seen.refused
    );
    assert!(seen.out_of_reach < 1_000, "{}", seen.out_of_reach);
}

/// The same with statistics of errors, which follow users and sensors wherever these are in the lists.
#[test]
fn whatever_changes_the_constraints_hold_in_expectation() {
    let mut random = Pcg64Mcg::seed_from_u64(17);
    let mut seen = Seen::default();
    for _ in 0..300 {
        fly::<f64>(with_planner, &mut random, true, &mut seen);
        fly::<f32>(with_straight_line, &mut random, true, &mut seen);
    }
    assert!(seen.changes > 2_500 && seen.joined > 50);
    for slots in [
        seen.error_floor,
        seen.infeasible,
        seen.optimal,
        seen.guaranteed,
    ] {
        assert!(
            slots > 100,
            "{} {} {} {}",
            seen.error_floor,
            seen.infeasible,
            seen.optimal,
            seen.guaranteed
        );
    }
}

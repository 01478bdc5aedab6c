// SPDX-License-Identifier: MIT OR Apache-2.0
//! Laws of the planner for any mission, state and budget: plans are feasible and finite, and more
//! work never makes them worse.

#[path = "../src/test_missions.rs"]
mod test_missions;

use firmware_core::{
    Displacement, Mission, Position, Scalar, Watt,
    inner::{SlotLimits, Workspace},
    mission::{Area, MissionChange, MissionParameters},
    planner::{Capacity, OperationsInFlight, Planner, PlannerError, PlannerState},
    policy::{Action, Observation, Policy},
    shield::Agility,
};
use proptest::prelude::*;
use test_missions::table_one_without_nodes;

const M: usize = 8;
const J: usize = 12;

type TestMission<T> = Mission<T, M, J>;
type TestPlanner<T> = Planner<T, (Vec<T>, Vec<u8>), M, J>;

/// A mission in dimensionless numbers, from which a mission in either precision is made.
#[derive(Clone, Debug)]
struct Numbers {
    slots: u32,
    area_m: [f64; 2],
    /// Start, destination, users and sensors, as fractions of the area.
    start: [f64; 2],
    destination: [f64; 2],
    users: Vec<[f64; 2]>,
    sensors: Vec<[f64; 2]>,
    altitude_m: f64,
    speed_mps: f64,
    noise_dbm: f64,
    threshold: f64,
}

impl Numbers {
    /// The mission; with a higher speed where the destination would be out of reach.
    fn mission<T: Scalar>(&self) -> TestMission<T> {
        let place = |[east, north]: [f64; 2]| {
            Position::new(T::of(east * self.area_m[0]), T::of(north * self.area_m[1]))
        };
        let (start, destination) = (place(self.start), place(self.destination));
        let distance_m = (destination - start).norm().to_f64();
        let least_mps = distance_m / f64::from(self.slots + 1) * 1.001;
        let sensors = self.sensors.len() as f64;
        let parameters = MissionParameters {
            slots: self.slots,
            start,
            destination,
            area: Area {
                east_m: T::of(self.area_m[0]),
                north_m: T::of(self.area_m[1]),
            },
            altitude_m: T::of(self.altitude_m),
            max_speed_mps: T::of(self.speed_mps.max(least_mps)),
            noise_power: Watt::from_dbm(T::of(self.noise_dbm)),
            mse_threshold: T::of(self.threshold / sensors),
            users: self.users.iter().map(|&user| place(user)).collect(),
            sensors: self.sensors.iter().map(|&sensor| place(sensor)).collect(),
            ..table_one_without_nodes()
        };
        Mission::new(parameters).expect("a valid mission")
    }
}

fn fractions() -> impl Strategy<Value = [f64; 2]> {
    let fraction = prop_oneof![4 => 0.0..1.0, 1 => Just(0.0), 1 => Just(1.0)];
    [fraction.clone(), fraction]
}

fn numbers() -> impl Strategy<Value = Numbers> {
    let exponent = |low: f64, high: f64| (low..high).prop_map(|x: f64| 10_f64.powf(x));
    (
        (1..30_u32, [exponent(0.0, 5.0), exponent(0.0, 5.0)]),
        (fractions(), fractions()),
        prop::collection::vec(fractions(), 1..=M),
        prop::collection::vec(fractions(), 1..=J),
        (exponent(0.0, 4.0), exponent(-2.0, 4.0)),
        (-120.0..-60.0, 0.05..0.99),
    )
        .prop_map(
            |(
                (slots, area_m),
                (start, destination),
                users,
                sensors,
                (altitude_m, speed_mps),
                rest,
            )| {
                let (noise_dbm, threshold) = rest;
                Numbers {
                    slots,
                    area_m,
                    start,
                    destination,
                    users,
                    sensors,
                    altitude_m,
                    speed_mps,
                    noise_dbm,
                    threshold,
                }
            },
        )
}

/// Any coordinate, in fractions of the area: mostly inside, sometimes no number at all.
fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => 0.0..1.0,
        1 => -2.0..3.0,
        1 => prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e30]),
    ]
}

#[derive(Clone, Debug)]
struct State {
    slot: u32,
    position: [f64; 2],
    counts: Vec<u32>,
    /// The longest step, the largest change of velocity, and the last slot's displacement, as
    /// fractions of `V_max delta`.
    reach: f64,
    velocity_change: f64,
    drift: [f64; 2],
}

impl State {
    fn agility<T: Scalar>(&self, limit_m: T) -> Agility<T> {
        let step_m = limit_m * T::of(self.reach);
        Agility {
            step_m,
            reach_m: step_m,
            velocity_change_m: limit_m * T::of(self.velocity_change),
            drift_m: self.drift.map(|drift| limit_m * T::of(drift)),
        }
    }
}

fn state() -> impl Strategy<Value = State> {
    let reach = prop_oneof![
        3 => Just(1.0),
        2 => 0.3..1.5,
        1 => prop::sample::select(vec![f64::NAN, -1.0, 0.0, f64::INFINITY, 1e-9]),
    ];
    let velocity_change = prop_oneof![
        3 => Just(f64::INFINITY),
        2 => 0.01..1.0,
        1 => prop::sample::select(vec![f64::NAN, -1.0, 0.0, 1e-30]),
    ];
    let drift = || prop_oneof![9 => -1.2..1.2, 1 => Just(f64::NAN)];
    let count = prop_oneof![9 => 0..6_u32, 1 => Just(u32::MAX)];
    (
        0..40_u32,
        [coordinate(), coordinate()],
        prop::collection::vec(count, 0..=M + 2),
        reach,
        velocity_change,
        [drift(), drift()],
    )
        .prop_map(
            |(slot, position, counts, reach, velocity_change, drift)| State {
                slot,
                position,
                counts,
                reach,
                velocity_change,
                drift,
            },
        )
}

fn planner<T: Scalar>(mission: &TestMission<T>) -> TestPlanner<T> {
    let capacity = Capacity {
        nodes: 9 * 9,
        stages: 12,
        ..Capacity::new(40, M)
    };
    let memory = (
        vec![T::of(f64::NAN); capacity.values()],
        vec![0xff; capacity.indices()],
    );
    Planner::new(mission, capacity, memory).expect("enough memory")
}

/// The sum of the rates of the plan by the channel model.
fn total<T: Scalar>(planner: &mut TestPlanner<T>) -> f64 {
    let mission = planner.mission().clone();
    let p = mission.parameters();
    let limits = SlotLimits::of_mission(&mission);
    let mut workspace = Workspace::<T, J>::default();
    let mut sum = 0.0;
    for slot in planner.slot()..=mission.slots() {
        let place = planner.waypoint(slot).expect("a slot ahead");
        let user = planner.served_user(slot).expect("a slot ahead");
        let gain = |node| mission.channel().power_gain(&place, node);
        let sensors: Vec<_> = p.sensors.iter().map(gain).collect();
        let field = workspace
            .sensors(&limits, &sensors)
            .expect("a slot problem");
        if field.is_feasible() {
            sum += field.rate(gain(&p.users[user])).to_f64();
        }
    }
    sum
}

/// Speed, area, arrival, users and quotas of the plan from `from` with `reach_m`.
fn check_feasible<T: Scalar>(
    planner: &mut TestPlanner<T>,
    from: Position<T>,
    reach_m: T,
    counts: &[u32],
) -> Result<(), TestCaseError> {
    let mission = planner.mission().clone();
    let p = mission.parameters();
    let slots_left = (mission.slots() + 1).saturating_sub(planner.slot());
    let slack_m = firmware_core::mission::rounding_m(&p.area, reach_m);
    let inside = |place: Position<T>| {
        Position::new(
            place.x.max(T::zero()).min(p.area.east_m),
            place.y.max(T::zero()).min(p.area.north_m),
        )
    };
    let start = inside(from);
    let distance_m = (p.destination - start).norm();
    let reachable = distance_m <= T::count(slots_left as usize) * reach_m + mission.reach_m();
    let count = |user: usize| counts.get(user).copied().unwrap_or(0);
    let mut owed: Vec<u32> = (0..mission.user_count())
        .map(|user| mission.quota().saturating_sub(count(user)))
        .collect();
    let payable = owed.iter().sum::<u32>() <= slots_left;
    let mut here = start;
    for slot in planner.slot()..=mission.slots() {
        let place = planner.waypoint(slot).expect("a slot ahead");
        prop_assert!(place.x.finite() && place.y.finite());
        prop_assert!(p.area.contains(&place), "{place} outside");
        let step_m = (place - here).norm();
        prop_assert!(
            step_m <= reach_m + slack_m,
            "slot {slot}: {step_m} m of {reach_m} m"
        );
        let user = planner.served_user(slot).expect("a slot ahead");
        prop_assert!(user < mission.user_count());
        if !payable {
            prop_assert!(owed[user] > 0, "user {user} is owed nothing");
        }
        owed[user] = owed[user].saturating_sub(1);
        here = place;
    }
    prop_assert!(planner.waypoint(mission.slots() + 1).is_none());
    if payable {
        prop_assert!(owed.iter().all(|&owed| owed == 0), "unfair: {owed:?}");
    }
    if reachable && slots_left > 0 {
        let missed_m = (here - p.destination).norm();
        let slack_m = slack_m * T::of(4.0) * T::count(slots_left as usize);
        prop_assert!(
            missed_m <= mission.reach_m() + slack_m,
            "{missed_m} m from the destination, reach {reach_m} m"
        );
    }
    Ok(())
}

fn obeys_the_laws<T: Scalar>(
    mission: &Numbers,
    states: &[State],
    other: &Numbers,
    budgets: &[u64],
) -> Result<(), TestCaseError> {
    let mission: TestMission<T> = mission.mission();
    let mut planner = planner(&mission);
    let mut from = mission.parameters().start;
    let (mut reach_m, mut counts) = (mission.reach_m(), vec![]);
    check_feasible(&mut planner, from, reach_m, &counts)?;
    for (index, state) in states.iter().enumerate() {
        let area = planner.mission().parameters().area;
        let position = Position::new(
            area.east_m * T::of(state.position[0]),
            area.north_m * T::of(state.position[1]),
        );
        let limit_m = planner.mission().reach_m();
        let agility = state.agility(limit_m);
        let wished_m = agility.step_m;
        planner.restart(&PlannerState {
            slot: state.slot,
            position,
            counts: &state.counts,
            agility,
        });
        if position.x.finite() && position.y.finite() {
            from = position;
        }
        let sound = wished_m.finite() && wished_m > T::zero();
        reach_m = if sound {
            wished_m.min(limit_m)
        } else {
            limit_m
        };
        counts.clone_from(&state.counts);
        if index == 1 {
            // What is known changes altogether.
            planner
                .change_mission(&other.mission())
                .expect("within capacity");
            reach_m = reach_m.min(planner.mission().reach_m());
            let area = planner.mission().parameters().area;
            // The planner knows the vehicle at the nearest place in the old area.
            let old = mission.parameters().area;
            from = Position::new(
                from.x
                    .max(T::zero())
                    .min(old.east_m)
                    .max(T::zero())
                    .min(area.east_m),
                from.y
                    .max(T::zero())
                    .min(old.north_m)
                    .max(T::zero())
                    .min(area.north_m),
            );
        }
        let has_inertia = state.velocity_change > 0.0 && state.velocity_change.is_finite();
        let (mut value, mut exact) = (T::zero(), f64::NEG_INFINITY);
        for &budget in budgets {
            let largest = planner.largest_step();
            let progress = planner.advance(budget);
            prop_assert!(progress.operations <= budget + largest);
            check_feasible(&mut planner, from, reach_m, &counts)?;
            let now = planner.value();
            prop_assert!(now.finite() && now >= value, "{value} then {now}");
            let limit = planner.mission().slot_rate_limit().to_f64();
            let of_model = total(&mut planner);
            let slack = 1e-3 * limit * f64::from(planner.mission().slots()) + 1e-6;
            prop_assert!(of_model.is_finite() && of_model >= 0.0);
            // The value of a plan for a vehicle with inertia is less than its rates.
            if now > T::zero() && !has_inertia {
                prop_assert!(of_model >= exact - slack, "{exact} then {of_model}");
                prop_assert!((of_model - now.to_f64()).abs() <= slack, "{of_model} {now}");
                exact = of_model;
            }
            if let Some(gap) = planner.gap_estimate() {
                prop_assert!(gap >= T::zero() && gap <= T::one());
            }
            value = now;
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn plans_are_feasible_and_never_get_worse(
        mission in numbers(),
        other in numbers(),
        states in prop::collection::vec(state(), 1..4),
        budgets in prop::collection::vec(prop_oneof![Just(0), 1..1000_u64, 1000..2_000_000_u64], 1..6),
    ) {
        obeys_the_laws::<f64>(&mission, &states, &other, &budgets)?;
        obeys_the_laws::<f32>(&mission, &states, &other, &budgets)?;
    }

    /// As a policy, on any observation, with any budget per slot.
    #[test]
    fn decides_soundly_on_any_observation(
        mission in numbers(),
        states in prop::collection::vec(state(), 1..6),
        budget in prop_oneof![Just(0), 1..300_000_u64],
    ) {
        let mission: TestMission<f32> = mission.mission();
        let mut planner = planner(&mission).with_operations_per_slot(budget);
        let area = mission.parameters().area;
        for state in states {
            let position = Position::new(
                area.east_m * state.position[0] as f32,
                area.north_m * state.position[1] as f32,
            );
            let action: Action<f32, M> = planner.decide(&Observation {
                slot: state.slot,
                counts: &state.counts,
                rate: f32::NAN,
                mse: f32::NAN,
                position,
                agility: state.agility(mission.reach_m()),
            });
            prop_assert_eq!(action.user_scores.len(), state.counts.len().min(M));
            prop_assert!(action.user_scores.iter().all(|score| score.is_finite()));
            if position.x.is_finite() && position.y.is_finite() {
                prop_assert!(action.displacement.iter().all(|metres| metres.is_finite()));
            }
        }
    }
}

/// The operations in flight are limited, and how they are divided among polls changes nothing.
#[test]
fn polls_spend_what_is_allowed_and_no_more() {
    const FIRST: u64 = 3_000_000;
    const PER_CHANGE: u64 = 1_000_000;
    let mission: TestMission<f32> = plain().mission();
    let is_planning = |planner: &TestPlanner<f32>| {
        let quality = Policy::<f32, M>::quality(planner).expect("a plan");
        quality.is_replanning
    };
    let plan = |planner: &mut TestPlanner<f32>| -> Vec<_> {
        (1..=24)
            .map(|slot| (planner.waypoint(slot), planner.served_user(slot)))
            .collect()
    };
    let change = MissionChange::User {
        user: 1,
        position_m: Position::new(700.0, 200.0),
    };
    let mut whole = planner(&mission);
    assert!(!whole.advance(FIRST).finished, "the limit has an effect");
    let first = plan(&mut whole);
    whole.revise(&change, 0);
    assert!(!whole.advance(PER_CHANGE).finished);
    for per_poll in [1, 1_000, 77_777, u64::MAX] {
        let mut polled = planner(&mission);
        polled.set_operations_in_flight(&OperationsInFlight {
            first_plan: FIRST,
            per_change: PER_CHANGE,
            per_correction: 0,
        });
        while is_planning(&polled) {
            polled.improve(per_poll);
        }
        assert_eq!(plan(&mut polled), first, "{per_poll} operations a poll");
        polled.improve(u64::MAX);
        assert_eq!(plan(&mut polled), first, "nothing is left to spend");
        polled.revise(&change, 0);
        while is_planning(&polled) {
            polled.improve(per_poll);
        }
        assert_eq!(
            plan(&mut polled),
            plan(&mut whole),
            "{per_poll}, after a change"
        );
        assert!(polled.value() > 0.0);
    }
}

/// A mission that exceeds the capacity is refused, and a place for a planner stays as it was.
#[test]
fn a_place_keeps_its_planner_if_the_next_mission_is_refused() {
    let mission: TestMission<f32> = plain().mission();
    let capacity = Capacity::new(23, M);
    let memory = (
        vec![0.0_f32; capacity.values()],
        vec![0; capacity.indices()],
    );
    let mut place = Some(planner(&mission));
    let refused = Planner::new_in(&mut place, &mission, capacity, memory).expect_err("24 slots");
    let expected = PlannerError::TooLarge {
        what: "slots",
        got: 24,
        capacity: 23,
    };
    assert_eq!(refused, expected);
    assert_eq!(capacity.check(&mission), Err(expected));
    assert!(place.is_some());
}

/// Table I's numbers with few nodes.
fn plain() -> Numbers {
    Numbers {
        slots: 24,
        area_m: [1000.0, 1000.0],
        start: [0.05, 0.05],
        destination: [0.95, 0.95],
        users: vec![[0.1, 0.9], [0.2, 0.7], [0.3, 0.8], [0.9, 0.2]],
        sensors: vec![[0.6, 0.2], [0.7, 0.3], [0.8, 0.4], [0.5, 0.5], [0.4, 0.3]],
        altitude_m: 100.0,
        speed_mps: 60.0,
        noise_dbm: -95.0,
        threshold: 0.6,
    }
}

#[test]
fn the_finished_plan_is_near_its_own_estimate_in_both_precisions() {
    let mut totals = vec![];
    fn finish<T: Scalar>(totals: &mut Vec<f64>) {
        let mut planner = planner(&plain().mission::<T>());
        while !planner.advance(50_000).finished {}
        let gap = planner.gap_estimate().expect("prices").to_f64();
        assert!(gap < 0.03, "{gap}");
        totals.push(total(&mut planner));
    }
    finish::<f64>(&mut totals);
    finish::<f32>(&mut totals);
    assert!((totals[0] / totals[1] - 1.0).abs() < 0.01, "{totals:?}");
}

/// Flying the finished plan through its own decisions gives the value that it stated.
#[test]
fn following_the_plan_keeps_it() {
    let mission: TestMission<f64> = plain().mission();
    let mut planner = planner(&mission);
    while !planner.advance(50_000).finished {}
    let plan: Vec<_> = (1..=24)
        .map(|slot| (planner.waypoint(slot), planner.served_user(slot)))
        .collect();
    let mut counts = vec![0; mission.user_count()];
    let mut here = mission.parameters().start;
    for (slot, planned) in (1..=24).zip(plan) {
        let action: Action<f64, M> = planner.decide(&Observation {
            slot,
            counts: &counts,
            rate: 0.0,
            mse: 0.0,
            position: here,
            agility: Agility::ideal(&mission),
        });
        here += action.displacement;
        let user = (0..counts.len())
            .max_by(|&a, &b| action.user_scores[a].total_cmp(&action.user_scores[b]));
        counts[user.expect("a user")] += 1;
        assert_eq!(planned.1, user);
        assert!((planned.0.expect("a waypoint") - here).norm() < 1e-9);
    }
}

/// The sum of the changes of velocity of a plan that exceed `free_m`, metres a slot, and the plan's
/// rates.
fn bends(planner: &mut TestPlanner<f64>, drift: [f64; 2], free_m: f64) -> (f64, f64) {
    let mut here = planner.mission().parameters().start;
    let mut last = Displacement::from(drift);
    let mut sum_m = 0.0;
    for slot in 1..=planner.mission().slots() {
        let place = planner.waypoint(slot).expect("a slot ahead");
        let step = place - here;
        sum_m += ((step - last).norm() - free_m).max(0.0);
        (here, last) = (place, step);
    }
    (sum_m, total(planner))
}

/// A plan for a vehicle with inertia bends much less than one for the paper's kinematics, and its
/// rates are little below: the vehicle starts at full speed, away from the users.
#[test]
fn inertia_straightens_the_plan() {
    let mission: TestMission<f64> = plain().mission();
    let limit_m = mission.reach_m();
    let agility = Agility {
        velocity_change_m: 0.04 * limit_m,
        drift_m: [-limit_m, 0.0],
        ..Agility::ideal(&mission)
    };
    let [ideal, inert] = [Agility::ideal(&mission), agility].map(|agility| {
        let mut planner = planner(&mission);
        planner.restart(&PlannerState {
            slot: 1,
            position: mission.parameters().start,
            counts: &[],
            agility,
        });
        while !planner.advance(50_000).finished {}
        // The planner counts changes of up to four times the limit as free.
        bends(&mut planner, agility.drift_m, 0.16 * limit_m)
    });
    println!("ideal {ideal:?}, with inertia {inert:?}");
    assert!(inert.0 < 0.5 * (ideal.0 + 0.84 * limit_m));
    assert!(inert.1 > 0.8 * ideal.1 && inert.1 < ideal.1 * 1.001);
}

#[test]
fn too_little_memory_and_too_large_missions_are_errors() {
    let mission: TestMission<f32> = plain().mission();
    let capacity = Capacity::new(24, M);
    let (values, bytes) = (capacity.values(), capacity.indices());
    let memory = |values: usize, bytes: usize| (vec![0.0_f32; values], vec![0_u8; bytes]);
    assert!(Planner::new(&mission, capacity, memory(values, bytes)).is_ok());
    let error = Planner::new(&mission, capacity, memory(values - 1, bytes)).expect_err("small");
    let (what, needed, got) = ("numbers", values, values - 1);
    assert_eq!(error, PlannerError::TooLittleMemory { what, needed, got });
    let capacity = Capacity::new(23, M);
    let memory = memory(capacity.values(), capacity.indices());
    let error = Planner::new(&mission, capacity, memory).expect_err("short");
    let (what, got, capacity) = ("slots", 24, 23);
    assert_eq!(
        error,
        PlannerError::TooLarge {
            what,
            got,
            capacity
        }
    );
}

// SPDX-License-Identifier: MIT OR Apache-2.0
//! The shield against random and invalid policy outputs: a million outputs over random missions,
//! and the projection against its definition.

mod random_slots;
#[path = "../src/test_missions.rs"]
mod test_missions;

use firmware_core::{
    Displacement, Mission, Position, Scalar,
    controller::{ChannelState, Controller},
    mission::{Area, MissionParameters, rounding_m},
    policy::{Action, Observation, Policy},
    shield::{Agility, Intervention, ReachableSet, admissible_waypoint},
};
use heapless::Vec;
use rand::{Rng, RngExt};
use rand_pcg::Pcg64Mcg;
use random_slots::{generator, log_uniform};
use test_missions::table_one_without_nodes;

const USERS: usize = 6;
const SENSORS: usize = 3;

type Parameters<T> = MissionParameters<T, USERS, SENSORS>;

fn place<T: Scalar>(random: &mut impl Rng, area: &Area<T>) -> Position<T> {
    let along = |extent: T, fraction: f64| (T::of(fraction) * extent).min(extent);
    Position::new(
        along(area.east_m, random.random_range(0.0..=1.0)),
        along(area.north_m, random.random_range(0.0..=1.0)),
    )
}

/// Returns missions with spare slots, without any, with one slot, in strips, across corners, and with
/// fewer slots than users.
fn mission<T: Scalar>(random: &mut impl Rng) -> Mission<T, USERS, SENSORS> {
    let area = Area {
        east_m: T::of(log_uniform(random, 1.0, 5000.0)),
        north_m: T::of(log_uniform(random, 1.0, 5000.0)),
    };
    let (start, destination) = match random.random_range(0..4) {
        0 => {
            let corner = Position::new(area.east_m, area.north_m);
            (Position::new(T::zero(), T::zero()), corner)
        }
        1 => {
            let here = place(random, &area);
            (here, here)
        }
        _ => (place(random, &area), place(random, &area)),
    };
    let slots = match random.random_range(0..4) {
        0 => 1,
        1 => random.random_range(1..8),
        _ => random.random_range(8..80),
    };
    // The reach that just suffices, or more.
    let distance_m = (destination - start).norm().to_f64();
    let least_m = distance_m / (f64::from(slots) + 1.0);
    let reach_m = match random.random_range(0..4) {
        0 => least_m,
        1 => least_m * (1.0 + log_uniform(random, 1e-9, 1.0)),
        2 => least_m + log_uniform(random, 1e-2, 1e2),
        _ => 1e4,
    };
    let slot_duration_s = T::of(random.random_range(0.2..5.0));
    let users = (0..random.random_range(1..=USERS)).map(|_| place(random, &area));
    let users: Vec<_, USERS> = users.collect();
    let sensors = (0..random.random_range(1..=SENSORS)).map(|_| place(random, &area));
    let sensors: Vec<_, SENSORS> = sensors.collect();
    let mse_threshold = T::of(0.5 / sensors.len() as f64);
    let parameters = Parameters {
        slots,
        slot_duration_s,
        start,
        destination,
        area,
        // Rounded up a little: the mission must be possible in this precision.
        max_speed_mps: T::of(reach_m.max(1e-3)) / slot_duration_s
            * (T::one() + T::EPSILON * T::of(4.0)),
        mse_threshold,
        users,
        sensors,
        ..table_one_without_nodes()
    };
    Mission::new(parameters).unwrap_or_else(|error| panic!("{error}"))
}

/// A policy with every kind of invalid output that the types allow.
struct Adversary {
    random: Pcg64Mcg,
    manner: u32,
}

impl Adversary {
    fn number<T: Scalar>(&mut self) -> T {
        T::of(match self.random.random_range(0..10) {
            0 => f64::NAN,
            1 => f64::INFINITY,
            2 => f64::NEG_INFINITY,
            3 => 0.0,
            4 => 3e38,
            5 => -3e38,
            6 => 1e-40,
            7 => log_uniform(&mut self.random, 1e-6, 1e12),
            _ => self.random.random_range(-100.0..100.0),
        })
    }
}

impl<T: Scalar> Policy<T, USERS> for Adversary {
    fn decide(&mut self, observation: &Observation<'_, T>) -> Action<T, USERS> {
        let users = observation.counts.len();
        // A direction that is held makes for the borders and the corners between them.
        let held = [(1e9, 0.0), (-1e9, 1e9), (0.0, -70.0), (40.0, 40.0)];
        let displacement = match self.manner {
            manner @ 0..4 => {
                let (x, y) = held[manner as usize];
                Displacement::new(T::of(x), T::of(y))
            }
            4 => Displacement::new(self.number(), self.number()),
            _ => {
                let mut coordinate = || T::of(self.random.random_range(-60.0..60.0));
                Displacement::new(coordinate(), coordinate())
            }
        };
        let mut user_scores: Vec<T, USERS> = match self.manner % 3 {
            // Always the same user, whatever the others are owed.
            0 => (0..users).map(|user| T::count(user)).collect(),
            1 => (0..users).map(|_| self.number()).collect(),
            _ => (0..users)
                .map(|_| T::of(self.random.random_range(-1.0..1.0)))
                .collect(),
        };
        if self.manner == 5 && self.random.random_bool(0.3) {
            let _ = user_scores.pop();
        }
        Action {
            displacement,
            user_scores,
        }
    }

    fn revise(&mut self, _: &firmware_core::mission::MissionChange<T>, _: u32) {}

    fn note_gains(&mut self, _: &firmware_core::policy::MeasuredGains<'_, T>) {}

    fn improve(&mut self, _: u64) {}

    fn quality(&self) -> Option<firmware_core::policy::PlanQuality> {
        None
    }
}

/// Flies missions until `outputs` outputs are used; the vehicle reaches every waypoint.
fn fly<T: Scalar>(seed: u64, outputs: u32) {
    let mut random = generator(seed);
    let (mut spent, mut infeasible) = (0, 0);
    let mut flown = 0_u64;
    while spent < outputs {
        flown += 1;
        let mission = mission::<T>(&mut random);
        let mut adversary = Adversary {
            random: generator(flown),
            manner: random.random_range(0..6),
        };
        let p = mission.parameters().clone();
        let slack_m = rounding_m(&p.area, mission.reach_m());
        let mut controller = Controller::new(mission.clone(), &mut adversary);
        let mut here = p.start;
        let mut counts = [0; USERS];
        while !controller.is_over() {
            let plan = controller.plan(here).expect("at rest");
            let next = plan.waypoint;
            let context = || format!("{plan:?} from {here} in {p:?}");
            assert!(p.area.contains(&next), "area: {}", context());
            let step_m = (next - here).norm();
            assert!(
                step_m <= mission.reach_m() + slack_m,
                "step {step_m}: {}",
                context()
            );
            assert!(!plan.intervention.out_of_reach, "{}", context());
            assert!(plan.served_user < p.users.len(), "{}", context());
            counts[plan.served_user] += 1;
            here = next;
            let state = ChannelState::predicted(&mission, plan.slot, &here);
            let command = controller.allocate(&state).expect("the slot under way");
            assert!(command.user_power <= p.user_power_max);
            for b in &command.sensor_coefficients {
                assert!(*b >= T::zero() && *b * *b <= p.sensor_power_max.0);
            }
            if command.status.is_feasible() {
                let limit = p.mse_threshold * (T::one() + T::CONSTRAINT_TOLERANCE);
                assert!(command.mse <= limit, "{command:?}");
            } else {
                infeasible += 1;
            }
            spent += 1;
        }
        let left_m = (here - p.destination).norm();
        assert!(
            left_m <= mission.reach_m() + slack_m,
            "arrival: {left_m} in {p:?}"
        );
        assert!(mission.has_arrived(&here));
        let quota = mission.quota();
        assert!(controller.fairness().is_fair());
        assert!(
            counts[..p.users.len()].iter().all(|&count| count >= quota),
            "{counts:?} {p:?}"
        );
    }
    // In these slots nothing was promised, so there was nothing to hold.
    assert!(
        infeasible < spent / 5,
        "Gamma was not checked in {infeasible} of {spent} slots"
    );
}

#[test]
fn a_million_hostile_outputs_break_nothing() {
    std::thread::scope(|scope| {
        scope.spawn(|| fly::<f64>(11, 700_000));
        scope.spawn(|| fly::<f32>(12, 300_000));
    });
}

/// The projection is the nearest point of a convex set: no point of the set is nearer, sampled
/// all over and, since a convex set's local optimum is global, close around the answer.
#[test]
fn the_projection_is_exact() {
    let mut random = generator(13);
    let (mut moved, mut compared) = (0, 0);
    for _ in 0..20_000 {
        let area = Area {
            east_m: log_uniform(&mut random, 10.0, 2000.0),
            north_m: log_uniform(&mut random, 10.0, 2000.0),
        };
        let from = place(&mut random, &area);
        let destination = place(&mut random, &area);
        let step_m = log_uniform(&mut random, 1.0, 500.0);
        let apart_m = (destination - from).norm();
        let home_m = (apart_m - step_m).max(0.0) + log_uniform(&mut random, 1e-6, 500.0);
        let set = ReachableSet::new(area, from, step_m, destination, home_m);
        let wish = place(&mut random, &area)
            + Displacement::new(
                random.random_range(-1.0..1.0) * step_m,
                random.random_range(-1.0..1.0) * step_m,
            );
        let nearest = set.nearest(&wish).expect("never empty");
        assert!(set.contains(&nearest));
        let distance = (nearest - wish).norm();
        moved += u32::from(distance > 0.0);
        // The set is closed up to the shield's own rounding slack, and so is the comparison.
        let slack = rounding_m(&area, step_m);
        for sample in 0..60 {
            let around = if sample < 20 { from } else { nearest };
            let radius = match sample {
                0..20 => step_m * random.random_range(0.0_f64..1.0).sqrt(),
                _ => log_uniform(&mut random, 1e-6, 1.0) * step_m,
            };
            let angle = random.random_range(0.0..core::f64::consts::TAU);
            let other = around + Displacement::new(angle.cos(), angle.sin()) * radius;
            let inside = |center: Position<f64>, radius_m: f64| (other - center).norm() <= radius_m;
            if area.contains(&other) && inside(from, step_m) && inside(destination, home_m) {
                compared += 1;
                let rival = (other - wish).norm();
                assert!(
                    rival >= distance - slack,
                    "{rival} {distance} {set:?} {wish}"
                );
            }
        }
    }
    assert!(moved > 10_000, "{moved}");
    assert!(
        compared > 180_000,
        "only {compared} of 1,200,000 samples were in the set"
    );
}

/// Inertia makes `F_n` smaller, never empty, and never sends the vehicle past the destination:
/// a policy that asks for the destination, where it can be reached, gets there.
#[test]
fn with_inertia_the_destination_stays_within_reach() {
    let mut random = generator(15);
    let mut near = 0;
    for _ in 0..20_000 {
        let mut p = mission::<f64>(&mut random).parameters().clone();
        // The borders are far: this is about the destination.
        p.area = Area {
            east_m: 5000.0,
            north_m: 5000.0,
        };
        p.destination = Position::new(2500.0, 2500.0);
        p.start = p.destination;
        p.slots = random.random_range(1..80);
        p.max_speed_mps = log_uniform(&mut random, 1.0, 50.0) / p.slot_duration_s;
        let mission = Mission::<f64, USERS, SENSORS>::new(p.clone()).expect("valid");
        let reach_m = mission.reach_m();
        let agility = Agility {
            step_m: reach_m,
            reach_m: reach_m * random.random_range(0.6..=1.0),
            velocity_change_m: log_uniform(&mut random, 1.0, 1000.0),
            drift_m: [(); 2].map(|()| reach_m * random.random_range(-1.0..=1.0)),
        };
        let slot = random.random_range(1..=p.slots);
        let far_m = (f64::from(p.slots - slot + 2) * reach_m * 0.999_999).min(2000.0);
        let away_m = far_m * random.random_range(0.0..=1.0);
        let angle = random.random_range(0.0..core::f64::consts::TAU);
        let from = p.destination + Displacement::new(angle.cos(), angle.sin()) * away_m;
        let set = ReachableSet::of_slot_with(&mission, slot, from, &agility);
        let ideal = ReachableSet::of_slot(&mission, slot, from);
        let mut coordinate = || random.random_range(-2.0..2.0) * reach_m;
        let wish = from + Displacement::new(coordinate(), coordinate());
        let nearest = set.nearest(&wish);
        let nearest = nearest.unwrap_or_else(|| panic!("empty: {set:?}"));
        assert!(ideal.contains(&nearest), "{nearest} {set:?}");
        if away_m <= reach_m {
            near += 1;
            let mut changed = Intervention::default();
            let waypoint = admissible_waypoint(&set, &(p.destination - from), &mut changed);
            let missed_m = (waypoint - p.destination).norm();
            assert!(missed_m < 1e-9 && !changed.any(), "{waypoint} {set:?}");
        }
    }
    assert!(near > 1_000, "{near}");
}

/// An admissible displacement is not changed and not reported.
#[test]
fn what_is_admissible_is_left_alone() {
    let mut random = generator(14);
    let mut admissible = 0;
    let area = Area {
        east_m: 1000.0,
        north_m: 1000.0,
    };
    for _ in 0..10_000 {
        let from = place(&mut random, &area);
        let destination = place(&mut random, &area);
        let set = ReachableSet::new(area, from, 30.0, destination, 800.0);
        let angle = random.random_range(0.0..core::f64::consts::TAU);
        let displacement =
            Displacement::new(angle.cos(), angle.sin()) * random.random_range(0.0..30.0);
        let wish = from + displacement;
        let mut changed = Intervention::default();
        let waypoint = admissible_waypoint(&set, &displacement, &mut changed);
        if set.contains(&wish) {
            admissible += 1;
            assert_eq!(waypoint, wish);
            assert!(!changed.any());
        }
    }
    assert!(
        admissible >= 8_000,
        "only {admissible} of 10,000 were admissible"
    );
}

//! Tests the certificate against everything that could contradict it: enumeration, random missions,
//! and a flight of the mission that it returns.

use firmware_core::{
    Mission, Position, USERS_MAX,
    controller::{ChannelState, Controller},
    mission::{Area, MissionParameters},
    shield::{Fairness, Intervention, ReachableSet, admissible_waypoint},
};
use planning::bound::{Bound, BoundError, BoundSettings, certify, certify_until};
use planning::search::SearchPolicy;
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use scenario::PlaceRates;
use scenario::{HostMission, Scenario};

fn shipped(name: &str) -> HostMission {
    Scenario::shipped(name).expect("a shipped scenario").mission
}

fn changed(
    mission: &HostMission,
    change: impl FnOnce(&mut MissionParameters<f64, 16, 64>),
) -> HostMission {
    let mut parameters = mission.parameters().clone();
    change(&mut parameters);
    Mission::new(parameters).expect("a valid mission")
}

/// BoundSettings for a quick search: one leaf, coarse cells.
const QUICK: BoundSettings = BoundSettings {
    gap: 0.01,
    finest_cell_m: 1.0,
    leaves_max: 1,
    pairs_max: 4_000_000,
    work_max: 4_000_000,
};

fn bound(mission: &HostMission, settings: &BoundSettings) -> Bound {
    certify(mission, settings, |_| {}).expect("a bound")
}

#[test]
fn shipped_missions_are_bounded_within_two_percent() {
    for name in ["separated", "mixed"] {
        let bound = bound(&shipped(name), &QUICK);
        assert!(bound.lower <= bound.upper);
        assert!(bound.gap < 0.02, "{name}: {}", bound.gap);
    }
}

/// Flies the plan through the controller, slot by slot, with the paper's kinematics.
#[test]
fn the_mission_keeps_every_constraint_and_reproduces_its_rate() {
    for name in ["separated", "mixed"] {
        let mission = shipped(name);
        let bound = bound(&mission, &QUICK);
        let plan = bound.plan.clone();
        for place in &plan.waypoints {
            assert_eq!(
                *place,
                place.map(|value| f64::from(value as f32)),
                "not an f32"
            );
        }
        let policy = SearchPolicy::new(plan.clone());
        let mut controller: Controller<f64, _> = Controller::new(mission.clone(), policy);
        let (mut here, mut sum) = (mission.parameters().start, 0.0);
        for (index, expected) in plan.waypoints.iter().enumerate() {
            let step = controller.plan(here).expect("a plan");
            assert!(
                !step.intervention.any(),
                "{name} slot {}: {:?}",
                index + 1,
                step.intervention
            );
            assert!((step.waypoint - expected).norm() < 1e-9);
            assert_eq!(step.served_user, plan.users[index]);
            here = step.waypoint;
            let state = ChannelState::predicted(&mission, step.slot, &here);
            sum += controller.allocate(&state).expect("a command").rate;
        }
        assert!(mission.has_arrived(&here));
        assert!(controller.fairness().is_fair());
        assert!(
            (sum / bound.lower - 1.0).abs() < 1e-9,
            "{sum} {}",
            bound.lower
        );
    }
}

#[test]
fn the_same_mission_gets_the_same_certificate() {
    let mission = shipped("separated");
    let [first, second] = [(); 2].map(|()| Bound {
        seconds: 0.0,
        ..bound(&mission, &QUICK)
    });
    assert_eq!(first, second);
}

/// Returns a mission that the shield admits: random wishes that persist for a few slots, and users
/// that are chosen at random or by rate.
fn random_mission(
    mission: &HostMission,
    rates: &mut PlaceRates<'_, 16, 64>,
    rng: &mut impl Rng,
) -> f64 {
    let p = mission.parameters();
    let users = mission.user_count();
    let greed = rng.random_range(0.0..1.0);
    let mut fairness: Fairness<USERS_MAX> = Fairness::new(mission);
    let (mut here, mut sum, mut row) = (p.start, 0.0, [0.0; USERS_MAX]);
    let place = |rng: &mut _| random_place(&p.area, rng);
    let mut target = place(rng);
    for slot in 1..=mission.slots() {
        if rng.random_bool(0.1) {
            target = place(rng);
        }
        let set = ReachableSet::of_slot(mission, slot, here);
        here = admissible_waypoint(&set, &(target - here), &mut Intervention::default());
        rates.write(&here, &mut row[..users]);
        let chosen = if rng.random_bool(greed) {
            fairness.best(|user| row[user])
        } else {
            let lucky = rng.random_range(0..users);
            fairness.best(|user| f64::from(u8::from(user == lucky)))
        };
        fairness.record(chosen);
        sum += chosen.map_or(0.0, |user| row[user]);
    }
    assert!(fairness.is_fair());
    sum
}

fn random_place(area: &Area<f64>, rng: &mut impl Rng) -> Position<f64> {
    Position::new(
        rng.random_range(0.0..area.east_m),
        rng.random_range(0.0..area.north_m),
    )
}

#[test]
fn ten_thousand_random_missions_stay_below() {
    let mut rng = Pcg64Mcg::seed_from_u64(11);
    for name in ["separated", "mixed"] {
        let mission = shipped(name);
        let upper = bound(&mission, &QUICK).upper;
        let mut rates = PlaceRates::new(&mission);
        let mut highest = 0.0_f64;
        for _ in 0..5000 {
            highest = highest.max(random_mission(&mission, &mut rates, &mut rng));
        }
        assert!(highest <= upper, "{name}: {highest} {upper}");
        assert!(highest > 0.5 * upper, "too weak to tell: {highest} {upper}");
    }
}

/// Tries every path over a lattice of positions and every fair order of users, on tiny random
/// missions.
#[test]
fn enumeration_never_exceeds_the_bound() {
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let table_one = shipped("separated");
    for round in 0..30 {
        let (slots, users) = [(2, 1), (3, 2), (4, 2), (5, 2)][round % 4];
        let mission = changed(&table_one, |p| {
            p.area = Area {
                east_m: 200.0,
                north_m: 160.0,
            };
            p.slots = slots;
            p.max_speed_mps = 45.0;
            p.noise_power.0 *= [1.0, 10.0][round % 2];
            p.mse_threshold = rng.random_range(0.012..0.027);
            p.users.truncate(users);
            let area = p.area;
            for place in p.users.iter_mut().chain(p.sensors.iter_mut()) {
                *place = random_place(&area, &mut rng);
            }
            p.start = random_place(&area, &mut rng);
            let turn = rng.random_range(0.0..6.0_f64);
            let away = 45.0 * rng.random_range(0.0..f64::from(slots));
            let wish = p.start + nalgebra::Vector2::new(turn.cos(), turn.sin()) * away;
            p.destination = Position::new(wish.x.clamp(0.0, 200.0), wish.y.clamp(0.0, 160.0));
        });
        let bound = bound(&mission, &BoundSettings::default());
        let best = best_by_enumeration(&mission, 13.0);
        assert!(best <= bound.upper, "round {round}: {best} {}", bound.upper);
        assert!(bound.lower <= bound.upper);
        assert!(
            bound.lower >= 0.98 * best,
            "round {round}: {best} {}",
            bound.lower
        );
        assert!(bound.gap < 0.05, "round {round}: {}", bound.gap);
    }
}

/// Computes the optimum by recursion over lattice points and users, with the counts that fairness
/// needs.
fn best_by_enumeration(mission: &HostMission, spacing_m: f64) -> f64 {
    let p = mission.parameters();
    let users = mission.user_count();
    let mut rates = PlaceRates::new(mission);
    let mut places = Vec::new();
    let steps = |extent_m: f64| (extent_m / spacing_m) as i32;
    for column in 0..=steps(p.area.east_m) {
        for row in 0..=steps(p.area.north_m) {
            let place = Position::new(f64::from(column), f64::from(row)) * spacing_m;
            let mut row = vec![0.0; users];
            rates.write(&place, &mut row);
            places.push((place, row));
        }
    }
    // `best[place][count of user 0]` is enough for two users.
    let reach_m = mission.reach_m();
    let slots = mission.slots() as usize;
    let mut best: Vec<Vec<f64>> = Vec::new();
    for slot in 0..slots {
        best = places
            .iter()
            .map(|(to, rates)| {
                let mut here = vec![f64::NEG_INFINITY; slots + 1];
                let mut arrive = |before: &[f64]| {
                    for (count, &value) in before.iter().enumerate() {
                        for (user, rate) in rates.iter().enumerate() {
                            let count = count + usize::from(user == 0);
                            if count <= slots {
                                here[count] = here[count].max(value + rate);
                            }
                        }
                    }
                };
                if slot == 0 {
                    if (to - p.start).norm() <= reach_m {
                        arrive(&[0.0]);
                    }
                } else {
                    for ((from, _), before) in places.iter().zip(&best) {
                        if (to - from).norm() <= reach_m {
                            arrive(before);
                        }
                    }
                }
                here
            })
            .collect();
    }
    let quota = mission.quota() as usize;
    let fair = |count: usize| count >= quota && (users == 1 || slots - count >= quota);
    let arrived = places
        .iter()
        .zip(&best)
        .filter(|((place, _), _)| (place - p.destination).norm() <= reach_m);
    arrived
        .flat_map(|(_, values)| values.iter().enumerate())
        .filter(|(count, _)| fair(*count))
        .fold(0.0, |best, (_, &value)| best.max(value))
}

/// A vehicle that can cross the whole area in a slot gains nothing from a higher speed: the
/// certificate is the same and takes no more work, whether the reach is due to the speed, to the
/// slot's length, or to both.
#[test]
fn a_reach_beyond_the_area_is_the_area() {
    let mission = shipped("separated");
    let certificate = |slot_duration_s: f64, max_speed_mps: f64| {
        let fast = changed(&mission, |p| {
            p.slot_duration_s = slot_duration_s;
            p.max_speed_mps = max_speed_mps;
        });
        let bound = bound(&fast, &QUICK);
        assert!(bound.lower <= bound.upper);
        assert!(
            bound.gap < 0.02,
            "{slot_duration_s} {max_speed_mps}: {}",
            bound.gap
        );
        Bound {
            seconds: 0.0,
            ..bound
        }
    };
    let just = certificate(60.0, 35.0);
    for (slot_duration_s, max_speed_mps) in [(3600.0, 30.0), (1.0, 1e6), (3600.0, 1e6)] {
        assert_eq!(certificate(slot_duration_s, max_speed_mps), just);
    }
}

/// The storage limit applies to the cells at which the missions are branched, not only to the
/// larger cells at the beginning.
#[test]
fn the_limit_on_pairs_holds_at_the_branching_depth_too() {
    let mission = shipped("separated");
    let with_pairs = |pairs_max: usize| {
        let settings = BoundSettings { pairs_max, ..QUICK };
        certify(&mission, &settings, |_| {}).map(|bound| bound.upper)
    };
    // 60 slots of at most 67 x 67 cells of 15 m, and four times that of 7.5 m.
    assert!(with_pairs(4 * 60 * 67 * 67).is_ok());
    for (pairs_max, side_m) in [(60 * 67 * 67, 7.5), (1000, 15.0)] {
        let Err(BoundError::TooLarge { cell_m, .. }) = with_pairs(pairs_max) else {
            panic!("{pairs_max} pairs are too few");
        };
        assert!((cell_m - side_m).abs() < 1e-6, "{cell_m}");
    }
}

/// If no position meets Gamma, every mission has rate zero, and the gap is exactly zero.
#[test]
fn nothing_carried_is_no_gap() {
    let deaf = changed(&shipped("separated"), |p| p.mse_threshold = 1e-6);
    let bound = bound(&deaf, &BoundSettings::default());
    assert!(bound.carries_nothing());
    assert_eq!((bound.lower, bound.gap, bound.leaves), (0.0, 0.0, 1));
    assert!(bound.upper < 60.0 * 2e-9, "{}", bound.upper);
}

#[test]
fn missions_without_room_and_missions_too_large_are_refused() {
    let mission = shipped("separated");
    let tight = changed(&mission, |p| {
        let distance_m = (p.destination - p.start).norm();
        p.max_speed_mps = distance_m / f64::from(p.slots + 1) * (1.0 + 1e-12);
    });
    assert!(matches!(
        certify(&tight, &QUICK, |_| {}),
        Err(BoundError::StraightPathOnly { .. })
    ));
    for slots in [1001, 100_000] {
        let long = changed(&mission, |p| p.slots = slots);
        assert_eq!(
            certify(&long, &QUICK, |_| {}).err(),
            Some(BoundError::TooManySlots { slots, max: 1000 })
        );
    }
    let slow = changed(&mission, |p| {
        p.max_speed_mps = 0.01;
        p.destination = p.start;
    });
    assert!(matches!(
        certify(&slow, &QUICK, |_| {}),
        Err(BoundError::TooLarge { .. })
    ));
}

/// A certification that is stopped at any time has a valid bound: no smaller than a mission that is
/// found with more time, and no larger than what no slot can exceed.
#[test]
fn a_stopped_certification_is_a_certificate() {
    let mission = shipped("mixed");
    let best = bound(&mission, &BoundSettings::default());
    let limit = f64::from(mission.slots()) * mission.slot_rate_limit();
    let mut uppers = Vec::new();
    for polls in [0, 1, 10, 300] {
        let count = std::sync::atomic::AtomicUsize::new(0);
        let stop = || count.fetch_add(1, std::sync::atomic::Ordering::Relaxed) >= polls;
        let stopped = certify_until(&mission, &BoundSettings::default(), &stop, |_| {});
        let stopped = stopped.expect("a bound");
        assert!(stopped.upper >= best.lower && stopped.upper <= limit * 1.000_001);
        assert!(stopped.lower <= best.upper && stopped.lower <= stopped.upper);
        assert!(stopped.lower > 0.0);
        uppers.push(stopped.upper);
    }
    assert!(uppers[0] > uppers[3], "{uppers:?}");
}

//! Tests of the environment against the controller, the paper's reward and the relaxed mission.

use std::{cell::RefCell, rc::Rc, sync::Arc};

use firmware_core::{
    Displacement, Position, USERS_MAX,
    controller::{ChannelState, Controller},
    policy::{self, Observation, Policy},
};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use scenario::{HostMission, Scenario};

use crate::{
    action::Action,
    mdp::Environment,
    relaxation::{Nodes, moves},
    settings::{Constraints, EnvironmentSettings},
};

fn mission(name: &str) -> HostMission {
    Scenario::shipped(name).expect("shipped").mission
}

fn settings(constraints: Constraints) -> EnvironmentSettings {
    EnvironmentSettings {
        constraints,
        ..EnvironmentSettings::default()
    }
}

/// A policy that gives the controller the action that the environment was given.
struct Replayed(Rc<RefCell<Action>>, f64, usize);

impl Policy<f64, USERS_MAX> for Replayed {
    fn decide(&mut self, _: &Observation<'_, f64>) -> policy::Action<f64, USERS_MAX> {
        let action = self.0.borrow();
        let component = |i: usize| f64::from(action.components[i]) * self.1;
        policy::Action {
            displacement: Displacement::new(component(0), component(1)),
            user_scores: (0..self.2)
                .map(|m| f64::from(u8::from(m == action.user)))
                .collect(),
        }
    }

    fn revise(&mut self, _: &firmware_core::mission::MissionChange<f64>, _: u32) {}

    fn note_gains(&mut self, _: &firmware_core::policy::MeasuredGains<'_, f64>) {}

    fn improve(&mut self, _: u64) {}

    fn quality(&self) -> Option<firmware_core::policy::PlanQuality> {
        None
    }
}

/// Waypoints, rates and MSE equal those of the controller, bit for bit.
#[test]
fn random_episodes_equal_the_controllers_flights() {
    for name in ["separated", "mixed"] {
        let mission = mission(name);
        let mut rng = Pcg64Mcg::seed_from_u64(4);
        let mut environment = Environment::new(mission.clone(), &settings(Constraints::Shielded));
        let users = mission.user_count();
        for _ in 0..20 {
            environment.reset();
            let shared = Rc::new(RefCell::new(Action::default()));
            let policy = Replayed(Rc::clone(&shared), mission.reach_m(), users);
            let mut controller = Controller::new(mission.clone(), policy);
            let mut sum_rate = 0.0;
            while !controller.is_over() {
                let admissible = environment.admissible();
                let mut action = shared.borrow_mut();
                action.randomize(2, users, admissible, &mut rng);
                let from = environment.position();
                let step = environment.step(&action);
                drop(action);
                let plan = controller.plan(from).expect("at rest");
                assert_eq!(plan.waypoint, environment.position());
                assert_eq!(plan.served_user, shared.borrow().user);
                assert!(!plan.intervention.user);
                let state = ChannelState::predicted(&mission, plan.slot, &plan.waypoint);
                let command = controller.allocate(&state).expect("planned");
                assert_eq!(command.rate, step.rate);
                assert_eq!(command.mse, step.mse);
                sum_rate += command.rate;
            }
            let episode = environment.episode();
            assert_eq!(episode.sum_rate, sum_rate);
            assert!(episode.arrived && episode.fair);
            assert_eq!(episode.mse_violations, 0);
        }
    }
}

#[test]
fn the_reward_is_the_papers() {
    let mission = mission("separated");
    let mut settings = settings(Constraints::Shielded);
    (settings.rate_weight, settings.trajectory_weight) = (2.0, 0.5);
    settings.arrival_reward = 7.0;
    let mut environment = Environment::new(mission.clone(), &settings);
    let mut action = Action {
        components: vec![0.7, 0.7],
        user: 0,
    };
    for slot in 1..=60_u32 {
        action.user = (slot as usize - 1) % 15;
        let step = environment.step(&action);
        let left = (environment.position() - mission.parameters().destination).norm();
        let trajectory = if slot == 60 {
            7.0
        } else {
            -f64::from(slot) * left
        };
        assert_eq!(step.reward.trajectory, trajectory);
        assert_eq!(step.reward.rate, step.rate);
        assert_eq!(step.reward.total, 2.0 * step.rate + 0.5 * trajectory);
        assert_eq!(step.last, slot == 60);
    }
}

/// Prices change the rewards of slots and sum to zero over a fair mission.
#[test]
fn prices_do_not_change_the_return_of_a_fair_mission() {
    let mission = mission("mixed");
    let prices: Vec<f64> = (0..15).map(|user| 0.1 * f64::from(user) - 0.3).collect();
    let settings = settings(Constraints::Shielded);
    let plain = Environment::new(mission, &settings);
    let (mut plain, mut priced) = (plain.clone(), plain.with_prices(&prices));
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    let mut action = Action::default();
    let mut moved = 0;
    for _ in 0..60 {
        action.randomize(2, 15, plain.admissible(), &mut rng);
        let (a, b) = (plain.step(&action).reward, priced.step(&action).reward);
        assert_eq!(a.rate, b.rate);
        // The mean price is 0.4.
        let expected = prices[action.user] - 0.4;
        assert!((b.total - a.total - expected).abs() < 1e-12);
        moved += u32::from(expected.abs() > 0.1);
    }
    assert!(moved > 40, "{moved}");
    let (plain, priced) = (plain.episode(), priced.episode());
    assert!(plain.fair && (plain.reward - priced.reward).abs() < 1e-9);
}

/// Shaping changes the rewards of slots, but shifts the returns of all missions by the same amount.
#[test]
fn shaping_shifts_every_return_by_the_same_amount() {
    let settings = settings(Constraints::Shielded);
    let plain = Environment::new(mission("mixed"), &settings);
    let values = Arc::new(plain.value_to_go());
    let at_start = values.at(0, &plain.position());
    assert!(at_start > 60.0, "{at_start}");
    let (mut plain, mut shaped) = (plain.clone(), plain.with_values(values));
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let mut action = Action::default();
    for _ in 0..5 {
        let mut moved = 0.0_f64;
        for _ in 0..60 {
            action.randomize(2, 15, plain.admissible(), &mut rng);
            let (a, b) = (plain.step(&action).reward, shaped.step(&action).reward);
            moved = moved.max((b.total - a.total).abs());
        }
        assert!(moved > 0.5, "{moved}");
        let shift = shaped.episode().reward - plain.episode().reward;
        assert!((shift + at_start).abs() < 1e-9, "{shift} {at_start}");
        plain.reset();
        shaped.reset();
    }
}

/// Peeking at a step does not change the state and returns the result of the step itself.
#[test]
fn peek_step_predicts_the_step() {
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let settings = settings(Constraints::Shielded);
    let mut environment = Environment::new(mission("separated"), &settings);
    let (mut before, mut after) = (vec![0.0; 19], vec![0.0; 19]);
    let mut peeked = vec![0.0; 19];
    let mut action = Action::default();
    loop {
        action.randomize(2, 15, environment.admissible(), &mut rng);
        environment.observe(&mut before);
        let result = environment.peek_step(&action, &mut peeked);
        environment.observe(&mut after);
        assert_eq!(before, after);
        assert_eq!(environment.advance(&action, &mut after), result);
        assert_eq!(after, peeked);
        if result.step.last {
            break;
        }
    }
}

/// The entropy mask is false exactly where the shield leaves only the flight to the destination at
/// full speed.
#[test]
fn there_is_no_choice_once_the_way_home_takes_every_slot() {
    let settings = EnvironmentSettings {
        entropy_when_forced: false,
        ..settings(Constraints::Shielded)
    };
    let mission = mission("separated");
    let mut environment = Environment::new(mission.clone(), &settings);
    let away = |sign: f32| Action {
        components: vec![sign, sign],
        user: 0,
    };
    let mut forced = 0;
    for slot in 0..60_usize {
        let (entropy_mask, from) = (environment.entropy_mask(), environment.position());
        let places = [1.0, -1.0].map(|sign| {
            let mut branch = environment.clone();
            branch.step(&away(sign));
            branch.position()
        });
        if !entropy_mask {
            // Opposite displacements lead to the same place.
            assert!((places[0] - places[1]).norm() < 15.0, "slot {slot}");
            forced += 1;
        } else if (from - mission.parameters().start).norm() < 1.0 && slot < 10 {
            assert!((places[0] - places[1]).norm() > 25.0, "slot {slot}");
        }
        environment.step(&Action {
            user: slot % 15,
            ..away(-1.0)
        });
    }
    assert!((20..50).contains(&forced), "{forced}");
}

/// The penalty form enforces only area and speed; the reward accounts for the other constraints.
#[test]
fn the_penalty_form_permits_violations_and_penalizes_them() {
    let mission = mission("separated");
    let mut environment = Environment::new(mission, &settings(Constraints::Penalty));
    let action = Action {
        components: vec![-1.0, -1.0],
        user: 3,
    };
    let mut unpaid = 0;
    loop {
        assert_eq!(environment.admissible(), 0x7fff);
        let step = environment.step(&action);
        unpaid += u32::from(step.rate > 0.0 && step.reward.rate == 0.0);
        if step.last {
            assert!(step.reward.trajectory < -60.0 * 1000.0);
            break;
        }
    }
    // User 3 is entitled to 4 slots; in the other 56 slots serving it is unfair.
    assert_eq!(unpaid, 56);
    assert!(!environment.episode().arrived && !environment.episode().fair);
    assert_eq!(environment.position(), Position::new(0.0, 0.0));
}

#[test]
fn observations_are_normalized_to_the_unit_cube() {
    let mission = mission("mixed");
    let mut rng = Pcg64Mcg::seed_from_u64(9);
    let mut environment = Environment::new(mission, &settings(Constraints::Shielded));
    let mut state = vec![f32::NAN; environment.dimensions().observation];
    let mut action = Action::default();
    loop {
        environment.observe(&mut state);
        assert!(
            state.iter().all(|x| (-1.0..=1.001).contains(x)),
            "{state:?}"
        );
        action.randomize(2, 15, environment.admissible(), &mut rng);
        if environment.step(&action).last {
            break;
        }
    }
}

fn environment() -> Environment<f64> {
    let scenario = Scenario::shipped("separated").and_then(|s| s.with_noise_dbm(-85.0).ok());
    let mission = scenario.expect("a shipped scenario").mission;
    let settings = settings(Constraints::Shielded);
    let prices: Vec<f64> = (0..15).map(|user| 0.02 * f64::from(user)).collect();
    Environment::new(mission, &settings).with_prices(&prices)
}

#[test]
fn what_is_bilinear_is_interpolated_exactly() {
    let nodes = Nodes::new([900.0, 500.0], 30.0);
    assert_eq!((nodes.columns, nodes.rows), (65, 37));
    let bilinear = |place: &Position<f64>| 2.0 + 0.01 * place.x - 0.03 * place.y * place.x;
    let values = (0..nodes.count()).map(|index| bilinear(&nodes.place(index)) as f32);
    let values: Vec<f32> = values.collect();
    for (x, y) in [(0.0, 0.0), (900.0, 500.0), (431.7, 77.7), (899.9, 0.1)] {
        let place = Position::new(x, y);
        let error = nodes.interpolate(&values, &place) - bilinear(&place);
        assert!(error.abs() < 2e-3, "{x} {y}: {error}");
    }
    // The value outside the area is the value at its border.
    let [outside, border] = [Position::new(-5.0, 600.0), Position::new(0.0, 500.0)];
    let [a, b] = [outside, border].map(|place| nodes.interpolate(&values, &place));
    assert_eq!(a, b);
}

/// A vehicle that always flies to the largest value achieves the value at the start.
#[test]
fn greedy_flight_achieves_the_value() {
    let mut environment = environment();
    let values = environment.value_to_go();
    let start = environment.position();
    let reach_m = environment.mission().reach_m();
    let (moves, slots) = (moves(reach_m), environment.mission().slots());
    let mut worth = 0.0;
    for slot in 1..=slots {
        let mut best = (f64::NEG_INFINITY, 0.0, Displacement::zeros());
        for step in &moves {
            let place = environment.position() + step;
            if place.x.min(place.y) < 0.0 || place.x.max(place.y) > 1000.0 {
                continue;
            }
            let here = environment.clone().best_worth(place);
            let total = here + values.at(slot, &place);
            if total > best.0 {
                best = (total, here, *step);
            }
        }
        let unit = best.2 / reach_m;
        let from = environment.position();
        environment.step(&Action {
            components: vec![unit.x as f32, unit.y as f32],
            user: slot as usize % 15,
        });
        // The shield changes the displacement only in the last slots.
        let flown = environment.position() - from;
        if slot < slots - 1 {
            assert!(
                (flown - best.2).norm() < 1.0,
                "slot {slot}: {flown} {}",
                best.2
            );
            worth += best.1;
        } else {
            worth += environment.clone().best_worth(environment.position());
        }
    }
    assert!(environment.episode().arrived);
    let predicted = values.at(0, &start);
    assert!(
        (worth / predicted - 1.0).abs() < 0.02,
        "{worth} {predicted}"
    );
    assert_eq!(values.at(slots, &start), 0.0);
    // The start is too far from the destination for the slots that are left.
    assert!(values.at(slots - 5, &start) < values.at(slots - 5, &environment.position()) - 10.0);
}

// SPDX-License-Identifier: MIT OR Apache-2.0
//! Tests of the network as a policy.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::boxed::Box;

use super::{
    file::{file, load},
    missions::{mission, parameters, state},
};
use crate::{
    Mission, Position, Scalar,
    controller::{Controller, DatedChange},
    mission::{MissionChange, MissionParameters},
    policy::{Policy, sets::*},
    test_missions::{table_one, table_one_without_nodes},
};

/// The policy decides what the network gives for the mission's observation, also after changes.
#[test]
fn decisions_are_those_of_the_network() {
    let mut random = Pcg64Mcg::seed_from_u64(31);
    let mut work = SetsWork::default();
    for _ in 0..20 {
        let p = parameters(&mut random);
        let mut mission = mission::<f32>(&p);
        let network = load(file()).expect("sound");
        let work = &mut work;
        let network = NetworkWithWork { network, work };
        let mut policy = SetsPolicy::new(network, &mission).expect("fits");
        let mut state = state(&mut random, &p);
        let begun = state.slot - 1;
        let position_m = Position::new(1.0, 2.0);
        for change in [
            MissionChange::MaxSpeed(12.5),
            MissionChange::UserLeft { user: 0 },
            MissionChange::User {
                user: p.users.len() as u16,
                position_m,
            },
        ] {
            let accepted = mission.change(&change, begun).is_ok();
            policy.revise(&change, begun);
            assert_eq!(policy.mission(), &mission);
            state.counts.resize(mission.user_count(), 0);
            let action = policy.decide(&state.observation(&mission));
            let observed = state.observe(&mission);
            let network = load(file()).expect("sound");
            let output = network
                .evaluate(&observed, &mut SetsWork::default())
                .expect("fits");
            assert_eq!(<[f32; 2]>::from(action.displacement), output.displacement_m);
            let mut scores = output.user_scores.into_iter();
            assert_eq!(action.user_scores.len(), mission.user_count());
            for (user, &score) in action.user_scores.iter().enumerate() {
                if mission.has_user(user) {
                    assert_eq!(Some(score), scores.next(), "{accepted} {user}");
                } else {
                    assert_eq!(score, f32::MIN);
                }
            }
        }
    }
}

/// Under the controller a whole mission with changes is flown without a broken output, in both
/// precisions.
#[test]
fn missions_are_flown() {
    fn fly<T: Scalar>() {
        let mission: Mission<T, 16, 64> = table_one();
        let network = load(file()).expect("sound");
        let work = Box::<SetsWork>::default();
        let policy = SetsPolicy::new(NetworkWithWork { network, work }, &mission).expect("fits");
        let mut position = mission.parameters().start;
        let mut controller = Controller::new(mission, policy);
        while !controller.is_over() {
            if controller.slots_done() == 20 {
                let change = MissionChange::UserLeft { user: 4 };
                assert!(controller.note_change(&DatedChange {
                    from_slot: 22,
                    change,
                }));
            }
            let plan = controller.plan(position).expect("at rest");
            assert!(!plan.intervention.broken_output, "{}", plan.slot);
            position = plan.waypoint;
            controller.allocate_predicted(&position).expect("under way");
        }
        assert!(controller.mission().has_arrived(&position));
        assert!(!controller.policy().mission().has_user(4));
        assert!(controller.fairness().is_fair());
    }
    fly::<f32>();
    fly::<f64>();
}

#[test]
fn larger_missions_are_refused() {
    let mut random = Pcg64Mcg::seed_from_u64(32);
    let mut place = || Position::new(random.random_range(0.0..900.0), 500.0);
    let mut mission = |users: usize, sensors: usize| {
        Mission::new(MissionParameters::<f32, 40, 100> {
            users: (0..users).map(|_| place()).collect(),
            sensors: (0..sensors).map(|_| place()).collect(),
            mse_threshold: 0.01,
            ..table_one_without_nodes()
        })
        .expect("valid")
    };
    let mut create = |users, sensors| {
        let network = load(file()).expect("sound");
        let work = SetsWork::default();
        let network = NetworkWithWork { network, work };
        SetsPolicy::new(network, &mission(users, sensors)).map(|_| ())
    };
    assert_eq!(create(16, 64), Ok(()));
    let users = SetsMismatch {
        what: "users",
        got: 17,
        most: 16,
    };
    assert_eq!(create(17, 64), Err(users));
    let sensors = SetsMismatch {
        what: "sensors",
        got: 65,
        most: 64,
    };
    assert_eq!(create(16, 65), Err(sensors));
}

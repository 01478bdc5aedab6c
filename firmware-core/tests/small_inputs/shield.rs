// SPDX-License-Identifier: MIT OR Apache-2.0
//! The shield: waypoints and users.

use firmware_core::{
    Displacement, Mission, Position, USERS_MAX,
    mission::{Area, rounding_m},
    shield::{Fairness, Intervention, ReachableSet, admissible_user, admissible_waypoint},
};

use crate::{choices::each, test_missions::table_one_without_nodes};

const USERS: usize = 3;

fn mission(slots: u32, start: [f64; 2]) -> Option<Mission<f64, USERS_MAX, 2>> {
    let mut parameters = table_one_without_nodes::<f64, USERS_MAX, 2>();
    parameters.slots = slots;
    parameters.area = Area {
        east_m: 100.0,
        north_m: 80.0,
    };
    parameters.start = Position::new(start[0], start[1]);
    parameters.destination = Position::new(80.0, 80.0);
    for user in 0..USERS {
        let place = Position::new(20.0 * user as f64, 10.0);
        parameters.users.push(place).expect("capacity");
    }
    let sensor = Position::new(50.0, 40.0);
    parameters.sensors.push(sensor).expect("capacity");
    Mission::new(parameters).ok()
}

/// Whatever a policy asks for, in every slot: the waypoint is in the area and within reach, and the
/// mission arrives.
#[cfg_attr(not(kani), test)]
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(40))]
fn every_flight_stays_inside_and_arrives() {
    each(|choices| {
        let slots = 1 + choices.below(3) as u32;
        let start = [
            choices.of(&[0.0, 35.0, 100.0]),
            choices.of(&[0.0, 40.0, 80.0]),
        ];
        let Some(mission) = mission(slots, start) else {
            return;
        };
        let p = mission.parameters();
        let slack_m = rounding_m(&p.area, mission.reach_m());
        let mut here = p.start;
        for slot in 1..=slots {
            let along = [-1e300, -7.0, 0.0, 30.0, 45.0];
            let displacement = Displacement::new(choices.of(&along), choices.of(&along));
            let set = ReachableSet::of_slot(&mission, slot, here);
            let mut changed = Intervention::default();
            let waypoint = admissible_waypoint(&set, &displacement, &mut changed);
            assert!(p.area.contains(&waypoint), "{waypoint}");
            assert!((waypoint - here).norm() <= mission.reach_m() + slack_m);
            assert!(!changed.out_of_reach);
            // Without an intervention it is what was asked for.
            if !changed.displacement {
                assert!((waypoint - here - displacement).norm() <= slack_m);
            }
            here = waypoint;
        }
        assert!(mission.has_arrived(&here), "{here}");
    });
}

/// Whatever the scores, and whoever is not heard: there is a user to serve, and where every slot is
/// used, every quota is met.
#[cfg_attr(not(kani), test)]
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(20))]
fn every_order_of_service_is_fair() {
    each(|choices| {
        let slots = 4 + choices.below(3) as u32;
        let mission = mission(slots, [50.0, 50.0]).expect("within reach");
        let mut fairness = Fairness::new(&mission);
        let mut missed = 0;
        for slot in 0..slots {
            // Also with too few scores, and none.
            let favorite = choices.below(USERS + 1);
            let scores: Vec<f64> = (0..favorite.min(USERS))
                .map(|user| if user + 1 == favorite { 2.0 } else { 1.0 })
                .collect();
            let mut changed = Intervention::default();
            let user = admissible_user(&fairness, &scores, &mut changed).expect("a user");
            assert!(user < USERS);
            assert_eq!(changed.user, favorite > 0 && user + 1 != favorite);
            assert!(missed > 0 || fairness.admits(user));
            // One slot may be lost.
            let is_heard = missed > 0 || slot > 2 || choices.below(2) == 0;
            missed += u32::from(!is_heard);
            fairness.record(is_heard.then_some(user));
        }
        let served: u32 = fairness.counts().iter().sum();
        assert_eq!(served + missed, slots);
        assert!(fairness.owed() <= missed);
        assert!(fairness.is_fair() || missed > 0);
    });
}

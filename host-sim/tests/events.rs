//! Missions that change in flight: what changes in the world is told to the vehicle, which takes it
//! and keeps every constraint of the mission as it is then.

use environment::Allocation;
use host_sim::{
    flight::{FlightSettings, Peer, RealTimeFactor, fly, vehicle_settings},
    policy::{HostPolicy, PolicyChoice},
    record::{FlightRecord, Summary},
};
use scenario::{EventKind, Events, Scenario};
use vehicle::{Profile, Vehicle};

const EVENTS: &str = "
[[event]]
slot = 21
user = 3
position_m = [620.0, 380.0]
[[event]]
slot = 21
user = 5
leaves = true
[[event]]
slot = 21
user = 15
position_m = [220.0, 580.0]
[[event]]
slot = 21
sensor = 7
leaves = true
[[event]]
slot = 25
sensor = 36
position_m = [700.0, 300.0]
[[event]]
slot = 31
mse_threshold = 0.0145
[[event]]
slot = 31
noise_dbm = -94.5
[[event]]
slot = 31
user = 5
position_m = [300.0, 600.0]
[[event]]
slot = 35
slots = 62
";

fn flown(choice: &PolicyChoice, profile: Profile, events: &Events) -> FlightRecord {
    let scenario = Scenario::shipped(match profile {
        Profile::Ideal => "separated",
        _ => "slow",
    });
    let scenario = scenario.expect("shipped");
    let (policy, name) = HostPolicy::load(choice, &scenario).expect("fits");
    let settings = FlightSettings {
        ground_link: None,
        policy: name,
        inner: Allocation::Exact,
        profile,
        real_time_factor: RealTimeFactor::Max,
        seed: 1,
        symbols_per_slot: 400,
        ignores_errors: false,
        events: events.clone(),
    };
    let vehicle = Vehicle::new(vehicle_settings(&scenario, profile));
    fly(
        &scenario,
        policy,
        &settings,
        Peer::built_in(vehicle),
        &mut (),
    )
    .unwrap_or_else(|failed| panic!("{}", failed.error))
}

fn events() -> Events {
    let mission = Scenario::shipped("separated").expect("shipped").mission;
    Events::parse(EVENTS, &mission).expect("valid events")
}

#[test]
fn every_event_is_taken_and_every_constraint_holds() {
    let events = events();
    for (choice, profile) in [
        (PolicyChoice::Plan, Profile::Ideal),
        (PolicyChoice::Plan, Profile::Multirotor),
        (PolicyChoice::Shipped, Profile::Ideal),
        (PolicyChoice::StraightLine, Profile::Ideal),
    ] {
        let record = flown(&choice, profile, &events);
        let summary: Summary = record.summary();
        let told = summary.link.vehicle.slots;
        assert_eq!((told.changes, told.changes_refused), (9, 0), "{choice}");
        assert_eq!(summary.link.vehicle.link.dropped(), 0);
        assert_eq!(summary.constraint_violations, 0, "{choice} {profile}");
        assert!(summary.arrived && summary.fair && summary.slots == 62);
        assert_eq!(summary.mse_violations, 0);
        assert_eq!(summary.users.len(), 16);
        // The signals that were drawn agree with the MSE over the sensors that were there.
        let deviation = (summary.empirical_mse_ratio - 1.0).abs();
        assert!(deviation < 4.0 * summary.empirical_mse_ratio_standard_error);
        // A user that was away was not served, and one that had joined was.
        let served = |user, slots: std::ops::RangeInclusive<u32>| {
            let mut of_slots = record
                .slots
                .iter()
                .filter(|slot| slots.contains(&slot.slot));
            of_slots.any(|slot| slot.served_user == Some(user))
        };
        assert!(!served(5, 21..=30), "{choice}");
        assert!(served(15, 21..=62) && !served(15, 1..=20), "{choice}");
        let quotas: Vec<_> = summary.users.iter().map(|user| user.quota).collect();
        // floor(62 / 16) from the start, floor((62 - 20) / 16) and floor((62 - 30) / 16) later.
        assert_eq!(
            (quotas[0], quotas[15], quotas[5]),
            (Some(3), Some(2), Some(2))
        );
        let words = |event: &host_sim::record::FlightEvent| event.text.contains("user 15 is at");
        assert_eq!(record.events.iter().filter(|event| words(event)).count(), 1);
    }
}

/// Planning again is worth it: the same plan, flown to its end as it was made, carries less.
#[test]
fn a_plan_that_follows_the_changes_carries_more() {
    let scenario = Scenario::shipped("separated").expect("shipped");
    let plan = planning::planner::plan(&scenario.mission, |_| {}).expect("within capacity");
    let rows = plan.waypoints.iter().zip(&plan.users);
    let rows = rows.map(|(place, user)| format!("{},{},{user}\n", place.x, place.y));
    let folder = tempfile::tempdir().expect("a directory");
    let file = folder.path().join("plan.csv");
    let text = rows.fold("east_m,north_m,user\n".to_owned(), |text, row| text + &row);
    std::fs::write(&file, text).expect("written");
    let (mut all_kept, mut all_replanned) = (0.0, 0.0);
    for seed in 2..=4 {
        let kind = EventKind::UsersMove;
        let events = kind.draw(&scenario.mission, seed).expect("large enough");
        let total = |choice| flown(&choice, Profile::Ideal, &events).summary().sum_rate;
        let kept = total(file.to_str().expect("UTF-8").parse().expect("a policy"));
        let replanned = total(PolicyChoice::Plan);
        println!("seed {seed}: {kept} kept, {replanned} replanned");
        assert!(replanned > kept, "seed {seed}: {replanned} {kept}");
        all_kept += kept;
        all_replanned += replanned;
    }
    assert!(
        all_replanned > 1.005 * all_kept,
        "{all_replanned} {all_kept}"
    );
}

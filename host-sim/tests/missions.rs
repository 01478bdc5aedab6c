//! Whole missions in simulated time, through encoded bytes on both links.

use firmware_core::policy::StraightLine;
use host_sim::{
    flight::{FlightSettings, Pace, Peer, fly, vehicle_settings},
    record::FlightRecord,
    scenario::Scenario,
    vehicle::{Profile, Vehicle},
};

fn flown(profile: Profile) -> FlightRecord {
    let scenario = Scenario::shipped("separated").unwrap();
    let settings = FlightSettings {
        policy: "straight-line".into(),
        profile,
        pace: Pace::Max,
        seed: 1,
        symbols_per_slot: 400,
    };
    let policy = StraightLine::new(&scenario.mission);
    let peer = Peer::built_in(Vehicle::new(vehicle_settings(&scenario, profile)));
    fly(&scenario, policy, &settings, peer, &mut ()).unwrap_or_else(|failed| {
        let record = failed.record.unwrap();
        panic!("{} {:#?}", failed.error, record.events)
    })
}

#[test]
fn the_default_mission_arrives_fair_and_accurate_on_every_kind_vehicle() {
    for profile in [Profile::Ideal, Profile::Multirotor] {
        let record = flown(profile);
        let summary = record.summary();
        println!("{summary:#?}");
        assert!(summary.arrived && summary.fair, "{summary:#?}");
        assert_eq!(summary.mse_violations, 0);
        assert_eq!(summary.constraint_violations, 0);
        let ratio_error = (summary.empirical_mse_ratio - 1.0).abs();
        assert!(ratio_error < 3.0 * summary.empirical_mse_ratio_standard_error);
        if profile == Profile::Ideal {
            assert!(summary.planned_vs_flown_m < 1e-3);
        }
    }
}

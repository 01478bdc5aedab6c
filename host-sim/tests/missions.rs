//! Whole missions in simulated time, through encoded bytes on both links.

use firmware_core::policy::StraightLine;
use host_sim::{
    allocation::Allocation,
    flight::{FlightSettings, Pace, Peer, fly, vehicle_settings},
    record::FlightRecord,
    scenario::Scenario,
    vehicle::{Profile, Vehicle},
};

fn flown(profile: Profile) -> FlightRecord {
    flown_with(profile, Allocation::Exact)
}

fn flown_with(profile: Profile, inner: Allocation) -> FlightRecord {
    let scenario = Scenario::shipped("separated").unwrap();
    let settings = FlightSettings {
        policy: "straight-line".into(),
        inner,
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

/// What each freedom is worth, on one path: Alg. 1 nearly reaches the optimum, and a scheme that
/// gives up a freedom never exceeds it. A slot that fixed sensor powers cannot make accurate is
/// reported as infeasible and carries nothing.
#[test]
fn every_allocation_flies_and_none_beats_the_exact_one() {
    let exact = flown(Profile::Ideal).summary();
    for (name, least) in [
        ("alternating", 0.99),
        ("fixed-user-power", 0.1),
        ("fixed-user-power:0.002", 0.01),
        ("fixed-sensor-power", 0.0),
        ("fixed-sensor-power:0.01", 0.0),
    ] {
        let record = flown_with(Profile::Ideal, name.parse().unwrap());
        let summary = record.summary();
        println!("{name}: {} of {}", summary.sum_rate, exact.sum_rate);
        assert_eq!(summary.inner, name);
        assert!(summary.arrived && summary.fair);
        assert!(summary.sum_rate <= exact.sum_rate * (1.0 + 1e-9), "{name}");
        assert!(summary.sum_rate >= exact.sum_rate * least, "{name}");
        for slot in &record.slots {
            assert!(slot.feasible || slot.rate == 0.0, "{name}: {slot:?}");
        }
    }
}

//! A mission with the board's computer, in single precision and stepped from outside like the board
//! in QEMU.

use environment::Allocation;
use firmware_core::console::PolicyKind;
use host_sim::{
    flight::{
        self, FlightSettings, Pace, Peer,
        computer::{Twin, order},
    },
    record::FlightRecord,
};
use scenario::{Events, Scenario};
use vehicle::{Profile, Vehicle};

fn flown(scenario: &Scenario, policy_kind: PolicyKind) -> FlightRecord {
    let settings = FlightSettings {
        policy: "of the board".into(),
        inner: Allocation::Exact,
        profile: Profile::Ideal,
        pace: Pace::Max,
        seed: 1,
        symbols_per_slot: 10,
        events: Events::default(),
    };
    let order = order(scenario, settings.profile, policy_kind);
    let mut twin = Twin::new(&order, None).expect("an order that can be flown");
    let vehicle = flight::vehicle_settings(scenario, settings.profile);
    let peer = Peer::built_in(Vehicle::new(vehicle));
    flight::fly_with(scenario, &mut twin, &settings, peer, &mut ()).expect("flown")
}

#[test]
fn a_mission_in_single_precision_arrives_and_is_the_same_each_time() {
    let scenario = Scenario::shipped("separated").expect("shipped");
    let record = flown(&scenario, PolicyKind::StraightLine);
    let summary = record.summary();
    assert!(summary.arrived && summary.fair, "{summary:?}");
    assert_eq!(
        (summary.mse_violations, summary.constraint_violations),
        (0, 0)
    );
    assert_eq!(record.slots.len(), 60);
    assert!(record.slots.iter().all(|slot| slot.age_slots == 0));
    let again = flown(&scenario, PolicyKind::StraightLine).slots;
    assert_eq!(again.len(), record.slots.len());
    for (one, other) in record.slots.iter().zip(&again) {
        assert_eq!(
            (one.planned, one.served_user),
            (other.planned, other.served_user)
        );
        assert_eq!(one.rate.to_bits(), other.rate.to_bits());
    }
}

#[test]
fn an_order_without_its_policy_is_refused() {
    let scenario = Scenario::shipped("separated").expect("shipped");
    let order = order(&scenario, Profile::Ideal, PolicyKind::Trained);
    let refusal = Twin::new(&order, None).expect_err("no policy");
    assert_eq!(refusal, "the board has no trained policy");
    let refusal = Twin::new(&order, Some((*b"ONNX").into())).expect_err("no policy");
    assert!(refusal.contains("UAVP"), "{refusal}");
}

/// The first plan is made before take-off, within the operations that the board allows for it.
#[test]
fn a_board_flies_its_own_plan() {
    /// The certified bound (models/bounds.csv), bit/s/Hz.
    const BOUND: f64 = 62.1043;
    let scenario = Scenario::shipped("separated").expect("shipped");
    let summary = flown(&scenario, PolicyKind::Plan).summary();
    assert!(summary.arrived && summary.fair, "{summary:?}");
    assert_eq!(
        (summary.mse_violations, summary.constraint_violations),
        (0, 0)
    );
    let fraction = summary.sum_rate / BOUND;
    assert!((0.98..=1.0).contains(&fraction), "{fraction}");
}

#[test]
fn an_order_beyond_the_planners_capacity_is_refused() {
    let scenario = Scenario::shipped("separated").expect("shipped");
    let mut order = order(&scenario, Profile::Ideal, PolicyKind::Plan);
    order.mission.slots = 150;
    assert!(Twin::new(&order, None).is_ok());
    order.mission.slots = 151;
    let refusal = Twin::new(&order, None).expect_err("too many slots");
    assert_eq!(
        refusal,
        "planner: the mission has 151 slots, but the planner holds at most 150"
    );
    order.policy_kind = PolicyKind::StraightLine;
    assert!(Twin::new(&order, None).is_ok());
}

//! The onboard MAVLink client and the built-in vehicle in simulated time, connected by encoded
//! MAVLink 2 frames in both directions.

mod flight;

use firmware_core::Position;
use firmware_core::autopilot::{Coordinates, Phase};
use firmware_core::time::Duration;
use flight::{SLOT, ready, zigzag};
use vehicle::Profile;

#[test]
fn the_ideal_vehicle_is_at_every_waypoint_at_the_slots_end() {
    for coordinates in [Coordinates::Local, Coordinates::Global] {
        let mut flight = ready(Profile::Ideal, |s, _| s.coordinates = coordinates);
        let begin = flight.now;
        let tolerance = match coordinates {
            Coordinates::Local => 1e-3,
            Coordinates::Global => 0.02, // 1e-7 degrees
        };
        for (n, waypoint) in zigzag().into_iter().enumerate() {
            let end = begin + SLOT * (n as u32 + 1);
            let ended = flight.fly_leg(waypoint, end);
            assert!(!ended.tick.extrapolated);
            assert!(ended.missed_m <= tolerance, "leg {n}: {ended:?}");
            assert!((flight.vehicle.true_position() - waypoint).norm() <= tolerance);
            assert_eq!(flight.now, end, "the slot grid is kept");
        }
        flight.client.land(flight.now);
        flight.run_until_phase(Phase::Landed, Duration::from_secs(60));
        assert!(!flight.vehicle.armed());
        assert_eq!(flight.vehicle.altitude_m(), 0.0);
        assert_eq!(flight.client.fault(), None);
    }
}

#[test]
fn a_multirotor_follows_a_straight_line_at_full_speed() {
    let mut flight = ready(Profile::Multirotor, |_, _| {});
    let begin = flight.now;
    let mut missed = Vec::new();
    for n in 0..25 {
        // The leg is planned from the present position, as in the controller.
        let from = flight.client.position().unwrap().position;
        let waypoint = Position::new(from.x + 27.0, from.y + 13.0);
        let ended = flight.fly_leg(waypoint, begin + SLOT * (n + 1));
        missed.push(ended.missed_m);
    }
    let mut under_way = missed[6..].to_vec();
    under_way.sort_by(f64::total_cmp);
    let median = under_way[under_way.len() / 2];
    assert!(median < 3.0, "median {median:.2} of {missed:.2?}");
    flight.client.return_and_land(flight.now);
    flight.run_until_phase(Phase::Landed, Duration::from_secs(200));
    let home = flight::start();
    assert!((flight.vehicle.true_position() - home).norm() < 1.0);
}

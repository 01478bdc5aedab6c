//! The trial leg before the first slot, which measures the speed that the airframe reaches.

mod flight;

use firmware_core::Position;
use firmware_core::autopilot::preflight::PreflightRefusal;
use firmware_core::autopilot::{Phase, failsafe::Cause};
use firmware_core::time::Duration;
use flight::{Flight, settings, start, vehicle};
use vehicle::{Airframe, Profile};

/// Flies an airframe with a client that may set parameters, for a mission that needs this speed,
/// until the first slot may begin or to the end.
fn tried(profile: Profile, airframe: Airframe, needed_mps: f64) -> Flight {
    let (mut settings, mut vehicle) = (settings(profile), vehicle(profile));
    settings.set_parameters = true;
    settings.preflight.needed_speed_mps = Some(needed_mps);
    settings.preflight.destination = Some(Position::new(950.0, 950.0));
    vehicle.ability = profile.ability_with(airframe);
    let mut flight = Flight::new(settings, vehicle);
    flight.client.launch(flight.now);
    flight.run_until(Duration::from_secs(300), |flight| {
        flight.client.phase() == Phase::Ready || flight.client.phase().is_final()
    });
    flight
}

fn has_tried(flight: &Flight) -> bool {
    let is_trial = |line: &&String| line.contains("trying what speed the airframe reaches");
    flight.log.iter().filter(is_trial).count() == 1
}

#[test]
fn an_airframe_that_is_too_slow_is_landed_where_it_took_off() {
    for (profile, most_mps) in [(Profile::ArduCopter, 15.3), (Profile::Px4, 11.0)] {
        let mut flight = tried(profile, Airframe::Stock, 20.0);
        assert!(has_tried(&flight), "{:#?}", flight.log);
        assert_eq!(flight.client.fault(), Some(Cause::TooSlow));
        let refusal = flight.client.refusal();
        let Some(PreflightRefusal::SlowAirframe {
            needed_mps,
            reached_mps,
        }) = refusal
        else {
            panic!("{refusal:?}")
        };
        assert_eq!(needed_mps, 20.0);
        assert!((8.0..most_mps).contains(&reached_mps), "{refusal:?}");
        let away_m = (flight.vehicle.true_position() - start()).norm();
        assert!(away_m < 10.0, "{away_m}");
        assert!(!flight.vehicle.armed());
        flight.run_until(Duration::from_secs(30), |flight| {
            flight.client.is_restored()
        });
    }
}

/// The result of the trial leg is used for planning from then on.
#[test]
fn an_airframe_that_is_fast_enough_flies_as_fast_as_it_can() {
    let slow = tried(Profile::ArduCopter, Airframe::Stock, 12.0);
    assert!(has_tried(&slow));
    assert_eq!(slow.client.phase(), Phase::Ready);
    let limit_mps = slow.client.limits().speed_mps;
    assert!((13.5..15.0).contains(&limit_mps), "{limit_mps}");
    for profile in [Profile::ArduCopter, Profile::Px4] {
        let strong = tried(profile, Airframe::Strong, 20.0);
        assert!(has_tried(&strong));
        assert_eq!(strong.client.phase(), Phase::Ready);
        let limit_mps = strong.client.limits().speed_mps;
        assert!(limit_mps > 30.0, "{limit_mps}");
        let away_m = (strong.vehicle.true_position() - start()).norm();
        assert!(away_m < 5.0, "{away_m}");
    }
}

/// A known airframe needs no trial: it is clear before take-off that the mission would not arrive.
#[test]
fn a_known_airframe_is_refused_on_the_ground() {
    let profile = Profile::ArduCopter;
    let mut settings = settings(profile);
    settings.set_parameters = true;
    settings.airframe_speed_mps = Some(15.2);
    settings.preflight.needed_speed_mps = Some(20.0);
    settings.preflight.destination = Some(Position::new(950.0, 950.0));
    let mut flight = Flight::new(settings, vehicle(profile));
    flight.client.launch(flight.now);
    flight.run_until_phase(Phase::Failed, Duration::from_secs(70));
    let refusal = flight.client.refusal();
    assert_eq!(
        refusal,
        Some(PreflightRefusal::TooSlow {
            needed_mps: 20.0,
            possible_mps: 15.2,
            parameter: None,
        })
    );
    assert!(!flight.vehicle.armed() && !has_tried(&flight));
}

/// No trial is made if the parameters that were read are sufficient.
#[test]
fn nothing_is_tried_where_the_parameters_as_found_are_enough() {
    for (profile, needed_mps) in [(Profile::ArduCopter, 9.0), (Profile::Px4, 4.5)] {
        let flight = tried(profile, Airframe::Stock, needed_mps);
        assert!(!has_tried(&flight));
        assert_eq!(flight.client.phase(), Phase::Ready);
    }
}

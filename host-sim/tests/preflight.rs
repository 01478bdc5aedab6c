//! Decisions before a flight: the client's own address, the requests that the autopilot refuses,
//! the profile, and the reasons to refuse a start.

mod flight;

use environment::Allocation;
use firmware_core::Position;
use firmware_core::autopilot::preflight::PreflightRefusal;
use firmware_core::autopilot::wire::Address;
use firmware_core::autopilot::{AutopilotSettings, Geofence, OwnAddress, Phase};
use firmware_core::policy::StraightLine;
use firmware_core::time::Duration;
use flight::{Flight, ready, settings, vehicle};
use host_sim::doctor;
use host_sim::flight::{
    FlightError, FlightSettings, Peer, ProfileChoice, RealTimeFactor, autopilot_settings, fly,
    vehicle_settings,
};
use mavlink::dialects::common::{MavCmd, MavMessage};
use scenario::{Events, Scenario};
use vehicle::{FlightMode, Profile, Vehicle, VehicleSettings};

/// An older PX4 has no CURRENT_MODE: it is asked once, and the log contains the refused request.
#[test]
fn a_refused_message_interval_is_asked_for_once() {
    let flight = ready(Profile::Px4, |_, vehicle| {
        vehicle.ready_after = Duration::from_secs(60);
        vehicle.refused_intervals.push(436);
    });
    let asked = |message: f32| {
        let is_asked = |sent: &MavMessage| {
            matches!(sent, MavMessage::COMMAND_LONG(c)
                if c.command == MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL && c.param1 == message)
        };
        flight.sent.iter().filter(|(_, m)| is_asked(m)).count()
    };
    assert_eq!(asked(0.0), 0, "PX4 refuses it always");
    assert_eq!(asked(436.0), 1);
    assert!(
        asked(1.0) > 3,
        "what was accepted is asked for again while something is missing"
    );
    let refused = "SET_MESSAGE_INTERVAL for CURRENT_MODE refused: failed";
    let said = flight
        .log
        .iter()
        .filter(|line| line.contains(refused))
        .count();
    assert_eq!(said, 1, "{:#?}", flight.log);
}

/// MAVLink's convention for an onboard computer: it uses the vehicle's system id.
#[test]
fn the_client_speaks_under_the_vehicles_system_id() {
    let flight = ready(Profile::ArduCopter, |_, vehicle| vehicle.system = 7);
    let own = |system, component| Address { system, component };
    assert_eq!(flight.client.own(), own(7, 191));
    let flight = ready(Profile::Multirotor, |settings, _| {
        settings.own = OwnAddress {
            system: Some(200),
            component: 25,
        };
    });
    assert_eq!(flight.client.own(), own(200, 25));
}

/// ArduCopter's ground-control failsafe counts the heartbeats of SYSID_MYGCS only: as an onboard
/// computer we neither start it nor keep it from acting; as system 255 we do.
#[test]
fn the_ground_control_failsafe_counts_one_system_id() {
    for (system, mode) in [(None, FlightMode::Guided), (Some(255), FlightMode::Return)] {
        let mut flight = ready(Profile::ArduCopter, |settings, vehicle| {
            settings.own.system = system;
            vehicle.parameters = vec![("FS_GCS_ENABLE".into(), 1.0)];
        });
        flight.run_for(Duration::from_secs(10));
        assert_eq!(flight.vehicle.mode(), FlightMode::Guided);
        // Our process ends.
        let end = flight.now + Duration::from_secs(10);
        while flight.now < end {
            flight.now += flight::TICK;
            flight.vehicle.step(flight.now);
        }
        assert_eq!(flight.vehicle.mode(), mode, "{system:?}");
    }
}

/// Runs a client that is told to launch and a modified vehicle until the start is refused.
fn refused(
    profile: Profile,
    change: impl FnOnce(&mut AutopilotSettings<f64>, &mut Vehicle, &mut VehicleSettings),
) -> PreflightRefusal {
    let (mut settings, mut vehicle_settings) = (settings(profile), vehicle(profile));
    settings.preflight.area = Some((Position::origin(), Position::new(1000.0, 1000.0)));
    settings.preflight.needed_speed_mps = Some(20.0);
    let mut unused = Vehicle::new(vehicle_settings.clone());
    change(&mut settings, &mut unused, &mut vehicle_settings);
    let faults = unused.faults;
    let mut flight = Flight::new(settings, vehicle_settings);
    flight.vehicle.faults = faults;
    flight.client.launch(flight.now);
    flight.run_until_phase(Phase::Failed, Duration::from_secs(70));
    assert!(!flight.vehicle.armed());
    let refusal = flight
        .client
        .refusal()
        .unwrap_or_else(|| panic!("{:#?}", flight.log));
    let words = format!("not started: {refusal}");
    assert!(
        flight.log.iter().any(|line| line.ends_with(&words)),
        "{words}"
    );
    assert_eq!(flight.client.fault(), None);
    refusal
}

fn set(vehicle: &mut VehicleSettings, parameters: &[(&str, f32)]) {
    let all = parameters.iter().map(|&(n, v)| (n.to_owned(), v));
    vehicle.parameters = all.collect();
}

const FAST: [(&str, f32); 4] = [
    ("WPNAV_SPEED", 3500.0),
    ("WPNAV_ACCEL", 1000.0),
    ("ANGLE_MAX", 4500.0),
    ("PSC_JERK_XY", 20.0),
];

#[test]
fn what_waiting_cannot_cure_is_refused_with_both_numbers() {
    let far = refused(Profile::ArduCopter, |_, _, vehicle| {
        vehicle.start = Position::new(1000.0, 3800.0);
        set(vehicle, &FAST);
    });
    let PreflightRefusal::TooFar {
        distance_m,
        limit_m,
    } = far
    else {
        panic!("{far}");
    };
    assert!(
        (distance_m - 2800.0).abs() < 1.0 && limit_m == 500.0,
        "{far}"
    );

    let empty = refused(Profile::Multirotor, |_, vehicle, _| {
        vehicle.faults.battery_percent = Some(20);
    });
    let battery = PreflightRefusal::BatteryLow {
        percent: 20,
        threshold: 20,
    };
    assert_eq!(empty, battery);

    let slow = refused(Profile::ArduCopter, |_, _, _| {});
    let too_slow = PreflightRefusal::TooSlow {
        needed_mps: 20.0,
        possible_mps: 9.5,
        parameter: Some(("WPNAV_SPEED", 3500.0)),
    };
    assert_eq!(slow, too_slow);

    let fence =
        |settings: &mut AutopilotSettings<f64>, vehicle: &mut VehicleSettings, ceiling_m: f32| {
            settings.altitude_m = 100.0;
            let fence = [
                ("FENCE_ENABLE", 1.0),
                ("FENCE_RADIUS", 1400.0),
                ("FENCE_ALT_MAX", ceiling_m),
            ];
            set(vehicle, &[&FAST[..], &fence].concat());
        };
    let low = refused(Profile::ArduCopter, |settings, _, vehicle| {
        fence(settings, vehicle, 100.0);
    });
    let above = PreflightRefusal::AboveAutopilotFence {
        parameter: "FENCE_ALT_MAX",
        limit_m: 100.0,
        needed_m: 100.0,
    };
    assert_eq!(low, above);

    let narrow = refused(Profile::Px4, |_, _, vehicle| {
        let parameters = [
            ("MPC_XY_VEL_MAX", 35.0),
            ("MPC_XY_CRUISE", 35.0),
            ("GF_MAX_HOR_DIST", 900.0),
        ];
        set(vehicle, &parameters);
    });
    let PreflightRefusal::OutsideAutopilotFence {
        parameter,
        limit_m,
        needed_m,
    } = narrow
    else {
        panic!("{narrow}");
    };
    assert_eq!((parameter, limit_m), ("GF_MAX_HOR_DIST", 900.0));
    // From (50, 80) to (1000, 1000).
    assert!((needed_m - 1322.5).abs() < 1.0, "{narrow}");
}

/// A vehicle that stands outside the client's geofence, but near enough, flies to the start.
#[test]
fn a_vehicle_outside_the_area_flies_to_the_start() {
    let mut flight = ready(Profile::Multirotor, |settings, vehicle| {
        let area = (Position::origin(), Position::new(1000.0, 1000.0));
        settings.preflight.area = Some(area);
        settings.geofence = Some(Geofence {
            low: area.0,
            high: area.1,
            ceiling_m: 150.0,
        });
        vehicle.start = Position::new(-400.0, 80.0);
    });
    flight.run_for(Duration::from_secs(2));
    assert_eq!(flight.client.phase(), Phase::Ready);
    assert_eq!(flight.client.fault(), None);
}

/// Without a specified profile the heartbeat decides; a profile for another autopilot is refused.
#[test]
fn the_heartbeat_names_the_profile() {
    let scenario = Scenario::shipped("separated").unwrap();
    for profile in [Profile::Multirotor, Profile::ArduCopter, Profile::Px4] {
        let settings = autopilot_settings(&scenario, Profile::Ideal);
        let mut flight = Flight::new(settings, vehicle(profile));
        let mut choice = ProfileChoice::new(&scenario, None);
        assert_eq!(choice.settle(&mut flight.client), Ok(None));
        flight.run_until_phase(Phase::Checking, Duration::from_secs(5));
        assert_eq!(choice.settle(&mut flight.client), Ok(Some(profile)));
        assert_eq!(choice.settle(&mut flight.client), Ok(None));
        let limits = autopilot_settings(&scenario, profile).limits;
        assert_eq!(flight.client.settings().limits, limits);
        assert!(flight.client.limits().speed_mps <= limits.speed_mps);
        let other = if profile == Profile::Px4 {
            Profile::ArduCopter
        } else {
            Profile::Px4
        };
        let mut wrong = ProfileChoice::new(&scenario, Some(other));
        let error = wrong.settle(&mut flight.client).unwrap_err().to_string();
        assert!(error.contains(&format!("--profile {other}")), "{error}");
    }
}

fn flight_settings(profile: Profile) -> FlightSettings {
    FlightSettings {
        ground_link: None,
        policy: "straight-line".into(),
        inner: Allocation::Exact,
        profile,
        real_time_factor: RealTimeFactor::Max,
        seed: 1,
        symbols_per_slot: 1,
        ignores_errors: false,
        events: Events::default(),
    }
}

/// A whole flight ends at once and reports the true cause.
#[test]
fn a_mission_that_cannot_arrive_is_refused_before_take_off() {
    let scenario = Scenario::shipped("separated").unwrap();
    let fly = |vehicle: Profile, planned: Profile| {
        let peer = Peer::built_in(Vehicle::new(vehicle_settings(&scenario, vehicle)));
        let policy = StraightLine::new(&scenario.mission);
        fly(&scenario, policy, &flight_settings(planned), peer, &mut ()).unwrap_err()
    };
    let failed = fly(Profile::ArduCopter, Profile::ArduCopter);
    let words = failed.error.to_string();
    assert!(words.contains("set WPNAV_SPEED to 3500"), "{words}");
    let record = failed.record.unwrap();
    assert!(
        record
            .events
            .last()
            .is_some_and(|event| event.time_s < 60.0)
    );
    assert!(record.slots.is_empty());
    let failed = fly(Profile::ArduCopter, Profile::Px4);
    assert!(
        matches!(failed.error, FlightError::WrongProfile(_)),
        "{}",
        failed.error
    );
}

/// The doctor predicts how the mission would end.
#[test]
fn the_outcome_is_predicted_from_the_parameters() {
    let scenario = Scenario::shipped("separated").unwrap();
    let predict = |parameters: &[(&str, f32)]| {
        let mut vehicle = vehicle_settings(&scenario, Profile::ArduCopter);
        set(&mut vehicle, parameters);
        let settings = autopilot_settings(&scenario, Profile::ArduCopter);
        let mut flight = Flight::new(settings, vehicle);
        flight.run_until_phase(Phase::Standby, Duration::from_secs(60));
        let starts = flight.client.refusals(flight.now).is_empty();
        let policies = [(); 2].map(|()| StraightLine::new(&scenario.mission));
        doctor::predict(&scenario, policies, &flight.client, starts).unwrap()
    };
    let fast = predict(&FAST);
    let flown = fast.flight.unwrap();
    assert!(flown.arrives && flown.total > 0.97 * fast.ideal, "{fast}");
    let slow = predict(&[]);
    assert_eq!((slow.flight, slow.possible_mps), (None, 9.5));
    assert!(
        slow.to_string().ends_with("the mission would not start"),
        "{slow}"
    );
    // The speed is sufficient for the distance, but not for the accelerations.
    let sluggish = predict(&[
        ("WPNAV_SPEED", 2250.0),
        ("WPNAV_ACCEL", 50.0),
        FAST[2],
        FAST[3],
    ]);
    assert!(!sluggish.flight.unwrap().arrives, "{sluggish}");
    assert!(
        sluggish.to_string().contains("would not arrive"),
        "{sluggish}"
    );
}

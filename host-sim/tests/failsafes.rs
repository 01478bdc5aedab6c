//! Tests each row of the failsafe table in simulated time: what happens, when, and how the flight
//! ends.

mod flight;

use firmware_core::Position;
use firmware_core::autopilot::failsafe::Cause;
use firmware_core::autopilot::{Geofence, Leg, Phase};
use firmware_core::time::{Duration, Instant};
use flight::{Flight, SLOT, ready, start};
use mavlink::dialects::common::{MavCmd, MavMessage};
use vehicle::{FlightMode, Profile};

const LANDING: Duration = Duration::from_secs(60);

fn hovering() -> Flight {
    ready(Profile::Ideal, |_, _| {})
}

/// Returns all messages except our heartbeat.
fn acts(flight: &Flight, since: Instant) -> Vec<&MavMessage> {
    let acting = |m: &&MavMessage| !matches!(m, MavMessage::HEARTBEAT(_));
    let later = flight.sent.iter().filter(|(at, _)| *at > since);
    later.map(|(_, message)| message).filter(acting).collect()
}

fn arms(message: &MavMessage) -> bool {
    matches!(message, MavMessage::COMMAND_LONG(c)
        if c.command == MavCmd::MAV_CMD_COMPONENT_ARM_DISARM && c.param1 == 1.0)
}

/// Flies legs eastwards until the client no longer accepts them.
fn fly_on(flight: &mut Flight, slots: u32) {
    for _ in 0..slots {
        let from = flight.client.position().unwrap().position;
        let leg = Leg {
            waypoint: Position::new(from.x + 10.0, from.y),
            end: flight.now + SLOT,
        };
        if flight.client.fly_leg(flight.now, leg).is_err() {
            return;
        }
        flight.run_until(SLOT * 2, |flight| {
            flight.client.leg_ended(flight.now).is_some() || flight.client.phase() != Phase::Leg
        });
    }
}

fn assert_lands(mut flight: Flight, cause: Cause, limit: Duration) {
    flight.run_until(limit, |flight| flight.client.phase() == Phase::Landing);
    assert_eq!(flight.client.fault(), Some(cause));
    flight.run_until_phase(Phase::Landed, LANDING);
    assert!(!flight.vehicle.armed());
    assert_eq!(flight.vehicle.altitude_m(), 0.0);
    let said = format!("FAILSAFE {cause}: land");
    assert!(
        flight.log.iter().any(|line| line.ends_with(&said)),
        "{:?}",
        flight.log
    );
    let landed = flight.now;
    flight.client.launch(flight.now);
    flight.run_for(Duration::from_secs(5));
    assert!(!acts(&flight, landed).into_iter().any(arms), "armed again");
}

#[test]
fn heartbeat_lost_falls_silent_and_lands_when_it_is_back() {
    let mut flight = hovering();
    fly_on(&mut flight, 3);
    flight.vehicle.faults.no_heartbeat = true;
    let lost = flight.now;
    flight.run_for(Duration::from_secs(8));
    assert_eq!(flight.client.fault(), Some(Cause::HeartbeatLost));
    let (last, _) = flight.sent.last().unwrap();
    let silence = *last - lost;
    assert!(silence <= Duration::from_millis(5_100), "{silence:?}");
    assert!(silence >= Duration::from_secs(4), "{silence:?}");
    flight.vehicle.faults.no_heartbeat = false;
    flight.run_until_phase(Phase::Landed, LANDING);
    assert_eq!(flight.vehicle.altitude_m(), 0.0);
}

/// In flight and while landing: 5 s and 20 s after the last heartbeat the flight is over, the first
/// cause is kept, and nothing is sent any more until the autopilot is received again.
#[test]
fn a_dead_link_ends_the_flight() {
    for landing in [false, true] {
        let mut flight = hovering();
        fly_on(&mut flight, 3);
        if landing {
            flight.client.land(flight.now);
            flight.run_for(Duration::from_secs(2));
        }
        flight.vehicle.faults.no_heartbeat = true;
        flight.vehicle.faults.no_position = landing;
        let lost = flight.now;
        flight.run_until_phase(Phase::Released, Duration::from_secs(27));
        let after = flight.now - lost;
        assert!(after >= Duration::from_secs(24), "{after:?}");
        assert_eq!(flight.client.fault(), Some(Cause::HeartbeatLost));
        assert!(flight.client.is_link_dead(flight.now));
        let (last, _) = flight.sent.last().unwrap();
        assert!(*last - lost <= Duration::from_millis(5_100));
        let said = "FAILSAFE link dead: release control";
        assert!(flight.log.iter().any(|line| line.ends_with(said)));
        // The autopilot is received again: only our heartbeat continues.
        flight.vehicle.faults.no_heartbeat = false;
        let heard = flight.now;
        flight.run_for(Duration::from_secs(5));
        assert!(acts(&flight, heard).is_empty());
        assert!(flight.sent.iter().any(|(at, _)| *at > heard));
        assert!(!flight.client.is_link_dead(flight.now));
    }
}

#[test]
fn position_lost_lands() {
    let mut flight = hovering();
    flight.vehicle.faults.no_position = true;
    assert_lands(flight, Cause::PositionLost, Duration::from_secs(2));
}

#[test]
fn position_jumped_lands() {
    let mut flight = hovering();
    flight.vehicle.faults.position_offset_m.x = 200.0;
    assert_lands(flight, Cause::PositionJumped, Duration::from_secs(1));
}

#[test]
fn setpoints_ignored_lands() {
    let mut flight = hovering();
    flight.vehicle.faults.ignore_setpoints = true;
    fly_on(&mut flight, 20);
    let late = flight
        .log
        .iter()
        .filter(|line| line.contains("no position sample"));
    assert_eq!(late.count(), 0);
    assert_lands(flight, Cause::SetpointsIgnored, Duration::from_secs(1));
}

#[test]
fn the_pilot_takes_over_for_good() {
    for mode in [
        FlightMode::Loiter,
        FlightMode::Manual,
        FlightMode::Return,
        FlightMode::Land,
    ] {
        let mut flight = hovering();
        fly_on(&mut flight, 2);
        let from = flight.client.position().unwrap().position;
        let waypoint = Position::new(from.x + 20.0, from.y);
        let end = flight.now + SLOT;
        flight
            .client
            .fly_leg(flight.now, Leg { waypoint, end })
            .unwrap();
        flight.run_for(Duration::from_millis(450));
        flight.vehicle.pilot_sets_mode(flight.now, mode);
        let taken = flight.now;
        flight.run_for(Duration::from_secs(10));
        assert_eq!(flight.client.phase(), Phase::Released, "{mode:?}");
        // This holds even if the pilot switches back to the mode that follows setpoints.
        flight
            .vehicle
            .pilot_sets_mode(flight.now, FlightMode::Guided);
        flight.client.launch(flight.now);
        flight.client.stop(flight.now);
        flight.client.land(flight.now);
        flight.run_for(Duration::from_secs(5));
        assert_eq!(flight.client.phase(), Phase::Released);
        assert!(
            acts(&flight, taken).is_empty(),
            "{:?}",
            acts(&flight, taken)
        );
        let heartbeats = flight.sent.iter().filter(|(at, _)| *at > taken).count();
        assert!(heartbeats >= 14, "our heartbeat goes on: {heartbeats}");
    }
}

#[test]
fn the_pilot_takes_over_while_landing() {
    let mut flight = hovering();
    flight.client.land(flight.now);
    flight.run_for(Duration::from_secs(2));
    assert_eq!(flight.vehicle.mode(), FlightMode::Land);
    flight
        .vehicle
        .pilot_sets_mode(flight.now, FlightMode::Loiter);
    let taken = flight.now;
    flight.run_for(Duration::from_secs(30));
    assert_eq!(flight.client.phase(), Phase::Released);
    assert!(acts(&flight, taken).is_empty());
    assert!(flight.vehicle.altitude_m() > 10.0);
}

/// If the motors stop in the air, someone else has control. Nothing is sent, and the client does
/// not arm.
#[test]
fn disarmed_in_flight_lets_go() {
    let mut flight = hovering();
    fly_on(&mut flight, 2);
    flight.vehicle.faults.disarmed = true;
    let stopped = flight.now;
    flight.run_until_phase(Phase::Released, Duration::from_secs(2));
    assert_eq!(flight.client.fault(), Some(Cause::Disarmed));
    let said = "FAILSAFE disarmed in flight: release control";
    assert!(flight.log.iter().any(|line| line.ends_with(said)));
    let released = flight.now;
    assert!(released - stopped <= Duration::from_millis(210));
    flight.vehicle.faults.disarmed = false;
    flight.client.launch(flight.now);
    flight.run_for(Duration::from_secs(10));
    assert!(acts(&flight, released).is_empty());
}

/// A command that the flight needs is refused permanently in the air: here the landing itself. Then
/// the client can only stop sending, so that the autopilot's own failsafe acts.
#[test]
fn a_landing_that_is_never_answered_falls_silent() {
    let mut flight = hovering();
    fly_on(&mut flight, 1);
    flight.swallowed = |m| is_command(m, MavCmd::MAV_CMD_NAV_LAND);
    flight.client.land(flight.now);
    flight.run_until_phase(Phase::Failed, Duration::from_secs(30));
    assert_eq!(flight.client.fault(), Some(Cause::CommandFailed));
    let failed = flight.now;
    flight.run_for(Duration::from_secs(10));
    assert!(flight.sent.iter().all(|(at, _)| *at <= failed));
}

#[test]
fn battery_low_lands() {
    let mut flight = hovering();
    flight.vehicle.faults.battery_percent = Some(15);
    assert_lands(flight, Cause::BatteryLow, Duration::from_secs(5));
}

#[test]
fn outside_the_geofence_lands() {
    let mut flight = ready(Profile::Ideal, |settings, _| {
        settings.geofence = Some(Geofence {
            low: Position::new(0.0, 0.0),
            high: Position::new(100.0, 100.0),
            ceiling_m: 120.0,
        });
    });
    flight.vehicle.faults.position_offset_m.y = 40.0; // drifts away, too slowly for a jump
    flight.run_for(Duration::from_millis(200));
    assert_lands(flight, Cause::FenceBreached, Duration::from_secs(1));
}

#[test]
fn ground_silent_lands() {
    let mut flight = ready(Profile::Ideal, |settings, _| {
        settings.watch.ground = Some(Duration::from_secs(2));
    });
    for _ in 0..5 {
        flight.client.note_ground_link(flight.now);
        fly_on(&mut flight, 1);
    }
    assert_eq!(flight.client.fault(), None);
    assert_lands(flight, Cause::GroundSilent, Duration::from_secs(3));
}

#[test]
fn a_slot_overrun_stops_and_then_lands() {
    let mut flight = ready(Profile::Multirotor, |_, _| {});
    fly_on(&mut flight, 4);
    flight.run_for(Duration::from_secs(6));
    assert!(
        flight.vehicle.velocity().norm() < 0.1,
        "the reference came to rest"
    );
    assert_lands(flight, Cause::SlotOverrun, Duration::from_secs(6));
}

#[test]
fn stop_lands_from_flight_and_stops_motors_on_the_ground() {
    let mut flight = hovering();
    fly_on(&mut flight, 1);
    flight.client.stop(flight.now);
    assert_lands(flight, Cause::StopAsked, Duration::from_secs(1));

    for phase in [
        Phase::Checking,
        Phase::TakingControl,
        Phase::Arming,
        Phase::TakingOff,
    ] {
        let settings = flight::settings(Profile::Multirotor);
        let vehicle = flight::vehicle(Profile::Multirotor);
        let mut flight = Flight::new(settings, vehicle);
        flight.client.launch(flight.now);
        flight.run_until_phase(phase, Duration::from_secs(60));
        flight.client.stop(flight.now);
        flight.run_until(Duration::from_secs(90), |f| f.client.phase().is_final());
        flight.run_for(Duration::from_secs(3));
        assert!(!flight.vehicle.armed(), "{phase:?}: {:#?}", flight.log);
        assert_eq!(flight.vehicle.altitude_m(), 0.0, "{phase:?}");
    }
}

/// Ctrl-C while the vehicle leaves the ground: whichever of the two is faster, the flight ends on
/// the ground with the motors off.
#[test]
fn stop_during_take_off_never_leaves_the_vehicle_in_the_air() {
    for profile in Profile::ALL {
        for tenths in 0..40 {
            let (settings, mut vehicle) = (flight::settings(profile), flight::vehicle(profile));
            vehicle.ready_after = Duration::from_secs(1);
            let mut flight = Flight::new(settings, vehicle);
            flight.client.launch(flight.now);
            flight.run_until_phase(Phase::TakingOff, Duration::from_secs(60));
            flight.run_for(Duration::from_millis(100) * tenths);
            flight.client.stop(flight.now);
            flight.run_until(Duration::from_secs(90), |f| f.client.phase().is_final());
            let context = || format!("{profile}, {tenths}: {:#?}", flight.log);
            assert_eq!(
                flight.client.fault(),
                Some(Cause::StopAsked),
                "{}",
                context()
            );
            assert!(!flight.vehicle.armed(), "{}", context());
            assert_eq!(flight.vehicle.altitude_m(), 0.0, "{}", context());
        }
    }
}

#[test]
fn a_start_that_is_not_answered_is_given_up_on_the_ground() {
    for command in [
        MavCmd::MAV_CMD_DO_SET_MODE,
        MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
        MavCmd::MAV_CMD_NAV_TAKEOFF,
    ] {
        let mut flight = Flight::new(
            flight::settings(Profile::Ideal),
            flight::vehicle(Profile::Ideal),
        );
        flight.swallowed = match command {
            MavCmd::MAV_CMD_DO_SET_MODE => |m| is_command(m, MavCmd::MAV_CMD_DO_SET_MODE),
            MavCmd::MAV_CMD_NAV_TAKEOFF => |m| is_command(m, MavCmd::MAV_CMD_NAV_TAKEOFF),
            _ => |m| is_command(m, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM),
        };
        flight.client.launch(flight.now);
        flight.run_until_phase(Phase::Failed, Duration::from_secs(60));
        assert_eq!(flight.client.fault(), Some(Cause::CommandFailed));
        assert!(!flight.vehicle.armed(), "{command:?}: {:#?}", flight.log);
        let confirmations: Vec<u8> = flight
            .sent
            .iter()
            .filter_map(|(_, message)| match message {
                MavMessage::COMMAND_LONG(c) if c.command == command => Some(c.confirmation),
                _ => None,
            })
            .take(8)
            .collect();
        assert_eq!(confirmations, [0, 1, 2, 3, 4, 5, 6, 7], "{command:?}");
    }
}

fn is_command(message: &MavMessage, command: MavCmd) -> bool {
    matches!(message, MavMessage::COMMAND_LONG(c) if c.command == command)
}

#[test]
fn a_vehicle_that_never_gets_ready_is_not_flown() {
    let settings = flight::settings(Profile::Ideal);
    let mut vehicle = flight::vehicle(Profile::Ideal);
    vehicle.ready_after = Duration::from_secs(100_000);
    let mut flight = Flight::new(settings, vehicle);
    flight.client.launch(flight.now);
    flight.run_until_phase(Phase::Failed, Duration::from_secs(200));
    assert_eq!(flight.client.fault(), Some(Cause::StageTimedOut));
    assert!(
        flight
            .log
            .iter()
            .any(|l| l.contains("no absolute position")),
        "{:?}",
        flight.log
    );
    assert!(!flight.sent.iter().any(|(_, m)| arms(m)));
}

#[test]
fn frames_of_others_steer_nothing() {
    use firmware_core::autopilot::wire::Address;
    use mavlink::dialects::common::{
        HEARTBEAT_DATA, LOCAL_POSITION_NED_DATA, MavAutopilot, MavModeFlag, MavState, MavType,
    };
    let mut flight = hovering();
    let before = flight.client.position();
    for from in [
        Address {
            system: 2,
            component: 1,
        },
        Address {
            system: 1,
            component: 2,
        },
        Address {
            system: 255,
            component: 190,
        },
    ] {
        let position = LOCAL_POSITION_NED_DATA {
            x: 900.0,
            time_boot_ms: u32::MAX / 4,
            ..LOCAL_POSITION_NED_DATA::DEFAULT
        };
        let heartbeat = HEARTBEAT_DATA {
            custom_mode: 9,
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            autopilot: MavAutopilot::MAV_AUTOPILOT_GENERIC,
            base_mode: MavModeFlag::empty(),
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        };
        flight
            .client
            .receive(flight.now, from, &MavMessage::LOCAL_POSITION_NED(position));
        flight
            .client
            .receive(flight.now, from, &MavMessage::HEARTBEAT(heartbeat));
    }
    assert_eq!(flight.client.position(), before);
    assert_eq!(flight.client.phase(), Phase::Ready);
    assert!((before.unwrap().position - start()).norm() < 1e-3);
}

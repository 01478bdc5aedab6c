// SPDX-License-Identifier: MIT OR Apache-2.0
//! Tests of the checks with a simulated autopilot.

use std::string::ToString;

use mavlink::dialects::common::{MavMessage, MavParamType, PARAM_VALUE_DATA};

use super::{manager::*, rules::*, *};
use crate::time::{Duration, Instant};
use crate::{
    autopilot::{profile::Firmware, wire::Address},
    limits::MotionLimits,
};

const NEEDS: Needs = Needs { speed_mps: 30.0 };
const TO: Address = Address {
    system: 1,
    component: 1,
};

#[test]
fn a_clipping_parameter_is_named_with_what_it_should_be() {
    let finding = ARDUCOPTER[0].effect.judge("WPNAV_SPEED", 1000.0, &NEEDS);
    assert_eq!(
        finding.unwrap().to_string(),
        "WPNAV_SPEED is 1000: it clips speed; set it to 3500"
    );
    assert_eq!(PX4[0].effect.judge("MPC_XY_VEL_MAX", 35.0, &NEEDS), None);
    let mut limits = MotionLimits::<f64>::ideal();
    ARDUCOPTER[0].effect.clip(1000.0, &mut limits);
    assert_eq!(limits.speed_mps, 9.5);
}

#[test]
fn every_value_and_every_change_can_be_kept() {
    for firmware in [Firmware::ArduCopter, Firmware::Px4] {
        let rules = rules(firmware);
        let clipping = rules.iter().filter(|rule| {
            let needs = NEEDS;
            rule.effect.needed(&needs).is_some()
        });
        assert!(rules.len() <= VALUES && clipping.count() <= CHANGES);
    }
}

/// The parameter to change is the one that leaves the lowest speed.
#[test]
fn the_slowest_parameter_is_named() {
    let mut manager = ParameterManager::default();
    let mut values = std::vec![("WPNAV_SPEED", 1000.0), ("ANGLE_MAX", 3000.0)];
    play(&mut manager, &mut values, false, false, |_| false);
    assert_eq!(manager.slowest(), Some(("WPNAV_SPEED", 3500.0)));
}

/// The values that a mission needs suffice, and just so: a vehicle with these values is not clipped
/// below the mission's speed, and a tenth less of any is reported.
#[test]
fn what_is_needed_does_not_clip() {
    for (firmware, limiting_rules) in [(Firmware::ArduCopter, 9), (Firmware::Px4, 4)] {
        for speed_mps in [3.0, 12.0, 30.0, 55.5] {
            let needs = Needs { speed_mps };
            let mut limits = MotionLimits::<f64>::ideal();
            let mut names = std::vec::Vec::new();
            for rule in rules(firmware) {
                if let Some((needed, _)) = rule.effect.needed(&needs) {
                    names.push(rule.name);
                    assert_eq!(rule.effect.judge(rule.name, needed, &needs), None);
                    let less = rule.effect.judge(rule.name, needed * 0.9, &needs);
                    assert!(less.is_some(), "{} of {}", needed * 0.9, rule.name);
                    rule.effect.clip(needed, &mut limits);
                }
            }
            assert_eq!(names.len(), limiting_rules, "{firmware:?}: {names:?}");
            // From the mission's speed to a fifth above it.
            let mission_mps = f64::from(speed_mps);
            let clipped_mps = mission_mps..mission_mps * 1.2;
            assert!(clipped_mps.contains(&limits.speed_mps), "{limits:?}");
        }
    }
}

/// Answers as an autopilot with these parameters until the manager has no more requests.
fn play(
    manager: &mut ParameterManager,
    values: &mut std::vec::Vec<(&'static str, f32)>,
    may_set: bool,
    restoring: bool,
    lost: impl Fn(u32) -> bool,
) -> (MotionLimits<f64>, std::vec::Vec<std::string::String>) {
    let firmware = Firmware::ArduCopter;
    let (mut limits, mut said) = (MotionLimits::<f64>::ideal(), std::vec::Vec::new());
    let mut now = Instant::ZERO + Duration::from_secs(100);
    for round in 0..2_000 {
        now += Duration::from_millis(100);
        let to = (TO, firmware);
        let report = |finding: Finding| said.push(finding.to_string());
        let message = match restoring {
            true => manager.restore(now, to, report),
            false => manager.request(now, to, &NEEDS, &mut limits, report),
        };
        let name = match &message {
            Some(MavMessage::PARAM_REQUEST_READ(read)) => read.param_id,
            Some(MavMessage::PARAM_SET(set)) => set.param_id,
            _ => continue,
        };
        let known = values
            .iter_mut()
            .find(|(known, _)| name.to_str() == Ok(*known));
        let Some((_, value)) = known else { continue };
        if let Some(MavMessage::PARAM_SET(set)) = message {
            *value = set.param_value;
        }
        let answer = PARAM_VALUE_DATA {
            param_id: name,
            param_value: *value,
            param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
            ..PARAM_VALUE_DATA::DEFAULT
        };
        if !lost(round) {
            let found = match restoring {
                true => manager.take_restored(firmware, &answer),
                false => manager.take(firmware, &answer, &NEEDS, &mut limits, may_set),
            };
            said.extend(found.map(|finding| finding.to_string()));
        }
    }
    (limits, said)
}

#[test]
fn what_clips_is_set_and_restored_even_if_every_second_answer_is_lost() {
    let found = std::vec![
        ("WPNAV_SPEED", 1000.0),
        ("WPNAV_ACCEL", 250.0),
        ("ANGLE_MAX", 3000.0),
        ("PSC_ANGLE_MAX", 0.0),
        ("PSC_JERK_XY", 5.0),
        ("FS_GCS_ENABLE", 1.0),
        ("FS_GCS_TIMEOUT", 5.0),
        ("SYSID_MYGCS", 255.0),
        ("GUID_TIMEOUT", 3.0),
        ("FENCE_ENABLE", 0.0),
        ("FENCE_TYPE", 7.0),
        ("FENCE_RADIUS", 300.0),
        ("FENCE_ALT_MAX", 100.0),
    ];
    let (mut values, mut manager) = (found.clone(), ParameterManager::default());
    let (limits, said) = play(&mut manager, &mut values, true, false, |n| n / 6 % 2 == 0);
    assert!(manager.is_done(Firmware::ArduCopter));
    assert_eq!(
        said,
        [
            "WPNAV_SPEED set from 1000 to 3500",
            "WPNAV_ACCEL set from 250 to 1000",
            "ANGLE_MAX set from 3000 to 4500",
            "PSC_JERK_XY set from 5 to 20"
        ]
    );
    assert!(limits.speed_mps > 30.0);
    assert_eq!(manager.value("FENCE_RADIUS"), Some(300.0));
    assert_eq!(values[..3].iter().map(|v| v.1).sum::<f32>(), 9000.0);
    let (_, said) = play(&mut manager, &mut values, true, true, |n| n / 6 % 2 == 0);
    assert_eq!(values, found);
    assert!(manager.is_restored() && said.len() == 4, "{said:?}");
}

/// A refused change is not repeated without end; a parameter that cannot be restored is reported with
/// its original value.
#[test]
fn what_cannot_be_set_or_restored_is_reported() {
    let mut values = std::vec![("WPNAV_SPEED", 1000.0)];
    let mut manager = ParameterManager::default();
    let (limits, said) = play(&mut manager, &mut values, true, false, |n| n > 0);
    assert_eq!(limits.speed_mps, 9.5);
    assert_eq!(
        said[0],
        "WPNAV_SPEED is 1000: it clips speed; set it to 3500"
    );
    let (_, said) = play(&mut manager, &mut values, true, true, |_| true);
    assert_eq!(
        said,
        ["WPNAV_SPEED was NOT restored; its former value is 1000"]
    );
}

#[test]
fn a_renamed_parameter_is_asked_for_only_where_the_old_one_is_missing() {
    for old_exists in [true, false] {
        let mut manager = ParameterManager::default();
        let mut asked = std::vec::Vec::new();
        let mut now = Instant::ZERO;
        let mut limits = MotionLimits::<f64>::ideal();
        while !manager.is_done(Firmware::ArduCopter) {
            let to = (TO, Firmware::ArduCopter);
            let request = manager.request(now, to, &NEEDS, &mut limits, |_| {});
            if let Some(MavMessage::PARAM_REQUEST_READ(request)) = request {
                let name = request.param_id.to_str().unwrap().to_string();
                let newer = name.starts_with("WP_")
                    || ["ATC_ANGLE_MAX", "PSC_JERK_NE", "MAV_GCS_SYSID"].contains(&name.as_str());
                let older = name.starts_with("WPNAV_")
                    || ["ANGLE_MAX", "PSC_JERK_XY", "SYSID_MYGCS"].contains(&name.as_str());
                let exists = !(newer && old_exists || older && !old_exists);
                let answer = PARAM_VALUE_DATA {
                    param_id: request.param_id,
                    param_value: 1.0,
                    ..PARAM_VALUE_DATA::DEFAULT
                };
                asked.push(name);
                if exists {
                    manager.take(to.1, &answer, &NEEDS, &mut limits, false);
                }
            }
            now += Duration::from_millis(100);
        }
        for newer in [
            "WP_SPD",
            "WP_ACC",
            "ATC_ANGLE_MAX",
            "PSC_JERK_NE",
            "MAV_GCS_SYSID",
        ] {
            let asks = asked.iter().any(|name| name == newer);
            assert_eq!(asks, !old_exists, "{newer}: {asked:?}");
        }
        assert_eq!(asked.iter().filter(|n| *n == "GUID_TIMEOUT").count(), 1);
    }
}

//! What an autopilot does if this process ends unexpectedly in flight.

use firmware_core::autopilot::profile::Firmware;

/// Returns what happens if this process ends unexpectedly in flight, according to the autopilot's parameters,
/// with and without a ground station. `own_system` is the system id of our heartbeats.
pub fn loss_of_client(
    firmware: Firmware,
    own_system: u8,
    parameter: impl Fn(&str) -> Option<f32>,
) -> Vec<String> {
    match firmware {
        Firmware::Generic => {
            vec![
                "if this process ends unexpectedly: the built-in vehicle stops after 3 s and \
                  hovers"
                    .into(),
            ]
        }
        Firmware::ArduCopter => {
            let timeout_s = parameter("GUID_TIMEOUT").unwrap_or(3.0);
            vec![
                format!(
                    "if this process ends unexpectedly: the vehicle continues with its last velocity for \
                     {timeout_s} s (GUID_TIMEOUT), then brakes, flies back some distance and hovers \
                     in GUIDED (distances: docs/failsafes.md)"
                ),
                arducopter_ground_failsafe(own_system, parameter),
            ]
        }
        Firmware::Px4 => {
            let loss_s = parameter("COM_OF_LOSS_T").unwrap_or(1.0);
            let action = match parameter("COM_OBL_RC_ACT").map(|value| value as i32) {
                Some(0) => {
                    "0, position mode: without a pilot the vehicle does not brake, and it descends"
                }
                Some(1) => "1, altitude mode",
                Some(2) => "2, manual flight",
                Some(3) => "3, return",
                Some(4) => "4, land",
                Some(5) => "5, hold",
                _ => "another action",
            };
            let ground = match parameter("NAV_DLL_ACT").map(|value| value as i32) {
                None | Some(0) => "NAV_DLL_ACT is 0: the loss or absence of a ground station has \
                                   no effect"
                    .into(),
                Some(value) => format!(
                    "NAV_DLL_ACT is {value} (1 hold, 2 return, 3 land): it acts {} s after the \
                     last heartbeat of an additional ground station (COM_DL_LOSS_T), but not when \
                     this process ends, because heartbeats of an onboard computer do not count",
                    parameter("COM_DL_LOSS_T").unwrap_or(10.0)
                ),
            };
            vec![
                format!(
                    "if this process ends unexpectedly: after {loss_s} s (COM_OF_LOSS_T) the \
                     autopilot executes COM_OBL_RC_ACT: {action} (distances: docs/failsafes.md)"
                ),
                ground,
            ]
        }
    }
}

/// Describes ArduCopter's ground failsafe. ArduCopter counts the heartbeats of one system id only.
fn arducopter_ground_failsafe(own_system: u8, parameter: impl Fn(&str) -> Option<f32>) -> String {
    let action = match parameter("FS_GCS_ENABLE").map(|value| value as i32) {
        None => return "FS_GCS_ENABLE could not be read".into(),
        Some(0) => {
            return "FS_GCS_ENABLE is 0: the vehicle keeps hovering, with or without an additional \
                    ground station, until a pilot takes over or the battery failsafe acts"
                .into();
        }
        Some(1) => "1 (return)",
        Some(3) => "3 (SmartRTL, or return)",
        Some(4) => "4 (SmartRTL, or land)",
        Some(5) => "5 (land)",
        Some(7) => "7 (brake, or land)",
        Some(_) => "not 0",
    };
    let timeout_s = parameter("FS_GCS_TIMEOUT").unwrap_or(5.0);
    let ground = parameter("SYSID_MYGCS").or_else(|| parameter("MAV_GCS_SYSID"));
    let ground = ground.unwrap_or(255.0);
    if ground == f32::from(own_system) {
        format!(
            "FS_GCS_ENABLE is {action}: the autopilot acts {timeout_s} s after this process ended, \
             because it counts the heartbeats of this program (system {own_system}); with an \
             additional ground station of the same system id it does not act, and the vehicle \
             keeps hovering"
        )
    } else {
        format!(
            "FS_GCS_ENABLE is {action}: the autopilot acts {timeout_s} s after the last heartbeat of \
             the ground station with system id {ground}, and never without one; heartbeats of this \
             program (system {own_system}) do not count, so if only this process ends the vehicle \
             keeps hovering"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The text says for each autopilot which heartbeats keep its failsafe from acting, and which
    /// do not.
    #[test]
    fn the_effect_of_a_lost_client_is_described_from_the_parameters() {
        let with = |all: &'static [(&str, f32)]| {
            move |name: &str| all.iter().find(|(known, _)| *known == name).map(|p| p.1)
        };
        let arducopter = |own, all| loss_of_client(Firmware::ArduCopter, own, with(all)).join("\n");
        let off = arducopter(1, &[("FS_GCS_ENABLE", 0.0), ("GUID_TIMEOUT", 2.5)]);
        assert!(off.contains("for 2.5 s (GUID_TIMEOUT)"), "{off}");
        assert!(off.contains("with or without an additional ground station"));
        const ON: &[(&str, f32)] = &[("FS_GCS_ENABLE", 1.0), ("SYSID_MYGCS", 255.0)];
        let beside = arducopter(1, ON);
        assert!(beside.contains("(system 1) do not count"), "{beside}");
        let counted = arducopter(255, ON);
        assert!(
            counted.contains("5 s after this process ended"),
            "{counted}"
        );
        const NEWER: &[(&str, f32)] = &[("FS_GCS_ENABLE", 5.0), ("MAV_GCS_SYSID", 254.0)];
        let newer = arducopter(254, NEWER);
        assert!(newer.contains("5 (land)"), "{newer}");
        const PX4: &[(&str, f32)] = &[("COM_OBL_RC_ACT", 4.0), ("NAV_DLL_ACT", 2.0)];
        let px4 = loss_of_client(Firmware::Px4, 1, with(PX4)).join("\n");
        assert!(px4.contains("COM_OBL_RC_ACT: 4, land"), "{px4}");
        assert!(
            px4.contains("heartbeats of an onboard computer do not count"),
            "{px4}"
        );
    }
}

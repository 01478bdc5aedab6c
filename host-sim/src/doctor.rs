//! Examines an autopilot without moving the vehicle: whether a mission would fly, and how well.
//!
//! The client connects and checks as it does before every flight and is never told to launch: it
//! only requests telemetry and reads parameters.

use std::fmt;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};

use firmware_core::USERS_MAX;
use firmware_core::autopilot::preflight::Preflight;
use firmware_core::autopilot::profile::Firmware;
use firmware_core::autopilot::{Autopilot, Event, Finding, Phase, advice};
use firmware_core::policy::Policy;
use firmware_core::time::Duration;

use crate::flight::{self, CONNECT_PATIENCE, FlightSettings, Pace, Peer, ProfileChoice};
use crate::session::Session;
use environment::Allocation;
use scenario::{Events, Scenario};
use vehicle::{Profile, Vehicle, VehicleSettings};

/// The result of an examination.
#[derive(Clone, Debug, Default)]
pub struct Diagnosis {
    /// The system id and the software; `None` if no autopilot was received.
    pub vehicle: Option<(u8, Firmware)>,
    /// The problems that would prevent a mission.
    pub stops: Vec<String>,
    /// The problems that would slow a mission down, and the parameter to set.
    pub slows: Vec<String>,
    /// The predicted end of the mission, if it can be predicted.
    pub outcome: Option<Prediction>,
    /// Further information.
    pub notes: Vec<String>,
    /// The messages of the autopilot during the examination.
    pub said: Vec<String>,
}

impl Diagnosis {
    /// Returns whether nothing prevents a mission.
    pub fn is_ready(&self) -> bool {
        self.vehicle.is_some() && self.stops.is_empty()
    }

    fn note(&mut self, event: &Event) {
        match event {
            Event::Connected { system, firmware } => self.vehicle = Some((*system, *firmware)),
            Event::Finding(finding) => {
                let words = finding.to_string();
                match finding {
                    Finding::Clips { .. } => self.slows.push(words),
                    _ => self.notes.push(words),
                }
            }
            Event::Text { text, .. } => self.said.push(text.to_string()),
            Event::Failed { .. } => self.notes.push(event.to_string()),
            _ => {}
        }
    }
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.vehicle {
            Some((system, firmware)) => {
                writeln!(f, "connected: {}, system {system}", firmware.name())?;
            }
            None => writeln!(f, "no autopilot: no heartbeat was received")?,
        }
        if let Some(outcome) = &self.outcome {
            writeln!(f, "outcome: {outcome}")?;
        }
        for (what, all) in [
            ("stops a mission", &self.stops),
            ("slows a mission", &self.slows),
            ("note", &self.notes),
            ("autopilot message", &self.said),
        ] {
            for words in all {
                writeln!(f, "{what}: {words}")?;
            }
        }
        let verdict = if self.is_ready() {
            "a mission would fly"
        } else {
            "a mission would not start"
        };
        write!(f, "{verdict}")
    }
}

/// Connects and checks, for at most `patience`, until every check passes or `stop` is set, and
/// reports meanwhile what it waits for. Without any heartbeat the limit is [`CONNECT_PATIENCE`].
pub fn examine(
    session: &mut Session,
    client: &mut Autopilot<f64>,
    patience: Duration,
    stop: &AtomicBool,
    mut say: impl FnMut(&Event),
) -> io::Result<Diagnosis> {
    let mut diagnosis = Diagnosis::default();
    let begin = session.now();
    loop {
        let waited = session.now() - begin;
        let unheard = client.phase() == Phase::Connecting && waited >= CONNECT_PATIENCE;
        let wrong = session.wrong_profile().is_some();
        let over = unheard || wrong || waited >= patience || stop.load(Ordering::Relaxed);
        if over || client.phase() == Phase::Standby {
            break;
        }
        session.turn(client, |_, _, _| {})?;
        while let Some(event) = client.take_next_event() {
            say(&event);
            diagnosis.note(&event);
        }
    }
    if let Some(wrong) = session.wrong_profile() {
        diagnosis.stops.push(wrong.to_string());
    }
    for refusal in client.refusals(session.now()) {
        diagnosis.stops.push(refusal.to_string());
    }
    if client.parameters_are_read()
        && let Some((_, firmware)) = client.vehicle()
    {
        let own = client.own().system;
        let words = loss_of_client(firmware, own, |name| client.parameter(name));
        diagnosis.notes.extend(words);
    }
    if client.phase() != Phase::Standby && diagnosis.vehicle.is_some() && diagnosis.stops.is_empty()
    {
        let words = client.obstacle().map(|obstacle| obstacle.to_string());
        let words = words.unwrap_or_else(|| "the checks were not completed in time".into());
        diagnosis.stops.push(words);
    }
    Ok(diagnosis)
}

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

/// The predicted end of a mission with the examined autopilot.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// The speed that the limits and parameters allow, m/s.
    pub possible_mps: f64,
    /// The speed that the straight path to the destination needs, m/s.
    pub needed_mps: f64,
    /// The sum rate of the ideal flight, bit/s/Hz.
    pub ideal: f64,
    /// The simulated flight; `None` if it would not start.
    pub flight: Option<PredictedFlight>,
}

/// A simulated flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictedFlight {
    /// Whether the vehicle arrives.
    pub arrives: bool,
    /// The distance from the end of the flight to the destination, m.
    pub distance_m: f64,
    /// The sum rate, bit/s/Hz.
    pub total: f64,
}

impl fmt::Display for Prediction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the vehicle can fly {:.1} m/s and needs {:.1} m/s to arrive; ",
            self.possible_mps, self.needed_mps
        )?;
        match self.flight {
            None => f.write_str("the mission would not start"),
            Some(flight) if flight.arrives => write!(
                f,
                "it would arrive with a sum rate of {:.1} bit/s/Hz ({:.0} % of {:.1} in an ideal \
                 flight), if the airframe reaches the speed that its parameters allow",
                flight.total,
                100.0 * flight.total / self.ideal,
                self.ideal
            ),
            Some(flight) => write!(
                f,
                "it would not arrive: it would end {:.0} m from the destination",
                flight.distance_m
            ),
        }
    }
}

/// Flies the mission twice with the built-in vehicle: once with the behaviour and the parameters of
/// the examined autopilot, and once with the ideal profile. The policy of each flight is given.
/// Returns `None` until the parameters have been read.
pub fn predict<P: Policy<f64, USERS_MAX>>(
    scenario: &Scenario,
    [policy, ideal_policy]: [P; 2],
    client: &Autopilot<f64>,
    starts: bool,
) -> Option<Prediction> {
    let (_, firmware) = client.vehicle().filter(|_| client.parameters_are_read())?;
    let fly = |policy: P, profile: Profile, parameters: Vec<(String, f32)>| {
        let settings = FlightSettings {
            policy: String::new(),
            inner: Allocation::Exact,
            profile,
            pace: Pace::Max,
            seed: 1,
            symbols_per_slot: 1,
            events: Events::default(),
        };
        let vehicle = VehicleSettings {
            parameters,
            ready_after: Duration::from_secs(1),
            ..flight::vehicle_settings(scenario, profile)
        };
        let peer = Peer::built_in(Vehicle::new(vehicle));
        // A flight that was aborted on the way has not arrived either.
        let (record, ended) = match flight::fly(scenario, policy, &settings, peer, &mut ()) {
            Ok(record) => (record, true),
            Err(failed) => (*failed.record?, false),
        };
        let summary = (!record.slots.is_empty()).then(|| record.summary())?;
        Some(PredictedFlight {
            arrives: ended && summary.arrived,
            distance_m: summary.arrival_distance_m,
            total: summary.sum_rate,
        })
    };
    let ideal = fly(ideal_policy, Profile::Ideal, Vec::new())?;
    let read = client
        .parameters()
        .map(|(name, value)| (name.to_owned(), value));
    let flown = starts.then(|| fly(policy, ProfileChoice::of(firmware), read.collect()));
    let mission = scenario.mission.parameters();
    Some(Prediction {
        possible_mps: client.limits().speed_mps.min(mission.max_speed_mps),
        needed_mps: Preflight::of(mission).needed_speed_mps.unwrap_or_default(),
        ideal: ideal.total,
        flight: flown.flatten(),
    })
}

/// Returns the parameters that are read before a mission of this speed, as a table in Markdown:
/// their defaults, the values that the mission needs, and the effect of lower values.
/// `docs/sitl.md` contains it.
pub fn parameter_table(speed_mps: f32) -> String {
    let mut table = format!(
        "| autopilot | parameter | default | for {speed_mps} m/s | unit | otherwise |\n\
         |---|---|---|---|---|---|\n"
    );
    for profile in [Profile::ArduCopter, Profile::Px4] {
        let firmware = profile.firmware();
        for parameter in advice(firmware, speed_mps) {
            let Some((needed, clips)) = parameter.needed else {
                continue;
            };
            let newer = parameter.instead_of.map_or(String::new(), |old| {
                format!(" (newer versions, for `{old}`)")
            });
            let default = profile
                .parameter(parameter.name)
                .map_or("–".into(), |value| match value {
                    0.0 => "0 (none)".into(),
                    _ => value.to_string(),
                });
            let unit = match (clips, parameter.unit) {
                ("speed", Some(100.0)) => "cm/s",
                ("speed", _) => "m/s",
                ("acceleration", Some(100.0)) => "cm/s²",
                ("acceleration", _) => "m/s²",
                ("jerk", _) => "m/s³",
                (_, Some(100.0)) => "0.01°",
                _ => "°",
            };
            table += &format!(
                "| {} | `{}`{newer} | {default} | {needed} | {unit} | clips {clips} |\n",
                firmware.name(),
                parameter.name,
            );
        }
    }
    table
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

    /// The documentation must tell users to set the parameters that the client asks for.
    #[test]
    fn docs_print_the_table() {
        let page = include_str!("../../docs/sitl.md");
        let table = parameter_table(30.0);
        assert!(page.contains(&table), "docs/sitl.md needs:\n{table}");
        for firmware in [Firmware::ArduCopter, Firmware::Px4] {
            for words in advice(firmware, 30.0).filter_map(|parameter| parameter.words) {
                assert!(page.contains(words), "docs/sitl.md needs: {words}");
            }
        }
    }
}

//! Examines an autopilot without moving the vehicle: whether a mission would fly, and how well.
//!
//! The client connects and checks as it does before every flight and is never told to launch: it
//! only requests telemetry and reads parameters.

mod lost_client;
mod prediction;

use std::{
    fmt, io,
    sync::atomic::{AtomicBool, Ordering},
};

use firmware_core::{
    autopilot::{Autopilot, Event, Finding, Phase, advice, profile::Firmware},
    time::Duration,
};
use vehicle::Profile;

use crate::{flight::CONNECT_PATIENCE, session::Session};

pub use lost_client::loss_of_client;
pub use prediction::{PredictedFlight, Prediction, predict};

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

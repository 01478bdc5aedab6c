//! A look at an autopilot that moves nothing: would a mission fly, and how well?
//!
//! The client connects and checks as it does before every flight, and is never told to launch:
//! it asks for telemetry and reads parameters, nothing else.

use std::fmt;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};

use firmware_core::autopilot::profile::Firmware;
use firmware_core::autopilot::{Autopilot, Event, Finding, Phase, advice};
use firmware_core::time::Duration;

use crate::flight::CONNECT_PATIENCE;
use crate::link::Session;
use crate::vehicle::Profile;

/// What was found.
#[derive(Clone, Debug, Default)]
pub struct Diagnosis {
    /// System id and software; `None` if nobody was heard.
    pub vehicle: Option<(u8, Firmware)>,
    /// What would stop a mission.
    pub stops: Vec<String>,
    /// What would slow it, and which parameter to set.
    pub slows: Vec<String>,
    /// What is good to know.
    pub notes: Vec<String>,
    /// What the autopilot said meanwhile.
    pub said: Vec<String>,
}

impl Diagnosis {
    /// Nothing stops a mission.
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
            None => writeln!(f, "nobody answers: no autopilot's heartbeat was heard")?,
        }
        for (what, all) in [
            ("stops a mission", &self.stops),
            ("slows a mission", &self.slows),
            ("to know", &self.notes),
            ("autopilot says", &self.said),
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

/// Connects and checks, for at most `patience`, until everything passes or `stop` is set; says
/// meanwhile what it waits for. Without any heartbeat [`CONNECT_PATIENCE`] is the limit.
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
        let deaf = client.phase() == Phase::Connecting && waited >= CONNECT_PATIENCE;
        let over = deaf || waited >= patience || stop.load(Ordering::Relaxed);
        if over || client.phase() == Phase::Standby {
            break;
        }
        session.turn(client, |_, _, _| {})?;
        while let Some(event) = client.take_next_event() {
            say(&event);
            diagnosis.note(&event);
        }
    }
    if client.phase() != Phase::Standby && diagnosis.vehicle.is_some() {
        let words = client.obstacle().map(|obstacle| obstacle.to_string());
        let words = words.unwrap_or_else(|| "the checks did not end".into());
        diagnosis.stops.push(words);
    }
    Ok(diagnosis)
}

/// The parameters that are read before a mission of this speed, as a table in Markdown: what they
/// are by default, what the mission needs, and what less would do. `docs/sitl.md` prints it.
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
                .map_or("–".into(), |value| value.to_string());
            let unit = match (clips, parameter.unit) {
                ("speed", Some(100.0)) => "cm/s",
                ("speed", _) => "m/s",
                ("acceleration", Some(100.0)) => "cm/s²",
                ("acceleration", _) => "m/s²",
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

    /// One source of truth: what the page tells people to set is what the client asks for.
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

//! A look at an autopilot that moves nothing: would a mission fly, and how well?
//!
//! The client connects and checks as it does before every flight, and is never told to launch:
//! it asks for telemetry and reads parameters, nothing else.

use std::fmt;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};

use firmware_core::autopilot::profile::Firmware;
use firmware_core::autopilot::{Autopilot, Event, Finding, Phase};
use firmware_core::time::{Duration, Instant};

use crate::link::Session;

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
                    Finding::Note(_) | Finding::Unread(_) => self.notes.push(words),
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

/// Connects and checks, for at most `patience`, until everything passes or `stop` is set.
pub fn examine(
    session: &mut Session,
    client: &mut Autopilot<f64>,
    patience: Duration,
    stop: &AtomicBool,
) -> io::Result<Diagnosis> {
    let mut diagnosis = Diagnosis::default();
    let begin = session.now();
    let waits = |now: Instant| now - begin < patience && !stop.load(Ordering::Relaxed);
    while waits(session.now()) && client.phase() != Phase::Standby {
        session.turn(client, |_, _, _| {})?;
        while let Some(event) = client.take_next_event() {
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

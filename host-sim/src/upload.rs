//! Uploads a whole mission to an autopilot over a link.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};

use firmware_core::Position;
use firmware_core::autopilot::failsafe::Cause;
use firmware_core::autopilot::frames::MapFrame;
use firmware_core::autopilot::mission::{
    Ending, Left, MissionPlan, MissionUpload, PlanError, SPACE_PATIENCE, UploadError,
};
use firmware_core::autopilot::preflight::PreflightRefusal;
use firmware_core::autopilot::{Autopilot, Event, Finding, Obstacle, Phase};
use firmware_core::time::{Duration, Instant};
use thiserror::Error;

use crate::flight::{CONNECT_PATIENCE, WrongProfile, is_notable};
use crate::session::Session;
use crate::watch::{Seen, WatchError, watch};
use link::NoHeartbeat;

/// A mission to upload and what to do with it.
#[derive(Clone, Debug)]
pub struct Upload<'a> {
    /// The waypoints in order, m.
    pub waypoints: &'a [Position<f64>],
    /// The speed along them, m/s.
    pub speed_mps: f64,
    /// The action after the last waypoint.
    pub ending: Ending,
    /// Whether to fly the mission as soon as it is uploaded.
    pub start: bool,
    /// Whether to follow the mission to its end and restore the parameters then.
    pub watch: bool,
    /// The longest time to wait for an autopilot, and, if the mission is started, for the autopilot
    /// to be ready.
    pub patience: Duration,
}

/// An event of an upload, to be displayed.
#[derive(Clone, Debug, PartialEq)]
pub enum UploadProgress {
    /// The autopilot has requested this number of items.
    Items {
        /// The number of requested items.
        done: u16,
        /// The number of items in the mission.
        count: u16,
    },
    /// A message for the user.
    Note(String),
}

/// The reason why an upload failed.
#[derive(Debug, Error)]
pub enum FailedUpload {
    /// The link failed.
    #[error("link: {0}")]
    Link(#[from] io::Error),
    /// No autopilot was received.
    #[error("{0}")]
    NoHeartbeat(NoHeartbeat),
    /// The specified profile is for another autopilot.
    #[error("{0}")]
    WrongProfile(WrongProfile),
    /// The autopilot answers but is not ready to start a mission.
    #[error("the autopilot is not ready: {0}")]
    NotReady(String),
    /// The mission cannot be uploaded.
    #[error("{0}")]
    Plan(#[from] PlanError),
    /// The transfer failed.
    #[error("{error}; {}", remaining_mission(*.left))]
    Transfer {
        /// The reason.
        error: UploadError,
        /// The mission that is stored in the autopilot now.
        left: Left,
    },
    /// The mission was started but not followed to its end.
    #[error("{0}")]
    Watch(#[from] WatchError),
}

fn remaining_mission(left: Left) -> &'static str {
    match left {
        Left::Old => "the autopilot keeps its former mission",
        Left::Nothing => "the received items were cleared: the autopilot has no mission",
        Left::Whole => "the autopilot has the complete mission",
        Left::Unknown => "the mission in the autopilot is NOT known: check it before you fly",
    }
}

/// The acceleration with which autopilots fly the legs of a mission, m/s^2: ArduCopter's default.
const MISSION_ACCELERATION_MPS2: f64 = 2.5;

/// Returns a warning if the legs of a mission are too short for its speed: an autopilot slows down
/// at each waypoint, and from rest to rest over a leg of length `L` with acceleration `a` it
/// reaches at most `sqrt(a L)`. (ArduCopter was observed to reach 8 m/s over 25 m, and 4.6 m/s over
/// 20 m.)
pub fn short_legs(waypoints: &[Position<f64>], speed_mps: f64) -> Option<String> {
    let mut legs_m: Vec<f64> = waypoints
        .windows(2)
        .map(|pair| (pair[1] - pair[0]).norm())
        .filter(|&leg_m| leg_m > 0.5)
        .collect();
    legs_m.sort_by(f64::total_cmp);
    let leg_m = *legs_m.get(legs_m.len() / 2)?;
    let reached_mps = (MISSION_ACCELERATION_MPS2 * leg_m).sqrt();
    (reached_mps < 0.9 * speed_mps).then(|| {
        format!(
            "half of the legs are shorter than {leg_m:.0} m: an autopilot slows down at each \
             waypoint and reaches {reached_mps:.0} m/s at most on such legs, not {speed_mps:.0}; \
             host-sim run flies them at the mission's speed"
        )
    })
}

/// The longest time that restoring the parameters may take after a failed upload.
const RESTORE_PATIENCE: Duration = Duration::from_secs(30);

/// The parameters that were set for the mission: the name and the former value.
type Changed = Vec<(&'static str, f32)>;

/// Reports the events of the client, and records which parameters it set.
fn take_events(
    client: &mut Autopilot<f64>,
    changed: &mut Changed,
    progress: &mut impl FnMut(UploadProgress),
) {
    while let Some(event) = client.take_next_event() {
        match &event {
            Event::Finding(Finding::Set { name, from, .. }) => changed.push((name, *from)),
            Event::Finding(Finding::Restored { name, .. }) => {
                changed.retain(|(known, _)| known != name);
            }
            Event::Finding(left @ Finding::NotRestored { .. }) => {
                progress(UploadProgress::Note(format!("{left}; set it manually")));
                continue;
            }
            // These phases belong to a flight by setpoints, which an upload is not, and the client
            // is stopped when parameters are restored.
            Event::Phase(_)
            | Event::Waiting(Obstacle::AlreadyArmed)
            | Event::Failsafe {
                cause: Cause::StopAsked,
                ..
            } => continue,
            _ if !is_notable(&event) => continue,
            _ => {}
        }
        progress(UploadProgress::Note(event.to_string()));
    }
}

/// Returns the reason why the mission must not be started. An uploaded mission has no slots: a
/// vehicle that is slower than the mission's speed only arrives later.
fn refusal(client: &Autopilot<f64>, now: Instant) -> Option<PreflightRefusal> {
    client
        .refusals(now)
        .into_iter()
        .find(|refusal| !matches!(refusal, PreflightRefusal::TooSlow { .. }))
}

impl Upload<'_> {
    /// Connects, transfers the mission, reads it back, compares it, and starts it if requested.
    /// Returns the number of items. If `stop` is set, the transfer is cancelled and the mission is
    /// cleared.
    ///
    /// If the client's settings include parameters, they are set before the transfer. After a
    /// successful transfer they stay set, because the mission is flown after this function has
    /// returned, and a note reports the former values. After a failure, and after a flight that was
    /// followed until the motors stopped, they are restored.
    ///
    /// # Errors
    /// Returns an error if no autopilot answers, if it is not ready to start or does not accept the
    /// mission, or if the flight was not followed to its end.
    pub fn run(
        &self,
        session: &mut Session,
        client: &mut Autopilot<f64>,
        stop: &AtomicBool,
        mut progress: impl FnMut(UploadProgress),
    ) -> Result<u16, FailedUpload> {
        let mut changed = Changed::new();
        let outcome = self.connect_and_transfer(session, client, stop, &mut changed, &mut progress);
        take_events(client, &mut changed, &mut progress);
        if let Ok(items) = outcome
            && self.watch
        {
            let followed = watch(session, client, items, stop, |seen| {
                progress(match seen {
                    Seen::Item(done) => UploadProgress::Items { done, count: items },
                    Seen::Event(words) => UploadProgress::Note(words),
                });
            });
            if client.is_armed() {
                report_former_values(&changed, &mut progress);
            } else {
                restore_parameters(session, client, &mut changed, &mut progress)?;
            }
            return Ok(followed.map(|()| items)?);
        }
        match &outcome {
            Ok(_) => report_former_values(&changed, &mut progress),
            Err(_) => restore_parameters(session, client, &mut changed, &mut progress)?,
        }
        outcome
    }

    /// Returns whether the client has received everything that is needed before a transfer.
    fn is_prepared(&self, client: &Autopilot<f64>, now: Instant) -> bool {
        let refused = refusal(client, now).is_some();
        let ready = !self.start || client.phase() == Phase::Standby || refused;
        let settled = !client.settings().set_parameters || client.parameters_are_read();
        client.vehicle().is_some() && ready && settled
    }

    fn connect_and_transfer(
        &self,
        session: &mut Session,
        client: &mut Autopilot<f64>,
        stop: &AtomicBool,
        changed: &mut Changed,
        progress: &mut impl FnMut(UploadProgress),
    ) -> Result<u16, FailedUpload> {
        let begin = session.now();
        while !self.is_prepared(client, session.now()) {
            session.turn(client, |_, _, _| {})?;
            take_events(client, changed, progress);
            if let Some(wrong) = session.wrong_profile() {
                return Err(FailedUpload::WrongProfile(wrong));
            }
            let waited = session.now() - begin;
            let unheard = client.vehicle().is_none() && waited >= CONNECT_PATIENCE;
            if unheard || waited >= self.patience || stop.load(Ordering::Relaxed) {
                let obstacle = client.obstacle().map(|obstacle| obstacle.to_string());
                return Err(match (client.vehicle(), obstacle) {
                    (None, _) => FailedUpload::NoHeartbeat(session.silence(begin)),
                    (_, Some(words)) => FailedUpload::NotReady(words),
                    (_, None) => {
                        FailedUpload::NotReady("its checks were not completed in time".into())
                    }
                });
            }
        }
        if let Some(wrong) = session.wrong_profile() {
            return Err(FailedUpload::WrongProfile(wrong));
        }
        if let Some(refusal) = refusal(client, session.now())
            && self.start
        {
            return Err(FailedUpload::NotReady(refusal.to_string()));
        }
        if let Some(words) = short_legs(self.waypoints, self.speed_mps) {
            progress(UploadProgress::Note(words));
        }
        let settings = *client.settings();
        let Some((to, firmware)) = client.vehicle() else {
            return Err(FailedUpload::NotReady(
                "the autopilot is not connected".into(),
            ));
        };
        let plan = MissionPlan {
            firmware,
            map: MapFrame::new(settings.map_origin),
            waypoints: self.waypoints,
            altitude_m: settings.altitude_m,
            speed_mps: self.speed_mps,
            ending: self.ending,
        };
        let mut upload = MissionUpload::new(plan, to, client.own(), self.start)?;
        let mut said = false;
        loop {
            while let Some(message) = upload.poll(session.now()) {
                session.send(&message)?;
            }
            session.turn(client, |now, from, message| {
                upload.receive(now, from, message)
            })?;
            take_events(client, changed, progress);
            if stop.load(Ordering::Relaxed) {
                upload.cancel(session.now());
            }
            if upload.waits_for_space() && !said {
                said = true;
                progress(UploadProgress::Note(format!(
                    "the autopilot reports no space for a mission; the upload is repeated for {} s, \
                     because ArduCopter reports this in the first seconds after it has booted",
                    SPACE_PATIENCE.as_secs_f64()
                )));
            }
            let (done, count) = upload.progress();
            progress(UploadProgress::Items { done, count });
            match upload.outcome() {
                // The last message of a read-back may still be due.
                Some(outcome) => {
                    while let Some(message) = upload.poll(session.now()) {
                        session.send(&message)?;
                    }
                    return outcome
                        .map(|()| count)
                        .map_err(|(error, left)| FailedUpload::Transfer { error, left });
                }
                None => continue,
            }
        }
    }
}

/// Reports the former values of the parameters that stay set for the mission.
fn report_former_values(changed: &Changed, progress: &mut impl FnMut(UploadProgress)) {
    if changed.is_empty() {
        return;
    }
    let old: Vec<String> = changed
        .iter()
        .map(|(name, from)| format!("{name} {from}"))
        .collect();
    progress(UploadProgress::Note(format!(
        "the parameters stay set because the mission needs them; their former values: {}",
        old.join(", ")
    )));
}

/// Restores the parameters that were set, after a failure or after a flight that was followed to
/// its end.
fn restore_parameters(
    session: &mut Session,
    client: &mut Autopilot<f64>,
    changed: &mut Changed,
    progress: &mut impl FnMut(UploadProgress),
) -> io::Result<()> {
    let begin = session.now();
    client.stop(begin);
    while !client.is_restored() {
        session.turn(client, |_, _, _| {})?;
        if session.now() - begin > RESTORE_PATIENCE {
            client.abandon_parameters();
        }
        take_events(client, changed, progress);
    }
    take_events(client, changed, progress);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ArduCopter flew legs of 25 m at 8 m/s and legs of 300 m at nearly 30 m/s.
    #[test]
    fn short_legs_are_named_with_their_length() {
        let legs = |length_m: f64| -> Vec<Position<f64>> {
            (0..20)
                .map(|n| Position::new(f64::from(n) * length_m, 0.0))
                .collect()
        };
        let words = short_legs(&legs(25.0), 30.0).expect("too short");
        assert!(
            words.contains("25 m") && words.contains("reaches 8 m/s at most"),
            "{words}"
        );
        assert_eq!(short_legs(&legs(300.0), 30.0), None);
        assert_eq!(short_legs(&legs(25.0), 8.0), None);
        assert_eq!(short_legs(&legs(25.0)[..1], 30.0), None);
    }
}

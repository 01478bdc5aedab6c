//! Hands a whole mission to an autopilot over a link.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};

use firmware_core::Position;
use firmware_core::autopilot::Autopilot;
use firmware_core::autopilot::frames::MapFrame;
use firmware_core::autopilot::mission::{
    Ending, Left, MissionPlan, MissionUpload, PlanError, UploadError,
};
use firmware_core::time::Duration;
use thiserror::Error;

use crate::flight::CONNECT_PATIENCE;
use crate::link::{Session, Silence};

/// What is handed over.
#[derive(Clone, Debug)]
pub struct Upload<'a> {
    /// Way-points in their order, m.
    pub waypoints: &'a [Position<f64>],
    /// Speed along them, m/s.
    pub speed_mps: f64,
    /// What follows the last.
    pub ending: Ending,
    /// Fly it as soon as it is there.
    pub start: bool,
    /// How long to wait for an autopilot, and for it to be ready where the mission is started.
    pub patience: Duration,
}

/// Why it failed.
#[derive(Debug, Error)]
pub enum FailedUpload {
    /// The link failed.
    #[error("link: {0}")]
    Link(#[from] io::Error),
    /// No autopilot was heard.
    #[error("{0}")]
    NobodyThere(Silence),
    /// The autopilot is there, but not ready to start a mission.
    #[error("the autopilot is not ready: {0}")]
    NotReady(String),
    /// The mission cannot be uploaded.
    #[error("{0}")]
    Plan(#[from] PlanError),
    /// The transfer failed.
    #[error("{error}; {}", what_is_left(*.left))]
    Transfer {
        /// Why.
        error: UploadError,
        /// What the autopilot has now.
        left: Left,
    },
}

fn what_is_left(left: Left) -> &'static str {
    match left {
        Left::Old => "the autopilot keeps the mission it had",
        Left::Nothing => "what had arrived was cleared: the autopilot has no mission",
        Left::Whole => "the autopilot has the whole mission",
        Left::Unknown => "what the autopilot has now is NOT known: check before you fly",
    }
}

impl Upload<'_> {
    /// Connects, transfers, reads back, compares, and starts if asked. Returns the number of
    /// items. When `stop` is set the transfer is cancelled and cleared.
    pub fn run(
        &self,
        session: &mut Session,
        client: &mut Autopilot<f64>,
        stop: &AtomicBool,
        mut progress: impl FnMut(u16, u16),
    ) -> Result<u16, FailedUpload> {
        let begin = session.now();
        let ready = |client: &Autopilot<f64>| {
            client.vehicle().is_some()
                && (!self.start || client.phase() == firmware_core::autopilot::Phase::Standby)
        };
        while !ready(client) {
            session.turn(client, |_, _, _| {})?;
            let waited = session.now() - begin;
            let deaf = client.vehicle().is_none() && waited >= CONNECT_PATIENCE;
            if deaf || waited >= self.patience || stop.load(Ordering::Relaxed) {
                let obstacle = client.obstacle().map(|obstacle| obstacle.to_string());
                return Err(match (client.vehicle(), obstacle) {
                    (None, _) => FailedUpload::NobodyThere(session.silence(begin)),
                    (_, Some(words)) => FailedUpload::NotReady(words),
                    (_, None) => FailedUpload::NotReady("its checks did not end".into()),
                });
            }
        }
        let settings = *client.settings();
        let Some((to, firmware)) = client.vehicle() else {
            return Err(FailedUpload::NotReady("it is gone".into()));
        };
        let plan = MissionPlan {
            firmware,
            map: MapFrame::new(settings.map_origin),
            waypoints: self.waypoints,
            altitude_m: settings.altitude_m,
            speed_mps: self.speed_mps,
            ending: self.ending,
        };
        let mut upload = MissionUpload::new(plan, to, settings.own, self.start)?;
        loop {
            while let Some(message) = upload.poll(session.now()) {
                session.send(&message)?;
            }
            session.turn(client, |now, from, message| {
                upload.receive(now, from, message)
            })?;
            if stop.load(Ordering::Relaxed) {
                upload.cancel(session.now());
            }
            let (done, count) = upload.progress();
            progress(done, count);
            match upload.outcome() {
                // The last word of a read-back may still be due.
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

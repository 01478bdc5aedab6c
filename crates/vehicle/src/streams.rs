//! The messages that the vehicle sends regularly, and their intervals.

use firmware_core::time::{Duration, Instant};

use super::profile::Profile;

pub(super) const HEARTBEAT: u32 = 0;
pub(super) const SYS_STATUS: u32 = 1;
pub(super) const ATTITUDE: u32 = 30;
pub(super) const LOCAL_POSITION_NED: u32 = 32;
pub(super) const GLOBAL_POSITION_INT: u32 = 33;
pub(super) const GPS_GLOBAL_ORIGIN: u32 = 49;
pub(super) const ESTIMATOR_STATUS: u32 = 230;
pub(super) const EKF_STATUS_REPORT: u32 = 193;
pub(super) const EXTENDED_SYS_STATE: u32 = 245;
pub(super) const CURRENT_MODE: u32 = 436;

/// One message that is sent regularly.
#[derive(Clone, Copy, Debug)]
struct Stream {
    message: u32,
    interval: Duration,
    due: Instant,
}

/// All messages that are sent regularly.
#[derive(Clone, Debug)]
pub(super) struct Streams {
    all: Vec<Stream>,
    /// Whether the message that is being sent is a regular one and not an answer.
    pub(super) sending: bool,
}

/// The shortest interval of any message.
const SHORTEST_INTERVAL: Duration = Duration::from_millis(5);

impl Streams {
    /// Returns the messages that the profile sends without being asked.
    pub(super) fn of(profile: Profile) -> Self {
        let second = Duration::from_secs(1);
        let mut wanted = vec![(HEARTBEAT, second)];
        if profile.sends_telemetry_unrequested() {
            wanted.extend([
                (SYS_STATUS, second),
                (ESTIMATOR_STATUS, second),
                (EXTENDED_SYS_STATE, second),
                (GLOBAL_POSITION_INT, second / 4),
                (LOCAL_POSITION_NED, second / 4),
                (ATTITUDE, second / 4),
            ]);
        }
        let stream = |(message, interval)| Stream {
            message,
            interval,
            due: Instant::ZERO + profile.first_heartbeat_after(),
        };
        Self {
            all: wanted.into_iter().map(stream).collect(),
            sending: false,
        }
    }

    /// Changes the interval of a message. `None` stops it.
    pub(super) fn set(&mut self, now: Instant, message: u32, interval: Option<Duration>) {
        self.all.retain(|stream| stream.message != message);
        if let Some(interval) = interval {
            self.all.push(Stream {
                message,
                interval: interval.max(SHORTEST_INTERVAL),
                due: now,
            });
        }
    }

    pub(super) fn take_due(&mut self, now: Instant) -> Option<u32> {
        let stream = self.all.iter_mut().find(|stream| now >= stream.due)?;
        // The times are on a regular grid, which starts again after a gap.
        stream.due =
            (stream.due + stream.interval).max(now.back(stream.interval) + SHORTEST_INTERVAL);
        Some(stream.message)
    }
}

//! The messages that the vehicle sends regularly, and their intervals.

use firmware_core::time::{Duration, Instant};
use mavlink::MessageData;
use mavlink::dialects::common::{
    ATTITUDE_DATA, ESTIMATOR_STATUS_DATA, EXTENDED_SYS_STATE_DATA, GLOBAL_POSITION_INT_DATA,
    HEARTBEAT_DATA, LOCAL_POSITION_NED_DATA, SYS_STATUS_DATA,
};

use super::profile::Profile;

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
        let mut wanted = vec![(HEARTBEAT_DATA::ID, second)];
        if profile.sends_telemetry_unrequested() {
            wanted.extend([
                (SYS_STATUS_DATA::ID, second),
                (ESTIMATOR_STATUS_DATA::ID, second),
                (EXTENDED_SYS_STATE_DATA::ID, second),
                (GLOBAL_POSITION_INT_DATA::ID, second / 4),
                (LOCAL_POSITION_NED_DATA::ID, second / 4),
                (ATTITUDE_DATA::ID, second / 4),
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

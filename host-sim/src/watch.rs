//! Follows a mission that an autopilot flies on its own, until the motors stop.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};

use firmware_core::autopilot::{Autopilot, Event};
use firmware_core::time::{Duration, Instant};
use mavlink::dialects::common::MavMessage;
use thiserror::Error;

use crate::flight::is_notable;
use crate::session::Session;

/// A started mission whose motors have not turned for this time was not started.
const START_PATIENCE: Duration = Duration::from_secs(30);

/// A displayed event while the mission is flown.
#[derive(Clone, Debug, PartialEq)]
pub enum Seen {
    /// The autopilot flies to this item.
    Item(u16),
    /// An action or a message of the autopilot.
    Event(String),
}

/// The reason why a mission was not followed to its end.
#[derive(Debug, Error)]
pub enum WatchError {
    /// The link failed.
    #[error("link: {0}")]
    Link(#[from] io::Error),
    /// The motors never turned.
    #[error("the mission was started, but the motors did not start")]
    NotArmed,
    /// No message was received for this time, seconds. The autopilot continues the mission.
    #[error(
        "no message received for {0:.0} s on the way to item {1}; the autopilot continues the mission"
    )]
    Silence(f64, u16),
    /// The motors stopped before the last waypoint.
    #[error("the motors stopped on the way to item {reached} of {last}")]
    Short {
        /// The item that the autopilot flew to.
        reached: u16,
        /// The last item.
        last: u16,
    },
    /// The user asked to stop watching. The autopilot continues the mission.
    #[error("stopped watching on the way to item {0}; the autopilot continues the mission")]
    Stopped(u16),
}

/// Follows the mission and returns when the motors have stopped after the last waypoint of `items`
/// items was reached.
///
/// # Errors
/// Returns an error if the link fails or no message is received, if the motors stop earlier or
/// never turn, or if `stop` is set.
pub fn watch(
    session: &mut Session,
    client: &mut Autopilot<f64>,
    items: u16,
    stop: &AtomicBool,
    mut see: impl FnMut(Seen),
) -> Result<(), WatchError> {
    let begin = session.now();
    let last = items.saturating_sub(1);
    let (mut item, mut flew) = (0, false);
    loop {
        let mut current = None;
        session.turn(client, |_, _, message| match message {
            MavMessage::MISSION_CURRENT(mission) => current = Some(mission.seq),
            // Some autopilots return to the first item when the last one is finished.
            MavMessage::MISSION_ITEM_REACHED(reached) => current = Some(reached.seq),
            _ => {}
        })?;
        if let Some(current) = current.filter(|&current| current > item && current <= last) {
            item = current;
            see(Seen::Item(item));
        }
        while let Some(event) = client.take_next_event() {
            // The client itself waits for the motors to stop, which is not displayed.
            let shown = is_notable(&event) && !matches!(event, Event::Waiting(_) | Event::Phase(_));
            if shown {
                see(Seen::Event(event.to_string()));
            }
        }
        let now = session.now();
        flew |= client.is_armed();
        if client.is_link_dead(now) {
            return Err(WatchError::Silence(silence_s(client, now), item));
        }
        if flew && !client.is_armed() {
            // The last item is the landing; not every autopilot reports that it has begun it.
            if item + 1 >= last {
                return Ok(());
            }
            return Err(WatchError::Short {
                reached: item,
                last,
            });
        }
        if !flew && now - begin > START_PATIENCE {
            return Err(WatchError::NotArmed);
        }
        if stop.load(Ordering::Relaxed) {
            return Err(WatchError::Stopped(item));
        }
    }
}

fn silence_s(client: &Autopilot<f64>, now: Instant) -> f64 {
    client
        .heartbeat_age(now)
        .map_or(0.0, |age| age.as_secs_f64())
}

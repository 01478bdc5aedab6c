//! The mission that the vehicle has stored, and the upload that is in progress.

use firmware_core::autopilot::wire::Address;
use firmware_core::time::Instant;
use mavlink::dialects::common::MISSION_ITEM_INT_DATA;

/// An upload to the vehicle.
#[derive(Debug)]
pub(super) struct Incoming {
    pub(super) from: Address,
    pub(super) count: u16,
    pub(super) items: Vec<MISSION_ITEM_INT_DATA>,
    /// Whether the sender does not support the deprecated form of requests.
    pub(super) new_requests: bool,
    pub(super) asked: Instant,
    pub(super) progress: Instant,
}

/// The stored mission, the upload in progress, and the progress of a flight through the mission.
#[derive(Debug, Default)]
pub(super) struct Missions {
    pub(super) items: Vec<MISSION_ITEM_INT_DATA>,
    pub(super) incoming: Option<Incoming>,
    pub(super) stored_at: Option<Instant>,
    pub(super) current: usize,
    pub(super) speed_mps: Option<f64>,
}

impl Missions {
    pub(super) fn len(&self) -> usize {
        self.items.len()
    }
}

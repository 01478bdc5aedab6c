//! What the vehicle has stored of a mission, and what is coming.

use firmware_core::autopilot::wire::Address;
use firmware_core::time::Instant;
use mavlink::dialects::common::MISSION_ITEM_INT_DATA;

/// A transfer to us.
#[derive(Debug)]
pub(super) struct Incoming {
    pub(super) from: Address,
    pub(super) count: u16,
    pub(super) items: Vec<MISSION_ITEM_INT_DATA>,
    /// The sender does not know the old form of requests.
    pub(super) new_requests: bool,
    pub(super) asked: Instant,
    pub(super) progress: Instant,
}

/// What is stored, what is coming, and where a flight through it is.
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

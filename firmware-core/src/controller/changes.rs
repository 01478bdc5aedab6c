// SPDX-License-Identifier: MIT OR Apache-2.0
//! Changes of the mission in flight: each comes into effect at the beginning of its slot.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::{mission::MissionChange, scalar::Scalar};

/// The number of changes that can wait for their slot.
pub const CHANGES_MAX: usize = 32;

/// A change of the mission from a slot on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "T: Scalar")]
pub struct DatedChange<T: Scalar> {
    /// The first slot with the change. If it has been planned already, it is allocated with the
    /// change, and the next one is planned with it.
    pub from_slot: u32,
    /// What changes.
    pub change: MissionChange<T>,
}

/// The changes that are not in effect yet, in the order in which they were received.
pub(super) type Pending<T> = Vec<DatedChange<T>, CHANGES_MAX>;

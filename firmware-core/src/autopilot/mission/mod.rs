// SPDX-License-Identifier: MIT OR Apache-2.0
//! Upload of a whole mission, which the autopilot then flies by itself.
//!
//! [`MissionPlan`] computes the mission items without storing them; [`MissionUpload`] transfers
//! them, reads them back, compares them, and starts the mission if requested. After a failed
//! transfer the autopilot has the old mission or none: an autopilot may keep and fly an incomplete
//! mission (ArduCopter does), so the mission is cleared after a failure, and the client checks that
//! it is.
//!
//! ```text
//! us:  COUNT ──────── ITEM k ──────────── REQUEST_LIST ──────── REQUEST_INT k ─────── ACK
//! it:        REQUEST(_INT) k ...     ACK               COUNT                 ITEM k ...
//! ```

mod outcome;
mod plan;
mod upload;

pub use outcome::{Left, UploadError, UploadOutcome};
pub use plan::{Ending, MissionPlan, PlanError};
pub use upload::{MissionUpload, SPACE_PATIENCE};

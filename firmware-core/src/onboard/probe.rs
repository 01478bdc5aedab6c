// SPDX-License-Identifier: MIT OR Apache-2.0
//! Measurement of the computing time of a slot.

/// One of the two computations of a slot, for measurements of their duration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activity {
    /// Policy and shield.
    Plan,
    /// The slot problem.
    Allocate,
}

/// Measures how long an [`Activity`] takes. The core has no clock of its own.
pub trait Probe {
    /// Called when the activity begins.
    fn begin(&mut self, activity: Activity);
    /// Called when the activity has ended.
    fn end(&mut self, activity: Activity);
}

/// A probe that measures nothing.
impl Probe for () {
    fn begin(&mut self, _: Activity) {}
    fn end(&mut self, _: Activity) {}
}

//! Measures how long the controller's two computations of a slot take.

use std::time::Instant as WallInstant;

use firmware_core::onboard::{Activity, Probe};

use crate::record::SlotRecord;

/// Measures the two computations of each slot.
#[derive(Debug, Default)]
pub(super) struct Stopwatch {
    begun: Option<WallInstant>,
    plan_us: Vec<f64>,
    allocate_us: Vec<f64>,
}

impl Stopwatch {
    /// Records times that were measured elsewhere; 0 if nothing was computed.
    pub(super) fn add(&mut self, plan_us: f64, allocate_us: f64) {
        self.plan_us.extend((plan_us > 0.0).then_some(plan_us));
        self.allocate_us
            .extend((allocate_us > 0.0).then_some(allocate_us));
    }

    /// Returns the total times for planning and for allocating.
    pub(super) fn totals_us(&self) -> (f64, f64) {
        (self.plan_us.iter().sum(), self.allocate_us.iter().sum())
    }

    /// Writes the two times of a slot into its record.
    pub(super) fn note(&self, slot: &mut SlotRecord) {
        let index = slot.slot as usize - 1;
        slot.plan_us = self.plan_us.get(index).copied().unwrap_or_default();
        slot.allocate_us = self.allocate_us.get(index).copied().unwrap_or_default();
    }
}

impl Probe for Stopwatch {
    fn begin(&mut self, _: Activity) {
        self.begun = Some(WallInstant::now());
    }

    fn end(&mut self, activity: Activity) {
        let Some(begun) = self.begun.take() else {
            return;
        };
        let micros = begun.elapsed().as_secs_f64() * 1e6;
        match activity {
            Activity::Plan => self.plan_us.push(micros),
            Activity::Allocate => self.allocate_us.push(micros),
        }
    }
}

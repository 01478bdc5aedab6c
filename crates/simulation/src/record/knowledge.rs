//! What it cost that the world was not known exactly.

use serde::Serialize;

use super::{FlightRecord, SlotRecord};

/// How many standard errors an empirical MSE must be above the threshold to count as above.
const SIGNIFICANT: f64 = 3.0;

/// The part of the summary that a world with an `[uncertainty]` table adds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KnowledgeSummary {
    /// The seed of the world.
    pub seed: u64,
    /// The vehicle was not told how good the estimates of channels are.
    pub errors_ignored: bool,
    /// The fraction of slots whose expected MSE is above the threshold.
    pub outage: f64,
    /// The fraction of slots whose empirical MSE is above the threshold, by more than three standard
    /// errors.
    pub empirical_outage: f64,
    /// The number of slots in which the estimates were too poor for the threshold, whatever the powers.
    pub error_floor_slots: usize,
    /// The sum of the rates of the same users at the same places if all channels were known exactly,
    /// bit/s/Hz.
    pub perfect_sum_rate: f64,
    /// That sum minus `sum_rate`: what is lost because channels are not known exactly. Negative where
    /// `Gamma` is broken for more rate.
    pub rate_lost: f64,
}

impl KnowledgeSummary {
    /// Returns what the lack of knowledge cost, or `None` if everything was known.
    pub(super) fn of(record: &FlightRecord) -> Option<Self> {
        let uncertainty = &record.scenario.uncertainty;
        if uncertainty.is_none() {
            return None;
        }
        let timeline = record.timeline();
        let share = |is_out: &dyn Fn(&SlotRecord, f64) -> bool| {
            let out = record.slots.iter().filter(|slot| {
                let mission = timeline.in_slot(slot.slot);
                is_out(slot, mission.parameters().mse_threshold)
            });
            out.count() as f64 / record.slots.len().max(1) as f64
        };
        let perfect = |slot: &SlotRecord| slot.perfect_rate.unwrap_or(slot.rate);
        let perfect_sum_rate: f64 = record.slots.iter().map(perfect).sum();
        let sum_rate: f64 = record.slots.iter().map(|slot| slot.rate).sum();
        Some(Self {
            seed: uncertainty.seed,
            errors_ignored: record.ignores_errors,
            outage: share(&|slot, threshold| slot.mse > threshold * (1.0 + 1e-9)),
            empirical_outage: share(&|slot, threshold| {
                let signals = &slot.signals;
                signals.empirical_mse > threshold + SIGNIFICANT * signals.standard_error
            }),
            error_floor_slots: record
                .slots
                .iter()
                .filter(|slot| slot.at_error_floor)
                .count(),
            perfect_sum_rate,
            rate_lost: perfect_sum_rate - sum_rate,
        })
    }
}

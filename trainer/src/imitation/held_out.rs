//! Evaluation on missions that no run learns from, as fractions of the planner's totals.

use anyhow::anyhow;
use environment::Allocation;
use pulp::Arch;
use scenario::{HostMission, random};

use super::{demonstration::planned, policy::SetPolicy};
use crate::{evaluate::fly, nn::sets::SetNetwork};

/// The seed of the first mission: beyond the benchmark's, and below those of all runs.
pub const FIRST_SEED: u64 = 1_000_000;
/// Missions with a smaller total, bit/s/Hz, are left out: fractions of it would mean little.
const TOTAL_MIN: f64 = 0.5;
/// The operations of the planner for a mission.
const PLANNING_OPERATIONS: u64 = 500_000_000;

/// Missions with the totals of the planner.
#[derive(Clone, Debug)]
pub struct HeldOut {
    missions: Vec<(HostMission, f64)>,
}

/// The result of an evaluation: flown totals as fractions of the planner's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluation {
    /// Mean over the missions.
    pub mean: f64,
    /// 5 % quantile.
    pub low: f64,
    /// The worst mission's.
    pub worst: f64,
    /// The number of missions that broke fairness or did not arrive; the shield leaves none.
    pub violated: usize,
}

impl HeldOut {
    /// Draws and plans `count` missions.
    ///
    /// # Errors
    /// Fails if a seed gives no mission.
    pub fn new(count: usize) -> anyhow::Result<Self> {
        let mut missions = Vec::new();
        for seed in (FIRST_SEED..).take(count) {
            let mission = random(seed, None).map_err(|error| anyhow!(error))?.mission;
            let total = planned(&mission, PLANNING_OPERATIONS)?.value();
            if total > TOTAL_MIN {
                missions.push((mission, total));
            }
        }
        Ok(Self { missions })
    }

    /// Flies the network deterministically through all missions.
    ///
    /// # Errors
    /// Returns the controller's error. A valid mission causes none.
    pub fn evaluate(&self, arch: Arch, network: &SetNetwork) -> anyhow::Result<Evaluation> {
        let mut fractions = Vec::new();
        let mut violated = 0;
        for (mission, total) in &self.missions {
            let policy = SetPolicy::new(network, mission.clone(), arch);
            let flight = fly(mission, policy, Allocation::default())?;
            violated += usize::from(!(flight.arrived && flight.fair));
            fractions.push(flight.sum_rate / total);
        }
        fractions.sort_by(f64::total_cmp);
        let count = fractions.len();
        Ok(Evaluation {
            mean: fractions.iter().sum::<f64>() / count as f64,
            low: fractions.get(count / 20).copied().unwrap_or(f64::NAN),
            worst: fractions.first().copied().unwrap_or(f64::NAN),
            violated,
        })
    }
}

//! Evaluation on missions that no run learns from, as fractions of the planner's totals.

use anyhow::anyhow;
use environment::Allocation;
use pulp::Arch;
use scenario::{DrawnMission, HostMission, Layout, MissionProperties};

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
    missions: Vec<(HostMission, MissionProperties, f64)>,
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

/// A flown mission.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flown {
    /// The properties of the mission. Layouts are known of missions that were drawn.
    pub properties: MissionProperties,
    /// The flown total as a fraction of the planner's.
    pub fraction: f64,
    /// Whether it broke fairness or did not arrive.
    pub violated: bool,
}

impl HeldOut {
    /// Draws and plans `count` missions. None of them has one of the layouts `left_out`.
    ///
    /// # Errors
    /// Fails if a seed gives no mission.
    pub fn new(count: usize, left_out: &[Layout]) -> anyhow::Result<Self> {
        Self::drawn(count, None, left_out)
    }

    /// Draws and plans `count` missions with one layout of users and sensors.
    ///
    /// # Errors
    /// Fails if a seed gives no mission.
    pub fn with_layout(count: usize, layout: Layout) -> anyhow::Result<Self> {
        Self::drawn(count, Some(layout), &[])
    }

    fn drawn(count: usize, layout: Option<Layout>, left_out: &[Layout]) -> anyhow::Result<Self> {
        let mut missions = Vec::new();
        for seed in (FIRST_SEED..).take(count) {
            let drawn = DrawnMission::new(seed, layout, left_out);
            let drawn = drawn.map_err(|error| anyhow!(error))?;
            let mission = drawn.scenario.mission;
            let total = planned(&mission, PLANNING_OPERATIONS)?.value();
            if total > TOTAL_MIN {
                let properties = MissionProperties {
                    layouts: Some(drawn.layouts),
                    ..MissionProperties::of(&mission)
                };
                missions.push((mission, properties, total));
            }
        }
        Ok(Self { missions })
    }

    /// Plans one mission, to which a network is adapted.
    ///
    /// # Errors
    /// Fails if the mission does not fit into a planner.
    pub fn of(mission: HostMission) -> anyhow::Result<Self> {
        let total = planned(&mission, PLANNING_OPERATIONS)?.value();
        let properties = MissionProperties::of(&mission);
        Ok(Self {
            missions: vec![(mission, properties, total)],
        })
    }

    /// Flies the network deterministically through all missions.
    ///
    /// # Errors
    /// Returns the controller's error. A valid mission causes none.
    pub fn fly(&self, arch: Arch, network: &SetNetwork) -> anyhow::Result<Vec<Flown>> {
        let flown = self.missions.iter().map(|(mission, properties, total)| {
            let policy = SetPolicy::new(network, mission.clone(), arch);
            let flight = fly(mission, policy, Allocation::default())?;
            Ok(Flown {
                properties: *properties,
                fraction: flight.sum_rate / total,
                violated: !(flight.arrived && flight.fair),
            })
        });
        flown.collect()
    }

    /// Flies the network and summarizes its totals.
    ///
    /// # Errors
    /// Like [`HeldOut::fly`].
    pub fn evaluate(&self, arch: Arch, network: &SetNetwork) -> anyhow::Result<Evaluation> {
        Ok(Evaluation::of(&self.fly(arch, network)?))
    }
}

impl Evaluation {
    /// Summarizes flights.
    pub fn of(flights: &[Flown]) -> Self {
        let mut fractions: Vec<f64> = flights.iter().map(|flown| flown.fraction).collect();
        fractions.sort_by(f64::total_cmp);
        let count = fractions.len();
        Self {
            mean: fractions.iter().sum::<f64>() / count as f64,
            low: fractions.get(count / 20).copied().unwrap_or(f64::NAN),
            worst: fractions.first().copied().unwrap_or(f64::NAN),
            violated: flights.iter().filter(|flown| flown.violated).count(),
        }
    }
}

// SPDX-License-Identifier: MIT OR Apache-2.0
//! The settings of the planner.

/// Settings of the planner: how much work it does before it is finished.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannerSettings {
    /// Iterations of the prices in the first round.
    pub first_iterations: u32,
    /// Iterations of the prices in each later round.
    pub later_iterations: u32,
    /// Rounds of prices and improvement.
    pub rounds: u32,
    /// Spacing of the finest stencils, as a fraction of the longest step.
    pub finest_spacing: f64,
    /// The most changes of the order of service in a round.
    pub changes: u32,
}

impl Default for PlannerSettings {
    fn default() -> Self {
        Self {
            first_iterations: 12,
            later_iterations: 20,
            rounds: 8,
            finest_spacing: 0.02,
            changes: 60,
        }
    }
}

impl PlannerSettings {
    pub(super) fn iterations(&self, round: u32) -> u32 {
        let iterations = match round {
            0 => self.first_iterations,
            _ => self.later_iterations,
        };
        iterations.max(1)
    }
}

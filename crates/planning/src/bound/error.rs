//! The reasons why a mission cannot be bounded.

use firmware_core::{Mission, mission::RadioModel};

/// Error returned when a mission cannot be bounded.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BoundError {
    /// The mission has too many slots, or its area is too large for its speed.
    #[error(
        "the mission has more than {pairs_max} pairs of slot and cell already at cells of \
         {cell_m} m; use fewer slots, a smaller area or a higher speed"
    )]
    TooLarge {
        /// The largest number of pairs that is allowed.
        pairs_max: usize,
        /// The side of the largest cells, metres.
        cell_m: f64,
    },
    /// The mission has more slots than the optimal assignment of users to slots supports.
    #[error(
        "the mission has {slots} slots, but the bound supports at most {max}, because the time to assign users is cubic in the slots"
    )]
    TooManySlots {
        /// The number of slots, `N`.
        slots: u32,
        /// The largest number that is allowed.
        max: u32,
    },
    /// The destination can only be reached on the straight line at full speed, so there is nothing
    /// to plan.
    #[error(
        "the destination is {distance_m} m from the start, and at most {reach_m} m can be flown: \
         only the straight path is possible, so there is nothing to search"
    )]
    StraightPathOnly {
        /// The distance from start to destination, metres.
        distance_m: f64,
        /// The largest distance that can be flown, `(N + 1) V_max delta`, metres.
        reach_m: f64,
    },
    /// The gains of the mission come from a map.
    #[error(
        "the bound needs a gain that falls with the horizontal distance, which radio.gain_map does \
         not promise: missions with a map of gains cannot be certified"
    )]
    GainMap,
    /// The gain of the channel rises somewhere with the distance, so the gain at the nearest point
    /// of a cell bounds nothing.
    #[error(
        "the bound needs a gain that falls with the horizontal distance, but that of radio.model \
         \"{model}\" rises at {distance_m} m"
    )]
    GainRises {
        /// The radio model.
        model: RadioModel,
        /// The horizontal distance, metres.
        distance_m: f64,
    },
}

/// Returns the error for a mission of which only one path can be flown.
pub(super) fn no_room<const M: usize, const J: usize>(mission: &Mission<f64, M, J>) -> BoundError {
    let p = mission.parameters();
    BoundError::StraightPathOnly {
        distance_m: (p.destination - p.start).norm(),
        reach_m: f64::from(mission.slots() + 1) * mission.reach_m(),
    }
}

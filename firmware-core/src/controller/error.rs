// SPDX-License-Identifier: MIT OR Apache-2.0
//! The reasons for which the controller refuses a call.

/// Error returned when the controller cannot carry out a call in its present state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum ControllerError {
    /// `plan` was called while a slot is under way.
    #[error("slot {slot} is planned and not yet allocated")]
    SlotUnderWay {
        /// The slot under way.
        slot: u32,
    },
    /// `allocate` was called while no slot is under way.
    #[error("no slot is planned: {done} of {slots} are done")]
    NothingPlanned {
        /// The number of slots done.
        done: u32,
        /// `N`, the number of slots of the mission.
        slots: u32,
    },
    /// The mission is over.
    #[error("the mission is over after {slots} slots")]
    MissionOver {
        /// `N`, the number of slots of the mission.
        slots: u32,
    },
    /// The channel state belongs to another slot.
    #[error("channel state is about slot {got}, but slot {expected} is under way")]
    WrongSlot {
        /// The slot of the channel state.
        got: u32,
        /// The slot under way.
        expected: u32,
    },
    /// The channel state or the quality of one has the wrong number of entries.
    #[error("entries of {got} {what}s, but the mission has {expected}")]
    WrongSize {
        /// `user` or `sensor`.
        what: &'static str,
        /// The number of entries.
        got: usize,
        /// The number of users or sensors of the mission.
        expected: usize,
    },
    /// The quality of channel estimates is older than the one in effect, or of a slot to come.
    #[error("quality of slot {got}, but it must be of slot {earliest} to {latest}")]
    QualityOutOfTurn {
        /// The slot of the quality.
        got: u32,
        /// The slot of the quality in effect.
        earliest: u32,
        /// The slot under way, or the next one.
        latest: u32,
    },
    /// The measured position is NaN or infinite.
    #[error("the measured position is not finite")]
    PositionNotFinite,
}

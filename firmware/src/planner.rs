//! The planner's memory: statics of its own, beside the memory that the controller needs.

use firmware_core::{
    console::{
        BoardMission, BoardPlanner, PLANNER_CAPACITY, PlannerBytes, PlannerNumbers, board_planner,
    },
    planner::PlannerError,
};

/// The planner of this image, whose memory is static.
pub type StaticPlanner = BoardPlanner<(&'static mut PlannerNumbers, &'static mut PlannerBytes)>;

/// The memory of the planner: its tables, and the planner itself.
#[derive(Debug)]
pub struct PlannerMemory {
    tables: (&'static mut PlannerNumbers, &'static mut PlannerBytes),
    planner: &'static mut Option<StaticPlanner>,
}

const _: () = assert!(PlannerMemory::BYTES <= 256 * 1024);

impl PlannerMemory {
    /// The size of the memory, bytes.
    pub const BYTES: usize =
        PLANNER_CAPACITY.memory_bytes::<f32>() + size_of::<Option<StaticPlanner>>();

    /// Returns the memory; `None` the second time.
    pub fn take() -> Option<Self> {
        let numbers = cortex_m::singleton!(PLANNER_NUMBERS: PlannerNumbers =
            [0.0; PLANNER_CAPACITY.values()])?;
        let bytes = cortex_m::singleton!(PLANNER_BYTES: PlannerBytes =
            [0; PLANNER_CAPACITY.indices()])?;
        let planner = cortex_m::singleton!(PLANNER: Option<StaticPlanner> = None)?;
        Some(Self {
            tables: (numbers, bytes),
            planner,
        })
    }

    /// Creates a planner for a mission in this memory. The memory is taken unless the mission is
    /// refused, so that another can be planned.
    ///
    /// # Errors
    /// Returns an error if the mission exceeds the capacity, or if the memory is in use.
    #[inline(never)]
    pub fn planner(
        memory: &mut Option<Self>,
        mission: &BoardMission,
    ) -> Result<&'static mut StaticPlanner, PlannerError> {
        PLANNER_CAPACITY.check(mission)?;
        let Some(Self { tables, planner }) = memory.take() else {
            return Err(PlannerError::TooLittleMemory {
                what: "bytes",
                needed: Self::BYTES,
                got: 0,
            });
        };
        board_planner(planner, mission, tables)
    }
}

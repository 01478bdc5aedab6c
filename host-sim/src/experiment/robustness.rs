//! What happens to totals and outage when the world is not known exactly: one kind of error at a
//! time, for planner, SAC and straight line, with allocations that know the statistics of the errors
//! (robust) and that ignore them (naive).
//!
//! Measured once into `robustness.csv` and `moving.csv`; drawings and tables are made from these.

mod drawing;
mod error_kind;
mod flights;
mod measurement;
mod moving;
mod page;
mod row;

pub use error_kind::ErrorKind;
pub use measurement::{forget, write, write_drawings};
pub use moving::MovingRow;
pub use page::section;
pub use row::{Extent, Group, NAME, Pilot, RobustnessRow};

//! File access: input with a limit on the length, and output that is written completely or not at
//! all.
//!
//! * [`input`]: reads files, with a limit on the length.
//! * [`output`]: writes files so that a reader, also after a crash, sees either the old or the new
//!   content.
//! * [`PerNode`]: a number that a file gives once for all users or sensors, or once for each.

#![deny(missing_docs)]

pub mod input;
pub mod output;
mod per_node;

pub use per_node::PerNode;

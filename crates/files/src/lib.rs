//! File access: input with a limit on the length, and output that is written completely or not at
//! all.
//!
//! * [`input`]: reads files, with a limit on the length.
//! * [`output`]: writes files so that a reader, also after a crash, sees either the old or the new
//!   content.
//! * [`named`]: a problem with the path of its file before it.
//! * [`PerNode`]: a number that a file gives once for all users or sensors, or once for each.

#![deny(missing_docs)]

pub mod input;
pub mod output;
mod per_node;

use std::{fmt::Display, path::Path};

pub use per_node::PerNode;

/// Returns the problem with the path of the file before it.
pub fn named(path: &Path, problem: impl Display) -> String {
    format!("{}: {problem}", path.display())
}

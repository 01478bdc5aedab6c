//! Files: read with a limit, written whole or not at all.
//!
//! * [`input`]: reading, with a limit on the length.
//! * [`output`]: writing, so that a reader or a crash sees the old file or the new one.

#![deny(missing_docs)]

pub mod input;
pub mod output;

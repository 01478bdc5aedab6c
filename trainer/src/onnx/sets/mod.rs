//! Policies for any mission as ONNX files of format version 2, as `docs/training.md` defines them.
//!
//! | | name | shape | unit |
//! |---|---|---|---|
//! | input | `mission` | f32\[1, 44\] | see [`firmware_core::policy::sets`] |
//! | input | `users`, `user_mask` | f32\[1, 16, 32\], f32\[1, 16\] | |
//! | input | `sensors`, `sensor_mask` | f32\[1, 64, 3\], f32\[1, 64\] | |
//! | output | `displacement` | f32\[1, 2\] | m |
//! | output | `user_scores` | f32\[1, 16\] | 0 where `user_mask` is 0 |
//!
//! Features, network and the scaling to metres are part of the graph, in elementary operators.

mod features;
mod metadata;
mod network;
mod operators;
mod read;
mod weights;
mod write;

pub use read::{is_for_any_mission, parse, read};
pub use write::write;

//! Policies as ONNX files that follow the contract in `docs/training.md`.
//!
//! | | name | shape | unit |
//! |---|---|---|---|
//! | input | `observation` | f32\[1, M + 4\] | counts, bit/s/Hz, MSE, m, m |
//! | output | `displacement` | f32\[1, 2\] | m |
//! | output | `user_scores` | f32\[1, M\] | |
//!
//! The normalizer, `tanh` and the scaling to metres are part of the graph. `metadata_props` say what
//! the policy was trained for ([`Provenance`](firmware_core::policy::Provenance)) and contain
//! a test vector.

mod contract;
mod convert;
mod folded;
mod graph;
mod metadata;
mod proto;
pub mod read;
pub mod sets;
mod tensor;
mod write;

pub use contract::{FORMAT_VERSION, OPSET};
pub use convert::to_policy_file;
pub use write::write;

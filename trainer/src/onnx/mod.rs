//! Policies as ONNX files, to the contract in `docs/training.md`.
//!
//! | | name | shape | unit |
//! |---|---|---|---|
//! | input | `observation` | f32\[1, M + 4\] | counts, bit/s/Hz, MSE, m, m |
//! | output | `displacement` | f32\[1, 2\] | m |
//! | output | `user_scores` | f32\[1, M\] | |
//!
//! Normaliser, `tanh` and the scaling to metres are in the graph. `metadata_props` say what the
//! policy is for ([`Provenance`](firmware_core::policy::Provenance)) and hold a test vector.

mod proto;
pub mod read;
mod write;

pub use write::write;

/// Version of the contract, `metadata_props["format_version"]`.
pub const FORMAT_VERSION: u32 = 1;
/// ONNX operator set; every operator used is unchanged from 13 to 17 and later.
pub const OPSET: i64 = 17;

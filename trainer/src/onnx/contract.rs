//! Numbers that the contract of policy files fixes.

/// Version of the contract, `metadata_props["format_version"]`.
pub const FORMAT_VERSION: u32 = 1;
/// ONNX operator set; every operator used is unchanged from 13 to 17 and later.
pub const OPSET: i64 = 17;

//! Converts `.onnx` files of both format versions to `.policy` files.

use firmware_core::policy::mlp::Mlp;

use super::{read, sets};

/// Returns the `.policy` file that decides as an `.onnx` file does.
///
/// # Errors
/// Fails if the content is no policy of the contract, or if the network exceeds the limits of
/// `firmware-core`.
pub fn to_policy_file(onnx: &[u8]) -> anyhow::Result<Vec<u8>> {
    if sets::is_for_any_mission(onnx) {
        let (network, precision) = sets::parse(onnx)?;
        return network.to_policy_file(precision);
    }
    let file = read::parse(onnx)?.to_policy_file()?;
    // A file that the vehicle would reject is not returned.
    Mlp::load(&file[..])?;
    Ok(file)
}

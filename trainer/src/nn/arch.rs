//! The vector instructions that tests run with.

use pulp::Arch;

/// Returns every set of vector instructions that this machine has, and the scalar fallback.
pub(crate) fn every_arch() -> Vec<Arch> {
    let mut every = vec![Arch::Scalar];
    #[cfg(target_arch = "x86_64")]
    {
        every.extend(pulp::x86::V3::try_new().map(Arch::V3));
        every.extend(pulp::x86::V4::try_new().map(Arch::V4));
    }
    #[cfg(target_arch = "aarch64")]
    every.extend(pulp::aarch64::Neon::try_new().map(Arch::Neon));
    every
}

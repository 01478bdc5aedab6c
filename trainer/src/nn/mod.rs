//! The parts of deep learning that SAC and DDPG need: dense layers, ReLU, back-propagation and
//! Adam, in `f32` on one thread, without allocation in a step and without `unsafe`.
//!
//! **Layout.** A batch of `B` vectors is stored feature by feature: row `i` holds feature `i` of
//! all samples and has `width = padded(B)` columns. In the product of a layer the samples run along
//! the SIMD vectors and the weights are broadcast scalars, so neither `W x` nor `W^T delta` needs a
//! transposed copy of `W`; only `dW = delta x^T` needs its inputs sample by sample. The weights of a
//! layer are stored row by row (one row per output), at a distance of `padded(inputs)`. The padding
//! of a row is zero, receives zero gradients and stays zero. The parameters of a network are one
//! vector, so Adam, target averaging and checkpoints do not depend on the layers.
//!
//! **Reproducibility.** Sums are formed in an order that does not depend on the width of the
//! machine's vectors ([`product`]), and functions come from `libm`: the same seed gives the same
//! bytes.

pub mod activations;
pub mod adam;
#[cfg(test)]
pub(crate) mod arch;
pub mod mlp;
pub mod product;
#[cfg(test)]
pub(crate) mod reference;
pub mod sets;

pub use activations::Activations;
pub use adam::Adam;
pub use mlp::Mlp;
pub use product::{LANES, padded};

/// Returns `tanh(x)`, with the same bits on every machine.
pub fn tanh(x: f32) -> f32 {
    libm::tanhf(x)
}

/// Returns `e^x`, with the same bits on every machine.
pub fn exp(x: f32) -> f32 {
    libm::expf(x)
}

/// Returns the natural logarithm, with the same bits on every machine.
pub fn ln(x: f32) -> f32 {
    libm::logf(x)
}

/// Returns `ln(1 + e^x)` without overflow.
pub fn softplus(x: f32) -> f32 {
    x.max(0.0) + libm::log1pf(libm::expf(-x.abs()))
}

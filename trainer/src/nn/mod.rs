//! The little of deep learning that SAC and DDPG need: dense layers, ReLU, back-propagation,
//! Adam. `f32`, one thread, no allocation in a step, no `unsafe`.
//!
//! **Layout.** A batch of `B` vectors is stored feature by feature: row `i` holds feature `i` of
//! all samples, `width = padded(B)` of them. The product of a layer then has the samples along
//! its vectors and the weights as broadcast scalars, so neither `W x` nor `W^T delta` needs a
//! transposed copy of `W`; only `dW = delta x^T` wants its inputs sample by sample.
//! A layer's weights lie row by row (one row per output), rows `padded(inputs)` apart; what
//! fills up a row is zero, gets zero gradients and stays zero. Parameters of a network are one
//! flat vector, so that Adam, target averaging and checkpoints need not know about layers.
//!
//! **Reproducibility.** Sums are formed in an order that does not depend on the machine's
//! vectors ([`product`]) and functions come from `libm`: same seed, same bytes.

pub mod adam;
pub mod mlp;
pub mod product;

pub use adam::Adam;
pub use mlp::{Mlp, Trace};
pub use product::{LANES, padded};

/// `tanh` of the same bits everywhere.
pub fn tanh(x: f32) -> f32 {
    libm::tanhf(x)
}

/// `exp` of the same bits everywhere.
pub fn exp(x: f32) -> f32 {
    libm::expf(x)
}

/// Natural logarithm of the same bits everywhere.
pub fn ln(x: f32) -> f32 {
    libm::logf(x)
}

/// `ln(1 + e^x)` without overflow.
pub fn softplus(x: f32) -> f32 {
    x.max(0.0) + libm::log1pf(libm::expf(-x.abs()))
}

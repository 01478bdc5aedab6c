//! The network of the policy for any mission, whose inputs are sets: a row of features for the
//! mission, one per user and one per sensor.
//!
//! The sensors are pooled to their mean and maximum. The mission, with the pooled sensors, and the
//! users are tokens of a transformer: `L` layers of attention with four heads and of a network with
//! one hidden layer, each after a layer norm. Heads compute the displacement from the mission's
//! token and a score per user ([`heads`]); a critic has only the head of the users, which computes a value
//! for each. A permutation of the users permutes the scores, and a
//! permutation of the sensors changes nothing but rounding.
//!
//! **Layout.** A batch consists of states with different numbers of users and sensors. Each matrix
//! has one row per token, user or sensor of all states, without padding between states
//! ([`SetBatch`]), so that every linear layer is one matrix product over the whole batch. The rows of
//! a linear layer's weights are padded as in [`Mlp`](super::Mlp), and the padding stays zero.
//!
//! **Reproducibility.** As in the rest of [`nn`](super): sums have an order that does not depend on
//! the machine's vectors. [`BatchGradient`] splits a batch into a fixed number of parts and adds their
//! gradients in a fixed order, so results do not depend on the number of threads either.
//!
//! | module | content |
//! |---|---|
//! | [`layout`] | sizes, and the place of every parameter |
//! | [`network`] | the parameters, their initial values and their order in files |
//! | [`batch`] | the inputs of a batch |
//! | [`forward`], [`backward`] | the passes through the whole network |
//! | [`linear`], [`norm`], [`attention`], [`pool`], [`heads`] | forward and backward pass of each part |
//! | [`functions`] | `exp`, and SiLU with its derivative |
//! | [`batch_gradient`] | gradients of a large batch on threads |
//! | [`parts`] | the parts of a batch on threads, and the sum of their gradients |

#[expect(
    clippy::needless_range_loop,
    clippy::manual_memcpy,
    reason = "loops over the lanes of several arrays become vector instructions"
)]
pub mod attention;
pub mod backward;
pub mod batch;
pub mod batch_gradient;
#[cfg(test)]
mod critic_tests;
pub mod forward;
pub mod functions;
pub mod heads;
pub mod layout;
pub mod linear;
pub mod network;
#[expect(
    clippy::needless_range_loop,
    reason = "loops over indices of several arrays become vector instructions"
)]
pub mod norm;
pub mod parts;
pub mod pool;
#[cfg(test)]
mod reference;
#[cfg(test)]
mod tests;

pub use batch::SetBatch;
pub use batch_gradient::BatchGradient;
pub use forward::Activations;
pub use layout::{Architecture, FeatureSizes, Heads, Layout};
pub use network::SetNetwork;

/// Makes a buffer `len` long. Its content is unspecified.
fn resize(buffer: &mut Vec<f32>, len: usize) -> &mut [f32] {
    if buffer.len() < len {
        buffer.resize(len, 0.0);
    }
    &mut buffer[..len]
}

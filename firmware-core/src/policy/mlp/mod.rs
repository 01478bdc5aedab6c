// SPDX-License-Identifier: MIT OR Apache-2.0
//! A trained policy without an allocator: a multilayer perceptron that reads its weights in place,
//! in flash or in a file's bytes.
//!
//! ```text
//! x = (observation - offset) * scale
//! x = max(0, W x + b)                      every layer but the last
//! [u_x, u_y, scores..] = W x + b           the last
//! displacement = reach tanh(u)             metres
//! ```
//!
//! A file of version 3 states its [`Functions`], as policies of other trainers have them: the hidden
//! layers may have `tanh` in place of `max(0, ..)`; the displacement may be clipped to `[-1, 1]` in place
//! of `tanh(u)`; and the scores may be limited in one of these ways.
//!
//! A `.policy` file, all numbers little endian:
//!
//! | part | bytes | |
//! |---|---|---|
//! | magic | 4 | `UAVP` |
//! | version | 2 | [`FORMAT_VERSION`], or [`FORMAT_VERSION_FUNCTIONS`] |
//! | checksum | 4 | CRC-32/ISO-HDLC over all that follows |
//! | header | varies | [`Header`] in postcard's encoding; in version 3 after the [`Functions`] |
//! | numbers | 4 each | `f32`: offset, scale, then per layer weights (a row per output) and biases, then the test vector: an observation, and the displacement and scores it gives |
//!
//! [`Mlp::load`] checks all of it, including the test vector. Worst case of a decision: one pass
//! over the weights and two `tanh`; about 41,000 multiplications and additions at 128 neurons. With
//! hidden layers of `tanh`, one `tanh` per neuron more.

mod format;
mod network;

pub use crate::policy::container::SELF_TEST_TOLERANCE;
pub use format::{
    Activation, FORMAT_VERSION, FORMAT_VERSION_FUNCTIONS, Functions, Header, LAYERS_MAX, Limit,
    LoadError, WIDTH_MAX, WriteError, write,
};
pub use network::Mlp;

#[cfg(test)]
mod tests;

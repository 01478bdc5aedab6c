// SPDX-License-Identifier: MIT OR Apache-2.0
//! A trained policy for any mission: its observation describes the mission as *sets* of users and
//! sensors, so that one policy flies every map.
//!
//! [`SetsObservation`] holds raw physical units in fixed columns ([`MISSION_COLUMN_NAMES`],
//! [`USER_COLUMN_NAMES`], [`SENSOR_COLUMN_NAMES`]); the functions of [`features`] turn them into the
//! inputs `g` (mission), `f_m` (user) and `s_j` (sensor) of the network, which are about 1 in size.
//!
//! # The network
//!
//! `D`, `F` and `L` are the sizes of its [`Architecture`]; `linear(n)` has `n` outputs; `norm`
//! subtracts the mean, divides by the standard deviation (with 1e-5 added to the variance) and
//! multiplies by a vector of scales. The weights are in the order of this table, those of a linear
//! map as a row per output and then the biases.
//!
//! | | | weights of |
//! |---|---|---|
//! | sensors | `h_j = linear(D) silu linear(D) s_j`, `pool = [mean_j h_j; max_j h_j]` | both linear maps, the inner one first |
//! | mission | `z_0 = linear(D) [g; pool]` | |
//! | users | `z_m = linear(D) f_m` | |
//! | `L` layers | `[q; k; v] = linear(3 D) norm z`, in 4 heads; `z += linear(D) softmax(q.k / sqrt(D/4)) v` | norm, linear(3 D), linear(D) |
//! | | `z += linear(D) silu linear(F) norm z` | norm, linear(F), linear(D) |
//! | end | `z = norm z` | norm |
//! | displacement | `[o_1; o_2; o_3] = linear(15) silu linear(D) z_0` | linear(D), linear(15) |
//! | per user | `[score_m; pull_{m,1..3}] = linear(4) silu linear(D) [z_m; z_0]` | linear(D), linear(4) |
//!
//! There are [`CANDIDATES`] candidates for the displacement, each with [`CANDIDATE_OUTPUTS`] outputs
//! `o_k`. With `p_k` the average of the users' positions relative to the vehicle, weighted by
//! `softmax_m(3 pull_{m,k})`, `q_f` the destination relative to the vehicle and `r` the reach,
//!
//! ```text
//! v_k = sigmoid(o_k2) p_k / r + sigmoid(o_k3) q_f / r + (o_k0, o_k1)
//! displacement = r v_k / max(1, |v_k|), with the k whose logit o_k4 is the largest, the first of equals
//! ```
//!
//! Where two ways are about equally good, a single displacement would be trained to their average,
//! which is on neither; candidates are trained to one way each.
//!
//! Permuting users permutes their scores, permuting sensors changes nothing (up to rounding).
//!
//! # The file
//!
//! Format version 2 of a `.policy` file, all numbers little endian:
//!
//! | part | bytes | |
//! |---|---|---|
//! | magic | 4 | `UAVP` |
//! | version | 2 | [`FORMAT_VERSION`] |
//! | checksum | 4 | CRC-32/ISO-HDLC over all that follows |
//! | header | varies | [`SetsHeader`] in postcard's encoding |
//! | weights | 2 or 4 each | IEEE binary16 or binary32 |
//! | test vector | 4 each | `f32`: the mission's columns, those of each user and of each sensor, then the displacement and a score per user |

mod architecture;
mod attention;
mod columns;
mod error;
pub mod features;
mod format;
pub mod half;
mod network;
mod observation;
mod panel;
mod policy;

pub use architecture::{
    Architecture, CANDIDATE_OUTPUTS, CANDIDATES, HEADS, HIDDEN_MAX, LAYERS_MAX, WIDTH_MAX,
};
pub use columns::{
    MISSION_COLUMN_NAMES, MISSION_COLUMNS, PLACES, RINGS, SENSOR_COLUMN_NAMES, SENSOR_COLUMNS,
    SENSORS, USER_COLUMN_NAMES, USER_COLUMNS, USERS,
};
pub use error::{SetsLoadError, SetsWriteError};
pub use format::{FORMAT_VERSION, Precision, SetsHeader, SetsProvenance, write};
pub use network::{SetsOutput, SetsWork};
pub use observation::SetsObservation;
pub use policy::{EvaluateSets, NetworkWithWork, SetsMismatch, SetsNetwork, SetsPolicy};

#[cfg(test)]
mod tests;

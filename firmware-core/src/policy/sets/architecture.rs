// SPDX-License-Identifier: MIT OR Apache-2.0
//! The sizes of a network.

use serde::{Deserialize, Serialize};

use super::{
    error::SetsLoadError,
    features::{MISSION_FEATURES, SENSOR_FEATURES, USER_FEATURES},
};

/// The number of attention heads.
pub const HEADS: usize = 4;

/// The largest width of a token.
pub const WIDTH_MAX: usize = 96;

/// The largest width of the hidden layer behind the attention.
pub const HIDDEN_MAX: usize = 288;

/// The largest number of attention layers.
pub const LAYERS_MAX: usize = 4;

/// The number of candidates for the displacement, of which the network chooses one.
pub const CANDIDATES: usize = 3;

/// The number of outputs per candidate of the displacement head: two free components, two gates and
/// the logit.
pub const CANDIDATE_OUTPUTS: usize = 5;

/// The sizes of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Architecture {
    /// `D`, the width of a token: a multiple of [`HEADS`], at most [`WIDTH_MAX`].
    pub width: u16,
    /// `F`, the width of the hidden layer behind the attention: 1 to [`HIDDEN_MAX`].
    pub hidden: u16,
    /// `L`, the number of attention layers: 1 to [`LAYERS_MAX`].
    pub layers: u16,
}

/// The sizes of a network, for computing.
pub(super) struct Size {
    pub(super) width: usize,
    pub(super) hidden: usize,
    pub(super) layers: usize,
}

impl Architecture {
    pub(super) fn size(&self) -> Size {
        Size {
            width: self.width.into(),
            hidden: self.hidden.into(),
            layers: self.layers.into(),
        }
    }

    /// Returns the number of weights.
    ///
    /// ```
    /// # use firmware_core::policy::sets::Architecture;
    /// let intended = Architecture { width: 64, hidden: 192, layers: 3 };
    /// assert_eq!(intended.weight_count(), 159_635);
    /// ```
    pub fn weight_count(&self) -> usize {
        let Size {
            width,
            hidden,
            layers,
        } = self.size();
        let linear = |inputs: usize, outputs: usize| outputs * (inputs + 1);
        let layer = 2 * width
            + linear(width, 3 * width)
            + linear(width, width)
            + linear(width, hidden)
            + linear(hidden, width);
        linear(SENSOR_FEATURES, width)
            + linear(width, width)
            + linear(MISSION_FEATURES + 2 * width, width)
            + linear(USER_FEATURES, width)
            + layers * layer
            + width
            + linear(width, width)
            + linear(width, CANDIDATE_OUTPUTS * CANDIDATES)
            + linear(2 * width, width)
            + linear(width, 1 + CANDIDATES)
    }

    pub(super) fn check(&self) -> Result<(), SetsLoadError> {
        let size = self.size();
        let whole_heads = size.width > 0 && size.width.is_multiple_of(HEADS);
        for (what, got, holds, expected) in [
            (
                "the width",
                self.width,
                whole_heads && size.width <= WIDTH_MAX,
                "a multiple of 4 from 4 to 96",
            ),
            (
                "the width of the hidden layer",
                self.hidden,
                (1..=HIDDEN_MAX).contains(&size.hidden),
                "1 to 288",
            ),
            (
                "the number of layers",
                self.layers,
                (1..=LAYERS_MAX).contains(&size.layers),
                "1 to 4",
            ),
        ] {
            if !holds {
                return Err(SetsLoadError::Architecture {
                    what,
                    got,
                    expected,
                });
            }
        }
        Ok(())
    }
}

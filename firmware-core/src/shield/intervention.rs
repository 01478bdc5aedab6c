// SPDX-License-Identifier: MIT OR Apache-2.0
//! The record of what the shield changed.

use serde::{Deserialize, Serialize};

/// What the shield changed in an action, if anything.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Intervention {
    /// The displacement was moved onto `F_n`.
    pub displacement: bool,
    /// The user with the highest score was not admissible.
    pub user: bool,
    /// The output was NaN, infinite or of the wrong size, and was replaced.
    pub broken_output: bool,
    /// `F_n` is empty because the vehicle is not where it was sent: the waypoint is the point
    /// of the speed disc nearest to the destination.
    pub out_of_reach: bool,
}

impl Intervention {
    /// Returns whether anything was changed.
    pub fn any(&self) -> bool {
        self.displacement || self.user || self.broken_output || self.out_of_reach
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_change_is_one() {
        let none = Intervention::default();
        assert!(!none.any());
        for change in [
            |changed: &mut Intervention| changed.displacement = true,
            |changed: &mut Intervention| changed.user = true,
            |changed: &mut Intervention| changed.broken_output = true,
            |changed: &mut Intervention| changed.out_of_reach = true,
        ] {
            let mut changed = none;
            change(&mut changed);
            assert!(changed.any(), "{changed:?}");
        }
    }
}

// SPDX-License-Identifier: MIT OR Apache-2.0
//! What the checks report about parameters.

use core::fmt;

/// A parameter that limits the mission, or that the operator should know of before it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Finding {
    /// A parameter that limits the mission.
    Clips {
        /// The name of the parameter.
        name: &'static str,
        /// The value, in the unit of the parameter.
        value: f32,
        /// What the mission needs, in the same unit.
        needed: f32,
        /// The quantity that it limits.
        what: &'static str,
    },
    /// A note for the operator.
    Note(&'static str),
    /// A parameter that was expected could not be read.
    Unread(&'static str),
    /// A parameter that clipped the mission was set.
    Set {
        /// The name of the parameter.
        name: &'static str,
        /// The original value, in the parameter's own unit.
        from: f32,
        /// The new value.
        to: f32,
    },
    /// A parameter that was set has been restored.
    Restored {
        /// The name of the parameter.
        name: &'static str,
        /// The restored value.
        value: f32,
    },
    /// A parameter that was set could not be restored.
    NotRestored {
        /// The name of the parameter.
        name: &'static str,
        /// The value before the flight.
        value: f32,
    },
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Clips {
                name,
                value,
                needed,
                what,
            } => write!(f, "{name} is {value}: it clips {what}; set it to {needed}"),
            Self::Note(words) => f.write_str(words),
            Self::Unread(name) => write!(f, "{name} could not be read"),
            Self::Set { name, from, to } => write!(f, "{name} set from {from} to {to}"),
            Self::Restored { name, value } => write!(f, "{name} restored to {value}"),
            Self::NotRestored { name, value } => {
                write!(f, "{name} was NOT restored; its former value is {value}")
            }
        }
    }
}

//! What is looked at before a flight, and said in words.

use core::fmt;

use heapless::String;

/// Something that would slow the mission or weaken it.
#[derive(Clone, Debug, PartialEq)]
pub enum Finding {
    /// A parameter that clips the mission.
    Clips {
        /// Its name.
        name: &'static str,
        /// Its value, in its own unit.
        value: f32,
        /// What the mission needs, in the same unit.
        needed: f32,
        /// What it clips.
        what: &'static str,
    },
    /// Anything else.
    Note(String<120>),
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
        }
    }
}

//! The forms of the action.

use std::f64::consts::TAU;

use numpy::{PyArrayDyn, PyReadonlyArrayDyn};
use pyo3::{exceptions::PyTypeError, prelude::*};

use crate::{arrays::readable, mission::value_error};

/// The largest number of directions of discrete actions.
const DIRECTIONS_MAX: usize = 360;

/// The form of the action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ActionKind {
    /// Displacement and a score per user, in one array.
    Box,
    /// Displacement, and a user.
    Hybrid,
    /// A number: (hover or one of the directions) x users.
    Discrete { directions: usize },
}

impl ActionKind {
    pub(super) fn named(name: &str, directions: usize) -> PyResult<Self> {
        if !(1..=DIRECTIONS_MAX).contains(&directions) {
            return Err(value_error(format!(
                "directions is {directions}, but must be 1 to {DIRECTIONS_MAX}"
            )));
        }
        match name {
            "box" => Ok(Self::Box),
            "hybrid" => Ok(Self::Hybrid),
            "discrete" => Ok(Self::Discrete { directions }),
            _ => Err(value_error(format!(
                "action is {name:?}, but must be box, hybrid or discrete"
            ))),
        }
    }

    /// Returns the length of an action mask: an entry per user, or per discrete action.
    pub(super) fn mask_length(self, users: usize) -> usize {
        match self {
            Self::Box | Self::Hybrid => users,
            Self::Discrete { directions } => (1 + directions) * users,
        }
    }
}

/// The arrays of the actions of a step.
pub(super) struct ActionArrays<'py> {
    numbers: Option<PyReadonlyArrayDyn<'py, f32>>,
    choices: Option<PyReadonlyArrayDyn<'py, i64>>,
}

impl<'py> ActionArrays<'py> {
    pub(super) fn new(
        kind: ActionKind,
        count: usize,
        users: usize,
        first: &Bound<'py, PyAny>,
        second: Option<&Bound<'py, PyArrayDyn<i64>>>,
    ) -> PyResult<Self> {
        let numbers = |width| -> PyResult<_> {
            let array = first.cast::<PyArrayDyn<f32>>()?;
            readable("actions", array, &[count, width]).map(Some)
        };
        let (numbers, choices) = match (kind, second) {
            (ActionKind::Box, None) => (numbers(2 + users)?, None),
            (ActionKind::Hybrid, Some(choices)) => {
                let choices = readable("actions[1]", choices, &[count])?;
                (numbers(2)?, Some(choices))
            }
            (ActionKind::Discrete { .. }, None) => {
                let array = first.cast::<PyArrayDyn<i64>>()?;
                (None, Some(readable("actions", array, &[count])?))
            }
            (ActionKind::Hybrid, None) => {
                return Err(PyTypeError::new_err("the users of the actions are missing"));
            }
            (_, Some(_)) => return Err(PyTypeError::new_err("actions must be one array")),
        };
        Ok(Self { numbers, choices })
    }

    pub(super) fn actions<'a>(
        &'a self,
        kind: ActionKind,
        users: usize,
        directions: &'a [[f32; 2]],
    ) -> PyResult<Actions<'a>> {
        let numbers = self.numbers.as_ref().map(|array| array.as_slice());
        let choices = self.choices.as_ref().map(|array| array.as_slice());
        Ok(Actions {
            kind,
            users,
            numbers: numbers.transpose()?.unwrap_or_default(),
            choices: choices.transpose()?.unwrap_or_default(),
            directions,
        })
    }
}

/// Returns the components of each displacement of discrete actions, hovering first.
pub(super) fn directions(kind: ActionKind) -> Vec<[f32; 2]> {
    let ActionKind::Discrete { directions } = kind else {
        return Vec::new();
    };
    let turns = (0..directions).map(|index| index as f64 * TAU / directions as f64);
    let unit = turns.map(|angle| [angle.cos() as f32, angle.sin() as f32]);
    std::iter::once([0.0, 0.0]).chain(unit).collect()
}

/// The actions of a step.
pub(super) struct Actions<'a> {
    kind: ActionKind,
    users: usize,
    numbers: &'a [f32],
    choices: &'a [i64],
    directions: &'a [[f32; 2]],
}

/// The choice of a user.
#[derive(Clone, Copy, Debug)]
pub(super) enum Wanted<'a> {
    /// The one with the highest score.
    Scores(&'a [f32]),
    /// This one.
    User(usize),
}

/// The action of an episode.
#[derive(Clone, Copy, Debug)]
pub(super) struct EpisodeAction<'a> {
    pub(super) displacement: [f32; 2],
    pub(super) wanted: Wanted<'a>,
}

impl Actions<'_> {
    /// Returns what is wrong with the actions.
    pub(super) fn problem(&self) -> Option<String> {
        if let Some(index) = self.numbers.iter().position(|x| !x.is_finite()) {
            let width = if self.kind == ActionKind::Box {
                2 + self.users
            } else {
                2
            };
            return Some(format!(
                "actions[{}][{}] is {}, but must be finite",
                index / width,
                index % width,
                self.numbers[index]
            ));
        }
        let end = match self.kind {
            ActionKind::Discrete { .. } => self.directions.len() * self.users,
            ActionKind::Box | ActionKind::Hybrid => self.users,
        } as i64;
        let index = self.choices.iter().position(|x| !(0..end).contains(x))?;
        let choice = self.choices[index];
        Some(format!(
            "the choice of actions[{index}] is {choice}, but must be 0 to {}",
            end - 1
        ))
    }

    /// Returns the action of an episode.
    pub(super) fn of(&self, index: usize) -> EpisodeAction<'_> {
        let choice = |index: usize| self.choices[index] as usize;
        match self.kind {
            ActionKind::Box => {
                let width = 2 + self.users;
                let row = &self.numbers[index * width..][..width];
                EpisodeAction {
                    displacement: [row[0], row[1]],
                    wanted: Wanted::Scores(&row[2..]),
                }
            }
            ActionKind::Hybrid => EpisodeAction {
                displacement: [self.numbers[2 * index], self.numbers[2 * index + 1]],
                wanted: Wanted::User(choice(index)),
            },
            ActionKind::Discrete { .. } => EpisodeAction {
                displacement: self.directions[choice(index) / self.users],
                wanted: Wanted::User(choice(index) % self.users),
            },
        }
    }
}

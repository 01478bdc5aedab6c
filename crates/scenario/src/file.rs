//! Reads a TOML file strictly, into what serde derives: a problem is one line that names the field,
//! the line, the value and what is allowed. Lists of a fixed length and tables need their own
//! functions here, because the `toml` crate drops the superfluous values of a list.

use std::{
    fmt,
    path::{Path, PathBuf},
};

use files::input;
use serde::{
    Deserialize, Deserializer,
    de::{DeserializeOwned, MapAccess, Visitor, value::MapAccessDeserializer},
};

/// Error returned when a file of a scenario or its events cannot be used: the file, and the reason
/// in one line.
#[derive(Debug)]
pub struct ScenarioError {
    path: PathBuf,
    problem: String,
}

impl fmt::Display for ScenarioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.path.display(), self.problem)
    }
}

impl ScenarioError {
    pub(crate) fn new(path: &Path, problem: String) -> Self {
        let path = path.to_owned();
        Self { path, problem }
    }
}

impl std::error::Error for ScenarioError {}

/// Reads the text of a file.
///
/// # Errors
/// Returns an error if the file cannot be read, is too long or is not UTF-8.
pub(crate) fn read(path: &Path) -> Result<String, ScenarioError> {
    input::read_text(path).map_err(|error| ScenarioError::new(path, error.to_string()))
}

/// Parses the text of a file.
///
/// # Errors
/// Returns one line that states what is wrong.
pub(crate) fn parse<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let table = toml::Deserializer::parse(text).map_err(|error| one_line(text, &error))?;
    serde_path_to_error::deserialize(table).map_err(|error| {
        let path = error.path().to_string();
        let problem = one_line(text, error.inner());
        match path.as_str() {
            "." => problem,
            _ => format!("{path}: {problem}"),
        }
    })
}

/// A list of exactly two numbers.
#[derive(Deserialize)]
#[serde(try_from = "Vec<f64>")]
struct Pair([f64; 2]);

const TWO_NUMBERS: &str = "but must be two numbers: east and north in metres";

impl TryFrom<Vec<f64>> for Pair {
    type Error = String;

    fn try_from(numbers: Vec<f64>) -> Result<Self, String> {
        <[f64; 2]>::try_from(numbers)
            .map(Self)
            .map_err(|numbers| match numbers.len() {
                many @ 9.. => format!("is a list of {many} numbers, {TWO_NUMBERS}"),
                _ => format!("is {numbers:?}, {TWO_NUMBERS}"),
            })
    }
}

/// Reads a list of two numbers, east and north.
pub(crate) fn pair<'de, D: Deserializer<'de>>(value: D) -> Result<[f64; 2], D::Error> {
    Pair::deserialize(value).map(|Pair(pair)| pair)
}

/// As [`pair`], for a key that need not be given.
pub(crate) fn optional_pair<'de, D: Deserializer<'de>>(
    value: D,
) -> Result<Option<[f64; 2]>, D::Error> {
    pair(value).map(Some)
}

/// As [`pair`], for a list of them.
pub(crate) fn pairs<'de, D: Deserializer<'de>>(value: D) -> Result<Vec<[f64; 2]>, D::Error> {
    let pairs = Vec::<Pair>::deserialize(value)?;
    Ok(pairs.into_iter().map(|Pair(pair)| pair).collect())
}

/// Reads a table with named keys. A list of its values without their names is refused.
pub(crate) fn table<'de, D: Deserializer<'de>, T: Deserialize<'de>>(
    value: D,
) -> Result<T, D::Error> {
    struct Named<T>(std::marker::PhantomData<T>);

    impl<'de, T: Deserialize<'de>> Visitor<'de> for Named<T> {
        type Value = T;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a table, each value with its name")
        }

        fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<T, A::Error> {
            T::deserialize(MapAccessDeserializer::new(map))
        }
    }

    value.deserialize_map(Named(std::marker::PhantomData))
}

/// As [`table`], for a key that need not be given.
pub(crate) fn optional_table<'de, D: Deserializer<'de>, T: Deserialize<'de>>(
    value: D,
) -> Result<Option<T>, D::Error> {
    table(value).map(Some)
}

/// Formats a TOML error as one line: what is wrong, and on which line of the file.
fn one_line(text: &str, error: &toml::de::Error) -> String {
    let message = error.message().replace('\n', "; ");
    match error.span() {
        Some(span) => {
            let line = 1 + text[..span.start.min(text.len())].matches('\n').count();
            let shown = text[span.start.min(text.len())..span.end.min(text.len())].trim();
            if shown.is_empty() || shown.contains('\n') || shown.len() > 60 {
                format!("{message} (line {line})")
            } else {
                format!("{message} (line {line}: `{shown}`)")
            }
        }
        None => message,
    }
}

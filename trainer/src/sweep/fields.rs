//! Reads a table of TOML field by field. Each error names the field, its value, and what would be
//! right.

use anyhow::{bail, ensure};
use toml::{Table, Value};

/// A table whose fields are taken out one by one.
#[derive(Debug)]
pub struct Fields {
    /// Path of the table in the file, with a point at its end; empty for the whole file.
    prefix: String,
    table: Table,
    /// The names that have been asked for, and thus all that are allowed.
    known: Vec<&'static str>,
}

impl Fields {
    /// Parses the text of a file.
    ///
    /// # Errors
    /// States in one line why the text is not TOML.
    pub fn parse(text: &str) -> anyhow::Result<Self> {
        let table = text.parse::<Table>().map_err(|error| {
            let start = error.span().map_or(0, |span| span.start);
            let line = 1 + text[..start.min(text.len())].matches('\n').count();
            let message = error.message().replace('\n', "; ");
            anyhow::anyhow!("line {line}: {message}")
        })?;
        Ok(Self::new(String::new(), table))
    }

    fn new(prefix: String, table: Table) -> Self {
        Self {
            prefix,
            table,
            known: Vec::new(),
        }
    }

    /// Takes a field, if it is present.
    pub fn take(&mut self, name: &'static str) -> Option<Value> {
        self.known.push(name);
        self.table.remove(name)
    }

    /// Takes a table, which is empty if it is not present.
    ///
    /// # Errors
    /// Fails if the field is not a table.
    pub fn table(&mut self, name: &'static str) -> anyhow::Result<Self> {
        let prefix = format!("{}{name}.", self.prefix);
        match self.take(name) {
            None => Ok(Self::new(prefix, Table::new())),
            Some(Value::Table(table)) => Ok(Self::new(prefix, table)),
            Some(other) => self.wrong(name, &other, &format!("a table, [{name}]")),
        }
    }

    /// Takes a value or a list of values that all differ; `expected` describes one of them.
    ///
    /// # Errors
    /// Fails if a value cannot be converted, if two are equal, or if the list is empty.
    pub fn list<T: PartialEq>(
        &mut self,
        name: &'static str,
        expected: &str,
        convert: impl Fn(&Value) -> Option<T>,
    ) -> anyhow::Result<Option<Vec<T>>> {
        let Some(value) = self.take(name) else {
            return Ok(None);
        };
        let mut values = Vec::new();
        for value in alternatives(value) {
            let Some(converted) = convert(&value) else {
                return self.wrong(name, &value, expected);
            };
            ensure!(
                !values.contains(&converted),
                "{}{name} contains {value} twice, but each run is trained once",
                self.prefix
            );
            values.push(converted);
        }
        self.ensure_some(name, &values)?;
        Ok(Some(values))
    }

    /// Takes one value.
    ///
    /// # Errors
    /// Fails if the value cannot be converted.
    pub fn one<T>(
        &mut self,
        name: &'static str,
        expected: &str,
        convert: impl Fn(&Value) -> Option<T>,
    ) -> anyhow::Result<Option<T>> {
        match self.take(name) {
            None => Ok(None),
            Some(value) => match convert(&value) {
                Some(converted) => Ok(Some(converted)),
                None => self.wrong(name, &value, expected),
            },
        }
    }

    /// Takes all remaining fields, each with its list of values.
    ///
    /// # Errors
    /// Fails if a list is empty.
    pub fn remaining(self) -> anyhow::Result<Vec<(String, Vec<Value>)>> {
        let prefix = self.prefix;
        let lists = self.table.into_iter().map(|(name, value)| {
            let values = alternatives(value);
            ensure!(
                !values.is_empty(),
                "{prefix}{name} is [], but must have a value"
            );
            Ok((name, values))
        });
        lists.collect()
    }

    /// Checks that no field is left.
    ///
    /// # Errors
    /// Names the first one that is, and those that are allowed.
    pub fn finish(self) -> anyhow::Result<()> {
        if let Some((name, value)) = self.table.iter().next() {
            bail!(
                "{}{name} = {} is unknown; known here: {}",
                self.prefix,
                short(value),
                self.known.join(", ")
            );
        }
        Ok(())
    }

    /// Returns the error for a field that is required.
    pub fn missing<T>(&self, name: &str, expected: &str) -> anyhow::Result<T> {
        bail!("{}{name} is missing: it must be {expected}", self.prefix)
    }

    /// Returns the error for a value that is not allowed.
    pub fn wrong<T>(&self, name: &str, value: &Value, expected: &str) -> anyhow::Result<T> {
        bail!(
            "{}{name} is {}, but must be {expected}",
            self.prefix,
            short(value)
        )
    }

    fn ensure_some<T>(&self, name: &str, values: &[T]) -> anyhow::Result<()> {
        ensure!(
            !values.is_empty(),
            "{}{name} is [], but must have a value",
            self.prefix
        );
        Ok(())
    }
}

/// Returns the values of a list, or the single value.
fn alternatives(value: Value) -> Vec<Value> {
    match value {
        Value::Array(values) => values,
        single => vec![single],
    }
}

/// Formats a value for an error, on one line of limited length.
pub fn short(value: &Value) -> String {
    let text = match value {
        Value::Table(_) => "a table".to_owned(),
        other => other.to_string().replace('\n', " "),
    };
    match text.char_indices().nth(60) {
        Some((end, _)) => format!("{}..", &text[..end]),
        None => text,
    }
}

/// Converts a whole number above 0.
pub fn count(value: &Value) -> Option<u32> {
    let number = value.as_integer()?;
    u32::try_from(number).ok().filter(|&number| number > 0)
}

/// Converts a text on one line that is not empty.
pub fn line(value: &Value) -> Option<String> {
    let text = value.as_str()?;
    let valid = !text.is_empty() && !text.contains(char::is_control);
    valid.then(|| text.to_owned())
}

/// Converts a word without white space.
pub fn word(value: &Value) -> Option<String> {
    line(value).filter(|text| !text.contains(char::is_whitespace))
}

/// Converts a finite number.
pub fn number(value: &Value) -> Option<f64> {
    let number = match value {
        Value::Integer(whole) => *whole as f64,
        Value::Float(number) => *number,
        _ => return None,
    };
    number.is_finite().then_some(number)
}

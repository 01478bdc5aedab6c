//! Settings that a file changes.

use serde::{Serialize, de::DeserializeOwned};

/// Returns the settings with the values that a table contains replaced; in a table within it, too.
///
/// # Errors
/// Fails if a name is unknown or if a value has another type.
pub fn overlay<S: Serialize + DeserializeOwned>(
    settings: &S,
    changes: toml::Table,
) -> anyhow::Result<S> {
    let mut table = toml::Table::try_from(settings)?;
    replace(&mut table, changes);
    Ok(table.try_into()?)
}

/// Replaces the values that `changes` contains.
fn replace(table: &mut toml::Table, changes: toml::Table) {
    for (name, value) in changes {
        match (table.get_mut(&name), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(changes)) => {
                replace(inner, changes);
            }
            (_, value) => {
                table.insert(name, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_within_a_table_keep_their_other_values() {
        let parse = |text: &str| text.parse::<toml::Table>().expect("TOML");
        let settings = parse("a = 1\n[run]\nseed = 1\nbatch = 2\n[run.sizes]\nwidth = 3\n");
        let changes = parse("a = 4\n[run]\nseed = 5\nsizes = { hidden = 6 }\n");
        let expected =
            parse("a = 4\n[run]\nseed = 5\nbatch = 2\nsizes = { width = 3, hidden = 6 }\n");
        assert_eq!(overlay(&settings, changes).expect("tables"), expected);
    }
}

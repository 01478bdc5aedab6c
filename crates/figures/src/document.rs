//! Writes tables into documents, each between two marks: `<!-- NAME -->` and `<!-- /NAME -->`.

use std::{fs, path::Path};

/// Returns the document with `text`, which must end in a newline, between the marks of this name.
///
/// # Errors
/// Returns an error that names the missing mark.
pub fn with_table(document: &str, name: &str, text: &str) -> Result<String, String> {
    let (open, close) = (format!("<!-- {name} -->"), format!("<!-- /{name} -->"));
    let split = |text: &str, mark: &str| -> Result<(String, String), String> {
        let (before, after) = text.split_once(mark).ok_or(format!("no {mark}"))?;
        Ok((before.into(), after.into()))
    };
    let (before, rest) = split(document, &open)?;
    let (_, after) = split(&rest, &close)?;
    Ok(format!("{before}{open}\n{text}{close}{after}"))
}

/// Writes a table into a file.
///
/// # Errors
/// Returns one line: the file, and what is wrong with it.
pub fn write_table(path: &Path, name: &str, text: &str) -> Result<(), String> {
    let named = |problem: String| format!("{}: {problem}", path.display());
    let document = fs::read_to_string(path).map_err(|error| named(error.to_string()))?;
    let document = with_table(&document, name, text).map_err(named)?;
    files::output::write(path, document.as_bytes()).map_err(|error| named(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_between_the_marks_changes() {
        let document = "a\n<!-- t -->\nold\n<!-- /t -->\nb <!-- u --><!-- /u -->";
        let changed = with_table(document, "t", "new\n").unwrap();
        assert_eq!(
            changed,
            document.replace("old", "new"),
            "the rest stays as it is"
        );
        assert_eq!(with_table(&changed, "t", "old\n").unwrap(), document);
    }

    #[test]
    fn a_missing_mark_is_named() {
        let missing = |document| with_table(document, "t", "x\n").unwrap_err();
        assert_eq!(missing("<!-- /t -->"), "no <!-- t -->");
        assert_eq!(missing("<!-- /t --> <!-- t -->"), "no <!-- /t -->");
    }
}

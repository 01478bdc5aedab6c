//! The documents name files and items that exist, so that a reader who searches for them finds them.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

use end_to_end::repository;

/// Returns the files below a directory that are part of the repository: no build output.
fn files(directory: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(directory).expect("a directory") {
        let path = entry.expect("readable").path();
        let name = path.file_name().expect("named").to_string_lossy();
        if ["target", ".git", "out", "artifacts", "node_modules"].contains(&&*name) {
            continue;
        }
        match path.is_dir() {
            true => files(&path, found),
            false => found.push(path),
        }
    }
}

/// Returns the texts between single backticks, outside of blocks of code.
fn quoted(text: &str) -> Vec<&str> {
    let mut is_block = false;
    let lines = text.lines().filter(|line| {
        let is_fence = line.starts_with("```");
        is_block ^= is_fence;
        !(is_block || is_fence || line.starts_with("    "))
    });
    lines
        .flat_map(|line| line.split('`').skip(1).step_by(2))
        .collect()
}

fn is_word(text: &str) -> bool {
    let is_part = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
    !text.is_empty() && text.chars().all(is_part)
}

#[test]
fn documents_name_what_exists() {
    let root = repository();
    let mut all = Vec::new();
    files(&root, &mut all);
    let names: Vec<String> = (all.iter())
        .map(|path| path.strip_prefix(&root).expect("below the root"))
        .map(|path| path.to_string_lossy().into_owned())
        .collect();
    let sources = all
        .iter()
        .filter(|path| path.extension().is_some_and(|e| e == "rs"));
    let sources: Vec<String> = sources
        .map(|path| fs::read_to_string(path).expect("text"))
        .collect();
    let letters = |letter: char| !(letter.is_ascii_alphanumeric() || letter == '_');
    let words: BTreeSet<&str> = sources
        .iter()
        .flat_map(|text| text.split(letters))
        .collect();

    let documents = names.iter().filter(|name| {
        let is_page = name
            .strip_prefix("docs/")
            .is_some_and(|rest| !rest.contains('/'));
        name.ends_with(".md") && (is_page || ["README.md", "CONTRIBUTING.md"].contains(&&***name))
    });
    let (mut checked, mut missing) = (0, Vec::new());
    for document in documents {
        let text = fs::read_to_string(root.join(document)).expect("text");
        for quoted in quoted(&text) {
            let parts: Vec<&str> = quoted.split("::").collect();
            let is_item = parts.len() > 1 && parts.iter().all(|part| is_word(part));
            let first = quoted.split('/').next().unwrap_or_default();
            let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "_-./".contains(letter);
            // What begins with a slash is a topic of a flight log.
            let is_path = quoted.contains('/')
                && !first.is_empty()
                && quoted.chars().all(is_plain)
                && !["target", "out"].contains(&first)
                && root.join(first).is_dir();
            let is_source = quoted.ends_with(".rs") && quoted.chars().all(is_plain);
            let exists = match (is_item, is_path, is_source) {
                (true, ..) => parts.iter().all(|part| words.contains(part)),
                (_, true, _) => root.join(quoted).exists(),
                (.., true) => {
                    let below = format!("/{quoted}");
                    names
                        .iter()
                        .any(|name| name.ends_with(&below) || name == quoted)
                }
                _ => continue,
            };
            checked += 1;
            if !exists {
                missing.push(format!("{document}: `{quoted}`"));
            }
        }
    }
    assert!(
        missing.is_empty(),
        "named but not there:\n{}",
        missing.join("\n")
    );
    assert!(checked > 150, "only {checked} names were found");
}

//! Starts `host-sim` as a user would.

use std::{
    path::Path,
    process::{Command, Output},
};

use serde_json::Value;

pub(crate) fn host_sim(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_host-sim"))
        .args(arguments)
        .output()
        .expect("it starts")
}

/// Returns the JSON that a successful command prints.
pub(crate) fn json(arguments: &[&str]) -> Value {
    let output = host_sim(arguments);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {errors}");
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// Returns the line of an input that is refused with exit code 2.
pub(crate) fn refusal(arguments: &[&str]) -> String {
    let output = host_sim(arguments);
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {errors}");
    assert_eq!(errors.lines().count(), 1, "{errors}");
    errors
}

pub(crate) fn text(path: &Path) -> &str {
    path.to_str().expect("a printable path")
}

pub(crate) fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().expect("a number")
}

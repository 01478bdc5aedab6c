//! The result of a command, and its exit code.

use std::{path::Path, process::ExitCode};

use anyhow::Context;
use files::output;

/// The reason why a command failed.
#[derive(Debug)]
pub(crate) enum Failure {
    /// Bad usage or bad input: exit code 2.
    BadInput(anyhow::Error),
    /// The command was executed and failed: exit code 1.
    Failed(anyhow::Error),
}

impl Failure {
    /// Prints the error on one line and returns the exit code.
    pub(crate) fn report(self) -> ExitCode {
        let (problem, code) = match self {
            Self::BadInput(problem) => (problem, 2),
            Self::Failed(problem) => (problem, 1),
        };
        eprintln!("error: {problem:#}");
        ExitCode::from(code)
    }
}

/// The result of a command.
pub(super) type Outcome = Result<(), Failure>;

/// Writes a file atomically.
pub(super) fn write(path: &Path, bytes: &[u8]) -> Outcome {
    let written = output::write(path, bytes).with_context(|| path.display().to_string());
    written.map_err(Failure::Failed)
}

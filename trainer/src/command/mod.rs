//! The command line, a module per kind of subcommand: reads arguments, calls the library, prints.

mod policies;
mod runs;
mod train;

use std::{path::Path, process::ExitCode};

use anyhow::Context;
use trainer::atomic_file::write_atomically;

pub(crate) use policies::{Convert, Evaluate, Export, Probe};
pub(crate) use runs::{Compare, Curves, Publish};
pub(crate) use train::Train;

/// Why a command did not succeed.
#[derive(Debug)]
pub(crate) enum Failure {
    /// What was asked for cannot be: exit code 2.
    BadInput(anyhow::Error),
    /// It was tried and failed: exit code 1.
    Failed(anyhow::Error),
}

impl Failure {
    /// Prints one line and gives the exit code.
    pub(crate) fn report(self) -> ExitCode {
        let (problem, code) = match self {
            Self::BadInput(problem) => (problem, 2),
            Self::Failed(problem) => (problem, 1),
        };
        eprintln!("error: {problem:#}");
        ExitCode::from(code)
    }
}

type Outcome = Result<(), Failure>;

fn write(path: &Path, bytes: &[u8]) -> Outcome {
    let written = write_atomically(path, bytes).with_context(|| path.display().to_string());
    written.map_err(Failure::Failed)
}

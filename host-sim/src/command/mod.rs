//! The command line, with a module per subcommand. Each reads its arguments, calls the library and
//! prints the result.

pub(crate) mod benchmark;
pub(crate) mod board;
pub(crate) mod bound;
pub(crate) mod doctor;
pub(crate) mod experiment;
pub(crate) mod faults;
pub(crate) mod plan;
pub(crate) mod run;
pub(crate) mod scenario;
pub(crate) mod signing;
pub(crate) mod solve;
pub(crate) mod upload;
pub(crate) mod vehicle;

use std::{
    fmt::Display,
    io::{self, IsTerminal},
    path::Path,
    process::ExitCode,
};

use ::scenario::Scenario;
use host_sim::{
    interrupt,
    policy::{HostPolicy, LoadProgress, PolicyChoice},
};
use indicatif::{ProgressBar, ProgressDrawTarget};

/// The reason why a command failed.
#[derive(Debug)]
pub(crate) enum Failure {
    /// Bad usage or bad input: exit code 2.
    BadInput(String),
    /// The command was executed and failed: exit code 1.
    Failed(String),
    /// The user ended the command with Ctrl-C: exit code 130.
    Interrupted(String),
    /// The reader of standard output closed the pipe: exit code 0.
    BrokenPipe,
}

impl Failure {
    /// Returns an error for bad usage or bad input. `problem` is one line.
    pub(crate) fn bad_input(problem: impl Display) -> Self {
        Self::BadInput(problem.to_string())
    }

    /// Returns an error for a command that failed. `problem` is one line.
    pub(crate) fn failed(problem: impl Display) -> Self {
        Self::Failed(problem.to_string())
    }

    /// Prints the error on one line and returns the exit code.
    pub(crate) fn report(self) -> ExitCode {
        let (problem, code) = match self {
            Self::BrokenPipe => return ExitCode::SUCCESS,
            Self::BadInput(problem) => (problem, 2),
            Self::Failed(problem) => (problem, 1),
            Self::Interrupted(problem) => (problem, interrupt::EXIT_CODE),
        };
        eprintln!("error: {problem}");
        ExitCode::from(code)
    }
}

impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Self {
        if error.kind() == io::ErrorKind::BrokenPipe {
            return Self::BrokenPipe;
        }
        Self::failed(error)
    }
}

/// Returns the target for progress bars: standard error if it is a terminal.
pub(crate) fn terminal() -> ProgressDrawTarget {
    if io::stderr().is_terminal() {
        ProgressDrawTarget::stderr()
    } else {
        ProgressDrawTarget::hidden()
    }
}

/// Loads the scenario named by `--scenario`: a file, or a shipped scenario.
pub(crate) fn load_scenario(argument: &Path) -> Result<Scenario, Failure> {
    Scenario::named(argument).map_err(Failure::bad_input)
}

/// Loads the policy named by `--policy`, and returns it with its name for records. Displays the
/// progress of a search or a plan.
pub(crate) fn load_policy(
    choice: &PolicyChoice,
    scenario: &Scenario,
) -> Result<(HostPolicy, String), Failure> {
    let spinner = ProgressBar::new_spinner().with_style(bound::style());
    let loaded = HostPolicy::load_watched(choice, scenario, |progress| {
        spinner.set_message(match progress {
            LoadProgress::Search(progress) => format!(
                "searching: {:.3} bit/s/Hz found, upper bound {:.3}, {} subproblems",
                progress.lower, progress.upper, progress.leaves
            ),
            LoadProgress::Plan(progress) => {
                format!("planning: {:.3} bit/s/Hz found", progress.value)
            }
        });
        spinner.tick();
    });
    spinner.finish_and_clear();
    loaded.map_err(Failure::bad_input)
}

/// Prints the warning about a policy that was trained for another mission, if there is one.
pub(crate) fn warn_of_policy(name: &str, warning: Option<&str>) {
    if let Some(warning) = warning {
        eprintln!("warning: {name}: {warning}");
    }
}

//! The command line, a module per subcommand: reads arguments, calls the library, prints.

pub(crate) mod benchmark;
pub(crate) mod board;
pub(crate) mod bound;
pub(crate) mod doctor;
pub(crate) mod experiment;
pub(crate) mod faults;
pub(crate) mod plan;
pub(crate) mod run;
pub(crate) mod scenario;
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

/// Why a command did not succeed.
#[derive(Debug)]
pub(crate) enum Failure {
    /// What was asked for cannot be: exit code 2.
    BadInput(String),
    /// It was tried and failed: exit code 1.
    Failed(String),
    /// A person ended it with ctrl-C before it was over: exit code 130.
    Interrupted(String),
    /// Whoever read our output has had enough, which is no failure.
    BrokenPipe,
}

impl Failure {
    /// Bad usage or input, in one line.
    pub(crate) fn bad_input(problem: impl Display) -> Self {
        Self::BadInput(problem.to_string())
    }

    /// A run that failed, in one line.
    pub(crate) fn failed(problem: impl Display) -> Self {
        Self::Failed(problem.to_string())
    }

    /// Prints the line and gives the exit code.
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

/// Where progress is drawn: standard error if somebody sees it there.
pub(crate) fn terminal() -> ProgressDrawTarget {
    if io::stderr().is_terminal() {
        ProgressDrawTarget::stderr()
    } else {
        ProgressDrawTarget::hidden()
    }
}

/// The scenario that `--scenario` names: a file, or the name of a shipped one.
pub(crate) fn load_scenario(argument: &Path) -> Result<Scenario, Failure> {
    Scenario::named(argument).map_err(Failure::bad_input)
}

/// The policy that `--policy` names, and its name in records. A search or a plan shows how far it
/// is.
pub(crate) fn load_policy(
    choice: &PolicyChoice,
    scenario: &Scenario,
) -> Result<(HostPolicy, String), Failure> {
    let spinner = ProgressBar::new_spinner().with_style(bound::style());
    let loaded = HostPolicy::load_watched(choice, scenario, |progress| {
        spinner.set_message(match progress {
            LoadProgress::Search(progress) => format!(
                "searching: {:.3} bit/s/Hz found, at most {:.3}, {} parts",
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

//! `host-sim solve`: solves slot problems that are given as JSON lines.

use std::{
    fs::File,
    io::{self, BufRead, BufReader, BufWriter, Write},
    path::PathBuf,
};

use clap::Args;
use reference::solve::{self, Method, Precision};

use super::Failure;

/// The options of `host-sim solve`.
#[derive(Debug, Args)]
pub(crate) struct SolveArguments {
    /// The solver
    #[arg(long, value_enum, default_value_t)]
    method: Method,
    /// Floating-point precision of the solver
    #[arg(long, value_enum, default_value_t)]
    precision: Precision,
    /// File with one slot problem per line, each a JSON object with the fields sensor_gain (array),
    /// user_gain, sensor_power_max, user_power_max, noise_power (W) and mse_threshold, and, where
    /// channels are not known exactly, sensor_error_variance (relative to the gain; a number or one
    /// per sensor), sensor_phase_error_rad (standard deviation, 0 to pi; a number or one per sensor)
    /// and user_error_variance (relative); absent, they are 0 [default: standard input]. For an
    /// invalid line {"error": ..} is printed, and the exit code is 2
    file: Option<PathBuf>,
}

/// Solves the problems line by line and prints the results on standard output. The number of invalid
/// lines is printed on standard error.
pub(crate) fn execute(arguments: &SolveArguments) -> Result<(), Failure> {
    if !arguments.method.supports(arguments.precision) {
        return Err(Failure::bad_input(
            "--precision is f32, but --method conic and conic-alternating support only f64",
        ));
    }
    let input: Box<dyn BufRead> = match &arguments.file {
        Some(path) => {
            let named = |error| Failure::bad_input(format!("{}: {error}", path.display()));
            let file = File::open(path).map_err(named)?;
            if file.metadata()?.is_dir() {
                return Err(Failure::bad_input(format!(
                    "{}: is a directory, but must be a file",
                    path.display()
                )));
            }
            Box::new(BufReader::new(file))
        }
        None => Box::new(io::stdin().lock()),
    };
    let mut output = BufWriter::new(io::stdout().lock());
    let solved = solve::run(arguments.method, arguments.precision, input, &mut output)
        .and_then(|tally| Ok(output.flush().map(|()| tally)?));
    match solved {
        Ok(tally) if tally.errors > 0 => Err(Failure::bad_input(format!(
            "{} of {} lines are not a valid slot problem",
            tally.errors, tally.lines
        ))),
        Ok(_) => Ok(()),
        // The reader of standard output closed the pipe.
        Err(error) if is_broken_pipe(&error) => Ok(()),
        Err(error) => Err(Failure::failed(error)),
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let io = error.downcast_ref::<io::Error>();
    io.is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

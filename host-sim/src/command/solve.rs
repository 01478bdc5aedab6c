//! `host-sim solve`: slot problems as JSON lines.

use std::{
    fs::File,
    io::{self, BufRead, BufReader, BufWriter, Write},
    path::PathBuf,
};

use clap::Args;
use reference::solve::{self, Method, Precision};

use super::Failure;

/// What to solve, and how.
#[derive(Debug, Args)]
pub(crate) struct SolveArguments {
    /// Which solver
    #[arg(long, value_enum, default_value_t)]
    method: Method,
    /// The arithmetic of the solver
    #[arg(long, value_enum, default_value_t)]
    precision: Precision,
    /// Slot problems, a JSON object a line; standard input without. A line that is none is
    /// answered with {"error": ..}, and the exit code is 2 at the end. Fields: sensor_gain (array),
    /// user_gain, sensor_power_max, user_power_max, noise_power (W), mse_threshold
    file: Option<PathBuf>,
}

/// Answers line by line on standard output; lines that were no problem are counted on standard
/// error.
pub(crate) fn execute(arguments: &SolveArguments) -> Result<(), Failure> {
    if !arguments.method.supports(arguments.precision) {
        return Err(Failure::bad_input(
            "--precision is f32, but --method conic and conic-alternating need f64: their solver \
             has no other",
        ));
    }
    let input: Box<dyn BufRead> = match &arguments.file {
        Some(path) => {
            let named = |error| Failure::bad_input(format!("{}: {error}", path.display()));
            let file = File::open(path).map_err(named)?;
            if file.metadata()?.is_dir() {
                return Err(Failure::bad_input(format!(
                    "{}: is a folder",
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
            "{} of {} lines were no slot problem",
            tally.errors, tally.lines
        ))),
        Ok(_) => Ok(()),
        // Whoever read our output has had enough.
        Err(error) if is_broken_pipe(&error) => Ok(()),
        Err(error) => Err(Failure::failed(error)),
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let io = error.downcast_ref::<io::Error>();
    io.is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

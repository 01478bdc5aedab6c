//! `host-sim experiment`: reproduces the paper's figures.

use std::{
    env::consts::EXE_SUFFIX,
    io::Write,
    path::{Path, PathBuf},
};

use clap::{Args, builder::PossibleValuesParser};
use host_sim::experiment::{
    Experiment, ExperimentContext, ExperimentSettings, Watcher,
    cell::Cell,
    report, robustness,
    seeds::{self, Collected},
};
use indicatif::ProgressBar;

use super::{Failure, bound::style};

/// The options of `host-sim experiment`.
#[derive(Debug, Args)]
pub(crate) struct ExperimentArguments {
    /// The figure to reproduce, or one of: all (every figure), bounds (only the certified bounds),
    /// report (drawings and page from the existing CSV files, without measuring), cards (the model
    /// card of the shipped policies), robustness (worlds that are not known exactly, on the shipped
    /// missions and on the benchmark's), seeds (the table MODELS/seeds.csv of all trainings, from the
    /// shipped policies and the finished runs in --runs)
    #[arg(value_parser = PossibleValuesParser::new(names()))]
    name: String,
    /// Output directory for NAME.csv, NAME.svg, index.html, trained policies and new bounds
    #[arg(long, default_value = "out/experiment", value_name = "DIR")]
    out: PathBuf,
    /// Directory with the shipped policies (cells/*.onnx), bounds.csv and learning_curves.csv
    #[arg(long, default_value = "models", value_name = "DIR")]
    models: PathBuf,
    /// Train the missing policies with the program `trainer`, which must be in the directory of this
    /// program. A training takes about three minutes on one core. Runs are stored in --out: finished
    /// runs are not repeated, and interrupted runs are continued
    #[arg(long)]
    train: bool,
    /// With seeds: the directory of runs, each named like its policy in MODELS/cells
    /// (separated-t60-n95-g0.015-sac-tuned-s2)
    #[arg(long, value_name = "DIR")]
    runs: Option<PathBuf>,
    /// Largest number of training seeds for each mission: flown where the policy exists, otherwise
    /// read from seeds.csv
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=16))]
    seeds: u64,
    /// Compute every bound again instead of reading bounds.csv; with robustness: fly everything again
    /// instead of keeping the rows of its tables
    #[arg(long)]
    fresh: bool,
    /// With robustness: the directory with the benchmark's missions
    #[arg(long, default_value = "benchmarks", value_name = "DIR")]
    benchmark: PathBuf,
    /// With robustness: the number of the benchmark's missions, from the first
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    missions: u64,
    /// With robustness: the number of seeds of each world
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=1000))]
    worlds: u64,
    /// With all, report or robustness: also write the page of results (docs/results.md) to this file
    #[arg(long, value_name = "FILE")]
    results: Option<PathBuf>,
    /// With bounds: also write the table between the marks in this document (docs/bound.md)
    #[arg(long, value_name = "FILE")]
    page: Option<PathBuf>,
}

const ALL: &str = "all";
const BOUNDS: &str = "bounds";
const REPORT: &str = "report";
const CARDS: &str = "cards";
const SEEDS: &str = "seeds";

fn names() -> Vec<&'static str> {
    let figures = Experiment::ALL.map(Experiment::name);
    let others = [ALL, BOUNDS, REPORT, CARDS, robustness::NAME, SEEDS];
    figures.into_iter().chain(others).collect()
}

/// Displays the current step on the terminal.
#[derive(Debug)]
struct Spinner(ProgressBar);

impl Watcher for Spinner {
    fn busy(&self, what: &str) {
        self.0.set_message(what.to_owned());
        self.0.tick();
    }
}

/// Measures figures and writes their files, or computes bounds, or writes the model card.
pub(crate) fn execute(arguments: &ExperimentArguments) -> Result<(), Failure> {
    let out = &arguments.out;
    if arguments.name == REPORT {
        return conclude(arguments, &Experiment::ALL);
    }
    let trainer = match arguments.train {
        true => Some(trainer()?),
        false => None,
    };
    let spinner = Spinner(ProgressBar::new_spinner().with_style(style()));
    let settings = ExperimentSettings {
        out: out.clone(),
        models: arguments.models.clone(),
        trainer,
        seeds: arguments.seeds,
        fresh: arguments.fresh,
    };
    let mut context = ExperimentContext::open(settings, &spinner).map_err(Failure::bad_input)?;
    let outcome = match arguments.name.as_str() {
        BOUNDS => return bounds(&mut context, &spinner, arguments.page.as_deref()),
        CARDS => {
            let page = arguments.models.join("cells/README.md");
            report::write_cards(&mut context, &page)
        }
        robustness::NAME => {
            let measured = measure_robustness(arguments, &spinner);
            spinner.0.finish_and_clear();
            return measured.map_err(Failure::failed);
        }
        SEEDS => {
            let collected = seeds::collect(&context, arguments.runs.as_deref());
            spinner.0.finish_and_clear();
            return write_collected(&collected.map_err(Failure::failed)?);
        }
        name => {
            let chosen = |experiment: &Experiment| name == ALL || experiment.name() == name;
            let chosen: Vec<Experiment> = Experiment::ALL.into_iter().filter(chosen).collect();
            let mut measured = Ok(());
            for experiment in &chosen {
                measured = measured.and_then(|()| experiment.measure(&mut context));
            }
            spinner.0.finish_and_clear();
            measured.map_err(Failure::failed)?;
            return conclude(arguments, &chosen);
        }
    };
    spinner.0.finish_and_clear();
    outcome.map_err(Failure::failed)
}

/// Writes drawings and pages, and prints the paper's claims with their verdicts.
fn conclude(arguments: &ExperimentArguments, measured: &[Experiment]) -> Result<(), Failure> {
    let out = &arguments.out;
    let mut stdout = std::io::stdout().lock();
    for &experiment in measured {
        report::write_drawing(experiment, out).map_err(Failure::failed)?;
        let claims = experiment.claims(out).map_err(Failure::failed)?;
        let drawing = out.join(format!("{}.svg", experiment.name()));
        writeln!(stdout, "{}: {}", experiment.name(), drawing.display())?;
        for claim in claims {
            writeln!(stdout, "  {}: {}", claim.verdict, claim.claimed)?;
            writeln!(stdout, "    {}", claim.measured)?;
        }
    }
    if measured.len() < Experiment::ALL.len() {
        return Ok(());
    }
    report::write_index(out).map_err(Failure::failed)?;
    writeln!(stdout, "all figures: {}", out.join("index.html").display())?;
    match &arguments.results {
        Some(path) => report::write_results(out, path).map_err(Failure::failed),
        None => Ok(()),
    }
}

/// Flies worlds that are not known exactly, and writes their files.
fn measure_robustness(arguments: &ExperimentArguments, spinner: &Spinner) -> Result<(), String> {
    let extent = robustness::Extent {
        missions: arguments.missions as usize,
        seeds: arguments.worlds,
    };
    if arguments.fresh {
        robustness::forget(&arguments.out)?;
    }
    robustness::write(&arguments.benchmark, extent, &arguments.out, spinner)?;
    robustness::write_drawings(&arguments.out)?;
    match &arguments.results {
        Some(path) => report::write_results(&arguments.out, path),
        None => Ok(()),
    }
}

/// Prints what the table of trainings contains now.
fn write_collected(collected: &Collected) -> Result<(), Failure> {
    let Collected {
        flown,
        kept,
        copied,
        unfinished,
    } = collected;
    let mut stdout = std::io::stdout().lock();
    writeln!(
        stdout,
        "{flown} trainings flown, {kept} rows kept whose policies are not there, {} policies of \
         seed 1 copied, {} runs unfinished",
        copied.len(),
        unfinished.len()
    )?;
    for name in copied {
        writeln!(stdout, "copied: {name}.onnx")?;
    }
    for name in unfinished {
        writeln!(stdout, "unfinished: {name}")?;
    }
    Ok(())
}

/// Computes the bounds of all missions of the figures and prints them.
fn bounds(
    context: &mut ExperimentContext<'_>,
    spinner: &Spinner,
    page: Option<&Path>,
) -> Result<(), Failure> {
    let mut rows = Vec::new();
    for cell in Cell::all() {
        let row = context.bound(&cell).map_err(Failure::failed)?;
        let gap = 100.0 * (row.upper - row.lower) / row.upper;
        let line = format!(
            "{cell}: upper {:.4}, lower {:.4}, gap {gap:.3} %, {:.1} s, {:.1} s of processor time",
            row.upper, row.lower, row.seconds, row.processor_seconds
        );
        spinner
            .0
            .suspend(|| writeln!(std::io::stdout(), "{line}"))?;
        rows.push(row);
    }
    spinner.0.finish_and_clear();
    match page {
        Some(page) => report::write_bounds(&rows, page).map_err(Failure::failed),
        None => Ok(()),
    }
}

/// Returns the path of the program `trainer`. It is started as a process because this program does
/// not depend on the trainer's library.
fn trainer() -> Result<PathBuf, Failure> {
    let here = std::env::current_exe().map_err(Failure::failed)?;
    let trainer = here.with_file_name(format!("trainer{EXE_SUFFIX}"));
    if trainer.is_file() {
        return Ok(trainer);
    }
    Err(Failure::bad_input(format!(
        "--train needs the program {}; build it with `cargo build --release -p trainer`",
        trainer.display()
    )))
}

//! `host-sim experiment`: the paper's figures.

use std::{
    env::consts::EXE_SUFFIX,
    io::Write,
    path::{Path, PathBuf},
};

use clap::{Args, builder::PossibleValuesParser};
use host_sim::experiment::{
    Experiment, ExperimentContext, Settings, Watcher,
    cell::Cell,
    report,
    seeds::{self, Collected},
};
use indicatif::ProgressBar;

use super::{Failure, bound::style};

/// What to make.
#[derive(Debug, Args)]
pub(crate) struct ExperimentArguments {
    /// A figure, or all of them; bounds: the certificates alone; report: page and drawings again
    /// from the CSV files that are there; cards: the card of the shipped policies; seeds: the table
    /// of trainings (MODELS/seeds.csv), from the shipped policies and the finished runs in --runs
    #[arg(value_parser = PossibleValuesParser::new(names()))]
    name: String,
    /// Where NAME.csv, NAME.svg and index.html go, and trainings and new bounds
    #[arg(long, default_value = "out/experiment", value_name = "DIR")]
    out: PathBuf,
    /// Where shipped policies (cells/*.onnx), bounds.csv and learning_curves.csv lie
    #[arg(long, default_value = "models", value_name = "DIR")]
    models: PathBuf,
    /// Train the policies that are missing with the trainer beside this program: some three minutes
    /// each on one core. Runs are kept in DIR: what is finished is never trained again, what was
    /// stopped goes on
    #[arg(long)]
    train: bool,
    /// With seeds: the directory of runs, each named as its policy in MODELS/cells
    /// (separated-t60-n95-g0.015-sac-tuned-s2)
    #[arg(long, value_name = "DIR")]
    runs: Option<PathBuf>,
    /// Seeds of a training that are measured: flown where the policy is there, otherwise read from
    /// seeds.csv
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..=16))]
    seeds: u64,
    /// Certify every bound anew instead of reading bounds.csv
    #[arg(long)]
    fresh: bool,
    /// With all or report: also write the page of results (docs/results.md)
    #[arg(long, value_name = "FILE")]
    results: Option<PathBuf>,
    /// With bounds: also put the table between the marks of this page (docs/bound.md)
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
    let others = [ALL, BOUNDS, REPORT, CARDS, SEEDS];
    figures.into_iter().chain(others).collect()
}

/// Shows what is being done on a terminal.
#[derive(Debug)]
struct Spinner(ProgressBar);

impl Watcher for Spinner {
    fn busy(&self, what: &str) {
        self.0.set_message(what.to_owned());
        self.0.tick();
    }
}

/// Does it.
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
    let settings = Settings {
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

/// Drawings, pages, and the verdicts in words.
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
    writeln!(stdout, "all of them: {}", out.join("index.html").display())?;
    match &arguments.results {
        Some(path) => report::write_results(out, path).map_err(Failure::failed),
        None => Ok(()),
    }
}

/// What the table of trainings has now.
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

/// Every certificate of the figures' missions, and their table.
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
            "{cell}: upper {:.4}, lower {:.4}, gap {gap:.3} %, {:.1} s, {:.1} s of processors",
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

/// The trainer depends on this program's library and not the other way round, so it is called as
/// a program.
fn trainer() -> Result<PathBuf, Failure> {
    let here = std::env::current_exe().map_err(Failure::failed)?;
    let trainer = here.with_file_name(format!("trainer{EXE_SUFFIX}"));
    if trainer.is_file() {
        return Ok(trainer);
    }
    Err(Failure::bad_input(format!(
        "--train needs the trainer at {}: cargo build --release -p trainer builds it",
        trainer.display()
    )))
}

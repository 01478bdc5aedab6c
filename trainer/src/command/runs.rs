//! `trainer publish|compare|curves`: the commands for finished runs.

use std::path::{Path, PathBuf};

use anyhow::{Context, Error, ensure};
use clap::Args;
use figures::document;
use firmware_core::policy::sets::Precision;
use trainer::{
    any_mission, card,
    compare::{Comparison, References},
    curves::{self, Curve},
    imitation,
    metrics::{EVALUATION, SUM_RATE},
    onnx,
    run::{CHECKPOINT, Run},
    sweep::results::{SweepResults, is_sweep},
};

use super::outcome::{Failure, Outcome, write};

#[derive(Debug, Args)]
pub(crate) struct Publish {
    /// The directory of a run
    run: PathBuf,
    /// Path without extension of the files to write: STEM.onnx, STEM.md, STEM.svg, and STEM.policy of
    /// a run with --missions random
    #[arg(long)]
    stem: PathBuf,
    /// The command that trained the policy, for the model card
    #[arg(long)]
    command: String,
    /// With a run of --missions random: the network of the last step instead of the best evaluated one.
    /// Where all evaluations are equal within their noise, it is the one with the lowest learning rate
    #[arg(long)]
    latest: bool,
    /// With a run of --missions random: take the mean of the weights of four networks, the best and the
    /// latest ones of the run and of this other run, which it started from
    #[arg(long, value_name = "RUN")]
    average_with: Option<PathBuf>,
}

impl Publish {
    pub(crate) fn execute(self) -> Outcome {
        for (extension, bytes) in self.files().map_err(Failure::BadInput)? {
            // with_extension would cut a stem at its last dot.
            let mut path = self.stem.clone().into_os_string();
            path.push(format!(".{extension}"));
            write(Path::new(&path), &bytes)?;
        }
        Ok(())
    }

    fn files(&self) -> anyhow::Result<Vec<(&'static str, Vec<u8>)>> {
        let name = self.stem.file_name().unwrap_or_default().to_string_lossy();
        let checkpoint = self.run.join(CHECKPOINT);
        if any_mission::method(&checkpoint).is_some() {
            let mut network = any_mission::read_network(&checkpoint, self.latest)?;
            if let Some(other) = &self.average_with {
                let other = other.join(CHECKPOINT);
                let others = [
                    any_mission::read_network(&checkpoint, !self.latest)?,
                    any_mission::read_network(&other, false)?,
                    any_mission::read_network(&other, true)?,
                ];
                network
                    .average_with(&others)
                    .with_context(|| other.display().to_string())?;
            }
            let mut summary = any_mission::read_summary(&checkpoint)?;
            if self.latest {
                summary.best_step = summary.steps;
            }
            let card = imitation::card::markdown(&name, &self.command, &network, &summary)?;
            return Ok(vec![
                ("onnx", onnx::sets::write(&network, Precision::Half)?),
                ("policy", network.to_policy_file(Precision::Half)?),
                ("md", card.into_bytes()),
                ("svg", curves::of_held_out(&summary.rows).into_bytes()),
            ]);
        }
        let only_random = [
            ("--latest", self.latest),
            ("--average-with", self.average_with.is_some()),
        ];
        for (option, given) in only_random {
            ensure!(!given, "{option} is only for a run with --missions random");
        }
        let Run { progress, scenario } = Run::open(&self.run)?;
        let best = progress.best.as_ref();
        let best = best.context("the run has no admissible policy")?;
        let references = References::of(&scenario.mission)?;
        let card = card::markdown(&name, &self.command, &progress, best, &references);
        let curve = card::learning_curve(&progress.rows, &references);
        Ok(vec![
            ("onnx", onnx::write(&best.actor)),
            ("md", card.into_bytes()),
            ("svg", curve.into_bytes()),
        ])
    }
}

#[derive(Debug, Args)]
pub(crate) struct Compare {
    /// The directories of the runs, or the one directory of a sweep, whose table has a row for each
    /// scenario and choice of settings over the seeds
    #[arg(required = true)]
    runs: Vec<PathBuf>,
    /// Write the table to this document, between <!-- NAME --> and <!-- /NAME -->
    #[arg(long, value_name = "FILE", requires = "name")]
    into: Option<PathBuf>,
    /// The NAME in these two comments
    #[arg(long, requires = "into")]
    name: Option<String>,
    /// Fail unless on every mission SAC is above the straight line and not below DDPG
    #[arg(long)]
    check: bool,
}

impl Compare {
    pub(crate) fn execute(self) -> Outcome {
        if let Some(directory) = self.runs.iter().find(|directory| is_sweep(directory)) {
            return self.compare_sweep(directory).map_err(Failure::BadInput);
        }
        let comparison = Comparison::of(&self.runs).map_err(Failure::BadInput)?;
        self.write(&comparison.markdown())
            .map_err(Failure::BadInput)?;
        if self.check {
            comparison.check().map_err(Failure::Failed)?;
        }
        Ok(())
    }

    fn compare_sweep(&self, directory: &Path) -> anyhow::Result<()> {
        let place = directory.display();
        ensure!(
            self.runs.len() == 1,
            "{place} is the directory of a sweep, which is compared alone"
        );
        ensure!(
            !self.check,
            "{place} is the directory of a sweep: --check compares runs, {place}/*"
        );
        let results = SweepResults::read(directory)?;
        self.write(&results.markdown())?;
        if results.unfinished > 0 {
            eprintln!("{} runs are not finished", results.unfinished);
        }
        Ok(())
    }

    fn write(&self, table: &str) -> anyhow::Result<()> {
        match (&self.into, &self.name) {
            (Some(path), Some(name)) => {
                document::write_table(path, name, table).map_err(Error::msg)
            }
            _ => {
                print!("{table}");
                Ok(())
            }
        }
    }
}

#[derive(Debug, Args)]
pub(crate) struct Curves {
    /// The directories of the runs
    #[arg(required = true)]
    runs: Vec<PathBuf>,
    /// The CSV file to write
    #[arg(long)]
    out: PathBuf,
    /// Also draw the curves of all runs into this SVG file
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Number of episodes that a row averages over
    #[arg(long, default_value_t = 40)]
    window: usize,
}

impl Curves {
    pub(crate) fn execute(self) -> Outcome {
        let text = self.text().map_err(Failure::BadInput)?;
        write(&self.out, text.as_bytes())?;
        if let Some(path) = &self.svg {
            let drawing = self.drawing().map_err(Failure::BadInput)?;
            write(path, drawing.as_bytes())?;
        }
        Ok(())
    }

    fn drawing(&self) -> anyhow::Result<String> {
        let mut drawn = Vec::new();
        for directory in &self.runs {
            let Run { progress, .. } = Run::open(directory)?;
            let name = directory.file_name().unwrap_or_default().to_string_lossy();
            drawn.push(Curve::of(name.into_owned(), &progress.rows, self.window));
        }
        Ok(curves::drawing(&drawn))
    }

    fn text(&self) -> anyhow::Result<String> {
        let mut text = String::from(
            "scenario,scenario_digest,algorithm,learning_rate,discount,seed,episode,\
             episodic_return,sum_rate,eval_sum_rate\n",
        );
        for directory in &self.runs {
            let Run { progress, .. } = Run::open(directory)?;
            let s = &progress.settings;
            for rows in progress.rows.chunks(self.window.max(1)) {
                let mean = |column: &str| {
                    let values: Vec<f64> = rows.iter().filter_map(|row| row.get(column)).collect();
                    match values.len() {
                        0 => String::new(),
                        count => format!("{:.4}", values.iter().sum::<f64>() / count as f64),
                    }
                };
                text += &format!(
                    "{},{},{},{},{},{},{},{},{},{}\n",
                    progress.scenario,
                    progress.scenario_digest,
                    s.algorithm.name(),
                    s.policy_learning_rate,
                    s.discount,
                    s.seed,
                    rows[rows.len() - 1].episode,
                    mean("charts/episodic_return"),
                    mean(SUM_RATE),
                    mean(EVALUATION),
                );
            }
        }
        Ok(text)
    }
}

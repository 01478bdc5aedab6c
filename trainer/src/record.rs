//! What the runs that train a policy for any mission have in common: steps, time, metrics, the best
//! network, and the loop that learns, evaluates and saves.

use std::{path::Path, time::Instant};

use anyhow::Context;
use files::output;
use pulp::Arch;
use serde::{Deserialize, Serialize};

use crate::{
    imitation::{
        held_out::{Evaluation, HeldOut},
        settings::Schedule,
    },
    metrics::{self, HELD_OUT, MetricsRow},
    nn::sets::SetNetwork,
    run::{METRICS, SETTINGS},
    tensorboard::EventWriter,
};

/// Threads of a run. Its results do not depend on them.
#[derive(Clone, Copy, Debug)]
pub struct Threads {
    /// That compute gradients.
    pub gradient: usize,
    /// That plan missions.
    pub planning: usize,
}

impl Default for Threads {
    fn default() -> Self {
        Self {
            gradient: 1,
            planning: 1,
        }
    }
}

/// The best network so far.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Best {
    /// Its mean fraction of the planner's totals.
    pub mean: f64,
    /// The step after which it was evaluated.
    pub step: u64,
    /// Its parameters, in the order of the file.
    pub parameters: Vec<f32>,
}

/// What a run did so far.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Progress {
    /// The number of gradient steps.
    pub step: u64,
    /// The duration, seconds.
    pub seconds: f64,
    /// The rows of the metrics.
    pub rows: Vec<MetricsRow>,
    /// The best network.
    pub best: Option<Best>,
    /// The sums of the losses since the last row.
    pub losses: Vec<f64>,
    /// The number of steps since the last row.
    pub losses_since: u64,
}

/// The progress of a run while it runs.
#[derive(Debug)]
pub struct Record {
    progress: Progress,
    started: Instant,
}

/// What differs between the runs.
pub trait Learning {
    /// The names of the losses, in the order in which they are noted.
    const LOSSES: &'static [&'static str];

    /// Returns the schedule.
    fn schedule(&self) -> Schedule;

    /// Returns the directory of the run.
    fn directory(&self) -> &Path;

    /// Returns the record.
    fn record(&self) -> &Record;

    /// Returns the record, to be changed.
    fn record_mut(&mut self) -> &mut Record;

    /// Returns the network that is learned.
    fn network(&self) -> &SetNetwork;

    /// Returns the number of missions learned from.
    fn missions(&self) -> u64;

    /// Performs one gradient step, when `fraction` (0 to 1) of the run is done.
    ///
    /// # Errors
    /// Fails if a loss is not finite.
    fn learn(&mut self, fraction: f64) -> anyhow::Result<()>;

    /// Writes the checkpoint.
    ///
    /// # Errors
    /// Returns the file system's error.
    fn save(&mut self) -> anyhow::Result<()>;
}

impl Record {
    /// Continues from earlier progress.
    pub fn new(progress: Progress) -> Self {
        Self {
            progress,
            started: Instant::now(),
        }
    }

    /// Returns the progress with the duration until now.
    pub fn progress(&self) -> Progress {
        Progress {
            seconds: self.seconds(),
            ..self.progress.clone()
        }
    }

    /// Returns the number of gradient steps so far.
    pub fn step(&self) -> u64 {
        self.progress.step
    }

    /// Returns the rows of the metrics so far.
    pub fn rows(&self) -> &[MetricsRow] {
        &self.progress.rows
    }

    /// Returns the duration of the run so far, seconds.
    fn seconds(&self) -> f64 {
        self.progress.seconds + self.started.elapsed().as_secs_f64()
    }

    /// Returns how much of the run is done, 0 to 1.
    fn fraction(&self, schedule: &Schedule) -> f64 {
        match schedule.steps {
            0 => self.seconds() / (60.0 * schedule.minutes),
            steps => self.step() as f64 / steps as f64,
        }
    }

    /// Counts a gradient step and adds its losses.
    pub fn note(&mut self, losses: impl ExactSizeIterator<Item = f64>) {
        let progress = &mut self.progress;
        progress.losses.resize(losses.len(), 0.0);
        for (sum, loss) in progress.losses.iter_mut().zip(losses) {
            *sum += loss;
        }
        progress.losses_since += 1;
        progress.step += 1;
    }

    /// Keeps a network if it is the best so far.
    fn keep(&mut self, evaluation: &Evaluation, network: &SetNetwork) {
        let progress = &mut self.progress;
        let best = progress.best.as_ref();
        let better = best.is_none_or(|best| evaluation.mean > best.mean);
        if evaluation.violated == 0 && better {
            progress.best = Some(Best {
                mean: evaluation.mean,
                step: progress.step,
                parameters: network.export(),
            });
        }
    }

    /// Adds a row to the metrics, and returns it.
    fn add_row(
        &mut self,
        names: &[&str],
        missions: u64,
        evaluation: Option<&Evaluation>,
    ) -> MetricsRow {
        let progress = &mut self.progress;
        let count = progress.losses_since as f64;
        let means = progress.losses.iter().map(|sum| sum / count);
        let mut values: Vec<(String, f64)> = (names.iter().zip(means))
            .map(|(&name, mean)| (name.to_owned(), mean))
            .collect();
        if let Some(e) = evaluation {
            let [mean, low, worst] = HELD_OUT;
            let evaluated = [
                (mean, e.mean),
                (low, e.low),
                (worst, e.worst),
                ("charts/held_out_violated", e.violated as f64),
            ];
            values.extend(evaluated.map(|(name, x)| (name.to_owned(), x)));
        }
        let row = MetricsRow {
            episode: missions as u32,
            global_step: progress.step,
            values,
        };
        progress.rows.push(row.clone());
        progress.losses.fill(0.0);
        progress.losses_since = 0;
        row
    }
}

/// Trains until the run is complete, and returns the best evaluation's mean fraction.
///
/// # Errors
/// Fails if a loss is not finite or a file cannot be written.
pub fn run(
    learning: &mut impl Learning,
    held_out: &HeldOut,
    arch: Arch,
    show_progress: bool,
) -> anyhow::Result<Option<f64>> {
    let schedule = learning.schedule();
    let mut events = EventWriter::create(learning.directory())?;
    let (first_step, started) = (learning.record().step(), Instant::now());
    loop {
        let fraction = learning.record().fraction(&schedule);
        if fraction < 1.0 {
            learning.learn(fraction)?;
        }
        // The last step is always evaluated and saved, also if it is only due for a report.
        let over = learning.record().fraction(&schedule) >= 1.0;
        let step = learning.record().step();
        let due = |every: u64| over || step.is_multiple_of(every);
        if due(schedule.report_every) && learning.record().progress.losses_since > 0 {
            let evaluate = due(schedule.evaluate_every);
            let evaluation = match evaluate {
                true => Some(held_out.evaluate(arch, learning.network())?),
                false => None,
            };
            let states = (step - first_step) as f64 * schedule.batch as f64;
            let speed = states / started.elapsed().as_secs_f64();
            report(learning, evaluation, speed, show_progress, &mut events)?;
            if evaluate {
                let path = learning.directory().join(METRICS);
                metrics::write_csv(&path, learning.record().rows())?;
                learning.save()?;
                events.flush()?;
            }
        }
        if over {
            let best = learning.record().progress.best.as_ref();
            return Ok(best.map(|best| best.mean));
        }
    }
}

/// Adds a row to the metrics, shows it, and keeps the network if it is the best so far.
fn report<L: Learning>(
    learning: &mut L,
    evaluation: Option<Evaluation>,
    states_per_second: f64,
    show: bool,
    events: &mut EventWriter,
) -> anyhow::Result<()> {
    let missions = learning.missions();
    if let Some(evaluation) = &evaluation {
        let network = learning.network().clone();
        learning.record_mut().keep(evaluation, &network);
    }
    let record = learning.record_mut();
    let row = record.add_row(L::LOSSES, missions, evaluation.as_ref());
    if show {
        let shown: Vec<String> = (row.values.iter())
            .map(|(name, x)| format!("{} {x:.4}", name.rsplit('/').next().unwrap_or(name)))
            .collect();
        eprintln!(
            "{:.1} min, step {}, {missions} missions, {states_per_second:.0} states/s: {}",
            record.seconds() / 60.0,
            row.global_step,
            shown.join(", ")
        );
    }
    let scalars = (row.values.iter()).map(|(name, x)| (name.as_str(), *x as f32));
    let speed = [("charts/SPS", states_per_second as f32)];
    events.scalars(row.global_step, scalars.chain(speed))?;
    Ok(())
}

/// Writes the settings of a run into its directory.
///
/// # Errors
/// Returns the file system's error.
pub fn save_settings(directory: &Path, settings: &impl Serialize) -> anyhow::Result<()> {
    let settings = toml::to_string(settings)?;
    let path = directory.join(SETTINGS);
    output::write(&path, settings.as_bytes()).with_context(|| path.display().to_string())
}

/// Returns the Euclidean norm, with a sum in double precision.
pub fn norm(gradient: &[f32]) -> f32 {
    let squares = gradient.iter().map(|&g| f64::from(g) * f64::from(g));
    squares.sum::<f64>().sqrt() as f32
}

/// Scales a gradient that is longer than `longest` to that length. Returns its length before.
pub fn limit_norm(gradient: &mut [f32], longest: f32) -> f32 {
    let norm = norm(gradient);
    let scale = (longest / norm).min(1.0);
    gradient.iter_mut().for_each(|g| *g *= scale);
    norm
}

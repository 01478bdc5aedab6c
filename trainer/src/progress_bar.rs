//! The progress bar of a training run.

use indicatif::{ProgressBar, ProgressStyle};

use crate::{checkpoint::TrainingProgress, metrics::SUM_RATE};

/// Number of episodes that the figures beside the bar are averaged over.
const RECENT: usize = 100;

/// Returns a progress bar at the run's present episode; a hidden one unless `shown`.
pub(crate) fn progress_bar(progress: &TrainingProgress, shown: bool) -> ProgressBar {
    if !shown {
        return ProgressBar::hidden();
    }
    let template = "{bar:30} episode {pos}/{len} [{elapsed}, {eta} left] {msg}";
    let style = ProgressStyle::with_template(template);
    let bar = ProgressBar::new(progress.settings.episodes.into());
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_position(progress.episode.into());
    bar
}

/// Returns the text beside the bar: means over the last episodes, best policy and speed.
pub(crate) fn message(progress: &TrainingProgress, slots_per_second: f64) -> String {
    let rows = &progress.rows;
    let recent = &rows[rows.len().saturating_sub(RECENT)..];
    let mean = |column: &str| {
        let sum: f64 = recent.iter().filter_map(|row| row.get(column)).sum();
        sum / recent.len() as f64
    };
    let best = progress.best.as_ref();
    let best = best.map_or("none".into(), |best| format!("{:.2}", best.flight.sum_rate));
    format!(
        "return {:.2}, rate {:.2}, arrived {:.0}%, best {best}, {slots_per_second:.0} slots/s",
        mean("charts/episodic_return"),
        mean(SUM_RATE),
        100.0 * mean("charts/arrived"),
    )
}

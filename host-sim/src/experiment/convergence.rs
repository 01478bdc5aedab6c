//! Learning curves of SAC with Table I's settings at several learning rates.

use figures::{
    chart::{Axis, Chart, Panel},
    series::{Look, Series},
};
use serde::{Deserialize, Serialize};

use super::{
    cell::{Cell, Learner, Preset, Topology, Training},
    claims::{Claim, Tally, Verdict},
    context::ExperimentContext,
    learning_rows::{LearningRow, TABLE_ONE_RATE, rate_of},
    rounded, statistics,
};

/// The learning rates in ascending order, as the trainer takes them; Table I's is the second.
const LEARNING_RATES: [&str; 4] = ["3e-5", "1e-4", "3e-4", "1e-3"];
/// The number of seeds, from 1.
const SEEDS: u64 = 3;

/// A row of `convergence.csv`: the mean over the seeds, for the episodes up to `episode`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct CurveRow {
    learning_rate: f64,
    episode: u32,
    runs: usize,
    episodic_return: f64,
    /// Half the width of the 95 % confidence interval.
    interval_95: Option<f64>,
}

impl CurveRow {
    /// Returns the ends of the confidence interval; the mean twice if there is none.
    fn interval(&self) -> (f64, f64) {
        let (mean, half) = (self.episodic_return, self.interval_95.unwrap_or(0.0));
        (mean - half, mean + half)
    }
}

/// Returns the trainings that the figure needs.
pub(super) fn trainings() -> Vec<Training> {
    let cell = Cell::table_one(Topology::Separated);
    let of_rate = |rate: &'static str| {
        (1..=SEEDS).map(move |seed| Training {
            learning_rate: (rate != TABLE_ONE_RATE).then_some(rate),
            ..Training::new(cell, Learner::Sac(Preset::TableOne), seed)
        })
    };
    LEARNING_RATES.into_iter().flat_map(of_rate).collect()
}

/// Computes the means over the seeds.
pub(super) fn measure(context: &mut ExperimentContext<'_>) -> Result<Vec<CurveRow>, String> {
    let rows = context.trainings().learning_curves(&trainings())?;
    let digest = Cell::table_one(Topology::Separated).scenario()?.digest();
    let mut curves = Vec::new();
    for rate in LEARNING_RATES.map(rate_of) {
        let of_rate: Vec<&LearningRow> =
            rows.iter().filter(|row| row.is_of(rate, &digest)).collect();
        let mut episodes: Vec<u32> = of_rate.iter().map(|row| row.episode).collect();
        episodes.sort_unstable();
        episodes.dedup();
        for episode in episodes {
            let at = of_rate.iter().filter(|row| row.episode == episode);
            let returns: Vec<f64> = at.map(|row| row.episodic_return).collect();
            curves.push(CurveRow {
                learning_rate: rate,
                episode,
                runs: returns.len(),
                episodic_return: rounded(statistics::mean(&returns)),
                interval_95: statistics::half_width_95(&returns).map(rounded),
            });
        }
    }
    Ok(curves)
}

fn of_rate(rows: &[CurveRow], rate: f64) -> Vec<&CurveRow> {
    rows.iter()
        .filter(|row| row.learning_rate == rate)
        .collect()
}

/// Draws the mean and its band over the episodes.
pub(super) fn chart(title: &str, rows: &[CurveRow]) -> Chart {
    let series = LEARNING_RATES.iter().enumerate().map(|(index, text)| {
        let curve = of_rate(rows, rate_of(text));
        let points = curve
            .iter()
            .map(|row| (f64::from(row.episode), row.episodic_return));
        let band = curve.iter().map(|row| row.interval());
        let name = match *text == TABLE_ONE_RATE {
            true => format!("learning rate {text} (Table I)"),
            false => format!("learning rate {text}"),
        };
        Series {
            band: band.collect(),
            mark_every: 10,
            ..Series::new(name, Look::nth(index), points.collect())
        }
    });
    let runs = rows.iter().map(|row| row.runs).max().unwrap_or(0);
    let episodes = rows.iter().map(|row| f64::from(row.episode));
    Chart {
        title: title.into(),
        panels: vec![Panel {
            title: match runs {
                1 => "SAC, separated topology: one seed each".into(),
                2 => "SAC, separated topology: mean of two seeds".into(),
                _ => format!("SAC, separated topology: mean and 95 % interval of {runs} seeds"),
            },
            x: Axis {
                ticks: 9,
                ..Axis::new("episode", [0.0, episodes.fold(1.0, f64::max)])
            },
            y: Axis::around(
                "return of an episode, bit/s/Hz",
                rows.iter().flat_map(|row| {
                    let (low, high) = row.interval();
                    [low, high]
                }),
            ),
            series: series.collect(),
        }],
        columns: 1,
        size: [700.0, 360.0],
    }
}

/// The properties of the curve of one learning rate.
struct Course {
    rate: f64,
    /// The mean return over the last tenth of all episodes.
    end: f64,
    /// The first episode from which on the mean stays within 2 % of the final value of the best
    /// rate.
    settled: Option<u32>,
    /// The standard deviation of the curve over its last half, around its own mean.
    unrest: f64,
    /// Whether all seeds reached the last episode.
    complete: bool,
}

fn courses(rows: &[CurveRow]) -> Vec<Course> {
    let last = rows.iter().map(|row| row.episode).max().unwrap_or(0);
    let mean_from = |curve: &[&CurveRow], share: f64| -> Vec<f64> {
        let from = share * f64::from(last);
        let late = curve.iter().filter(|row| f64::from(row.episode) > from);
        late.map(|row| row.episodic_return).collect()
    };
    let curves = LEARNING_RATES.map(|text| (rate_of(text), of_rate(rows, rate_of(text))));
    let ends = curves
        .iter()
        .map(|(_, curve)| statistics::mean(&mean_from(curve, 0.9)));
    let best = ends.fold(f64::NEG_INFINITY, f64::max);
    curves
        .iter()
        .map(|(rate, curve)| {
            let near = |row: &&&CurveRow| row.episodic_return >= 0.98 * best;
            let settled = curve.iter().rev().take_while(near).last();
            Course {
                rate: *rate,
                end: statistics::mean(&mean_from(curve, 0.9)),
                settled: settled.map(|row| row.episode),
                unrest: statistics::deviation(&mean_from(curve, 0.5)).unwrap_or(f64::NAN),
                complete: match (curve.first(), curve.last()) {
                    (Some(first), Some(end)) => (end.episode, end.runs) == (last, first.runs),
                    _ => false,
                },
            }
        })
        .collect()
}

/// Returns the claims that the training converges, that small learning rates are slow and that
/// large ones are unstable.
pub(super) fn claims(rows: &[CurveRow]) -> Vec<Claim> {
    let courses = courses(rows);
    let describe = |what: &dyn Fn(&Course) -> String| -> String {
        let each = courses
            .iter()
            .map(|course| format!("{:e}: {}", course.rate, what(course)));
        each.collect::<Vec<_>>().join("; ")
    };
    let settled = |course: &Course| match course.settled {
        Some(episode) => format!("from episode {episode}"),
        None => "never".into(),
    };
    let at = |text: &str| courses.iter().find(|course| course.rate == rate_of(text));
    let (slowest, table_one, fastest) = (
        at(LEARNING_RATES[0]),
        at(TABLE_ONE_RATE),
        at(LEARNING_RATES[3]),
    );
    let patience =
        |course: Option<&Course>| course.and_then(|course| course.settled).unwrap_or(u32::MAX);
    let runs = rows.iter().map(|row| row.runs).max().unwrap_or(0);
    let mut converged = Tally::default();
    converged.add(table_one.is_some_and(|course| course.complete && course.settled.is_some()));
    let slow = patience(slowest) > patience(table_one);
    let rough = match (fastest, table_one) {
        (Some(fast), Some(table)) => !fast.complete || fast.unrest > table.unrest,
        _ => false,
    };
    let worse = match (fastest, table_one) {
        (Some(fast), Some(table)) => !fast.complete || fast.end < table.end,
        _ => false,
    };
    vec![
        Claim::new(
            "Training converges at Table I's learning rate.",
            converged.verdict(),
            format!(
                "Within 2 % of the best rate's last tenth and staying there: {}.",
                describe(&settled)
            ),
            "",
        ),
        Claim::new(
            "A learning rate that is too small converges slowly.",
            Verdict::of(usize::from(slow), 1),
            format!(
                "{} settles {}, {} {}.",
                LEARNING_RATES[0],
                slowest.map_or("never".into(), settled),
                TABLE_ONE_RATE,
                table_one.map_or("never".into(), settled),
            ),
            "",
        ),
        Claim::new(
            "A learning rate that is too large fluctuates and may miss the optimum or diverge.",
            Verdict::of(usize::from(rough) + usize::from(worse), 2),
            format!(
                "Standard deviation of the curve over its second half, and mean return of its last \
                 tenth, of {runs} seed(s) each: {}.",
                describe(&|course| match course.complete {
                    true => format!("{:.2}, {:.2}", course.unrest, course.end),
                    false => "stopped: a loss exceeded its limit".into(),
                })
            ),
            match courses.iter().all(|course| course.complete) {
                true => {
                    "No rate up to ten times Table I's is too large for this mission: no run stopped."
                }
                false => "",
            },
        ),
    ]
}

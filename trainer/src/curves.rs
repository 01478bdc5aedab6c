//! Learning curves of several runs in one drawing.

use figures::{
    chart::{Axis, Chart, Panel, SIZE},
    series::{Look, Series},
};

use crate::metrics::{EVALUATION, HELD_OUT, MetricsRow, SUM_RATE};

/// A learning curve: the mean total rate of the episodes up to each point.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// The name in the legend.
    pub name: String,
    /// Episode and total rate, bit/s/Hz.
    pub points: Vec<(f64, f64)>,
}

impl Curve {
    /// Creates the curve of a run with a point for each `window` episodes: the evaluations of the
    /// deterministic policy, or the episodes with exploration if the run has no evaluations.
    pub fn of(name: String, rows: &[MetricsRow], window: usize) -> Self {
        let evaluated = means(rows, EVALUATION, window);
        let points = match evaluated.is_empty() {
            true => means(rows, SUM_RATE, window),
            false => evaluated,
        };
        Self { name, points }
    }
}

/// Returns the last episode of each `window` episodes and the mean of a column over them. Windows
/// without a value in this column are left out.
pub(crate) fn means(rows: &[MetricsRow], column: &str, window: usize) -> Vec<(f64, f64)> {
    let point = |rows: &[MetricsRow]| {
        let values: Vec<f64> = rows.iter().filter_map(|row| row.get(column)).collect();
        let last = rows.last()?;
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (!values.is_empty()).then_some((f64::from(last.episode), mean))
    };
    rows.chunks(window.max(1)).filter_map(point).collect()
}

/// Returns the drawing as SVG.
pub fn drawing(curves: &[Curve]) -> String {
    let series = curves.iter().enumerate().map(|(index, curve)| {
        let look = Look::nth(index).without_marks();
        Series::new(curve.name.clone(), look, curve.points.clone())
    });
    over_episodes("Learning curves", series.collect())
}

/// Draws the evaluations on held-out missions over the missions learned from, as SVG.
pub fn of_held_out(rows: &[MetricsRow]) -> String {
    let names = ["mean", "5 % quantile", "worst"].into_iter().enumerate();
    let series = names.zip(HELD_OUT).map(|((index, name), column)| {
        let look = Look::nth(index).without_marks();
        Series::new(name, look, means(rows, column, 1))
    });
    let axes = ["missions", "fraction of the planner's total"];
    drawn("Learning curve", axes, series.collect())
}

/// Draws total rates over episodes.
pub(crate) fn over_episodes(title: &str, series: Vec<Series>) -> String {
    drawn(title, ["episode", "total rate, bit/s/Hz"], series)
}

fn drawn(title: &str, [x, y]: [&str; 2], series: Vec<Series>) -> String {
    let points = || series.iter().flat_map(|series| &series.points);
    let last = points().map(|point| point.0).fold(1.0, f64::max);
    let panel = Panel {
        title: String::new(),
        x: Axis {
            ticks: 8,
            ..Axis::new(x, [0.0, last])
        },
        y: Axis::around(y, points().map(|point| point.1)),
        series,
    };
    let chart = Chart {
        title: title.into(),
        panels: vec![panel],
        columns: 1,
        size: SIZE,
    };
    chart.to_svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_run_has_its_line_and_its_name() {
        let curve = |name: &str, level: f64| Curve {
            name: name.into(),
            points: (1..=10)
                .map(|step| (f64::from(40 * step), level + f64::from(step)))
                .collect(),
        };
        let drawn = drawing(&[curve("seed 1", 40.0), curve("seed 2", 50.0)]);
        assert!(drawn.starts_with("<svg"), "{drawn}");
        // One line in the panel and one in the legend.
        assert_eq!(drawn.matches("<path").count(), 4, "{drawn}");
        for words in [
            "seed 1",
            "seed 2",
            "episode",
            "total rate, bit/s/Hz",
            ">400<",
        ] {
            assert!(drawn.contains(words), "{words}: {drawn}");
        }
    }
}

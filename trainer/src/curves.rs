//! Learning curves of several runs in one drawing.

use figures::{
    axis::{self, Key, LEFT, Panel, RIGHT, Scale},
    markup::{Element, PathData, element, label, line},
    quantity, theme,
};

use crate::metrics::{EVALUATION, Row};

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
    pub fn of(name: String, rows: &[Row], window: usize) -> Self {
        let of_column = |column: &str| -> Vec<(f64, f64)> {
            let windows = rows.chunks(window.max(1));
            let point = |rows: &[Row]| {
                let values: Vec<f64> = rows.iter().filter_map(|row| row.get(column)).collect();
                let last = rows.last()?;
                let mean = values.iter().sum::<f64>() / values.len() as f64;
                (!values.is_empty()).then_some((f64::from(last.episode), mean))
            };
            windows.filter_map(point).collect()
        };
        let evaluated = of_column(EVALUATION);
        let points = match evaluated.is_empty() {
            true => of_column("charts/sum_rate"),
            false => evaluated,
        };
        Self { name, points }
    }
}

/// Where the legend begins.
const LEGEND_Y: f64 = 14.0;
/// The height of the panel.
const PANEL: f64 = 240.0;
/// Dashes of lines that follow each other, so that they differ without colour, too.
const DASHES: [&str; 4] = ["none", "8 4", "2 3", "12 3 2 3"];

/// Returns the drawing as SVG.
pub fn drawing(curves: &[Curve]) -> String {
    let keys = curves.iter().enumerate().map(|(index, curve)| Key {
        mark: styled(
            line("computed", [-9.0, 0.0], [9.0, 0.0]),
            index,
            curves.len(),
        ),
        words: curve.name.clone(),
    });
    let (legend, foot) = axis::legend(keys.collect(), [LEFT, LEGEND_Y]);
    let (top, bottom) = (foot + 16.0, foot + 16.0 + PANEL);
    let points = || curves.iter().flat_map(|curve| &curve.points);
    let panel = Panel {
        top,
        bottom,
        scale: Scale::around(points().map(|point| point.1), [bottom, top]),
    };
    let last = points().map(|point| point.0).fold(1.0, f64::max);
    let episodes = Scale::linear([0.0, last], [LEFT, RIGHT]);
    let mut ticks = element("g");
    for tick in episodes.ticks(8) {
        let x = episodes.at(tick.value);
        ticks.push(label("tick middle", [x, bottom + 16.0], tick.label));
    }
    let lines = curves.iter().enumerate().map(|(index, curve)| {
        let places = curve.points.iter();
        let places = places.map(|&(episode, rate)| [episodes.at(episode), panel.scale.at(rate)]);
        styled(
            PathData::through(places).path("computed"),
            index,
            curves.len(),
        )
    });
    let described = quantity::count(curves.len(), "run");
    let middle = (LEFT + RIGHT) / 2.0;
    let figure = axis::figure(bottom + 40.0, "Learning curves", &described)
        .with(theme::drawing_style())
        .with(
            element("rect")
                .class("paper")
                .set("width", "100%")
                .set("height", "100%"),
        )
        .with(legend)
        .with(panel.draw("total rate, bit/s/Hz"))
        .with(panel.base())
        .with(ticks)
        .with(label("axis middle", [middle, bottom + 34.0], "episode"))
        .with_all(lines);
    format!("{figure}\n")
}

/// Gives a line the appearance of the run of this index. The lightest colours of the map are not
/// used, because they are hard to see on paper.
fn styled(line: Element, index: usize, of: usize) -> Element {
    let share = 0.85 * index as f64 / of.max(2).saturating_sub(1) as f64;
    let dashes = DASHES[index % DASHES.len()];
    line.set(
        "style",
        format!("stroke:{};stroke-dasharray:{dashes}", theme::viridis(share)),
    )
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
        assert_eq!(drawn.matches("<path").count(), 2, "{drawn}");
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

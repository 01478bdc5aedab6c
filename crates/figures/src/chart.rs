//! Charts of series in one or several panels, with axes and one legend above all panels, where it
//! covers no point.

use crate::{
    axis::{self, Key, LEFT, RIGHT, Scale, WIDTH},
    markup::{Element, element, label, rectangle},
    placement::Placement,
    series::{SAMPLE_WIDTH, Series},
    theme,
};

/// An axis of a panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// The title, with the unit.
    pub title: String,
    /// The smallest and the largest value. What is outside is drawn at the border.
    pub range: [f64; 2],
    /// The approximate number of ticks of a horizontal axis. Those of a vertical one follow from
    /// its height.
    pub ticks: usize,
}

impl Axis {
    /// Creates an axis with about six ticks.
    pub fn new(title: impl Into<String>, range: [f64; 2]) -> Self {
        Self {
            title: title.into(),
            range,
            ticks: 6,
        }
    }

    /// Creates an axis that contains all finite `values` with a small margin.
    pub fn around(title: impl Into<String>, values: impl Iterator<Item = f64>) -> Self {
        let (low, high) = values
            .filter(|value| value.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            });
        if low > high {
            return Self::new(title, [0.0, 1.0]);
        }
        let margin = match 0.06 * (high - low) {
            margin if margin > 1e-9 * high.abs() => margin,
            _ => 0.1 * high.abs().max(1e-9),
        };
        Self::new(title, [low - margin, high + margin])
    }

    /// Makes the axis start at zero.
    pub fn from_zero(self) -> Self {
        Self {
            range: [0.0, self.range[1]],
            ..self
        }
    }
}

/// One coordinate system.
#[derive(Clone, Debug)]
pub struct Panel {
    /// The text above the panel; empty for none.
    pub title: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// The series. The first one is drawn last, on top of the others.
    pub series: Vec<Series>,
}

/// Several panels, row by row. A name stands for the same series in all of them.
#[derive(Clone, Debug)]
pub struct Chart {
    /// What the chart shows, for readers who do not see it.
    pub title: String,
    /// The panels.
    pub panels: Vec<Panel>,
    /// The number of panels in a row.
    pub columns: usize,
    /// The width and height of the area in which a panel's series are drawn.
    pub size: [f64; 2],
}

/// The width and height of a panel's area, unless something speaks for another: as wide as the
/// panels of all other figures.
pub const SIZE: [f64; 2] = [RIGHT - LEFT, 300.0];

/// The vertical coordinate of the legend's first row.
const LEGEND_Y: f64 = 16.0;
/// The space above panels with titles.
const ABOVE: f64 = 34.0;
/// The space above panels without titles.
const ABOVE_UNTITLED: f64 = 14.0;
/// The space below a panel for ticks and the axis's title.
const BELOW: f64 = 42.0;

impl Chart {
    /// Returns the chart for a page with the style sheet [`theme::page_style`].
    pub fn to_element(&self) -> Element {
        self.draw(false)
    }

    /// Returns the chart as a file of its own.
    pub fn to_svg(&self) -> String {
        format!("{}\n", self.draw(true))
    }

    fn draw(&self, is_file: bool) -> Element {
        let columns = self.columns.max(1);
        let rows = self.panels.len().div_ceil(columns);
        let above = match self.panels.iter().all(|panel| panel.title.is_empty()) {
            true => ABOVE_UNTITLED,
            false => ABOVE,
        };
        let cell = [
            self.size[0] + WIDTH - (RIGHT - LEFT),
            self.size[1] + above + BELOW,
        ];
        let width = cell[0] * columns as f64;
        let (legend, foot) = self.legend(width);
        let size = [width, foot + 8.0 + cell[1] * rows as f64];
        let mut figure = axis::figure_of_size(size, &self.title, &self.description())
            .class("chart")
            .at("width", size[0])
            .at("height", size[1]);
        if is_file {
            figure.push(theme::chart_style());
            figure.push(rectangle("paper", [0.0, 0.0], size));
        }
        figure.push(legend);
        for (index, panel) in self.panels.iter().enumerate() {
            let left = LEFT + cell[0] * (index % columns) as f64;
            let top = foot + 8.0 + above + cell[1] * (index / columns) as f64;
            figure.push(panel.draw([left, top], self.size));
        }
        figure
    }

    /// Draws the legend of all panels. Returns it with the `y` below it.
    fn legend(&self, width: f64) -> (Element, f64) {
        let mut listed: Vec<&Series> = Vec::new();
        for series in self.panels.iter().flat_map(|panel| &panel.series) {
            if !series.name.is_empty() && listed.iter().all(|known| known.name != series.name) {
                listed.push(series);
            }
        }
        if listed.is_empty() {
            return (element("g"), 0.0);
        }
        let keys = listed.into_iter().map(|series| Key {
            mark: series.sample(),
            words: series.name.clone(),
        });
        let ends = [LEFT, width - (WIDTH - RIGHT)];
        let (legend, y) = axis::legend_within(keys.collect(), ends, LEGEND_Y, SAMPLE_WIDTH);
        (legend, y + 8.0)
    }

    fn description(&self) -> String {
        let panels = self.panels.iter().map(|panel| {
            let axes = format!("{} over {}", panel.y.title, panel.x.title);
            match panel.title.as_str() {
                "" => axes,
                title => format!("{title}: {axes}"),
            }
        });
        panels.collect::<Vec<_>>().join("; ")
    }
}

impl Panel {
    fn draw(&self, [left, top]: [f64; 2], [width, height]: [f64; 2]) -> Element {
        let (right, bottom) = (left + width, top + height);
        let x = Scale::linear(self.x.range, [left, right]);
        let y = Scale::linear(self.y.range, [bottom, top]);
        let frame = axis::Panel {
            left,
            right,
            top,
            bottom,
            scale: y,
        };
        let scales = [&x, &y];
        let mut placement = Placement::within([left, top], [right, bottom]);
        for series in &self.series {
            series.occupy(scales, &mut placement);
        }
        let layers = || self.series.iter().rev();
        element("g")
            .with(label(
                "headline middle",
                [f64::midpoint(left, right), top - 10.0],
                self.title.clone(),
            ))
            .with(axis::horizontal(
                &x,
                [top, bottom],
                self.x.ticks,
                &self.x.title,
            ))
            .with(frame.draw(&self.y.title))
            .with(frame.base())
            .with_all(layers().filter_map(|series| series.draw_band(scales)))
            .with_all(layers().map(|series| series.draw(scales)))
            .with_all(
                layers()
                    .filter(|series| !series.labels.is_empty())
                    .map(|series| series.draw_labels(scales, &mut placement)),
            )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::series::Look;

    fn panel(title: &str, series: Vec<Series>) -> Panel {
        Panel {
            title: title.into(),
            x: Axis::new("time, s", [0.0, 10.0]),
            y: Axis::new("height, m", [0.0, 100.0]),
            series,
        }
    }

    fn chart(panels: Vec<Panel>) -> Chart {
        Chart {
            title: "Heights".into(),
            columns: 2,
            panels,
            size: SIZE,
        }
    }

    #[test]
    fn a_name_in_several_panels_is_listed_once_and_every_axis_has_its_title() {
        let series = |name: &str| Series::new(name, Look::nth(0), vec![(0.0, 0.0), (10.0, 100.0)]);
        let panels = ["a < b", "c", "d"].map(|title| {
            panel(
                title,
                vec![series("balloon & crew"), series(""), series(title)],
            )
        });
        let drawn = chart(panels.into()).to_svg();
        let count = |text: &str| drawn.matches(text).count();
        assert_eq!(count(">balloon &amp; crew<"), 1);
        assert_eq!(count(">time, s<"), 3);
        assert_eq!(count(">height, m<"), 3);
        assert_eq!(count(">a &lt; b<"), 2, "a panel and a key");
        assert!(
            !drawn.contains("var(--"),
            "a file has its colours as values"
        );
        assert!(!drawn.contains("NaN"));
    }

    #[test]
    fn points_are_between_the_ends_of_their_axes() {
        let series = Series {
            band: vec![(-50.0, 50.0), (50.0, 150.0)],
            labels: vec!["first".into(), "last".into()],
            ..Series::new("s", Look::nth(1), vec![(0.0, 0.0), (10.0, 100.0)])
        };
        let drawn = chart(vec![panel("p", vec![series])])
            .to_element()
            .to_string();
        let [left, right, bottom] = [LEFT, RIGHT, LEGEND_Y + 16.0 + ABOVE + SIZE[1]];
        let top = bottom - SIZE[1];
        let diagonal = format!("M{left} {bottom}L{right} {top}");
        assert!(drawn.contains(&diagonal), "{diagonal} in {drawn}");
        let middle = f64::midpoint(top, bottom);
        let band = format!("M{left} {bottom}L{right} {middle}L{right} {top}L{left} {middle}Z");
        assert!(drawn.contains(&band), "{band} in {drawn}");
        assert!(drawn.contains(">first<") && drawn.contains(">last<"));
    }

    #[test]
    fn axes_contain_their_values() {
        let axis = Axis::around("", [3.0, f64::NAN, 7.0].into_iter());
        assert!(axis.range[0] < 3.0 && axis.range[1] > 7.0);
        assert_eq!(axis.from_zero().range[0], 0.0);
        for values in [vec![], vec![0.0], vec![5.0, 5.0]] {
            let axis = Axis::around("", values.iter().copied());
            assert!(axis.range[0] < axis.range[1], "{axis:?}");
            for value in values {
                assert!(axis.range[0] <= value && value <= axis.range[1], "{axis:?}");
            }
        }
    }
}

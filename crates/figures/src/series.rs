//! Series of points in a chart: lines, marks, bands and texts at the points. Series differ by mark
//! and dash as well as by colour, so a black-and-white print contains the same information.

use crate::{
    axis::Scale,
    markup::{Element, PathData, element, label},
    placement::{Align, Placement},
    theme,
};

/// The mark of the points of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Marker {
    /// A filled circle.
    Circle,
    /// A filled square.
    Square,
    /// A filled triangle.
    Triangle,
    /// A filled square that stands on a corner.
    Diamond,
    /// An x.
    Cross,
    /// A plus sign.
    Plus,
    /// An open circle.
    Ring,
    /// A small filled circle.
    Dot,
}

/// The line between the points of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// The points are not connected.
    None,
    /// A continuous line.
    Solid,
    /// The lengths of dashes and gaps, as SVG takes them.
    Dashed(&'static str),
}

/// The colour of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Color {
    /// The colour of this index, from 0. There are seven, after which they repeat.
    Series(usize),
    /// The colour of texts.
    Ink,
    /// A grey, for what the chart is not about.
    Soft,
}

/// The appearance of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Look {
    /// The mark of its points, if they have one.
    pub marker: Option<Marker>,
    /// The line between its points.
    pub line: Line,
    /// The colour of both.
    pub color: Color,
}

const MARKERS: [Marker; 7] = [
    Marker::Circle,
    Marker::Square,
    Marker::Triangle,
    Marker::Diamond,
    Marker::Cross,
    Marker::Plus,
    Marker::Ring,
];

const LINES: [Line; 4] = [
    Line::Solid,
    Line::Dashed("8 4"),
    Line::Dashed("2 3"),
    Line::Dashed("12 3 2 3"),
];

impl Look {
    /// Returns the appearance of the series of this index, with marks and a line. The first 28
    /// differ from each other in colour or dash, and all of the same colour in both.
    pub fn nth(index: usize) -> Self {
        // The shift gives the same colour another mark and another dash when it comes again.
        let shifted = index + 2 * (index / theme::SERIES);
        Self {
            marker: Some(MARKERS[shifted % MARKERS.len()]),
            line: LINES[shifted % LINES.len()],
            color: Color::Series(index),
        }
    }

    /// Returns the appearance with a line only.
    pub fn without_marks(self) -> Self {
        Self {
            marker: None,
            ..self
        }
    }
}

impl Color {
    fn class(self) -> &'static str {
        const CLASSES: [&str; theme::SERIES] = [
            "series-1", "series-2", "series-3", "series-4", "series-5", "series-6", "series-7",
        ];
        match self {
            Self::Series(index) => CLASSES[index % CLASSES.len()],
            Self::Ink => "series-ink",
            Self::Soft => "series-soft",
        }
    }
}

/// A series of points.
#[derive(Clone, Debug)]
pub struct Series {
    /// The name in the legend; a series with an empty name is not listed.
    pub name: String,
    /// The appearance.
    pub look: Look,
    /// The points, in the units of the axes.
    pub points: Vec<(f64, f64)>,
    /// The lower and upper limit for each point, drawn as a band under the line; empty for no band.
    pub band: Vec<(f64, f64)>,
    /// A text at each point; empty for no texts.
    pub labels: Vec<String>,
    /// The distance of the marked points: 1 marks every point.
    pub mark_every: usize,
}

/// The size of marks: about half their width.
const RADIUS: f64 = 4.0;
/// The size of the letters of texts at points.
const LABEL_SIZE: f64 = 11.0;
/// The width of the piece of a series that a legend shows.
pub(crate) const SAMPLE_WIDTH: f64 = 38.0;

impl Series {
    /// Creates a series in which every point is marked, without band and texts.
    pub fn new(name: impl Into<String>, look: Look, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.into(),
            look,
            points,
            band: Vec::new(),
            labels: Vec::new(),
            mark_every: 1,
        }
    }

    /// Draws the band.
    pub(crate) fn draw_band(&self, [x, y]: [&Scale; 2]) -> Option<Element> {
        let limits = || self.points.iter().zip(&self.band);
        let lower = limits().map(|(point, band)| [x.at(point.0), y.at(band.0)]);
        let upper = limits().map(|(point, band)| [x.at(point.0), y.at(band.1)]);
        let mut outline = PathData::through(lower.chain(upper.rev()));
        outline.close();
        let class = format!("{} band", self.look.color.class());
        (!self.band.is_empty()).then(|| outline.path(class))
    }

    /// Draws the line and the marks.
    pub(crate) fn draw(&self, scales: [&Scale; 2]) -> Element {
        let mut group = element("g");
        let points: Vec<[f64; 2]> = self.positions(scales).collect();
        if self.look.line != Line::None {
            group.push(self.look.stroke(points.iter().copied()));
        }
        let marked = points.into_iter().step_by(self.mark_every.max(1));
        group.with_all(self.look.marks(marked))
    }

    fn positions(&self, [x, y]: [&Scale; 2]) -> impl Iterator<Item = [f64; 2]> {
        self.points
            .iter()
            .map(|point| [x.at(point.0), y.at(point.1)])
    }

    /// Draws the piece of the series that a legend shows, around the origin.
    pub(crate) fn sample(&self) -> Element {
        let half = SAMPLE_WIDTH / 2.0;
        let mut group = element("g");
        if self.look.line != Line::None {
            group.push(self.look.stroke([[-half, 0.0], [half, 0.0]]));
        }
        group.with_all(self.look.marks([[0.0, 0.0]]))
    }

    /// Marks the positions that texts must not cover.
    pub(crate) fn occupy(&self, scales: [&Scale; 2], placement: &mut Placement) {
        let every = self.mark_every.max(1);
        for (index, position) in self.positions(scales).enumerate() {
            let radius = match self.look.marker {
                Some(Marker::Dot) => 2.0,
                Some(_) if index % every == 0 => RADIUS,
                _ => 0.5,
            };
            placement.take(position, radius);
        }
    }

    /// Draws the texts where they cover least.
    pub(crate) fn draw_labels(&self, scales: [&Scale; 2], placement: &mut Placement) -> Element {
        let labels = self.positions(scales).zip(&self.labels);
        element("g").with_all(labels.map(|(position, words)| {
            let spot = placement.place(position, RADIUS, words, LABEL_SIZE);
            let class = match spot.align {
                Align::Start => "node",
                Align::Middle => "node middle",
                Align::End => "node end",
            };
            label(class, spot.at, words.clone())
        }))
    }
}

impl Look {
    fn stroke(self, points: impl IntoIterator<Item = [f64; 2]>) -> Element {
        let class = format!("{} curve", self.color.class());
        let path = PathData::through(points).path(class);
        match self.line {
            Line::Dashed(lengths) => path.set("stroke-dasharray", lengths),
            Line::None | Line::Solid => path,
        }
    }

    /// Draws all marks as one path, which keeps files small.
    fn marks(self, centers: impl IntoIterator<Item = [f64; 2]>) -> Option<Element> {
        let marker = self.marker?;
        let mut path = PathData::default();
        for center in centers {
            marker.draw(center, &mut path);
        }
        let kind = match marker {
            Marker::Cross | Marker::Plus | Marker::Ring => "open-mark",
            Marker::Circle | Marker::Square | Marker::Triangle | Marker::Diamond | Marker::Dot => {
                "mark"
            }
        };
        Some(path.path(format!("{} {kind}", self.color.class())))
    }
}

impl Marker {
    fn draw(self, center: [f64; 2], path: &mut PathData) {
        let r = RADIUS;
        let mut strokes = |strokes: &[&[[f64; 2]]], closed: bool| {
            for stroke in strokes {
                for (index, [dx, dy]) in stroke.iter().enumerate() {
                    let [x, y] = [center[0] + dx, center[1] + dy];
                    match index {
                        0 => path.move_to(x, y),
                        _ => path.line_to(x, y),
                    }
                }
                if closed {
                    path.close();
                }
            }
        };
        match self {
            Self::Circle => path.circle(center, r),
            Self::Ring => path.circle(center, r + 0.5),
            Self::Dot => path.circle(center, 2.2),
            Self::Square => strokes(&[&[[-r, -r], [r, -r], [r, r], [-r, r]]], true),
            Self::Triangle => {
                strokes(&[&[[0.0, -r - 1.0], [r + 1.0, r], [-r - 1.0, r]]], true);
            }
            Self::Diamond => {
                let r = r + 1.0;
                strokes(&[&[[0.0, -r], [r, 0.0], [0.0, r], [-r, 0.0]]], true);
            }
            Self::Cross => strokes(&[&[[-r, -r], [r, r]], &[[-r, r], [r, -r]]], false),
            Self::Plus => {
                let r = r + 1.5;
                strokes(&[&[[-r, 0.0], [r, 0.0]], &[[0.0, -r], [0.0, r]]], false);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looks_differ_without_colour_as_long_as_there_are_marks_and_dashes() {
        let without_colour = |index| (Look::nth(index).marker, Look::nth(index).line);
        for index in 0..7 {
            for other in 0..index {
                assert_ne!(without_colour(index), without_colour(other));
            }
        }
        let class = |index| (Look::nth(index).color.class(), Look::nth(index).line);
        for index in 0..28 {
            for other in 0..index {
                assert_ne!(class(index), class(other), "{index}, {other}");
            }
        }
    }

    #[test]
    fn every_mark_is_drawn_around_its_point() {
        for marker in MARKERS.into_iter().chain([Marker::Dot]) {
            let look = Look {
                marker: Some(marker),
                line: Line::None,
                color: Color::Soft,
            };
            let marks = look.marks([[100.0, 50.0], [20.0, 30.0]]).unwrap();
            let marks = marks.to_string();
            assert!(marks.matches('M').count() >= 2, "{marks}");
            let path = marks.split("d=\"").nth(1).unwrap();
            let first = path.trim_start_matches('M').split(['L', 'a']).next();
            let [x, y] = first
                .unwrap()
                .split_once(' ')
                .map(|(x, y)| [x, y].map(|text| text.parse::<f64>().unwrap()))
                .unwrap();
            assert!((x - 100.0).hypot(y - 50.0) <= 2.0 * RADIUS, "{marks}");
        }
    }
}

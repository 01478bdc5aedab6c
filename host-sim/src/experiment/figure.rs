//! Drawings of several panels, as SVG. Series differ by marker and dash as well as by colour, and
//! the colours differ in lightness: a black-and-white print contains the same information.

use std::iter::{Once, once};

use plotters::{
    chart::{ChartBuilder, ChartContext, SeriesLabelPosition},
    coord::{Shift, types::RangedCoordf64},
    element::{Drawable, EmptyElement, PointCollection, Polygon, Text},
    prelude::{Cartesian2d, DrawingArea, DrawingAreaErrorKind, IntoDrawingArea, SVGBackend},
    series::{DashedLineSeries, LineSeries},
    style::{
        BLACK, Color, IntoFont, RGBColor, ShapeStyle, TextStyle, WHITE,
        text_anchor::{HPos, Pos, VPos},
    },
};
use plotters_backend::{BackendCoord, DrawingBackend, DrawingErrorKind};

/// The marker of the points of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Marker {
    Circle,
    Square,
    Triangle,
    Diamond,
    Cross,
    Plus,
    Dot,
}

/// The line between the points of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Line {
    None,
    Solid,
    /// The lengths of dash and gap, pixels.
    Dashed(u32, u32),
}

/// The appearance of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Look {
    pub(super) marker: Marker,
    pub(super) line: Line,
    pub(super) color: [u8; 3],
}

/// The appearances in the order in which a figure uses them, from dark to light and dark again.
pub(super) const LOOKS: [Look; 7] = [
    look(Marker::Circle, Line::Solid, [16, 16, 16]),
    look(Marker::Square, Line::Dashed(8, 4), [176, 48, 16]),
    look(Marker::Triangle, Line::Dashed(2, 4), [20, 110, 190]),
    look(Marker::Diamond, Line::Dashed(12, 3), [0, 130, 90]),
    look(Marker::Cross, Line::Dashed(5, 2), [200, 120, 0]),
    look(Marker::Plus, Line::Solid, [140, 90, 160]),
    look(Marker::Circle, Line::Dashed(4, 4), [150, 30, 90]),
];

/// Creates an appearance.
pub(super) const fn look(marker: Marker, line: Line, color: [u8; 3]) -> Look {
    Look {
        marker,
        line,
        color,
    }
}

/// A series of points.
#[derive(Clone, Debug)]
pub(super) struct Series {
    /// The name in the legend; a series with an empty name is not listed.
    pub(super) name: String,
    pub(super) look: Look,
    pub(super) points: Vec<(f64, f64)>,
    /// The lower and upper limit for each point, drawn as a band under the line; empty for no band.
    pub(super) band: Vec<(f64, f64)>,
    /// A text at each point; empty for no texts.
    pub(super) labels: Vec<String>,
    /// The distance of the marked points: 1 marks every point.
    pub(super) mark_every: usize,
}

impl Series {
    pub(super) fn new(name: impl Into<String>, look: Look, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.into(),
            look,
            points,
            band: Vec::new(),
            labels: Vec::new(),
            mark_every: 1,
        }
    }
}

/// An axis: its label with the unit, and its range.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    pub(super) label: String,
    pub(super) from: f64,
    pub(super) to: f64,
    /// The approximate number of tick labels.
    pub(super) ticks: usize,
    /// The number of decimal digits.
    pub(super) digits: usize,
}

impl Axis {
    /// Creates an axis that contains all `values` with a small margin.
    pub(super) fn around(label: &str, values: impl Iterator<Item = f64>, digits: usize) -> Self {
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
            (low.min(x), high.max(x))
        });
        let room = 0.06 * (high - low).max(1e-9);
        Self {
            label: label.into(),
            from: low - room,
            to: high + room,
            ticks: 6,
            digits,
        }
    }

    /// Makes the axis start at zero.
    pub(super) fn with_zero(self) -> Self {
        Self { from: 0.0, ..self }
    }
}

/// One coordinate system.
#[derive(Clone, Debug)]
pub(super) struct Panel {
    pub(super) title: String,
    pub(super) x: Axis,
    pub(super) y: Axis,
    pub(super) series: Vec<Series>,
    pub(super) legend: SeriesLabelPosition,
}

/// Several panels, row by row.
#[derive(Clone, Debug)]
pub(super) struct Figure {
    pub(super) panels: Vec<Panel>,
    pub(super) columns: usize,
    /// The size of a panel, pixels.
    pub(super) size: (u32, u32),
}

type Problem<'a> = DrawingAreaErrorKind<<SVGBackend<'a> as DrawingBackend>::ErrorType>;
type Ground<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Plane<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

const FONT: &str = "sans-serif";
const TEXT: u32 = 13;
const MARK: i32 = 4;

impl Figure {
    /// Draws the figure.
    ///
    /// # Errors
    /// Returns the error of the plotting crate in one line.
    pub(super) fn to_svg(&self) -> Result<String, String> {
        let rows = self.panels.len().div_ceil(self.columns);
        let size = (self.size.0 * self.columns as u32, self.size.1 * rows as u32);
        let mut svg = String::new();
        self.draw(&mut svg, size, rows)
            .map_err(|problem| problem.to_string())?;
        Ok(svg)
    }

    fn draw<'a>(
        &self,
        svg: &'a mut String,
        size: (u32, u32),
        rows: usize,
    ) -> Result<(), Problem<'a>> {
        let root = SVGBackend::with_string(svg, size).into_drawing_area();
        root.fill(&WHITE)?;
        let areas = root.split_evenly((rows, self.columns));
        for (panel, area) in self.panels.iter().zip(&areas) {
            panel.draw(area)?;
        }
        root.present()
    }
}

impl Panel {
    fn draw<'a>(&self, area: &Ground<'a>) -> Result<(), Problem<'a>> {
        let (x, y) = (&self.x, &self.y);
        let mut plane = ChartBuilder::on(area)
            .caption(&self.title, (FONT, TEXT + 3))
            .margin(10)
            .x_label_area_size(42)
            .y_label_area_size(56)
            .build_cartesian_2d(x.from..x.to, y.from..y.to)?;
        plane
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(RGBColor(225, 225, 225))
            .x_desc(&x.label)
            .y_desc(&y.label)
            .x_labels(x.ticks)
            .y_labels(y.ticks)
            .x_label_formatter(&|value| format!("{value:.*}", x.digits))
            .y_label_formatter(&|value| format!("{value:.*}", y.digits))
            .label_style((FONT, TEXT))
            .axis_desc_style((FONT, TEXT))
            .draw()?;
        for series in &self.series {
            series.draw_band(&mut plane)?;
        }
        for series in &self.series {
            series.draw(&mut plane)?;
        }
        if self.series.iter().all(|series| series.name.is_empty()) {
            return Ok(());
        }
        plane
            .configure_series_labels()
            .position(self.legend.clone())
            .legend_area_size(34)
            .margin(6)
            .background_style(WHITE.mix(0.85))
            .border_style(RGBColor(190, 190, 190))
            .label_font((FONT, TEXT))
            .draw()
    }
}

impl Series {
    fn style(&self) -> ShapeStyle {
        let [red, green, blue] = self.look.color;
        RGBColor(red, green, blue).stroke_width(2)
    }

    fn draw_band<'b>(&self, plane: &mut Plane<'_, 'b>) -> Result<(), Problem<'b>> {
        if self.band.is_empty() {
            return Ok(());
        }
        let low = self.points.iter().zip(&self.band).map(|(p, b)| (p.0, b.0));
        let high = self.points.iter().zip(&self.band).map(|(p, b)| (p.0, b.1));
        let outline: Vec<(f64, f64)> = low.chain(high.rev()).collect();
        let [red, green, blue] = self.look.color;
        let fill = RGBColor(red, green, blue).mix(0.18).filled();
        plane.draw_series([Polygon::new(outline, fill)])?;
        Ok(())
    }

    fn draw<'b>(&self, plane: &mut Plane<'_, 'b>) -> Result<(), Problem<'b>> {
        let (look, style) = (self.look, self.style());
        let points = self.points.iter().copied();
        let drawn = match look.line {
            Line::None => plane.draw_series(std::iter::empty::<Sign<(f64, f64)>>())?,
            Line::Solid => plane.draw_series(LineSeries::new(points, style))?,
            Line::Dashed(on, off) => {
                plane.draw_series(DashedLineSeries::new(points, on, off, style))?
            }
        };
        if !self.name.is_empty() {
            drawn.label(&self.name).legend(move |at| Sign {
                at,
                marker: look.marker,
                sample: Some(look.line),
                style,
            });
        }
        let marked = self.points.iter().step_by(self.mark_every.max(1));
        plane.draw_series(marked.map(|&at| Sign {
            at,
            marker: look.marker,
            sample: None,
            style,
        }))?;
        let labels = self.points.iter().zip(&self.labels);
        let font = (FONT, TEXT - 3).into_font();
        let written = TextStyle::from(font)
            .color(&BLACK)
            .pos(Pos::new(HPos::Center, VPos::Bottom));
        plane.draw_series(labels.map(|(&place, text)| {
            EmptyElement::at(place) + Text::new(text.clone(), (0, -5), written.clone())
        }))?;
        Ok(())
    }
}

/// A marker at a position; in the legend with a piece of its line.
struct Sign<C> {
    at: C,
    marker: Marker,
    sample: Option<Line>,
    style: ShapeStyle,
}

impl<'a, C: 'a> PointCollection<'a, C> for &'a Sign<C> {
    type Point = &'a C;
    type IntoIter = Once<&'a C>;

    fn point_iter(self) -> Self::IntoIter {
        once(&self.at)
    }
}

/// The length of the piece of line in the legend, pixels.
const SAMPLE: i32 = 30;

impl<C, DB: DrawingBackend> Drawable<DB> for Sign<C> {
    fn draw<I: Iterator<Item = BackendCoord>>(
        &self,
        mut places: I,
        backend: &mut DB,
        _: (u32, u32),
    ) -> Result<(), DrawingErrorKind<DB::ErrorType>> {
        let Some((mut x, y)) = places.next() else {
            return Ok(());
        };
        if let Some(line) = self.sample {
            let (on, off) = match line {
                Line::None => (0, SAMPLE),
                Line::Solid => (SAMPLE, 0),
                Line::Dashed(on, off) => (on as i32, off as i32),
            };
            let dashes = (x..x + SAMPLE).step_by((on + off) as usize);
            for from in dashes.filter(|_| on > 0) {
                let to = (from + on).min(x + SAMPLE);
                backend.draw_path([(from, y), (to, y)], &self.style)?;
            }
            x += SAMPLE / 2;
        }
        let stroke = |backend: &mut DB, points: &[(i32, i32)]| {
            let points = points.iter().map(|(dx, dy)| (x + dx, y + dy));
            backend.draw_path(points, &self.style)
        };
        let fill = |backend: &mut DB, points: &[(i32, i32)]| {
            let points = points.iter().map(|(dx, dy)| (x + dx, y + dy));
            backend.fill_polygon(points, &self.style.filled())
        };
        let r = MARK;
        match self.marker {
            Marker::Dot => backend.draw_circle((x, y), 2, &self.style, true),
            Marker::Circle => backend.draw_circle((x, y), r as u32, &self.style, true),
            Marker::Square => fill(backend, &[(-r, -r), (r, -r), (r, r), (-r, r)]),
            Marker::Triangle => fill(backend, &[(0, -r - 1), (r + 1, r), (-r - 1, r)]),
            Marker::Diamond => {
                let r = r + 1;
                fill(backend, &[(0, -r), (r, 0), (0, r), (-r, 0)])
            }
            Marker::Cross => {
                stroke(backend, &[(-r, -r), (r, r)])?;
                stroke(backend, &[(-r, r), (r, -r)])
            }
            Marker::Plus => {
                stroke(backend, &[(-r - 1, 0), (r + 1, 0)])?;
                stroke(backend, &[(0, -r - 1), (0, r + 1)])
            }
        }
    }
}

//! Maps values to positions in a drawing: scales with readable ticks, horizontal axes, the slot
//! axis, panels with a vertical axis, and legends.

use crate::{
    markup::{Element, element, label, line, rectangle},
    quantity, theme,
};

/// The width of every figure, in its own units: about one CSS pixel each on a desktop.
pub const WIDTH: f64 = 560.0;
/// The left end of panels.
pub const LEFT: f64 = 66.0;
/// The right end of panels.
pub const RIGHT: f64 = WIDTH - 18.0;
/// The distance of the middle of a vertical axis's title from the axis.
const TITLE_DISTANCE: f64 = 52.0;
/// The number of slots above which figures have no hover areas and the page has no table of slots.
pub const DETAILED_SLOTS_MAX: usize = 2_000;

/// Maps values to a line, linearly or logarithmically.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    low: f64,
    high: f64,
    from_px: f64,
    to_px: f64,
    logarithmic: bool,
}

/// A tick of an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// The value that the tick is at.
    pub value: f64,
    /// The text beside the tick.
    pub label: String,
}

impl Scale {
    /// Creates a linear scale that maps `low..high` to `from_px..to_px`.
    pub fn linear([low, high]: [f64; 2], [from_px, to_px]: [f64; 2]) -> Self {
        Self {
            low,
            high,
            from_px,
            to_px,
            logarithmic: false,
        }
    }

    /// Creates a scale that shows all values with a margin. It is logarithmic if the values are
    /// positive and span more than a factor of fifty. Otherwise it is linear and starts at 0 if the
    /// values are near it.
    pub fn around(values: impl Iterator<Item = f64>, range_px: [f64; 2]) -> Self {
        let (low, high) = values
            .filter(|value| value.is_finite())
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            });
        if low > high {
            return Self::linear([0.0, 1.0], range_px);
        }
        if low > 0.0 && high > 50.0 * low {
            return Self {
                logarithmic: true,
                ..Self::linear([low / 1.5, high * 1.5], range_px)
            };
        }
        let from_zero = low >= 0.0 && low < 0.35 * high;
        let air = match (high - low) * 0.1 {
            air if air > 1e-9 * high.abs() => air,
            _ => high.abs().max(1e-12) * 0.1,
        };
        let low = if from_zero { 0.0 } else { low - air };
        Self::linear([low, high + air], range_px)
    }

    /// Returns whether the scale is logarithmic.
    pub fn is_logarithmic(&self) -> bool {
        self.logarithmic
    }

    /// Returns the position of a value. Values outside the range are drawn at the border.
    pub fn at(&self, value: f64) -> f64 {
        let share = if self.logarithmic {
            (value / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        };
        self.from_px + (self.to_px - self.from_px) * theme::within_one(share)
    }

    /// Returns about this many ticks at round values.
    pub fn ticks(&self, about: usize) -> Vec<Tick> {
        if self.logarithmic {
            return self.decades(about);
        }
        let span = self.high - self.low;
        let mut step = round_step(span / about.max(1) as f64);
        if span < 2.5 * step {
            step = round_step(span / (2 * about).max(5) as f64);
        }
        let decimals = (-step.log10().floor()).clamp(0.0, 12.0) as usize;
        let first = (self.low / step - 1e-9).ceil() as i64;
        let last = (self.high / step + 1e-9).floor() as i64;
        (first..=last)
            .map(|multiple| {
                let value = multiple as f64 * step;
                let label = if (1e-5..1e6).contains(&step) {
                    quantity::decimal(value, decimals)
                } else {
                    quantity::significant(value, 3)
                };
                Tick { value, label }
            })
            .collect()
    }

    fn decades(&self, about: usize) -> Vec<Tick> {
        let first = self.low.log10().ceil() as i32;
        let last = self.high.log10().floor() as i32;
        let stride = ((last - first) as usize / about.max(1) + 1).min(100);
        (first..=last)
            .step_by(stride)
            .map(|exponent| Tick {
                value: 10f64.powi(exponent),
                label: quantity::power_of_ten(exponent),
            })
            .collect()
    }
}

/// Returns the smallest 1, 2 or 5 times a power of ten that is not less than `least`.
pub fn round_step(least: f64) -> f64 {
    let decade = 10f64.powf(least.log10().floor());
    let multiple = match least / decade {
        ratio if ratio <= 1.0 + 1e-9 => 1.0,
        ratio if ratio <= 2.0 + 1e-9 => 2.0,
        ratio if ratio <= 5.0 + 1e-9 => 5.0,
        _ => 10.0,
    };
    multiple * decade
}

/// The axis of a mission's slots, side by side between [`LEFT`] and [`RIGHT`].
#[derive(Clone, Copy, Debug)]
pub struct SlotAxis {
    /// The number of slots, `N`, at least 1.
    slots: usize,
}

impl SlotAxis {
    /// Creates an axis of this many slots.
    pub fn new(slots: usize) -> Self {
        Self {
            slots: slots.max(1),
        }
    }

    /// Returns the width of a slot.
    pub fn band(&self) -> f64 {
        (RIGHT - LEFT) / self.slots as f64
    }

    /// Returns the position where slot `n` begins.
    pub fn begin(&self, slot: u32) -> f64 {
        LEFT + (f64::from(slot) - 1.0) * self.band()
    }

    /// Returns the middle of slot `n`.
    pub fn middle(&self, slot: u32) -> f64 {
        self.begin(slot) + self.band() / 2.0
    }

    /// Returns whether a mark is drawn for slot `n`. If slots are narrower than marks, only the
    /// first slot of each group that is wide enough for a mark has one.
    pub fn begins_mark(&self, slot: u32) -> bool {
        let stretch = (5.0 / self.band()).ceil().max(1.0) as u32;
        slot.saturating_sub(1).is_multiple_of(stretch)
    }

    /// Draws the ticks, their numbers and the title below them. `y` is the lower end of the panel.
    pub fn draw(&self, y: f64) -> Element {
        let mut group = element("g");
        for slot in self.numbered() {
            let x = self.middle(slot);
            group.push(line("edge", [x, y], [x, y + 4.0]));
            group.push(label("tick middle", [x, y + 16.0], slot.to_string()));
        }
        group.with(label(
            "axis middle",
            [(LEFT + RIGHT) / 2.0, y + 33.0],
            "slot n",
        ))
    }

    /// Returns the slots that have a number: round ones, and the first if there is enough space.
    fn numbered(&self) -> Vec<u32> {
        let step = round_step(self.slots as f64 / 8.0).max(1.0) as usize;
        let round = (step..=self.slots).step_by(step);
        let first = (step > 1).then_some(1);
        first.into_iter().chain(round).map(|n| n as u32).collect()
    }

    /// Draws an invisible column per slot, with the text that is shown when a pointer is over it.
    pub fn hover(
        &self,
        [top, bottom]: [f64; 2],
        slots: impl Iterator<Item = (u32, String)>,
    ) -> Element {
        let mut group = element("g");
        if self.slots <= DETAILED_SLOTS_MAX {
            group = group.with_all(slots.map(|(slot, words)| {
                rectangle("hit", [self.begin(slot), top], [self.band(), bottom - top])
                    .set("data-slot", slot.to_string())
                    .with(element("title").text(words))
            }));
        }
        group
    }
}

/// Draws a horizontal axis below an area between `top` and `bottom`: about this many vertical grid
/// lines with their numbers, and the title of the axis below them.
pub fn horizontal(scale: &Scale, [top, bottom]: [f64; 2], about: usize, title: &str) -> Element {
    let mut group = element("g");
    for tick in scale.ticks(about) {
        let x = scale.at(tick.value);
        group.push(line("grid", [x, top], [x, bottom]));
        group.push(label("tick middle", [x, bottom + 16.0], tick.label));
    }
    group.with(label(
        "axis middle",
        [f64::midpoint(scale.from_px, scale.to_px), bottom + 33.0],
        title.to_owned(),
    ))
}

/// A rectangle with a vertical axis at its left.
#[derive(Clone, Copy, Debug)]
pub struct Panel {
    /// The left end, at which the axis is.
    pub left: f64,
    /// The right end.
    pub right: f64,
    /// The upper end.
    pub top: f64,
    /// The lower end.
    pub bottom: f64,
    /// The scale of the vertical axis, from `bottom` to `top`.
    pub scale: Scale,
}

impl Panel {
    /// Draws grid lines with their numbers, and the title of the axis, upright, above the numbers.
    pub fn draw(&self, title: &str) -> Element {
        let mut group = element("g");
        let about = ((self.bottom - self.top) / 30.0).round().max(3.0);
        for tick in self.scale.ticks(about as usize) {
            let y = self.scale.at(tick.value);
            group.push(line("grid", [self.left, y], [self.right, y]));
            group.push(label("tick end", [self.left - 7.0, y + 4.0], tick.label));
        }
        let [x, middle] = [
            self.left - TITLE_DISTANCE,
            f64::midpoint(self.top, self.bottom),
        ];
        group.with(
            label("axis middle", [x, middle], title.to_owned())
                .set("transform", format!("rotate(-90 {x} {middle})")),
        )
    }

    /// Draws the base line.
    pub fn base(&self) -> Element {
        line("edge", [self.left, self.bottom], [self.right, self.bottom])
    }

    /// Draws a bound as a line across the panel.
    pub fn bound(&self, value: f64) -> Element {
        let y = self.scale.at(value);
        line("bound", [self.left, y], [self.right, y])
    }
}

/// An entry of a legend.
#[derive(Clone, Debug)]
pub struct Key {
    /// The mark, drawn around the origin.
    pub mark: Element,
    /// The meaning of the mark.
    pub words: String,
}

/// Draws a legend between `left` and the right end of a figure, with marks that are 18 wide. See
/// [`legend_within`].
pub fn legend(keys: Vec<Key>, [left, y]: [f64; 2]) -> (Element, f64) {
    legend_within(keys, [left, RIGHT + 8.0], y, 18.0)
}

/// Draws a row of legend entries between `left` and `right`, centred on `y`, with further rows `18`
/// apart if necessary. Marks are `mark_width` wide. Returns the legend and the `y` of the last row.
pub fn legend_within(
    keys: Vec<Key>,
    [left, right]: [f64; 2],
    y: f64,
    mark_width: f64,
) -> (Element, f64) {
    let mut group = element("g");
    let [mut x, mut y] = [left, y];
    for key in keys {
        // Leaves enough space for the larger letters of a narrow screen.
        let width = mark_width + 6.0 + text_width(&key.words, 14.0);
        if x > left && x + width > right {
            x = left;
            y += 18.0;
        }
        group.push(
            element("g")
                .set("transform", format!("translate({x:.1} {y:.1})"))
                .with(
                    element("g")
                        .set("transform", format!("translate({} 0)", mark_width / 2.0))
                        .with(key.mark),
                )
                .with(label("label", [mark_width + 5.0, 4.0], key.words)),
        );
        x += width + 8.0;
    }
    (group, y)
}

/// Returns the approximate width of a text, which is accurate enough to keep labels apart.
pub fn text_width(words: &str, size: f64) -> f64 {
    words.chars().count() as f64 * size * 0.56
}

/// Creates a figure: an accessible drawing that is [`WIDTH`] wide and `height` high.
pub fn figure(height: f64, title: &str, description: &str) -> Element {
    figure_of_size([WIDTH, height], title, description)
}

/// Creates a figure of any size.
pub fn figure_of_size([width, height]: [f64; 2], title: &str, description: &str) -> Element {
    element("svg")
        .set("xmlns", "http://www.w3.org/2000/svg")
        .set("viewBox", format!("0 0 {width:.0} {height:.0}"))
        .set("role", "img")
        .set("aria-label", format!("{title}. {description}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let labels = |scale: Scale| -> Vec<String> {
            scale.ticks(5).into_iter().map(|tick| tick.label).collect()
        };
        let scale = Scale::linear([0.0, 1.12], [100.0, 0.0]);
        assert_eq!(labels(scale), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        let negative = Scale::linear([-0.3, 0.3], [0.0, 1.0]);
        assert!(labels(negative).contains(&"\u{2212}0.2".to_owned()));
        for (low, high) in [(0.0, 1e-9), (1e8, 3e9), (-7.0, 11.0), (20.999, 21.001)] {
            let ticks = Scale::linear([low, high], [0.0, 1.0]).ticks(5);
            assert!((2..=7).contains(&ticks.len()), "{low} to {high}: {ticks:?}");
            let mut labels: Vec<_> = ticks.iter().map(|tick| &tick.label).collect();
            labels.dedup();
            assert_eq!(labels.len(), ticks.len(), "{ticks:?}");
        }
    }

    #[test]
    fn scales_hold_what_they_show() {
        let range = [0.0, 1.0];
        for values in [
            vec![],
            vec![0.0],
            vec![3.0, 3.0],
            vec![-1.0, 2.0],
            vec![1e-9, 1.0, f64::NAN],
            vec![f64::INFINITY, 5.0],
        ] {
            let scale = Scale::around(values.iter().copied(), range);
            for value in values {
                let place = scale.at(value);
                assert!((0.0..=1.0).contains(&place), "{value} at {place}");
            }
            assert!(scale.low < scale.high, "{scale:?}");
            assert!(scale.ticks(4).len() >= 2, "{scale:?}");
        }
    }

    #[test]
    fn slots_are_numbered_sparsely() {
        assert_eq!(SlotAxis::new(1).numbered(), [1]);
        assert_eq!(SlotAxis::new(60).numbered(), [1, 10, 20, 30, 40, 50, 60]);
        assert_eq!(SlotAxis::new(7).numbered(), [1, 2, 3, 4, 5, 6, 7]);
        assert!(SlotAxis::new(100_000).numbered().len() <= 12);
    }
}

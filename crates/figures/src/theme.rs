//! Colours: a table of named colours for light and dark schemes, and viridis for rates.

use crate::markup::{Element, element};

/// Name, value in the light scheme, and value in the dark scheme. Style sheets refer to a colour as
/// `var(--name)`.
const COLORS: [(&str, &str, &str); 12 + SERIES] = [
    ("ground", "#f4f5f3", "#0e1115"),
    ("paper", "#ffffff", "#171b21"),
    ("ink", "#1a1e24", "#e8ebef"),
    ("soft", "#59626e", "#a0a9b5"),
    ("grid", "#e4e7ea", "#2a3039"),
    ("edge", "#c3c9d0", "#434b57"),
    // Lines that must not be crossed: the threshold, the physical limit, or the maximum of a power.
    ("bound", "#b83d08", "#ff9a5c"),
    // Measured or estimated values, as opposed to computed ones.
    ("sample", "#1f5fd0", "#82b1ff"),
    ("good", "#14713d", "#63d391"),
    ("bad", "#c0182b", "#ff7a85"),
    ("veil", "#c0182b1c", "#ff7a8526"),
    // The planned path below the flown one.
    ("plan", "#c9ced6", "#4d5665"),
    // The series of a chart. The test below measures how far they are apart, also for readers who
    // are colour-blind.
    ("series-1", "#1a1e24", "#e8ebef"),
    ("series-2", "#d87e2c", "#efa527"),
    ("series-3", "#4609f3", "#99b8ef"),
    ("series-4", "#347765", "#46de84"),
    ("series-5", "#9d2e16", "#bc4226"),
    ("series-6", "#a176cf", "#8b6d8b"),
    ("series-7", "#68086b", "#1563d7"),
];

/// The number of colours for series.
pub(crate) const SERIES: usize = 7;

/// The style sheet of the figures' classes, in named colours.
const FIGURE_STYLE: &str = include_str!("figure.css");
/// The style sheet of the classes that only charts use.
const CHART_STYLE: &str = include_str!("chart.css");

/// Returns the style sheet of a page: both colour schemes, and always the light one on paper.
pub fn page_style() -> Element {
    let scheme =
        |pick: fn(&(&str, &str, &str)) -> String| -> String { COLORS.iter().map(pick).collect() };
    let light = scheme(|(name, light, _)| format!("--{name}:{light};"));
    let dark = scheme(|(name, _, dark)| format!("--{name}:{dark};"));
    element("style").verbatim(format!(
        ":root{{color-scheme:light dark;{light}}}\n\
         @media screen and (prefers-color-scheme:dark){{:root{{{dark}}}}}\n{FIGURE_STYLE}{CHART_STYLE}\n{}",
        include_str!("page.css")
    ))
}

/// Returns the style sheet of a drawing that is used outside a page. It is light and contains its
/// colours as values, because not every SVG viewer supports custom properties.
pub fn drawing_style() -> Element {
    element("style").verbatim(with_values(FIGURE_STYLE.to_owned()))
}

/// Returns the style sheet of a chart that is used outside a page.
pub(crate) fn chart_style() -> Element {
    element("style").verbatim(with_values(format!("{FIGURE_STYLE}{CHART_STYLE}")))
}

/// Replaces the names of colours by the values of the light scheme.
fn with_values(mut style: String) -> String {
    for (name, light, _) in COLORS {
        style = style.replace(&format!("var(--{name})"), light);
    }
    style
}

/// Eleven support points of matplotlib's viridis (public domain). The map is perceptually uniform,
/// and its lightness increases throughout, so it remains readable when printed in black and white.
const VIRIDIS: [[u8; 3]; 11] = [
    [68, 1, 84],
    [72, 36, 117],
    [65, 68, 135],
    [53, 95, 141],
    [42, 120, 142],
    [33, 145, 140],
    [34, 168, 132],
    [68, 191, 112],
    [122, 209, 81],
    [189, 223, 38],
    [253, 231, 37],
];

/// Returns the colour of `share` in 0..=1. Values that are not finite count as 0.
pub fn viridis(share: f64) -> String {
    let [red, green, blue] = viridis_rgb(share);
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// Clamps `share` to 0..=1. NaN becomes 0.
pub fn within_one(share: f64) -> f64 {
    match share.is_nan() {
        true => 0.0,
        false => share.clamp(0.0, 1.0),
    }
}

fn viridis_rgb(share: f64) -> [u8; 3] {
    let intervals = (VIRIDIS.len() - 1) as f64;
    let place = within_one(share) * intervals;
    let below = (place as usize).min(VIRIDIS.len() - 2);
    let fraction = place - below as f64;
    std::array::from_fn(|channel| {
        let [low, high] = [below, below + 1].map(|index| f64::from(VIRIDIS[index][channel]));
        (low + (high - low) * fraction).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn viridis_gets_lighter_throughout() {
        let luminance = |share: f64| -> f64 {
            let [red, green, blue] = viridis_rgb(share).map(f64::from);
            0.2126 * red + 0.7152 * green + 0.0722 * blue
        };
        for step in 0..200 {
            let [low, high] = [step, step + 5].map(|step| luminance(f64::from(step) / 205.0));
            assert!(low < high, "at {step}: {low} to {high}");
        }
        assert_eq!(viridis(0.0), "#440154");
        assert_eq!(viridis(1.0), "#fde725");
        assert_eq!(viridis(7.0), "#fde725");
        assert_eq!(viridis(f64::NAN), "#440154");
    }

    /// The coordinates of a colour in linear RGB.
    fn linear(color: &str) -> [f64; 3] {
        std::array::from_fn(|channel| {
            let digits = &color[1 + 2 * channel..3 + 2 * channel];
            let share = f64::from(u8::from_str_radix(digits, 16).unwrap()) / 255.0;
            match share <= 0.040_45 {
                true => share / 12.92,
                false => ((share + 0.055) / 1.055).powf(2.4),
            }
        })
    }

    fn apply(matrix: [[f64; 3]; 3], vector: [f64; 3]) -> [f64; 3] {
        matrix.map(|row| (0..3).map(|i| row[i] * vector[i]).sum())
    }

    /// CIE L*a*b* under D65.
    fn lab(linear: [f64; 3]) -> [f64; 3] {
        const XYZ: [[f64; 3]; 3] = [
            [0.4124, 0.3576, 0.1805],
            [0.2126, 0.7152, 0.0722],
            [0.0193, 0.1192, 0.9505],
        ];
        let [x, y, z] = apply(XYZ, linear.map(|value| value.clamp(0.0, 1.0)));
        let [x, y, z] = [x / 0.9505, y, z / 1.089].map(|ratio| match ratio > 0.008_856 {
            true => ratio.cbrt(),
            false => 7.787 * ratio + 16.0 / 116.0,
        });
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    /// What protanopes, deuteranopes and tritanopes see (Machado, Oliveira and Fernandes, 2009,
    /// severity 1), in linear RGB.
    const COLOR_BLIND: [[[f64; 3]; 3]; 3] = [
        [
            [0.152_286, 1.052_583, -0.204_868],
            [0.114_503, 0.786_281, 0.099_216],
            [-0.003_882, -0.048_116, 1.051_998],
        ],
        [
            [0.367_322, 0.860_646, -0.227_968],
            [0.280_085, 0.672_501, 0.047_413],
            [-0.011_820, 0.042_940, 0.968_881],
        ],
        [
            [1.255_528, -0.076_749, -0.178_779],
            [-0.078_411, 0.930_809, 0.147_602],
            [0.004_733, 0.691_367, 0.303_900],
        ],
    ];

    /// Any two colours of series differ by at least 25 (CIE 1976), also for readers who are
    /// colour-blind; a difference of 2.3 is just noticeable. Each has a contrast of at least 3 (the
    /// limit of WCAG 2 for graphics) with the paper.
    #[test]
    fn colors_of_series_can_be_told_apart() {
        const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let luminance = |color: &str| {
            let [red, green, blue] = linear(color);
            0.2126 * red + 0.7152 * green + 0.0722 * blue
        };
        for is_light in [true, false] {
            let scheme = |color: &(&'static str, &'static str, &'static str)| match is_light {
                true => color.1,
                false => color.2,
            };
            let paper = COLORS.iter().find(|color| color.0 == "paper").unwrap();
            let paper = luminance(scheme(paper));
            let of_series = COLORS.iter().filter(|color| color.0.starts_with("series-"));
            let series: Vec<&str> = of_series.map(scheme).collect();
            assert_eq!(series.len(), SERIES);
            for (index, color) in series.iter().enumerate() {
                let luminance = luminance(color);
                let contrast = (luminance.max(paper) + 0.05) / (luminance.min(paper) + 0.05);
                assert!(contrast >= 3.0, "{color}: {contrast}");
                for other in &series[..index] {
                    for seen in [IDENTITY].into_iter().chain(COLOR_BLIND) {
                        let [a, b] = [color, other].map(|color| lab(apply(seen, linear(color))));
                        let difference = (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
                        assert!(difference >= 25.0, "{color}, {other}: {difference}");
                    }
                }
            }
        }
    }

    #[test]
    fn every_color_that_a_style_names_is_in_the_table() {
        for style in [FIGURE_STYLE, CHART_STYLE, include_str!("page.css")] {
            assert!(style.contains("var(--"), "names no color");
            for use_of in style.split("var(--").skip(1) {
                let name = use_of.split(')').next().unwrap_or_default();
                assert!(COLORS.iter().any(|color| color.0 == name), "{name}");
            }
        }
        for style in [drawing_style(), chart_style()] {
            assert!(!style.to_string().contains("var("));
        }
    }
}

//! Colours: a table of named colours for light and dark schemes, and viridis for rates.

use crate::markup::{Element, element};

/// Name, value in the light scheme, and value in the dark scheme. Style sheets refer to a colour as
/// `var(--name)`.
const COLORS: [(&str, &str, &str); 12] = [
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
];

/// The style sheet of the figures' classes, in named colours.
const FIGURE_STYLE: &str = include_str!("figure.css");

/// Returns the style sheet of a page: both colour schemes, and always the light one on paper.
pub fn page_style() -> Element {
    let scheme =
        |pick: fn(&(&str, &str, &str)) -> String| -> String { COLORS.iter().map(pick).collect() };
    let light = scheme(|(name, light, _)| format!("--{name}:{light};"));
    let dark = scheme(|(name, _, dark)| format!("--{name}:{dark};"));
    element("style").verbatim(format!(
        ":root{{color-scheme:light dark;{light}}}\n\
         @media screen and (prefers-color-scheme:dark){{:root{{{dark}}}}}\n{FIGURE_STYLE}\n{}",
        include_str!("page.css")
    ))
}

/// Returns the style sheet of a drawing that is used outside a page. It is light and contains its
/// colours as values, because not every SVG viewer supports custom properties.
pub fn drawing_style() -> Element {
    let mut style = FIGURE_STYLE.to_owned();
    for (name, light, _) in COLORS {
        style = style.replace(&format!("var(--{name})"), light);
    }
    element("style").verbatim(style)
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

    #[test]
    fn every_color_that_a_style_names_is_in_the_table() {
        for style in [FIGURE_STYLE, include_str!("page.css")] {
            assert!(style.contains("var(--"), "names no color");
            for use_of in style.split("var(--").skip(1) {
                let name = use_of.split(')').next().unwrap_or_default();
                assert!(COLORS.iter().any(|color| color.0 == name), "{name}");
            }
        }
        assert!(!drawing_style().to_string().contains("var("));
    }
}

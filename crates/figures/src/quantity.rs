//! Formats numbers for people, with a number of significant digits, a proper minus sign, and units.

/// Formats `value` with `digits` significant digits. Very small and very large values are written
/// as `1.23×10⁻⁷`.
pub fn significant(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return "–".into();
    }
    if value == 0.0 {
        return "0".into();
    }
    // Rounding may carry into the next decade (0.9996 to 1.000), so the value is rounded before its
    // exponent is used.
    let scientific = format!("{value:.*e}", digits.saturating_sub(1));
    let (mantissa, exponent) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    if (-4..6).contains(&exponent) {
        let decimals = (digits as i32 - 1 - exponent).max(0) as usize;
        minus(format!("{value:.decimals$}"))
    } else {
        minus(format!("{mantissa}×10{}", superscript(exponent)))
    }
}

/// Formats `value` as briefly as possible so that it can be read back, with up to a dozen digits:
/// 0.015, 2000, -95.
pub fn plain(value: f64) -> String {
    if !value.is_finite() {
        return "–".into();
    }
    let rounded: f64 = format!("{value:.11e}").parse().unwrap_or(value);
    if rounded != 0.0 && !(1e-6..1e9).contains(&rounded.abs()) {
        let text = format!("{rounded:e}");
        let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
        let exponent = superscript(exponent.parse().unwrap_or(0));
        return minus(format!("{mantissa}×10{exponent}"));
    }
    minus(format!("{rounded}"))
}

/// Formats `value` with this many decimals.
pub fn decimal(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "–".into();
    }
    let text = format!("{value:.decimals$}");
    // Avoids "-0.00".
    match text.strip_prefix('-') {
        Some(digits) if digits.chars().all(|c| c == '0' || c == '.') => digits.into(),
        _ => minus(text),
    }
}

/// Formats `share`, a fraction of 1, as a percentage.
pub fn percent(share: f64) -> String {
    format!("{} %", decimal(share * 100.0, 1))
}

/// Formats ten to the power of `exponent`.
pub fn power_of_ten(exponent: i32) -> String {
    match exponent {
        -3..=4 => plain(10f64.powi(exponent)),
        _ => format!("10{}", superscript(exponent)),
    }
}

/// Formats a number of things: "1 slot", "2 slots".
pub fn count(number: usize, one: &str) -> String {
    match number {
        1 => format!("1 {one}"),
        _ => format!("{number} {one}s"),
    }
}

/// Returns a unit that suits a power of this size, and the number of these units in a watt.
pub fn power_unit(size_w: f64) -> (&'static str, f64) {
    match size_w {
        size if size >= 1.0 => ("W", 1.0),
        size if size >= 1e-3 => ("mW", 1e3),
        size if size >= 1e-6 => ("µW", 1e6),
        _ => ("nW", 1e9),
    }
}

/// Returns a unit as it is printed. Scenario files often contain ASCII replacements.
pub fn unit(written: &str) -> &str {
    match written {
        "degC" => "°C",
        "degF" => "°F",
        "degK" => "K",
        "ug/m3" => "µg/m³",
        other => other,
    }
}

/// Shortens a text to at most this many characters.
pub fn shortened(words: &str, characters: usize) -> String {
    match words.char_indices().nth(characters) {
        Some(_) => words.chars().take(characters - 1).chain(['…']).collect(),
        None => words.into(),
    }
}

fn minus(text: String) -> String {
    match text.strip_prefix('-') {
        Some(digits) => format!("\u{2212}{digits}"),
        None => text,
    }
}

fn superscript(exponent: i32) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let digits = exponent
        .unsigned_abs()
        .to_string()
        .bytes()
        .map(|digit| DIGITS[usize::from(digit - b'0')])
        .collect::<String>();
    match exponent {
        ..0 => format!("⁻{digits}"),
        _ => digits,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!(significant(0.015, 4), "0.01500");
        assert_eq!(significant(0.999_96, 4), "1.000");
        assert_eq!(significant(53.1234, 3), "53.1");
        assert_eq!(significant(-1234.5, 3), "\u{2212}1234");
        assert_eq!(significant(1.234e-7, 3), "1.23×10⁻⁷");
        assert_eq!(significant(f64::NAN, 3), "–");
        assert_eq!(plain(0.1 + 0.2), "0.3");
        assert_eq!(plain(2e9), "2×10⁹");
        assert_eq!(plain(-95.0), "\u{2212}95");
        assert_eq!(decimal(-0.001, 2), "0.00");
        assert_eq!(percent(0.7912), "79.1 %");
        assert_eq!(power_of_ten(-12), "10⁻¹²");
        assert_eq!(count(1, "slot"), "1 slot");
        assert_eq!(shortened("°C", 2), "°C");
        assert_eq!(shortened("µg/m³", 4), "µg/…");
        assert_eq!(count(0, "slot"), "0 slots");
    }
}

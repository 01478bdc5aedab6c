//! The mean and the 95 % confidence interval of a few runs.

/// Two-sided 95 % quantiles of Student's t for 1, 2, .. degrees of freedom.
const STUDENT_95: [f64; 15] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160,
    2.145, 2.131,
];

/// Returns the mean; NaN if there are no values.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Returns the sample standard deviation; `None` for fewer than two values.
pub fn deviation(values: &[f64]) -> Option<f64> {
    if values.len() < 2 {
        return None;
    }
    let mean = mean(values);
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    Some((squares / (values.len() - 1) as f64).sqrt())
}

/// Returns the median; NaN if there are no values.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match (sorted.len(), sorted.len() / 2) {
        (0, _) => f64::NAN,
        (count, middle) if count % 2 == 1 => sorted[middle],
        (_, middle) => 0.5 * (sorted[middle - 1] + sorted[middle]),
    }
}

/// Returns half the width of the mean's 95 % confidence interval, assuming normally distributed
/// values; `None` for fewer than three values, because the interval of two is nine standard
/// deviations wide and carries no information. Beyond 16 values the quantile of 15 degrees of
/// freedom is used, which makes the interval too wide.
pub fn half_width_95(values: &[f64]) -> Option<f64> {
    if values.len() < 3 {
        return None;
    }
    let freedom = values.len().saturating_sub(1).min(STUDENT_95.len());
    let quantile = STUDENT_95.get(freedom.checked_sub(1)?)?;
    Some(quantile * deviation(values)? / (values.len() as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_values_have_the_interval_of_two_degrees_of_freedom() {
        let values = [1.0, 2.0, 3.0];
        assert_eq!(mean(&values), 2.0);
        assert_eq!(deviation(&values), Some(1.0));
        assert_eq!((median(&values), median(&values[1..])), (2.0, 2.5));
        assert!(median(&[]).is_nan());
        let half = half_width_95(&values).expect("three values");
        assert!((half - 4.303 / 3.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(half_width_95(&[1.0, 2.0]), None);
    }
}

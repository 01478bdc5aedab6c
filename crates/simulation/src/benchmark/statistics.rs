//! The statistics of a policy over all missions.

use std::collections::BTreeMap;

use serde::Serialize;

use super::{Bounds, COUNTED_GAP, Flown};

/// The statistics of one policy.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PolicyStatistics {
    /// The policy.
    pub policy: String,
    /// The number of flown missions.
    pub flown: usize,
    /// The number of missions that the policy does not fit.
    pub refused: usize,
    /// The number of missions that count: flown, with a certified gap of at most [`COUNTED_GAP`].
    pub counted: usize,
    /// The mean fraction of the certified upper bound over the missions that count.
    pub mean: f64,
    /// The 5 % quantile of the fraction (nearest rank).
    pub quantile_5: f64,
    /// The smallest fraction.
    pub worst: f64,
    /// The mission with the smallest fraction.
    pub worst_mission: String,
    /// The mean fraction of the reference policy over the same missions; NaN if it did not fly them
    /// all.
    pub reference_mean: f64,
    /// The mean fraction of the total of the reference policy with the ideal vehicle, over all
    /// missions that both flew; NaN if it flew none, or if these are its flights.
    pub ideal_mean: f64,
    /// The number of violated constraints over all flown missions.
    pub violations: usize,
    /// The number of slots less accurate than `Gamma` over all flown missions.
    pub inaccurate_slots: usize,
    /// The median time of preparation, seconds.
    pub preparation_median_s: f64,
    /// The longest time of preparation, seconds.
    pub preparation_max_s: f64,
    /// The median over the missions of the median time of a decision, microseconds.
    pub decision_median_us: f64,
}

/// Returns the flights of a policy on missions that it fits.
fn flown_by<'a>(policy: &'a str, flights: &'a [Flown]) -> impl Iterator<Item = &'a Flown> {
    let fits = move |flown: &&Flown| flown.policy == policy && !flown.sum_rate.is_nan();
    flights.iter().filter(fits)
}

/// Returns the fraction of the certified upper bound that a flight reached, if its mission counts.
fn share(flown: &Flown, bounds: &Bounds) -> Option<f64> {
    let bound = bounds.of(&flown.digest)?;
    let counts = bound.gap <= COUNTED_GAP && bound.upper > 0.0;
    counts.then(|| flown.sum_rate / bound.upper)
}

/// Returns the fractions that a policy reached on the missions that count, with the missions' names,
/// in ascending order.
pub fn shares<'a>(policy: &'a str, flights: &'a [Flown], bounds: &Bounds) -> Vec<(f64, &'a str)> {
    let mut shares: Vec<(f64, &str)> = flown_by(policy, flights)
        .filter_map(|flown| Some((share(flown, bounds)?, flown.mission.as_str())))
        .collect();
    shares.sort_by(|a, b| a.0.total_cmp(&b.0));
    shares
}

/// Returns the mean of a policy's totals, each as a fraction of that of the ideal vehicle.
fn mean_of_ideal<'a>(flown: impl Iterator<Item = &'a Flown>, ideal: &[Flown]) -> f64 {
    let totals: BTreeMap<&str, f64> = ideal
        .iter()
        .map(|flown| (flown.digest.as_str(), flown.sum_rate))
        .collect();
    let ratio = |flown: &Flown| Some(flown.sum_rate / totals.get(flown.digest.as_str())?);
    let ratios: Vec<f64> = flown.filter_map(ratio).collect();
    ratios.iter().sum::<f64>() / ratios.len() as f64
}

/// Returns the statistics of `policy` over its flights, with the mean of the policy `reference` over
/// the same missions; NaN if no mission counts. `ideal` are the flights of the reference policy with
/// the ideal vehicle, or none.
pub fn statistics(
    policy: &str,
    reference: &str,
    flights: &[Flown],
    ideal: &[Flown],
    bounds: &Bounds,
) -> PolicyStatistics {
    let flown = || flown_by(policy, flights);
    let shares = shares(policy, flights, bounds);
    let of_reference: BTreeMap<&str, f64> = flown_by(reference, flights)
        .filter_map(|flown| Some((flown.mission.as_str(), share(flown, bounds)?)))
        .collect();
    let reference_sum: Option<f64> = shares
        .iter()
        .map(|(_, mission)| of_reference.get(mission))
        .sum();
    let sorted = |value: fn(&Flown) -> f64| {
        let mut values: Vec<f64> = flown().map(value).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let preparation = sorted(|flown| flown.preparation_s);
    let decision = sorted(|flown| flown.decision_us);
    let median = |values: &[f64]| values.get(values.len() / 2).copied().unwrap_or(f64::NAN);
    let sum: f64 = shares.iter().map(|(share, _)| share).sum();
    let rank = (shares.len() as f64 * 0.05).ceil() as usize;
    let at = |index: usize| shares.get(index).map_or(f64::NAN, |(share, _)| *share);
    PolicyStatistics {
        policy: policy.into(),
        flown: flown().count(),
        refused: flights
            .iter()
            .filter(|flown| flown.policy == policy)
            .count()
            - flown().count(),
        counted: shares.len(),
        mean: sum / shares.len() as f64,
        quantile_5: at(rank.saturating_sub(1)),
        worst: at(0),
        worst_mission: shares.first().map_or("", |(_, name)| name).into(),
        reference_mean: reference_sum.map_or(f64::NAN, |sum| sum / shares.len() as f64),
        ideal_mean: mean_of_ideal(flown(), ideal),
        violations: flown().map(|flown| flown.violations).sum(),
        inaccurate_slots: flown().map(|flown| flown.inaccurate_slots).sum(),
        preparation_median_s: median(&preparation),
        preparation_max_s: preparation.last().copied().unwrap_or(f64::NAN),
        decision_median_us: median(&decision),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::benchmark::BoundRecord;

    fn flown(index: usize, sum_rate: f64) -> Flown {
        Flown {
            mission: format!("m{index}"),
            digest: format!("d{index}"),
            policy: "plan".into(),
            profile: "ideal".into(),
            sum_rate,
            violations: index % 2,
            inaccurate_slots: 0,
            preparation_s: index as f64,
            decision_us: 1.0,
        }
    }

    /// 40 missions with fractions 0.61 to 1.00: the 5 % quantile is the second smallest. One
    /// mission with a loose bound and one that the policy does not fit do not count.
    #[test]
    fn shares_are_of_missions_with_close_bounds() {
        let mut bounds = Bounds::default();
        let mut flights = vec![];
        for index in 0..42 {
            bounds.insert(BoundRecord {
                mission: format!("m{index}"),
                digest: format!("d{index}"),
                upper: 10.0,
                lower: 9.9,
                gap: if index == 40 { 0.05 } else { 0.01 },
                processor_seconds: 1.0,
            });
            let share = 1.0 - index as f64 / 100.0;
            let sum_rate = if index == 41 { f64::NAN } else { 10.0 * share };
            flights.push(flown(index, sum_rate));
        }
        // Another policy flew the ten missions with the smallest fractions, and half as well.
        for index in 30..40 {
            let mut half = flights[index].clone();
            half.policy = "half".into();
            half.sum_rate /= 2.0;
            flights.push(half);
        }
        let found = statistics("plan", "half", &flights, &[], &bounds);
        assert!(found.reference_mean.is_nan(), "half flew only ten");
        let half = statistics("half", "plan", &flights, &[], &bounds);
        assert_eq!((half.flown, half.counted), (10, 10));
        assert!((half.reference_mean - 0.655).abs() < 1e-12);
        assert!((half.mean - 0.3275).abs() < 1e-12);
        let found_alone = statistics("plan", "plan", &flights, &[], &bounds);
        assert_eq!(found_alone.reference_mean, found_alone.mean);
        assert_eq!((found.flown, found.refused, found.counted), (41, 1, 40));
        assert!((found.mean - 0.805).abs() < 1e-12);
        assert!((found.quantile_5 - 0.62).abs() < 1e-12);
        assert!((found.worst - 0.61).abs() < 1e-12);
        assert_eq!(
            (found.worst_mission.as_str(), found.violations),
            ("m39", 20)
        );
        // The ideal vehicle carries twice as much.
        let double = |flown: &Flown| Flown {
            sum_rate: 2.0 * flown.sum_rate,
            ..flown.clone()
        };
        let ideal: Vec<Flown> = flights[..40].iter().map(double).collect();
        let half = statistics("half", "plan", &flights, &ideal, &bounds);
        assert!((half.ideal_mean - 0.25).abs() < 1e-12);
        assert!(found_alone.ideal_mean.is_nan());
        assert_eq!(
            statistics("fixed", "plan", &flights, &[], &bounds).counted,
            0
        );
    }
}

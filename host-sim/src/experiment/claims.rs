//! The claims of the paper, and the measured results.

use std::fmt;

/// Whether the measured numbers support a claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The claim holds in every case.
    Agrees,
    /// The claim holds in some cases, or only in direction.
    InPart,
    /// The claim holds in no case.
    Differs,
    /// The claim was not measured.
    Open,
}

impl Verdict {
    /// Returns the verdict if `holding` of `cases` cases support the claim.
    pub fn of(holding: usize, cases: usize) -> Self {
        match holding {
            _ if cases == 0 => Self::Open,
            _ if holding == cases => Self::Agrees,
            0 => Self::Differs,
            _ => Self::InPart,
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Agrees => "agrees",
            Self::InPart => "in part",
            Self::Differs => "differs",
            Self::Open => "open",
        })
    }
}

/// A claim with its verdict.
#[derive(Clone, Debug, PartialEq)]
pub struct Claim {
    /// The claim, in our words.
    pub claimed: String,
    /// The verdict.
    pub verdict: Verdict,
    /// The measured numbers.
    pub measured: String,
    /// The known reason if the claim does not hold in every case; otherwise empty.
    pub reason: &'static str,
}

impl Claim {
    /// Creates a claim; the reason is only used if the claim does not hold in every case.
    pub(super) fn new(
        claimed: impl Into<String>,
        verdict: Verdict,
        measured: String,
        reason: &'static str,
    ) -> Self {
        let reason = match verdict {
            Verdict::Agrees => "",
            Verdict::InPart | Verdict::Differs | Verdict::Open => reason,
        };
        Self {
            claimed: claimed.into(),
            verdict,
            measured,
            reason,
        }
    }
}

/// Counts the cases in which a claim holds.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    pub(super) holding: usize,
    pub(super) cases: usize,
}

impl Tally {
    pub(super) fn add(&mut self, holds: bool) {
        self.cases += 1;
        self.holding += usize::from(holds);
    }

    /// Adds a case in which `value` must be above `reference`; adds nothing if one of them was not
    /// measured (NaN).
    pub(super) fn add_above(&mut self, value: f64, reference: f64) {
        if let Some(order) = value.partial_cmp(&reference) {
            self.add(order.is_gt());
        }
    }

    pub(super) fn verdict(&self) -> Verdict {
        Verdict::of(self.holding, self.cases)
    }
}

impl std::ops::Add for Tally {
    type Output = Self;

    fn add(self, more: Self) -> Self {
        Self {
            holding: self.holding + more.holding,
            cases: self.cases + more.cases,
        }
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {}", self.holding, self.cases)
    }
}

/// Returns the smallest and the largest value.
pub(super) fn range(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let start = (f64::INFINITY, f64::NEG_INFINITY);
    let widen = |(low, high): (f64, f64), x: f64| (low.min(x), high.max(x));
    values.into_iter().fold(start, widen)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_not_measured_is_no_agreement() {
        assert_eq!(Verdict::of(0, 0), Verdict::Open);
        assert_eq!(Verdict::of(2, 2), Verdict::Agrees);
        assert_eq!(Verdict::of(1, 2), Verdict::InPart);
        assert_eq!(Verdict::of(0, 2), Verdict::Differs);
        let mut tally = Tally::default();
        tally.add_above(f64::NAN, 1.0);
        assert_eq!(tally.verdict(), Verdict::Open);
        tally.add_above(2.0, 1.0);
        assert_eq!((tally + tally).cases, 2);
    }
}

//! The summary of a flight, which scripts read in `summary.json`: totals, the constraints that were
//! kept or violated, and what every user received.

use firmware_core::{Position, USERS_MAX, mission::MEASUREMENT_M, shield::Fairness};
use scenario::{HostMission, Timeline};
use serde::Serialize;

use super::{CertifiedBound, FlightRecord, KnowledgeSummary, LinkRecord, SlotRecord};

/// The number of slots and the amount of data of a user.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct UserSummary {
    /// The number of slots in which the user was served.
    pub slots: u32,
    /// The sum of its rates over its slots, bit/s/Hz.
    pub data: f64,
    /// The number of slots that it had to be served in; `None` for a user that left.
    pub quota: Option<u32>,
}

impl UserSummary {
    /// Returns whether the user was served in fewer slots than its quota.
    pub fn is_short(&self) -> bool {
        self.quota.is_some_and(|quota| self.slots < quota)
    }
}

/// The median and the maximum of a duration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Timing {
    /// The median, microseconds.
    pub median: f64,
    /// The maximum, microseconds.
    pub max: f64,
}

/// The contents of `summary.json`. Everything except the two timings is the same for the same seed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The scenario's name.
    pub scenario: String,
    /// The SHA-256 digest of the mission.
    pub scenario_digest: String,
    /// The policy.
    pub policy: String,
    /// The solver.
    pub inner: String,
    /// The vehicle's profile.
    pub profile: String,
    /// Whether the mission was flown to its end and the vehicle landed.
    pub completed: bool,
    /// How the flight ended, in words: "landed", or the true cause.
    pub ended: String,
    /// The number of flown slots.
    pub slots: usize,
    /// The sum of the rates, bit/s/Hz.
    pub sum_rate: f64,
    /// The sum of the rates of the ideal flight, bit/s/Hz: [`FlightNotes::ideal_sum_rate`](super::FlightNotes::ideal_sum_rate).
    pub ideal_sum_rate: Option<f64>,
    /// The certified bound ([`FlightNotes::certified_bound`]); absent if it was not asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub certified_bound: Option<CertifiedBound>,
    /// `sum_rate` as a fraction of the certified bound.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fraction_of_bound: Option<f64>,
    /// The warning about a policy that was trained for another mission.
    pub policy_warning: Option<String>,
    /// The limit of the sum of the rates at any positions: the number of slots times `log2(1 / (1 -
    /// J Gamma))`.
    pub sum_rate_physical_limit: f64,
    /// The summary of each user.
    pub users: Vec<UserSummary>,
    /// The largest `MSE_n`.
    pub mse_max: f64,
    /// `Gamma`, in the slot with the largest MSE.
    pub mse_threshold: f64,
    /// The number of slots with `MSE_n > Gamma` (by more than 1e-9 relative).
    pub mse_violations: usize,
    /// The ratio of the empirical to the analytic MSE, averaged over all symbols of the mission;
    /// near 1.
    pub empirical_mse_ratio: f64,
    /// The standard error of that ratio.
    pub empirical_mse_ratio_standard_error: f64,
    /// The root mean square of the errors of the estimates, in the scenario's unit.
    pub estimate_error_rms: f64,
    /// The number of flown positions or schedules that violate eq:a1 to eq:a3, eq:traj1 or
    /// eq:traj2.
    pub constraint_violations: usize,
    /// The number of slots in which the shield changed the policy's action.
    pub shield_interventions: usize,
    /// The distance from the last position to the destination, metres.
    pub arrival_distance_m: f64,
    /// Whether that distance is at most `V_max delta`.
    pub arrived: bool,
    /// Whether every user that is there at the end was served in at least `floor(N/M)` slots, or,
    /// where users joined or left or slots were lost, in its quota
    /// ([`Fairness`](firmware_core::shield::Fairness)).
    pub fair: bool,
    /// The largest distance between a waypoint and the reached position, metres.
    pub planned_vs_flown_m: f64,
    /// The median of that distance, metres.
    pub planned_vs_flown_median_m: f64,
    /// The sum of the rates at the waypoints minus `sum_rate`, bit/s/Hz: the loss due to deviations
    /// from the waypoints. Negative if the deviations increased the rate.
    pub planned_vs_flown_rate: f64,
    /// The time from the start of slot 1 to the end of the last slot, on the vehicle's clock,
    /// seconds.
    pub duration_s: f64,
    /// Seconds of the vehicle's clock per second of our clock, as estimated at the end.
    pub clock_rate: f64,
    /// The number of slots whose position was extrapolated because no sample was received in time.
    pub ticks_extrapolated: usize,
    /// The longest time from the end of a slot until its position was known, seconds of the
    /// vehicle's clock.
    pub lateness_max_s: f64,
    /// The durations of `allocate`, microseconds.
    pub allocate_us: Timing,
    /// The durations of `plan`, microseconds.
    pub plan_us: Timing,
    /// The frames and counters of the ground link at both ends.
    pub link: LinkRecord,
    /// The number of changes of the mission in flight.
    pub mission_changes: usize,
    /// What it cost that the world was not known exactly; absent if it was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub knowledge: Option<KnowledgeSummary>,
    /// The seed of the drawn signals.
    pub seed: u64,
    /// The version of this program.
    pub version: &'static str,
}

impl Summary {
    /// Returns the fewest slots of a user that is there at the end.
    pub fn fewest_slots(&self) -> u32 {
        let present = self.users.iter().filter(|user| user.quota.is_some());
        present.map(|user| user.slots).min().unwrap_or(0)
    }

    /// Returns the quotas of the users in words: one number, or from the smallest to the largest.
    pub fn quotas_in_words(&self) -> String {
        let quotas = self.users.iter().filter_map(|user| user.quota);
        match (quotas.clone().min(), quotas.max()) {
            (Some(least), Some(most)) if least < most => format!("{least} to {most}"),
            (least, _) => least.unwrap_or(0).to_string(),
        }
    }
}

impl FlightRecord {
    /// Returns the summary of this flight.
    pub fn summary(&self) -> Summary {
        let timeline = self.timeline();
        let mission = timeline.at_end();
        let p = mission.parameters();
        let users = self.users();
        let limits = (1..=mission.slots()).map(|slot| timeline.in_slot(slot).slot_rate_limit());
        let last = self.slots.last().map_or(p.start, |slot| slot.flown);
        let arrival_distance_m = (last - p.destination).norm();
        let (ratio, standard_error) = self.empirical_mse_ratio();
        let deviations: Vec<f64> = self
            .slots
            .iter()
            .map(|slot| (slot.planned - slot.flown).norm())
            .collect();
        let squares = self.slots.iter().map(|slot| slot.signals.error().powi(2));
        let sum_rate: f64 = self.slots.iter().map(|slot| slot.rate).sum();
        let bound = self.notes.certified_bound.as_ref();
        let bound = bound.filter(|bound| bound.upper > 0.0);
        Summary {
            scenario: self.scenario.name.clone(),
            scenario_digest: self.scenario.digest(),
            policy: self.policy.clone(),
            inner: self.inner.clone(),
            profile: self.profile.clone(),
            completed: self.completed,
            ended: self.ended.clone(),
            slots: self.slots.len(),
            sum_rate,
            ideal_sum_rate: self.notes.ideal_sum_rate,
            certified_bound: self.notes.certified_bound.clone(),
            fraction_of_bound: bound.map(|bound| sum_rate / bound.upper),
            policy_warning: self.notes.policy_warning.clone(),
            sum_rate_physical_limit: match self.changes.changes() {
                [] => f64::from(mission.slots()) * mission.slot_rate_limit(),
                _ => limits.sum(),
            },
            fair: !users.iter().any(UserSummary::is_short),
            users,
            mse_max: self.slots.iter().map(|slot| slot.mse).fold(0.0, f64::max),
            mse_threshold: (self.slots.iter())
                .max_by(|a, b| a.mse.total_cmp(&b.mse))
                .map_or(mission, |slot| timeline.in_slot(slot.slot))
                .parameters()
                .mse_threshold,
            mse_violations: self
                .slots
                .iter()
                .filter(|slot| violates_mse(timeline.in_slot(slot.slot), slot))
                .count(),
            empirical_mse_ratio: ratio,
            empirical_mse_ratio_standard_error: standard_error,
            estimate_error_rms: (squares.sum::<f64>() / self.slots.len().max(1) as f64).sqrt(),
            constraint_violations: self.constraint_violations(&timeline),
            mission_changes: self.changes.changes().len(),
            knowledge: KnowledgeSummary::of(self),
            shield_interventions: self
                .slots
                .iter()
                .filter(|slot| slot.intervention.any())
                .count(),
            arrival_distance_m,
            arrived: self.slots.len() == mission.slots() as usize && mission.has_arrived(&last),
            planned_vs_flown_m: deviations.iter().copied().fold(0.0, f64::max),
            planned_vs_flown_median_m: median(deviations),
            planned_vs_flown_rate: self
                .slots
                .iter()
                .map(|slot| slot.planned_rate - slot.rate)
                .sum(),
            duration_s: self.duration_s(),
            clock_rate: self
                .slots
                .last()
                .map_or(1.0, |slot| f64::from(slot.tick.clock_rate)),
            ticks_extrapolated: self
                .slots
                .iter()
                .filter(|slot| slot.tick.extrapolated)
                .count(),
            lateness_max_s: self
                .slots
                .iter()
                .map(|slot| slot.tick.lateness.as_secs_f64())
                .fold(0.0, f64::max),
            allocate_us: timing(self.slots.iter().map(|slot| slot.allocate_us)),
            plan_us: timing(self.slots.iter().map(|slot| slot.plan_us)),
            link: self.link,
            seed: self.seed,
            version: env!("CARGO_PKG_VERSION"),
        }
    }

    /// Returns the time from the start of slot 1 to the end of the last slot, on the vehicle's
    /// clock, seconds.
    fn duration_s(&self) -> f64 {
        let slot_s = self.scenario.mission.parameters().slot_duration_s;
        match (self.slots.first(), self.slots.last()) {
            (Some(first), Some(last)) => {
                let began = f64::from(first.slot - 1) * slot_s;
                began + (last.tick.time - first.tick.time).as_secs_f64() + slot_s
            }
            _ => 0.0,
        }
    }

    /// Returns whether the average of a slot is less accurate than required.
    pub fn violates_mse(&self, slot: &SlotRecord) -> bool {
        violates_mse(self.timeline().in_slot(slot.slot), slot)
    }

    /// Returns the mission as it was in each slot.
    pub fn timeline(&self) -> Timeline {
        self.changes.timeline(&self.scenario.mission)
    }

    /// Returns what the users were owed at the end.
    pub fn fairness(&self, timeline: &Timeline) -> Fairness<USERS_MAX> {
        let mut fairness = Fairness::new(&self.scenario.mission);
        let mut slots = self.slots.iter().peekable();
        for slot in 1..=timeline.at_end().slots() {
            if slot > 1 && timeline.version_in(slot) != timeline.version_in(slot - 1) {
                fairness.revise(timeline.in_slot(slot), None);
            }
            let record = slots.next_if(|record| record.slot == slot);
            fairness.record(record.and_then(|record| record.served_user));
        }
        fairness
    }

    /// Returns the slots and the data of every user.
    pub fn users(&self) -> Vec<UserSummary> {
        let timeline = self.timeline();
        let fairness = self.fairness(&timeline);
        let mut users: Vec<_> = (0..timeline.at_end().user_count())
            .map(|user| UserSummary {
                slots: 0,
                data: 0.0,
                quota: fairness.quota(user),
            })
            .collect();
        for slot in &self.slots {
            if let Some(user) = slot.served_user.and_then(|user| users.get_mut(user)) {
                user.slots += 1;
                user.data += slot.rate;
            }
        }
        users
    }

    /// Returns the mean over all symbols of `|error|^2 / MSE_n`, and its standard error. The error
    /// of a slot is a complex Gaussian, so its square is exponentially distributed: its standard
    /// deviation equals its mean.
    fn empirical_mse_ratio(&self) -> (f64, f64) {
        let symbols: f64 = self
            .slots
            .iter()
            .map(|slot| f64::from(slot.signals.symbols))
            .sum();
        let sum: f64 = self
            .slots
            .iter()
            .map(|slot| slot.signals.empirical_mse / slot.mse * f64::from(slot.signals.symbols))
            .sum();
        if self.scenario.uncertainty.is_none() {
            return (sum / symbols, symbols.sqrt().recip());
        }
        // With errors of the channels it is not exponential: its spread is measured.
        let variance: f64 = (self.slots.iter())
            .map(|slot| {
                let weight = f64::from(slot.signals.symbols) / symbols;
                (weight * slot.signals.standard_error / slot.mse).powi(2)
            })
            .sum();
        (sum / symbols, variance.sqrt())
    }

    /// Returns the number of violated constraints: steps longer than `V_max delta`, positions
    /// outside the area and, for a mission that was flown to its end, a destination out of reach
    /// and users below their quota. A flight that was aborted is reported as such elsewhere.
    fn constraint_violations(&self, timeline: &Timeline) -> usize {
        let p = self.scenario.mission.parameters();
        let mut violations = 0;
        let mut from = p.start;
        for slot in &self.slots {
            if !self.completed && slot.tick.extrapolated {
                // The link was failing: the position of the vehicle is not known.
                continue;
            }
            let step_m = (slot.flown - from).norm();
            let reach_m = timeline.in_slot(slot.slot).reach_m();
            violations += usize::from(step_m > reach_m + MEASUREMENT_M);
            let nearest = Position::new(
                slot.flown.x.clamp(0.0, p.area.east_m),
                slot.flown.y.clamp(0.0, p.area.north_m),
            );
            violations += usize::from((slot.flown - nearest).norm() > MEASUREMENT_M);
            from = slot.flown;
        }
        if !self.completed {
            return violations;
        }
        let mission = timeline.at_end();
        violations += usize::from(!mission.has_arrived(&from));
        violations += usize::from(self.slots.len() != mission.slots() as usize);
        violations + self.users().iter().filter(|user| user.is_short()).count()
    }
}

/// Returns whether the average of a slot is less accurate than its mission requires.
fn violates_mse(mission: &HostMission, slot: &SlotRecord) -> bool {
    slot.mse > mission.parameters().mse_threshold * (1.0 + 1e-9)
}

fn timing(values: impl Iterator<Item = f64>) -> Timing {
    let values: Vec<f64> = values.collect();
    Timing {
        max: values.iter().copied().fold(0.0, f64::max),
        median: median(values),
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[n / 2],
        n => f64::midpoint(values[n / 2 - 1], values[n / 2]),
    }
}

//! What a flight leaves behind: one record per slot, the path flown, and the summary that
//! scripts read. Files are written by `report`.

use firmware_core::{
    Position,
    autopilot::Tick,
    controller::ChannelSource,
    inner::LimitedBy,
    link::{LinkCounters, VehicleStatus},
    mission::MEASUREMENT_M,
    shield::Intervention,
};
use serde::Serialize;

use scenario::Scenario;

/// A flown mission.
#[derive(Clone, Debug)]
pub struct FlightRecord {
    /// What was flown.
    pub scenario: Scenario,
    /// Who decided: `straight-line`, `fixed`, `search` or a file's name.
    pub policy: String,
    /// Which solver allocated.
    pub inner: String,
    /// Which vehicle: a profile's name.
    pub profile: String,
    /// Of the signals drawn.
    pub seed: u64,
    /// Slot by slot, in order.
    pub slots: Vec<SlotRecord>,
    /// Where the vehicle truly was, in time, from the start of slot 1.
    pub path: Vec<PathSample>,
    /// What happened between the autopilot and its client, in order.
    pub events: Vec<FlightEvent>,
    /// What came over the ground link, and what did not.
    pub link: LinkRecord,
    /// Whether the mission was flown to its end and the vehicle landed.
    pub completed: bool,
    /// How the flight ended, in words: "landed", or the true cause.
    pub ended: String,
}

/// Something that happened, in words.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightEvent {
    /// Since the client started, seconds.
    pub time_s: f64,
    /// What.
    pub text: String,
    /// Whether a person wants to see it when it happens.
    pub notable: bool,
}

/// What became of the ground link's frames, at both ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LinkRecord {
    /// The last counters that the vehicle sent down.
    pub vehicle: VehicleStatus,
    /// Frames that the ground received.
    pub ground: LinkCounters,
    /// Slots of which the ground got the arrival alone or the command alone: users and sensors
    /// were silent.
    pub slots_missed: u32,
    /// Arrivals and commands that came again.
    pub repeated: u32,
    /// Arrivals and commands about a slot, or serving a user, that the mission does not have.
    pub nonsense: u32,
}

/// The vehicle's true place at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSample {
    /// Since the start of slot 1, seconds.
    pub time_s: f64,
    /// Where, metres.
    pub position: Position<f64>,
    /// How high over the ground, metres.
    pub altitude_m: f64,
}

/// One slot: planned, flown, allocated, received.
#[derive(Clone, Debug, PartialEq)]
pub struct SlotRecord {
    /// `n`, 1 to `N`.
    pub slot: u32,
    /// The waypoint, metres.
    pub planned: Position<f64>,
    /// Where the vehicle truly was at the slot's end, metres.
    pub flown: Position<f64>,
    /// When the slot ended, on the vehicle's clock, and how its position was known.
    pub tick: Tick,
    /// The user served, from 0; `None` where no user was heard.
    pub served_user: Option<usize>,
    /// `p`, watts.
    pub user_power_w: f64,
    /// `eta`, one over square root of watts.
    pub normalizing_factor: f64,
    /// Average of `|b_j|^2` over the sensors, watts.
    pub sensor_power_mean_w: f64,
    /// `R_n`, bit/s/Hz.
    pub rate: f64,
    /// What the same user would have got with the vehicle at the waypoint, bit/s/Hz.
    pub planned_rate: f64,
    /// `MSE_n`, analytic, at the true channels.
    pub mse: f64,
    /// What holds the rate back.
    pub limited_by: LimitedBy,
    /// Whether `Gamma` could be met.
    pub feasible: bool,
    /// What the shield changed.
    pub intervention: Intervention,
    /// Where the controller's gains came from.
    pub channel_source: ChannelSource,
    /// How old they were, slots; 0 when they were this slot's.
    pub age_slots: u32,
    /// The signals that were drawn and received.
    pub signals: SignalRecord,
    /// How long `plan` took, microseconds.
    pub plan_us: f64,
    /// How long `allocate` took, microseconds.
    pub allocate_us: f64,
}

impl SlotRecord {
    /// The user served, as reports name it.
    pub fn user_name(&self) -> String {
        self.served_user
            .map_or_else(|| "nobody".into(), |user| format!("u{user}"))
    }
}

/// What the receiver made of a slot's signals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalRecord {
    /// Mean of `|F-hat - F|^2` over the symbols drawn.
    pub empirical_mse: f64,
    /// How many symbols that is.
    pub symbols: u32,
    /// The wanted function of what the sensors measured, in the scenario's unit.
    pub true_value: f64,
    /// What was estimated over the air.
    pub estimate: f64,
}

impl SignalRecord {
    /// `estimate - true_value`, in the scenario's unit.
    pub fn error(&self) -> f64 {
        self.estimate - self.true_value
    }
}

/// Per user: how often served, and how much it sent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct UserSummary {
    /// Slots served.
    pub slots: u32,
    /// Sum of its rates over its slots, bit/s/Hz.
    pub data: f64,
}

/// Median and maximum.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Timing {
    /// The middle one, microseconds.
    pub median: f64,
    /// The longest, microseconds.
    pub max: f64,
}

/// `summary.json`. Everything but the two timings is the same for the same seed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The scenario's name.
    pub scenario: String,
    /// SHA-256 of the mission.
    pub scenario_digest: String,
    /// Who decided.
    pub policy: String,
    /// Which solver.
    pub inner: String,
    /// Which vehicle.
    pub profile: String,
    /// Whether the mission was flown to its end and the vehicle landed.
    pub completed: bool,
    /// How the flight ended, in words: "landed", or the true cause.
    pub ended: String,
    /// Slots flown.
    pub slots: usize,
    /// Sum of the rates, bit/s/Hz.
    pub sum_rate: f64,
    /// What no position could exceed: slots times `log2(1 / (1 - J Gamma))`.
    pub sum_rate_physical_limit: f64,
    /// Per user.
    pub users: Vec<UserSummary>,
    /// The largest `MSE_n`.
    pub mse_max: f64,
    /// `Gamma`.
    pub mse_threshold: f64,
    /// Slots with `MSE_n > Gamma` (beyond 1e-9 relative).
    pub mse_violations: usize,
    /// Empirical over analytic MSE, averaged over all symbols of the mission; near 1.
    pub empirical_mse_ratio: f64,
    /// Standard error of that ratio.
    pub empirical_mse_ratio_standard_error: f64,
    /// Root mean square of the estimates' errors, in the scenario's unit.
    pub estimate_error_rms: f64,
    /// Flown positions or schedules that break eq:a1 to eq:a3, eq:traj1 or eq:traj2.
    pub constraint_violations: usize,
    /// Slots in which the shield changed the policy's action.
    pub shield_interventions: usize,
    /// From the last position to the destination, metres.
    pub arrival_distance_m: f64,
    /// Whether that is at most `V_max delta`.
    pub arrived: bool,
    /// Whether every user had its `floor(N/M)` slots.
    pub fair: bool,
    /// Largest distance between a waypoint and the place reached, metres.
    pub planned_vs_flown_m: f64,
    /// Median of that distance, metres.
    pub planned_vs_flown_median_m: f64,
    /// Sum of the rates that the waypoints would have given, less `sum_rate`, bit/s/Hz: what it
    /// cost to fly beside them. Below zero where that happened to help.
    pub planned_vs_flown_rate: f64,
    /// From the start of slot 1 to the end of the last, on the vehicle's clock, seconds.
    pub duration_s: f64,
    /// Seconds of the vehicle's clock per second of ours, as estimated at the end.
    pub clock_rate: f64,
    /// Slots whose position was extrapolated, because no sample came in time.
    pub ticks_extrapolated: usize,
    /// By how much the position of a slot's end was known later than it ended, at most, seconds
    /// of the vehicle's clock.
    pub lateness_max_s: f64,
    /// How long `allocate` took, microseconds.
    pub allocate_us: Timing,
    /// How long `plan` took, microseconds.
    pub plan_us: Timing,
    /// Frames and counters of the ground link at both ends.
    pub link: LinkRecord,
    /// Of the signals.
    pub seed: u64,
    /// Of this program.
    pub version: &'static str,
}

impl FlightRecord {
    /// The summary of this flight.
    pub fn summary(&self) -> Summary {
        let mission = &self.scenario.mission;
        let p = mission.parameters();
        let users = self.users();
        let last = self.slots.last().map_or(p.start, |slot| slot.flown);
        let arrival_distance_m = (last - p.destination).norm();
        let (ratio, standard_error) = self.empirical_mse_ratio();
        let deviations: Vec<f64> = self
            .slots
            .iter()
            .map(|slot| (slot.planned - slot.flown).norm())
            .collect();
        let squares = self.slots.iter().map(|slot| slot.signals.error().powi(2));
        Summary {
            scenario: self.scenario.name.clone(),
            scenario_digest: self.scenario.digest(),
            policy: self.policy.clone(),
            inner: self.inner.clone(),
            profile: self.profile.clone(),
            completed: self.completed,
            ended: self.ended.clone(),
            slots: self.slots.len(),
            sum_rate: self.slots.iter().map(|slot| slot.rate).sum(),
            sum_rate_physical_limit: f64::from(mission.slots()) * mission.slot_rate_limit(),
            fair: users.iter().all(|user| user.slots >= mission.quota()),
            users,
            mse_max: self.slots.iter().map(|slot| slot.mse).fold(0.0, f64::max),
            mse_threshold: p.mse_threshold,
            mse_violations: self
                .slots
                .iter()
                .filter(|slot| self.violates_mse(slot))
                .count(),
            empirical_mse_ratio: ratio,
            empirical_mse_ratio_standard_error: standard_error,
            estimate_error_rms: (squares.sum::<f64>() / self.slots.len().max(1) as f64).sqrt(),
            constraint_violations: self.constraint_violations(),
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

    /// From the start of slot 1 to the end of the last slot, on the vehicle's clock, seconds.
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

    /// Whether a slot's average is less accurate than asked.
    pub fn violates_mse(&self, slot: &SlotRecord) -> bool {
        let threshold = self.scenario.mission.parameters().mse_threshold;
        slot.mse > threshold * (1.0 + 1e-9)
    }

    /// Slots and data of every user.
    pub fn users(&self) -> Vec<UserSummary> {
        let none = UserSummary {
            slots: 0,
            data: 0.0,
        };
        let mut users = vec![none; self.scenario.mission.user_count()];
        for slot in &self.slots {
            if let Some(user) = slot.served_user.and_then(|user| users.get_mut(user)) {
                user.slots += 1;
                user.data += slot.rate;
            }
        }
        users
    }

    /// Mean over all symbols of `|error|^2 / MSE_n`, and its standard error. The error of a slot
    /// is a complex Gaussian, so its square is exponential: as much deviation as mean.
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
        (sum / symbols, symbols.sqrt().recip())
    }

    /// Steps longer than `V_max delta`, places outside the area and, of a mission that was flown to
    /// its end, a destination out of reach and users short of their quota: a flight that was broken
    /// off says so itself.
    fn constraint_violations(&self) -> usize {
        let mission = &self.scenario.mission;
        let p = mission.parameters();
        let mut violations = 0;
        let mut from = p.start;
        for slot in &self.slots {
            if !self.completed && slot.tick.extrapolated {
                // The link was dying: where the vehicle was is not known.
                continue;
            }
            let step_m = (slot.flown - from).norm();
            violations += usize::from(step_m > mission.reach_m() + MEASUREMENT_M);
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
        violations += usize::from(!mission.has_arrived(&from));
        violations += usize::from(self.slots.len() != mission.slots() as usize);
        let short = |user: &&UserSummary| user.slots < mission.quota();
        violations + self.users().iter().filter(short).count()
    }
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

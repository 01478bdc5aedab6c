//! The tables below the figures: outcome, mission (Table I), run, every slot, and the events of the
//! autopilot and its client.

use firmware_core::{inner::LimitedBy, mission::RadioModel};

use super::{against_waypoints, of_certified_bound, of_ideal_flight, of_knowledge, slots_csv};
use crate::record::{FlightRecord, Summary, Timing};
use figures::{
    axis::DETAILED_SLOTS_MAX,
    markup::{Element, element},
    quantity::{self, count, decimal, percent, plain, power_unit, significant},
};
use scenario::HostMission;

/// Returns the tables of outcome, mission and run.
pub(super) fn tables(record: &FlightRecord, summary: &Summary) -> Element {
    let mission = &record.scenario.mission;
    let p = mission.parameters();
    let power = |watts: f64| {
        let (unit, per_watt) = power_unit(watts);
        format!("{} {unit}", plain(watts * per_watt))
    };
    let place = |east: f64, north: f64| format!("{} m, {} m", plain(east), plain(north));
    let timing = |timing: &Timing| {
        format!(
            "{} µs, {} µs",
            significant(timing.median, 3),
            significant(timing.max, 3)
        )
    };
    let mut outcome = vec![
        (
            "Total rate, of limit",
            format!(
                "{} bit/s/Hz, {}",
                significant(summary.sum_rate, 6),
                percent(summary.sum_rate / summary.sum_rate_physical_limit)
            ),
        ),
        (
            "Largest MSE",
            format!(
                "{}, Γ = {}",
                significant(summary.mse_max, 6),
                plain(summary.mse_threshold)
            ),
        ),
        ("Slots above Γ", summary.mse_violations.to_string()),
        (
            "Constraint violations",
            summary.constraint_violations.to_string(),
        ),
        (
            "Empirical / analytic MSE",
            format!(
                "{} ± {}",
                decimal(summary.empirical_mse_ratio, 4),
                decimal(summary.empirical_mse_ratio_standard_error, 4)
            ),
        ),
        (
            "Estimate's error",
            format!(
                "{} {} rms",
                significant(summary.estimate_error_rms, 3),
                quantity::unit(&record.scenario.sensing.unit)
            ),
        ),
        (
            "Shield changed",
            format!(
                "{} of {}",
                summary.shield_interventions,
                count(summary.slots, "slot")
            ),
        ),
        (
            "Distance at the end",
            format!("{} m", decimal(summary.arrival_distance_m, 2)),
        ),
        (
            "Planned to flown",
            format!(
                "{} m at most, median {} m",
                decimal(summary.planned_vs_flown_m, 3),
                decimal(summary.planned_vs_flown_median_m, 3)
            ),
        ),
        ("Plan, median and max", timing(&summary.plan_us)),
        ("Allocate, median and max", timing(&summary.allocate_us)),
    ];
    if let Some((share, of)) = of_ideal_flight(summary) {
        outcome.insert(1, ("Of the ideal flight", format!("{share} {of}")));
        outcome.push(("Rate where it flew", against_waypoints(summary, 4)));
    }
    if let Some((fraction, of)) = of_certified_bound(summary) {
        outcome.insert(1, ("Of the certified bound", format!("{fraction} {of}")));
    }
    if let Some(knowledge) = &summary.knowledge {
        for (name, value, words) in of_knowledge(knowledge) {
            outcome.push((name, format!("{value} {words}")));
        }
    }
    let mut table_one = vec![
        (
            "Slots N, duration δ",
            format!("{} × {} s", p.slots, plain(p.slot_duration_s)),
        ),
        (
            "Users M, sensors J",
            format!("{}, {}", p.users.len(), p.sensors.len()),
        ),
        (
            "Area Λ",
            format!("{} m × {} m", plain(p.area.east_m), plain(p.area.north_m)),
        ),
        ("Start q_o (east, north)", place(p.start.x, p.start.y)),
        ("Destination q_f", place(p.destination.x, p.destination.y)),
        ("Altitude H", format!("{} m", plain(p.altitude_m))),
        ("Speed V_max", format!("{} m/s", plain(p.max_speed_mps))),
        ("Carrier f_c", format!("{} GHz", plain(p.carrier_hz / 1e9))),
        (
            "Noise σ²",
            format!(
                "{} dBm",
                plain((10.0 * (p.noise_power.0 * 1e3).log10() * 1e6).round() / 1e6)
            ),
        ),
        ("User power p", power(p.user_power_max.0)),
        ("Sensor power p_b", power(p.sensor_power_max.0)),
        ("MSE threshold Γ", plain(p.mse_threshold)),
        (
            "Physical limit per slot",
            format!(
                "log₂ 1/(1 − JΓ) = {} bit/s/Hz",
                significant(mission.slot_rate_limit(), 4)
            ),
        ),
    ];
    let after_carrier = 1 + table_one
        .iter()
        .position(|(name, _)| *name == "Carrier f_c")
        .unwrap_or(0);
    table_one.splice(after_carrier..after_carrier, radio_model(mission));
    let run = vec![
        ("Scenario", summary.scenario.clone()),
        (
            "Digest (SHA-256)",
            summary.scenario_digest.chars().take(16).collect(),
        ),
        ("Policy", summary.policy.clone()),
        ("Allocation", summary.inner.clone()),
        ("Vehicle", summary.profile.clone()),
        (
            "Function F",
            format!(
                "{} ({})",
                record.scenario.sensing.function,
                quantity::unit(&record.scenario.sensing.unit)
            ),
        ),
        ("Seed of the signals", summary.seed.to_string()),
        ("host-sim", summary.version.to_owned()),
    ];
    let table = |title: &'static str, rows: Vec<(&'static str, String)>| {
        let rows = rows.into_iter().map(|(name, value)| {
            element("tr")
                .with(symbols(element("th").set("scope", "row"), name))
                .with(element("td").text(value))
        });
        element("div")
            .class("card")
            .with(element("h2").text(title))
            .with(
                element("table")
                    .class("facts")
                    .with(element("tbody").with_all(rows)),
            )
    };
    element("section")
        .class("tables")
        .set("aria-label", "Facts")
        .with(table("Outcome", outcome))
        .with(table("Mission", table_one))
        .with(table("Run", run))
}

/// Returns the rows on the model of the mean channel gain.
fn radio_model(mission: &HostMission) -> Vec<(&'static str, String)> {
    let p = mission.parameters();
    if mission.has_gain_map() {
        return vec![("Gains", "from a map (radio.gain_map)".to_owned())];
    }
    match p.radio_model {
        RadioModel::ProbabilisticLos => vec![
            (
                "Environment A, B",
                format!("{}, {}", plain(p.environment.a), plain(p.environment.b)),
            ),
            (
                "Excess loss LoS, NLoS",
                format!(
                    "{} dB, {} dB",
                    plain(p.excess_loss_db.los),
                    plain(p.excess_loss_db.nlos)
                ),
            ),
        ],
        model => vec![("Radio model", format!("{model} (3GPP TR 36.777)"))],
    }
}

/// Returns the events of the autopilot and its client, as a collapsed section.
pub(super) fn events(record: &FlightRecord) -> Option<Element> {
    let rows = record.events.iter().map(|event| {
        element("tr")
            .with(element("td").text(format!("{} s", decimal(event.time_s, 2))))
            .with(element("td").class("said").text(event.text.clone()))
    });
    (!record.events.is_empty()).then(|| {
        element("details")
            .class("card")
            .with(element("summary").text("Events"))
            .with(
                element("div").class("scroll").with(
                    element("table")
                        .class("slots events")
                        .with(element("tbody").with_all(rows)),
                ),
            )
    })
}

/// Returns a name with its symbols formatted: `q_f` gets a subscript.
fn symbols(mut cell: Element, name: &'static str) -> Element {
    let mut parts = name.split('_');
    cell = cell.text(parts.next().unwrap_or_default());
    for part in parts {
        let end = part
            .find(|character: char| !character.is_alphanumeric())
            .unwrap_or(part.len());
        let (below, rest) = part.split_at(end);
        cell = cell.with(element("sub").text(below)).text(rest);
    }
    cell
}

/// Returns a table of all slots as a collapsed section, for readers who cannot use the figures.
pub(super) fn slots(record: &FlightRecord) -> Element {
    if record.slots.len() > DETAILED_SLOTS_MAX {
        return element("p")
            .class("lead")
            .text("All slots are in slots.csv.");
    }
    const HEADS: [&str; 11] = [
        "slot",
        "east (m)",
        "north (m)",
        "user",
        "rate (bit/s/Hz)",
        "MSE",
        "empirical",
        "limited by",
        "true",
        "estimate",
        "shield",
    ];
    let rows = record.slots.iter().map(|slot| {
        let limited_by = match (slot.feasible, slot.limited_by) {
            (false, _) => "out of reach",
            (true, LimitedBy::Accuracy) => "accuracy",
            (true, LimitedBy::Power) => "power",
            (true, LimitedBy::None) => "–",
        };
        let cells = [
            slot.slot.to_string(),
            decimal(slot.flown.x, 1),
            decimal(slot.flown.y, 1),
            slot.user_name(),
            significant(slot.rate, 4),
            significant(slot.mse, 4),
            significant(slot.signals.empirical_mse, 4),
            limited_by.into(),
            significant(slot.signals.true_value, 5),
            significant(slot.signals.estimate, 5),
            slots_csv::shield(&slot.intervention).replace('_', " "),
        ];
        element("tr").with_all(cells.map(|cell| element("td").text(cell)))
    });
    let heads = HEADS.map(|head| element("th").set("scope", "col").text(head));
    element("details")
        .class("card")
        .with(element("summary").text("Slot by slot"))
        .with(
            element("div").class("scroll").with(
                element("table")
                    .class("slots")
                    .with(element("thead").with(element("tr").with_all(heads)))
                    .with(element("tbody").with_all(rows)),
            ),
        )
}

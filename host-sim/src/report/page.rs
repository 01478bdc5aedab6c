//! `report.html`: verdicts, the map, the figures, all facts, and the slots as a table. Without
//! scripts everything can be read; a few lines of script link the figures under the pointer.

use firmware_core::{inner::LimitedBy, shield::Intervention};

use super::{
    axis::DETAILED_SLOTS_MAX,
    map,
    markup::{Element, element},
    quantity::{self, count, decimal, percent, plain, power_unit, significant},
    schedule, series, slots_csv, theme,
};
use crate::record::{FlightRecord, Summary, Timing};

/// The whole page.
pub(super) fn html(record: &FlightRecord, summary: &Summary) -> String {
    let title = format!("{} · {}", summary.scenario, summary.policy);
    let head = element("head")
        .with(element("meta").set("charset", "utf-8"))
        .with(
            element("meta")
                .set("name", "viewport")
                .set("content", "width=device-width, initial-scale=1"),
        )
        .with(
            element("meta")
                .set("name", "generator")
                .set("content", format!("host-sim {}", summary.version)),
        )
        .with(element("title").text(title))
        .with(theme::page_style());
    let body = element("body").with(
        element("main")
            .with(heading(record, summary))
            .with(tiles(record, summary))
            .with(figures(record, summary))
            .with(facts(record, summary))
            .with(slots(record))
            .with_all(events(record))
            .with(element("script").verbatim(include_str!("page.js"))),
    );
    let page = element("html").set("lang", "en").with(head).with(body);
    format!("<!DOCTYPE html>\n{page}")
}

fn heading(record: &FlightRecord, summary: &Summary) -> Element {
    element("header")
        .with(element("p").class("kicker").text("Flight report"))
        .with(
            element("h1")
                .text(summary.scenario.clone())
                .with(element("span").class("by").text(" flown by "))
                .text(summary.policy.clone()),
        )
        .with_all(broken_off(record))
        .with(element("p").class("lead").text(format!(
            "{}, {} allocation, {} vehicle, seed {}",
            count(summary.slots, "slot"),
            summary.inner,
            summary.profile,
            summary.seed
        )))
}

/// Said first of a flight that did not reach its end.
fn broken_off(record: &FlightRecord) -> Option<Element> {
    let slots = record.scenario.mission.slots() as usize;
    (record.slots.len() < slots).then(|| {
        element("p").class("alarm").text(format!(
            "Broken off after {} of {slots} slots.",
            record.slots.len()
        ))
    })
}

/// A verdict or number that one wants to see first.
struct Tile {
    holds: Option<bool>,
    name: &'static str,
    value: String,
    unit: &'static str,
    words: String,
    /// A share of 1, drawn as a bar.
    share: Option<f64>,
}

fn tiles(record: &FlightRecord, summary: &Summary) -> Element {
    let mission = &record.scenario.mission;
    let share = summary.sum_rate / summary.sum_rate_physical_limit;
    let verdict = |holds: bool| if holds { "yes" } else { "no" }.to_owned();
    let fewest = summary.users.iter().map(|user| user.slots).min();
    let tiles = [
        Tile {
            holds: None,
            name: "Total rate",
            value: significant(summary.sum_rate, 4),
            unit: "bit/s/Hz",
            words: format!(
                "over {}, {} each",
                count(summary.slots, "slot"),
                significant(summary.sum_rate / summary.slots.max(1) as f64, 3)
            ),
            share: None,
        },
        Tile {
            holds: None,
            name: "Of the physical limit",
            value: decimal(share * 100.0, 1),
            unit: "%",
            words: format!(
                "of {} bit/s/Hz, which no path can exceed",
                significant(summary.sum_rate_physical_limit, 4)
            ),
            share: Some(share),
        },
        Tile {
            holds: Some(summary.arrived),
            name: "Arrived",
            value: verdict(summary.arrived),
            unit: "",
            words: format!(
                "{} m from the destination, {} m allowed",
                decimal(summary.arrival_distance_m, 1),
                plain(mission.reach_m())
            ),
            share: None,
        },
        Tile {
            holds: Some(summary.fair),
            name: "Fair",
            value: verdict(summary.fair),
            unit: "",
            words: format!(
                "every user has at least {}, {} owed",
                count(fewest.unwrap_or(0) as usize, "slot"),
                mission.quota()
            ),
            share: None,
        },
        Tile {
            holds: Some(summary.mse_violations == 0),
            name: "Accurate",
            value: verdict(summary.mse_violations == 0),
            unit: "",
            words: if summary.mse_violations == 0 {
                format!(
                    "MSE at most {}, threshold {}",
                    significant(summary.mse_max, 4),
                    plain(summary.mse_threshold)
                )
            } else {
                format!(
                    "{} above the threshold {}, MSE up to {}",
                    count(summary.mse_violations, "slot"),
                    plain(summary.mse_threshold),
                    significant(summary.mse_max, 3)
                )
            },
            share: None,
        },
    ];
    element("section")
        .class("tiles")
        .set("aria-label", "Verdicts")
        .with_all(tiles.into_iter().map(tile))
}

fn tile(tile: Tile) -> Element {
    let class = match tile.holds {
        Some(true) => "tile good",
        Some(false) => "tile bad",
        None => "tile",
    };
    let mut value = element("p").class("value");
    match tile.holds {
        Some(true) => value.push(sign("✓")),
        Some(false) => value.push(sign("✗")),
        None => (),
    }
    let mut value = value.text(tile.value);
    if !tile.unit.is_empty() {
        value.push(
            element("span")
                .class("unit")
                .text(format!(" {}", tile.unit)),
        );
    }
    let mut tile_element = element("div")
        .class(class)
        .with(element("h2").text(tile.name))
        .with(value);
    if let Some(share) = tile.share {
        let width = (share * 100.0).clamp(0.0, 100.0);
        tile_element.push(
            element("div").class("meter").with(
                element("div")
                    .class("level")
                    .set("style", format!("width:{width:.1}%"))
                    .text(""),
            ),
        );
    }
    tile_element.with(element("p").class("words").text(tile.words))
}

fn sign(sign: &'static str) -> Element {
    element("span")
        .class("sign")
        .set("aria-hidden", "true")
        .text(sign)
}

fn figures(record: &FlightRecord, summary: &Summary) -> Element {
    let unit = quantity::unit(&record.scenario.sensing.unit);
    let rates = record.slots.iter().map(|slot| slot.rate);
    let lowest = rates.clone().fold(f64::INFINITY, f64::min);
    let highest = rates.fold(0.0, f64::max);
    let infeasible = record.slots.iter().filter(|slot| !slot.feasible).count();
    let of_threshold = match infeasible {
        0 => "Γ could be met in every slot".to_owned(),
        some => format!("Γ was out of reach in {}", count(some, "slot")),
    };
    let limited = |by| {
        let slots = record.slots.iter();
        slots
            .filter(|slot| slot.feasible && slot.limited_by == by)
            .count()
    };
    let deviation = match decimal(summary.planned_vs_flown_m, 2).as_str() {
        "0.00" => "every waypoint was reached".to_owned(),
        most => format!(
            "waypoints were missed by {most} m at most, {} m in the median",
            decimal(summary.planned_vs_flown_median_m, 2)
        ),
    };
    let figure = |title: &'static str, words: String, drawing: Element| {
        element("figure")
            .with(
                element("figcaption")
                    .with(element("h2").text(title))
                    .with(element("p").text(words)),
            )
            .with(drawing)
    };
    element("section")
        .class("figures")
        .set("aria-label", "Figures")
        .with(figure(
            "Path",
            format!("Colour is the rate reached there; {deviation}."),
            map::draw(&record.scenario, Some(record), None),
        ))
        .with(
            element("div")
                .class("stack")
                .with(figure(
                    "Rate per slot",
                    format!(
                        "{} to {} bit/s/Hz; limited by the user's power in {}, by accuracy in {}{}.",
                        significant(lowest, 3),
                        significant(highest, 3),
                        count(limited(LimitedBy::Power), "slot"),
                        limited(LimitedBy::Accuracy),
                        match infeasible {
                            0 => String::new(),
                            some => format!("; no rate in {some}"),
                        }
                    ),
                    series::rate(record),
                ))
                .with(figure(
                    "Schedule",
                    format!("Who is served when; {}.", shield(record)),
                    schedule::strip(record),
                )),
        )
        .with(figure(
            "Accuracy of the average",
            format!(
                "{of_threshold}; empirical / analytic MSE {} ± {}.",
                decimal(summary.empirical_mse_ratio, 3),
                decimal(summary.empirical_mse_ratio_standard_error, 3)
            ),
            series::mse(record),
        ))
        .with(figure(
            "Estimate over the air",
            format!(
                "The sensors' {}; error {} {unit} rms.",
                record.scenario.sensing.function,
                significant(summary.estimate_error_rms, 3)
            ),
            series::estimate(record),
        ))
        .with(figure(
            "Total per user",
            format!(
                "Each piece is a slot, coloured by its rate; {} owed to everybody.",
                match record.scenario.mission.quota() {
                    1 => "1 slot is".to_owned(),
                    quota => format!("{quota} slots are"),
                }
            ),
            schedule::totals(record),
        ))
        .with(figure(
            "Transmit powers",
            "The served user and the mean over the sensors, slot by slot.".into(),
            series::power(record),
        ))
}

/// What the shield did, in words.
fn shield(record: &FlightRecord) -> String {
    let slots = |changed: fn(&Intervention) -> bool| {
        let slots = record.slots.iter();
        slots.filter(|slot| changed(&slot.intervention)).count()
    };
    let changes = [
        (slots(|shield| shield.user), "the user"),
        (slots(|shield| shield.displacement), "the displacement"),
        (slots(|shield| shield.broken_output), "a broken output"),
        (slots(|shield| shield.out_of_reach), "a place out of reach"),
    ];
    let changes: Vec<String> = changes
        .into_iter()
        .filter(|(slots, _)| *slots > 0)
        .map(|(slots, what)| format!("{what} in {}", count(slots, "slot")))
        .collect();
    match changes.is_empty() {
        true => "the shield left every action of the policy as it was".into(),
        false => format!("the shield corrected {}", changes.join(", ")),
    }
}

fn facts(record: &FlightRecord, summary: &Summary) -> Element {
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
    let outcome = vec![
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
            "Constraints broken",
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
            format!("{} m at most", decimal(summary.planned_vs_flown_m, 3)),
        ),
        ("Plan, median and max", timing(&summary.plan_us)),
        ("Allocate, median and max", timing(&summary.allocate_us)),
    ];
    let table_one = vec![
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

/// What the autopilot and its client said to one another, folded away.
fn events(record: &FlightRecord) -> Option<Element> {
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

/// Names with symbols in them: `q_f` gets a subscript.
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

/// Every slot in words and numbers, folded away: for readers without eyes for figures.
fn slots(record: &FlightRecord) -> Element {
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
            format!("u{}", slot.served_user),
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

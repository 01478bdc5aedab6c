//! `report.html`: the main results, the map, the figures, all tables, and the slots as a table. The
//! page is complete without scripts; a short script highlights the slot under the pointer in all
//! figures.

use firmware_core::{inner::LimitedBy, shield::Intervention};

use super::{against_waypoints, facts, map, of_ideal_flight, of_knowledge, schedule, series};
use crate::record::{FlightRecord, Summary};
use figures::{
    markup::{Element, element},
    page,
    quantity::{self, count, decimal, plain, significant},
};

/// Returns the whole page.
pub(super) fn html(record: &FlightRecord, summary: &Summary) -> String {
    let title = format!("{} · {}", summary.scenario, summary.policy);
    let generator = format!("host-sim {}", summary.version);
    let main = element("main")
        .with(heading(record, summary))
        .with(tiles(record, summary))
        .with(figures(record, summary))
        .with(facts::tables(record, summary))
        .with(facts::slots(record))
        .with_all(facts::events(record))
        .with(element("script").verbatim(include_str!("page.js")));
    page::page(title, generator, main)
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
        .with_all(aborted(record))
        .with_all(policy_warning(summary))
        .with(element("p").class("lead").text(format!(
            "{}, {} allocation, {} vehicle, seed {}",
            count(summary.slots, "slot"),
            summary.inner,
            summary.profile,
            summary.seed
        )))
}

/// Returns the notice at the top of the page for a flight that was aborted.
fn aborted(record: &FlightRecord) -> Option<Element> {
    let slots = record.scenario.mission.slots() as usize;
    (record.slots.len() < slots).then(|| {
        element("p").class("alarm").text(format!(
            "Aborted after {} of {slots} slots.",
            record.slots.len()
        ))
    })
}

/// Returns the warning about a policy that was trained for another mission.
fn policy_warning(summary: &Summary) -> Option<Element> {
    let warning = summary.policy_warning.as_ref()?;
    Some(
        element("p")
            .class("alarm")
            .text(format!("Warning: the policy was {warning}.")),
    )
}

/// A main result: a verdict or a number.
struct Tile {
    holds: Option<bool>,
    name: &'static str,
    value: String,
    unit: &'static str,
    words: String,
    /// The fraction of 1 that is drawn as a bar.
    share: Option<f64>,
}

fn tiles(record: &FlightRecord, summary: &Summary) -> Element {
    let mission = &record.scenario.mission;
    let share = summary.sum_rate / summary.sum_rate_physical_limit;
    let verdict = |holds: bool| if holds { "yes" } else { "no" }.to_owned();
    let tiles = [
        Tile {
            holds: None,
            name: "Total rate",
            value: significant(summary.sum_rate, 4),
            unit: "bit/s/Hz",
            words: [format!(
                "over {}, {} each",
                count(summary.slots, "slot"),
                significant(summary.sum_rate / summary.slots.max(1) as f64, 3)
            )]
            .into_iter()
            .chain(of_ideal_flight(summary).map(|(share, of)| format!("{share} {of}")))
            .collect::<Vec<_>>()
            .join("; "),
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
                "every user has at least {}, quota {}",
                count(summary.fewest_slots() as usize, "slot"),
                summary.quotas_in_words()
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
            "waypoints were missed by {most} m at most, {} m in the median: {}",
            decimal(summary.planned_vs_flown_median_m, 2),
            against_waypoints(summary, 3)
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
                "{of_threshold}; empirical / analytic MSE {} ± {}{}.",
                decimal(summary.empirical_mse_ratio, 3),
                decimal(summary.empirical_mse_ratio_standard_error, 3),
                match &summary.knowledge {
                    Some(knowledge) => {
                        let facts = of_knowledge(knowledge).into_iter();
                        let words = facts.map(|(name, value, words)| format!("; {name} {value} {words}"));
                        words.collect()
                    }
                    None => String::new(),
                }
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
                "Each piece is a slot, coloured by its rate; each user's quota is {}.",
                count(record.scenario.mission.quota() as usize, "slot")
            ),
            schedule::totals(record),
        ))
        .with(figure(
            "Transmit powers",
            "The served user and the mean over the sensors, slot by slot.".into(),
            series::power(record),
        ))
}

/// Describes what the shield changed.
fn shield(record: &FlightRecord) -> String {
    let slots = |changed: fn(&Intervention) -> bool| {
        let slots = record.slots.iter();
        slots.filter(|slot| changed(&slot.intervention)).count()
    };
    let changes = [
        (slots(|shield| shield.user), "the user"),
        (slots(|shield| shield.displacement), "the displacement"),
        (slots(|shield| shield.broken_output), "an invalid output"),
        (slots(|shield| shield.out_of_reach), "a place out of reach"),
    ];
    let changes: Vec<String> = changes
        .into_iter()
        .filter(|(slots, _)| *slots > 0)
        .map(|(slots, what)| format!("{what} in {}", count(slots, "slot")))
        .collect();
    match changes.is_empty() {
        true => "the shield changed no action of the policy".into(),
        false => format!("the shield corrected {}", changes.join(", ")),
    }
}

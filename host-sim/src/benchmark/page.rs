//! The benchmark as one self-contained page: the table, the fractions of all missions, and the
//! missions with the smallest ones.

use figures::{
    chart::{self, Axis, Chart, Panel},
    markup::{Element, element},
    page,
    series::{Look, Series},
};
use scenario::Scenario;
use vehicle::Profile;

use simulation::benchmark::{Bounds, COUNTED_GAP, Flown, shares};

use super::Table;

const TITLE: &str = "Policies against certified bounds";
/// The number of missions in the list of the smallest fractions.
const LISTED: usize = 12;

/// Returns the page for flights of `policies` with one profile.
pub fn page(
    scenarios: &[Scenario],
    policies: &[String],
    profile: Profile,
    flights: &[Flown],
    bounds: &Bounds,
    table: &Table,
) -> String {
    let lead = format!(
        "{} missions, vehicle profile {profile}. A fraction is a mission's sum rate by that of its \
         certified upper bound, which no flight exceeds. Missions whose certified gap is above {} % do \
         not count.",
        scenarios.len(),
        100.0 * COUNTED_GAP,
    );
    let mut main = element("main")
        .with(element("h1").text(TITLE))
        .with(element("p").class("lead").text(lead))
        .with(section("Statistics", table.to_element()));
    if let Some(chart) = distribution(policies, flights, bounds) {
        let drawing = element("div").class("scroll").with(chart.to_element());
        main.push(section(
            "All missions",
            element("figure").with(drawing).with(element("figcaption").with(
                element("p").text(
                    "The fractions of each policy in ascending order: where a line is at 50 %, half of the missions \
                     have a smaller fraction.",
                ),
            )),
        ));
    }
    for policy in policies {
        if let Some(list) = smallest(policy, scenarios, flights, bounds) {
            let title = format!("The smallest fractions of {policy}");
            main.push(section(title, list));
        }
    }
    let generator = format!("host-sim {}", env!("CARGO_PKG_VERSION"));
    page::page(TITLE.into(), generator, main)
}

fn section(title: impl Into<String>, content: Element) -> Element {
    element("section")
        .with(element("h2").text(title.into()))
        .with(content)
}

/// Draws the sorted fractions of all policies; `None` if no mission counts.
fn distribution(policies: &[String], flights: &[Flown], bounds: &Bounds) -> Option<Chart> {
    let series: Vec<Series> = policies
        .iter()
        .enumerate()
        .filter_map(|(index, policy)| {
            let shares = shares(policy, flights, bounds);
            let count = shares.len() as f64;
            let point = |(rank, (share, _)): (usize, &(f64, &str))| {
                (100.0 * (rank as f64 + 0.5) / count, *share)
            };
            let points: Vec<_> = shares.iter().enumerate().map(point).collect();
            let mut series = Series::new(policy.clone(), Look::nth(index), points);
            series.mark_every = (shares.len() / 12).max(1);
            (!shares.is_empty()).then_some(series)
        })
        .collect();
    let all = series.iter().flat_map(|series| &series.points);
    let y = Axis::around("fraction of the certified bound", all.map(|point| point.1));
    let x = Axis::new("missions, %", [0.0, 100.0]);
    let panel = Panel {
        title: String::new(),
        x,
        y,
        series,
    };
    (!panel.series.is_empty()).then(|| Chart {
        title: "Sorted fractions of the certified bound, one line per policy".into(),
        panels: vec![panel],
        columns: 1,
        size: chart::SIZE,
    })
}

/// Lists the missions on which a policy has its smallest fractions; `None` if none counts.
fn smallest(
    policy: &str,
    scenarios: &[Scenario],
    flights: &[Flown],
    bounds: &Bounds,
) -> Option<Element> {
    let shares = shares(policy, flights, bounds);
    let rows = shares
        .iter()
        .take(LISTED)
        .filter_map(|(share, name)| {
            let scenario = scenarios.iter().find(|scenario| scenario.name == *name)?;
            let parameters = scenario.mission.parameters();
            let cells = [
                format!("{share:.4}"),
                scenario.mission.user_count().to_string(),
                scenario.mission.sensor_count().to_string(),
                scenario.mission.slots().to_string(),
                format!("{:.0}", parameters.max_speed_mps),
                format!("{:.4}", parameters.mse_threshold),
            ];
            let name = element("td").class("said").text((*name).to_owned());
            let cells = cells.into_iter().map(|cell| element("td").text(cell));
            Some(element("tr").with(name).with_all(cells))
        })
        .collect::<Vec<_>>();
    let headings = ["fraction", "users", "sensors", "slots", "m/s", "Gamma"];
    let head = element("tr")
        .with(element("th").class("said").text("mission"))
        .with_all(headings.map(|heading| element("th").text(heading)));
    let table = element("table")
        .class("slots")
        .with(element("thead").with(head))
        .with(element("tbody").with_all(rows));
    (!shares.is_empty()).then(|| element("div").class("scroll").with(table))
}

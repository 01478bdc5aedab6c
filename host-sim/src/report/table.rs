//! The summary for a terminal of 80 columns: fact, value, verdict. It is formatted here because a
//! table crate would add borders and wrapping that are not needed.

use std::io::IsTerminal;

use super::{of_certified_bound, of_ideal_flight, of_knowledge};
use crate::record::{FlightRecord, Summary};
use figures::quantity::{self, count, decimal, percent, plain, significant};

/// The formatting options.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Look {
    /// Whether verdicts are coloured. They are always given by signs and words as well.
    pub color: bool,
}

impl Look {
    /// Returns the options for standard output: colours if it is a terminal, unless `NO_COLOR` is set or
    /// `TERM` is `dumb`.
    pub fn of_stdout() -> Self {
        let set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
        let dumb = std::env::var_os("TERM").is_some_and(|terminal| terminal == "dumb");
        Self {
            color: std::io::stdout().is_terminal() && !set("NO_COLOR") && !dumb,
        }
    }

    fn paint(self, code: &str, words: &str) -> String {
        match self.color {
            true => format!("\u{1b}[{code}m{words}\u{1b}[0m"),
            false => words.into(),
        }
    }
}

/// A line: whether the value is as required (if it has a requirement), the name, the value, and an
/// explanation.
struct Fact {
    holds: Option<bool>,
    name: &'static str,
    value: String,
    words: String,
}

/// The columns at which the parts of a line begin, and the width of the table.
const NAME: usize = 15;
const VALUE: usize = 17;
const WIDTH: usize = 80;

/// Formats the summary for a terminal. Lines are at most 80 columns long, except those with file
/// names.
pub fn table(record: &FlightRecord, summary: &Summary, look: Look) -> String {
    let names = [&summary.scenario, &summary.policy];
    let [scenario, policy] = names.map(|name| printable(name));
    let title = look.paint("1", &format!("{scenario} · {policy}"));
    let mut lines = vec![format!(
        "{title} · {} allocation · {} vehicle · seed {}",
        summary.inner, summary.profile, summary.seed
    )];
    lines.push(String::new());
    for fact in facts(record, summary) {
        let sign = match fact.holds {
            Some(true) => look.paint("32", "✓"),
            Some(false) => look.paint("1;31", "✗"),
            None => " ".into(),
        };
        let value = pad(&fact.value, VALUE);
        let value = match fact.holds {
            Some(false) => look.paint("1;31", &value),
            _ => look.paint("1", &value),
        };
        let line = format!("{sign} {}{value} {}", pad(fact.name, NAME), fact.words);
        lines.push(line.trim_end().into());
    }
    lines.push(String::new());
    lines.extend(users(summary, look));
    lines.push(String::new());
    lines.join("\n")
}

fn facts(record: &FlightRecord, summary: &Summary) -> Vec<Fact> {
    let mission = &record.scenario.mission;
    let unit = quantity::unit(&record.scenario.sensing.unit);
    let ratio = summary.empirical_mse_ratio;
    let deviation = summary.empirical_mse_ratio_standard_error;
    let fact = |holds, name, value, words| Fact {
        holds,
        name,
        value,
        words,
    };
    let link = &summary.link;
    let dropped = link.vehicle.link.dropped() + link.ground.dropped();
    let mut facts = vec![
        fact(
            None,
            "total rate",
            format!("{} bit/s/Hz", significant(summary.sum_rate, 4)),
            format!(
                "{} of the physical limit {}",
                percent(summary.sum_rate / summary.sum_rate_physical_limit),
                significant(summary.sum_rate_physical_limit, 4)
            ),
        ),
        fact(
            Some(summary.arrived),
            "arrived",
            format!("{} m away", decimal(summary.arrival_distance_m, 1)),
            format!("within {} m of the destination", plain(mission.reach_m())),
        ),
        fact(
            Some(summary.fair),
            "fair",
            count(summary.fewest_slots() as usize, "slot"),
            format!("at least per user, quota {}", summary.quotas_in_words()),
        ),
        fact(
            Some(summary.mse_violations == 0),
            "MSE",
            significant(summary.mse_max, 4),
            format!(
                "at most, threshold {}, {} of {} above",
                significant(summary.mse_threshold, 4),
                summary.mse_violations,
                summary.slots
            ),
        ),
        fact(
            Some(summary.constraint_violations == 0),
            "constraints",
            format!("{} violated", summary.constraint_violations),
            "speed, area, arrival, quotas".into(),
        ),
        fact(
            Some((ratio - 1.0).abs() <= 3.0 * deviation),
            "signals",
            format!("{} ± {}", decimal(ratio, 3), decimal(deviation, 3)),
            "empirical over analytic MSE".into(),
        ),
        fact(
            None,
            "estimate",
            format!("{} {unit}", significant(summary.estimate_error_rms, 3)),
            format!("error (rms) of the {}", record.scenario.sensing.function),
        ),
        fact(
            None,
            "off the plan",
            format!("{} m", decimal(summary.planned_vs_flown_m, 2)),
            format!(
                "at most, median {} m",
                decimal(summary.planned_vs_flown_median_m, 2)
            ),
        ),
        fact(
            None,
            "shield",
            count(summary.shield_interventions, "slot"),
            format!("of {} changed", summary.slots),
        ),
        fact(
            None,
            "ground link",
            count(dropped as usize, "frame"),
            format!(
                "dropped, {} on aged channel state",
                count(summary.link.vehicle.slots.stale as usize, "slot")
            ),
        ),
        timing("plan", &summary.plan_us),
        timing("allocate", &summary.allocate_us),
    ];
    if let Some((share, of)) = of_ideal_flight(summary) {
        facts.insert(1, fact(None, "ideal flight", share, of));
    }
    if let Some(knowledge) = &summary.knowledge {
        let facts_of = of_knowledge(knowledge).into_iter();
        let facts_of = facts_of.map(|(name, value, words)| fact(None, name, value, words));
        facts.splice(4..4, facts_of);
    }
    if let Some((fraction, of)) = of_certified_bound(summary) {
        facts.insert(1, fact(None, "of any mission", fraction, of));
    }
    facts
}

fn timing(name: &'static str, timing: &crate::record::Timing) -> Fact {
    Fact {
        holds: None,
        name,
        value: format!("{} µs", significant(timing.median, 3)),
        words: format!("median, {} µs at most", significant(timing.max, 3)),
    }
}

/// Formats a column per user with its number, slots and data; red if its quota was not met.
fn users(summary: &Summary, look: Look) -> Vec<String> {
    const COLUMN: usize = 6;
    let heads = ["user", "slots", "bit/s/Hz"];
    let indent = 2 + NAME;
    let numbered: Vec<_> = summary.users.iter().enumerate().collect();
    let mut lines = Vec::new();
    for chunk in numbered.chunks((WIDTH - indent) / COLUMN) {
        for (row, head) in heads.into_iter().enumerate() {
            let mut line = format!("  {}", pad(head, NAME));
            for (user, summary) in chunk {
                let cell = match row {
                    0 => format!("u{user}"),
                    1 => summary.slots.to_string(),
                    _ => significant(summary.data, 3),
                };
                let cell = format!("{cell:>COLUMN$}");
                line.push_str(&match (row, summary.is_short()) {
                    (0, _) => look.paint("2", &cell),
                    (1, true) => look.paint("1;31", &cell),
                    _ => cell,
                });
            }
            lines.push(line);
        }
    }
    lines
}

/// Removes control characters from a name that comes from a file.
fn printable(name: &str) -> String {
    name.chars()
        .map(|character| match character.is_control() {
            true => char::REPLACEMENT_CHARACTER,
            false => character,
        })
        .collect()
}

fn pad(words: &str, width: usize) -> String {
    let missing = width.saturating_sub(words.chars().count());
    format!("{words}{}", " ".repeat(missing))
}

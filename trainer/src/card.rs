//! Model cards: a description of a shipped policy and of its training, and its learning curve as SVG.

use std::fmt::Write as _;

use figures::series::{Color, Line, Look, Series};

use crate::{
    checkpoint::{Evaluated, TrainingProgress},
    compare::References,
    curves,
    metrics::{EVALUATION, MetricsRow, SUM_RATE},
};

/// Returns the model card in Markdown. `name` is the stem of the files' names, and `command` is the
/// command that trained the policy.
pub fn markdown(
    name: &str,
    command: &str,
    progress: &TrainingProgress,
    best: &Evaluated,
    references: &References,
) -> String {
    let s = &progress.settings;
    let rate = best.flight.sum_rate;
    let compared = |other: f64| format!("{other:.3} (policy: {:.1} % of it)", 100.0 * rate / other);
    let rows = [
        ("Scenario", progress.scenario.clone()),
        ("Scenario digest", format!("`{}`", progress.scenario_digest)),
        ("Made by", format!("`{command}`")),
        ("Algorithm", s.algorithm.name().to_uppercase()),
        ("Seed", s.seed.to_string()),
        (
            "Episodes, slots",
            format!("{}, {}", progress.episode, progress.global_step),
        ),
        ("Kept after episode", best.episode.to_string()),
        (
            "Total rate",
            format!(
                "**{rate:.3}** bit/s/Hz over {} slots",
                best.flight.path_m.len()
            ),
        ),
        ("Straight line", compared(references.straight_line)),
        ("Search", compared(references.search)),
        ("Upper bound of any mission", compared(references.bound)),
        (
            "Constraints",
            format!(
                "arrived: {}, fair: {}, slots over Gamma: {}",
                yes(best.flight.arrived),
                yes(best.flight.fair),
                best.flight.mse_violations
            ),
        ),
        (
            "Slots in which the shield acted",
            best.flight.shield_interventions.to_string(),
        ),
    ];
    let mut card = format!("# {name}\n\n| | |\n|---|---|\n");
    for (key, value) in rows {
        // Writing to a string cannot fail.
        let _ = writeln!(card, "| {key} | {value} |");
    }
    let _ = write!(
        card,
        "\nThe same command writes the same bytes, with any of the vector instructions that \
         docs/training.md names.\nSearch and bound are those of `host-sim bound`. The shield acts in \
         most slots: the policy's displacements fill a\nsquare, of which the shield keeps the disc \
         that the speed allows, and the policy scores users that have already\nhad their slots, \
         which the shield excludes.\n\n![Learning curve]({name}.svg)\n"
    );
    card
}

/// Returns "yes" or "no".
fn yes(is: bool) -> &'static str {
    if is { "yes" } else { "no" }
}

/// Number of episodes that a point of the curve with exploration averages over.
const WINDOW: usize = 40;

/// Returns the learning curve as SVG: the total rate over episodes, with exploration (means over 40
/// episodes) and of the deterministic policy, and those of two references.
pub fn learning_curve(rows: &[MetricsRow], references: &References) -> String {
    let explored = curves::means(rows, SUM_RATE, WINDOW);
    let evaluated = curves::means(rows, EVALUATION, 1);
    let last = explored.last().map_or(1.0, |point| point.0);
    let level = |name: &str, rate: f64, dashes: &'static str| {
        let look = Look {
            marker: None,
            line: Line::Dashed(dashes),
            color: Color::Soft,
        };
        Series::new(name, look, vec![(0.0, rate), (last, rate)])
    };
    let solid = |color: Color| Look {
        marker: None,
        line: Line::Solid,
        color,
    };
    let series = vec![
        Series::new("deterministic", solid(Color::Series(1)), evaluated),
        Series::new("exploring", solid(Color::Soft), explored),
        level("search", references.search, "6 4"),
        level("straight line", references.straight_line, "2 4"),
    ];
    curves::over_episodes("Learning curve", series)
}

//! The planner's figures: instructions, measured by an image of its own, and how far the plans are
//! from the best.

use std::{fs, path::Path};

use anyhow::{Context, Result};

use crate::{
    build::Images,
    figure::{Figure, printed},
    order,
};

/// The certified bounds of the shipped missions.
const BOUNDS: &str = "models/bounds.csv";

/// Returns the figures of the planner. The limits are those that the project has set itself.
pub(crate) fn figures(root: &Path, images: &Images) -> Result<Vec<Figure>> {
    let lines = printed(root, &images.bench_planner)?;
    let number = |part: &str| {
        let line = lines.get(part).and_then(|line| line["value"].as_u64());
        line.with_context(|| format!("the planner's bench printed no value for {part}"))
    };
    let instructions = |name, part, limit| {
        anyhow::Ok(Figure {
            name,
            unit: "instructions",
            value: number(part)?,
            limit: Some(limit),
            ..Figure::default()
        })
    };
    // The bench prints rates in 10^-4 bit/s/Hz.
    let rate = |part| number(part).map(|scaled| scaled as f64 * 1e-4);
    let below = |name, part, best: f64, limit| {
        anyhow::Ok(Figure {
            name,
            unit: "x 10^-4",
            value: ((1.0 - rate(part)? / best).max(0.0) * 1e4).ceil() as u64,
            limit,
            ..Figure::default()
        })
    };
    let bound = bound(root)?;
    let unlimited = rate("replan, value without a limit")?;
    Ok(vec![
        instructions(
            "planner: first plan of the default mission",
            "first plan",
            4_000_000_000,
        )?,
        below(
            "planner: how far that plan is below the certified bound",
            "first plan, value",
            bound,
            Some(200),
        )?,
        instructions(
            "planner: a new plan after a user has moved",
            "replan",
            200_000_000,
        )?,
        below(
            "planner: how far that plan is below that of a search without a limit",
            "replan, value",
            unlimited,
            None,
        )?,
        instructions("planner: the most in one poll", "poll", 2_000_000)?,
        instructions(
            "planner: the most in one poll, with 150 slots, 16 users, 64 sensors",
            "poll, largest mission",
            2_000_000,
        )?,
    ])
}

/// Returns the certified upper bound of the default mission, bit/s/Hz.
fn bound(root: &Path) -> Result<f64> {
    let digest = order::default_scenario()?.digest();
    let path = root.join(BOUNDS);
    let table = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    let mut rows = table.lines().map(|line| line.split(','));
    let names: Vec<&str> = rows.next().context("no header")?.collect();
    let column = |name: &str| {
        let found = names.iter().position(|&known| known == name);
        found.with_context(|| format!("{BOUNDS} has no column {name}"))
    };
    let (key, upper) = (column("scenario_digest")?, column("upper")?);
    rows.map(|row| row.collect::<Vec<_>>())
        .find(|row| row.get(key) == Some(&digest.as_str()))
        .and_then(|row| row.get(upper)?.parse().ok())
        .with_context(|| format!("{BOUNDS} has no bound of {}", order::DEFAULT))
}

//! The figures of the policy for any mission: instructions, measured by an image of its own, and
//! bytes.

use std::{fs, path::Path};

use anyhow::{Context, Result, ensure};
use firmware_core::policy::sets::{SetsNetwork, SetsWork};

use crate::{
    build::Images,
    elf::Sizes,
    figure::{Figure, printed},
};

/// The least number of decisions that are measured.
const DECISIONS: u64 = 250;

/// Returns the figures of the image with the policy for any mission, whose flight needs `stack` bytes
/// of stack at most. The limits are those that the project has set itself.
pub(crate) fn figures(root: &Path, images: &Images, stack: u64) -> Result<Vec<Figure>> {
    let lines = printed(root, &images.bench_sets)?;
    let instructions = |name, part: &str, limit| {
        let line = lines.get(part);
        let line =
            line.with_context(|| format!("the bench of any mission printed no line for {part}"))?;
        let number = |key: &str| {
            let number = line[key].as_u64();
            number.with_context(|| format!("{part}: no {key}"))
        };
        ensure!(
            number("count")? >= DECISIONS,
            "{part}: measured fewer than {DECISIONS} times"
        );
        Ok(Figure {
            name,
            unit: "instructions",
            value: number("worst")?,
            mean: Some(number("mean")?),
            limit,
            ..Figure::default()
        })
    };
    let bytes = |name, value, limit| Figure {
        name,
        unit: "bytes",
        value,
        limit,
        ..Figure::default()
    };
    let file = &images.any_mission.policy;
    let file = fs::read(file).with_context(|| file.display().to_string())?;
    let network = SetsNetwork::load(file, &mut SetsWork::default())?;
    let header = network.header();
    let weights = header.architecture.weight_count() * header.precision.bytes();
    let sizes = Sizes::read(&images.any_mission.image)?;
    ensure!(
        sizes.sets_work > 0,
        "the image has no work space of the policy for any mission"
    );
    let statics = u64::from(sizes.data) + u64::from(sizes.bss);
    let statics = statics
        .checked_sub(sizes.planner.into())
        .context("the planner's statics are not in RAM")?;
    let flash = u64::from(sizes.text) + u64::from(sizes.rodata) + u64::from(sizes.data);
    Ok(vec![
        instructions(
            "policy for any mission: a decision, 16 users and 64 sensors",
            "decision",
            Some(20_000_000),
        )?,
        instructions("of that, the observation", "observation", None)?,
        bytes(
            "flash: weights of the policy for any mission",
            weights as u64,
            Some(384 * 1024),
        ),
        bytes("flash in all, with the policy for any mission", flash, None),
        bytes(
            "RAM: work space of the policy for any mission",
            sizes.sets_work.into(),
            None,
        ),
        bytes(
            "RAM: stack, the most of a flight with the policy for any mission and changes",
            stack,
            None,
        ),
        bytes(
            "RAM in all with the policy for any mission, without the planner's tables",
            statics + stack,
            None,
        ),
    ])
}

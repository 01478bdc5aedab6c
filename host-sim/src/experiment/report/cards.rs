//! The card of the shipped policies of the figures' missions: how each was trained, and what it
//! reaches.

use std::{
    fmt::{Display, Write as _},
    path::{Path, PathBuf},
};

use crate::experiment::{
    ExperimentContext,
    cell::{Cell, Learner, Training},
    table,
};
use crate::policy::{HostPolicy, PolicyChoice};
use environment::Allocation;

/// Writes the card of all available policies of the figures' cells: how each was trained, and its
/// result when it is flown.
///
/// # Errors
/// Returns an error if a policy cannot be loaded, does not fit or cannot be flown, or if a file
/// cannot be written.
pub fn write_cards(context: &mut ExperimentContext<'_>, path: &Path) -> Result<(), String> {
    let mut text = String::from(
        "# Policies of the figures\n\n\
         Written by `host-sim experiment cards`, which flies every policy here on its mission \
         (controller, links, ideal vehicle).\nA file's name says how it was made: topology, \
         mission time in seconds, noise in minus dBm, Gamma, algorithm, preset,\nseed; so \
         `separated-t60-n95-g0.010-sac-tuned-s1.onnx` is `policy.onnx` of\n\n    \
         trainer train --scenario separated --mse-threshold 0.01 --algorithm sac --preset tuned \
         --seed 1\n\nand `host-sim experiment --train` makes any of them with these arguments. \
         For other times and noise powers the scenario\nis the shipped one with `slots` and \
         `noise_dbm` changed. 4,000 episodes each; the best of the evaluations every 20\nepisodes \
         is kept, after the episode in the table. Input, outputs and metadata: \
         docs/training.md. Every policy is for its own\nmission only: the optimum differs at \
         another threshold or noise power.\n\n\
         | policy | scenario digest | kept after | total rate | of the bound | straight line | \
         arrived, fair | slots over Gamma | shield acted |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    let seeds = context.settings().seeds;
    for cell in Cell::all() {
        for learner in Learner::ALL {
            for seed in 1..=seeds {
                let training = Training::new(cell, learner, seed);
                if let Some(file) = context.trainings().find(&training) {
                    let row = card(context, &training, file)?;
                    let _ = writeln!(text, "{row}");
                }
            }
        }
    }
    table::write_text(path, &text)
}

fn card(
    context: &mut ExperimentContext<'_>,
    training: &Training,
    file: PathBuf,
) -> Result<impl Display + use<>, String> {
    let cell = &training.cell;
    let choice = PolicyChoice::File(file);
    let (policy, _) = HostPolicy::load(&choice, &cell.scenario()?)?;
    let provenance = policy.provenance();
    let kept = provenance.map_or(0, |provenance| provenance.episodes);
    let flown = context.fly(cell, &choice, Allocation::Exact)?.summary();
    let digest = provenance.map_or("", |provenance| &provenance.scenario_digest);
    if digest != flown.scenario_digest {
        return Err(format!(
            "{training}.onnx was trained on a mission other than the one in its name"
        ));
    }
    let line = context.fly(cell, &PolicyChoice::StraightLine, Allocation::Exact)?;
    let bound = context.bound(cell)?;
    let yes = |is: bool| if is { "yes" } else { "no" };
    Ok(format!(
        "| {training} | `{}` | {kept} | {:.3} | {:.1} % | {:.3} | {}, {} | {} | {} |",
        &digest[..12.min(digest.len())],
        flown.sum_rate,
        100.0 * flown.sum_rate / bound.upper,
        line.summary().sum_rate,
        yes(flown.arrived),
        yes(flown.fair),
        flown.mse_violations,
        flown.shield_interventions,
    ))
}

//! The model card of a policy for any mission: what it was trained on, and where it is weak.

use std::fmt::Write as _;

use anyhow::Context;
use pulp::Arch;
use scenario::{Layout, MissionGroup};

use super::{
    encoder::FEATURES,
    held_out::{Evaluation, Flown, HeldOut},
    run::Summary,
    settings::RANDOM,
    trained::TrainedNetwork,
};
use crate::nn::sets::SetNetwork;

/// Number of held-out missions of the distribution, and of each layout.
const MISSIONS: [usize; 2] = [200, 40];

/// Returns the model card in Markdown. `name` is the stem of the files' names, and `command` is the
/// command that trained the policy. The network flies held-out missions for it.
///
/// # Errors
/// Fails if the parameters do not fit the architecture, or if a flight fails.
pub fn markdown(
    name: &str,
    command: &str,
    network: &TrainedNetwork,
    summary: &Summary,
) -> anyhow::Result<String> {
    let mut flying = SetNetwork::new(network.architecture, FEATURES, 0);
    let imported = flying.import(&network.parameters);
    imported.ok().context("the parameters do not fit")?;
    let arch = Arch::new();
    let [count, per_layout] = MISSIONS;
    let flights = HeldOut::new(count, &[])?.fly(arch, &flying)?;
    let mut groups = vec![("all".to_owned(), flights.clone())];
    groups.extend(MissionGroup::BY_SIZE.map(|group| {
        let is_in = |flown: &&Flown| group.contains(&flown.properties);
        let flown = flights.iter().filter(is_in).copied();
        (group.to_string(), flown.collect::<Vec<_>>())
    }));
    for layout in Layout::ALL {
        let held_out = HeldOut::with_layout(per_layout, layout)?;
        let name = format!("users and sensors {}", layout.name());
        groups.push((name, held_out.fly(arch, &flying)?));
    }
    let size = network.architecture;
    let mut card = format!(
        "# {name}\n\nA policy for any mission with up to 16 users and 64 sensors (docs/training.md).\n\n\
         | | |\n|---|---|\n\
         | Made by | `{command}` |\n\
         | Algorithm | {} |\n\
         | Missions | {}, drawn from the distribution of `host-sim scenario random`{} |\n\
         | Seed | {} |\n\
         | Gradient steps | {} of {} states |\n\
         | Duration | {:.0} min |\n\
         | Kept after step | {} |\n\
         | Network | {} weights: width {}, hidden width {}, {} layers |\n\n\
         Totals as fractions of those of the onboard planner, on missions that it did not learn from:\n\n\
         | missions | | mean | 5 % quantile | worst | violated |\n|---|--:|--:|--:|--:|--:|\n",
        network.provenance.algorithm,
        network.provenance.episodes,
        network
            .provenance
            .missions
            .strip_prefix(RANDOM)
            .unwrap_or(""),
        network.provenance.seed,
        summary.steps,
        summary.batch,
        summary.minutes,
        summary.best_step,
        network.parameters.len(),
        size.width,
        size.hidden,
        size.layers,
    );
    for (name, flights) in groups.iter().filter(|(_, flights)| !flights.is_empty()) {
        let Evaluation {
            mean,
            low,
            worst,
            violated,
        } = Evaluation::of(flights);
        // Writing to a string cannot fail.
        let _ = writeln!(
            card,
            "| {name} | {} | {mean:.4} | {low:.4} | {worst:.4} | {violated} |",
            flights.len()
        );
    }
    let _ = write!(card, "\n![Learning curve]({name}.svg)\n");
    Ok(card)
}

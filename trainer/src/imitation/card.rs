//! The model card of a policy for any mission: what it was trained on, and where it is weak.

use std::fmt::Write as _;

use anyhow::Context;
use clap::ValueEnum;
use pulp::Arch;
use scenario::Layout;

use super::{
    encoder::FEATURES,
    held_out::{Evaluation, Flown, HeldOut},
    run::Summary,
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
    let flights = HeldOut::new(count)?.fly(arch, &flying)?;
    let mut groups = vec![("all".to_owned(), flights.clone())];
    groups.extend(parts(&flights));
    for layout in Layout::value_variants() {
        let held_out = HeldOut::with_layout(per_layout, Some(*layout))?;
        let name = layout
            .to_possible_value()
            .map(|value| value.get_name().to_owned());
        let name = format!("users and sensors {}", name.unwrap_or_default());
        groups.push((name, held_out.fly(arch, &flying)?));
    }
    let size = network.architecture;
    let mut card = format!(
        "# {name}\n\nA policy for any mission with up to 16 users and 64 sensors (docs/training.md).\n\n\
         | | |\n|---|---|\n\
         | Made by | `{command}` |\n\
         | Algorithm | {} |\n\
         | Missions | {}, drawn from the distribution of `host-sim scenario random` |\n\
         | Seed | {} |\n\
         | Gradient steps | {} of {} states |\n\
         | Duration | {:.0} min |\n\
         | Kept after step | {} |\n\
         | Network | {} weights: width {}, hidden width {}, {} layers |\n\n\
         Totals as fractions of those of the onboard planner, on missions that it did not learn from:\n\n\
         | missions | | mean | 5 % quantile | worst | violated |\n|---|--:|--:|--:|--:|--:|\n",
        network.provenance.algorithm,
        network.provenance.episodes,
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

/// Divides flights by the numbers of users and sensors and by the threshold.
fn parts(flights: &[Flown]) -> Vec<(String, Vec<Flown>)> {
    type Belongs = fn(&Flown) -> bool;
    let parts: [(&str, Belongs); 9] = [
        ("4 to 8 users", |f| f.users <= 8),
        ("9 to 12 users", |f| (9..=12).contains(&f.users)),
        ("13 to 16 users", |f| f.users >= 13),
        ("8 to 24 sensors", |f| f.sensors <= 24),
        ("25 to 44 sensors", |f| (25..=44).contains(&f.sensors)),
        ("45 to 64 sensors", |f| f.sensors >= 45),
        ("J Gamma below 0.5", |f| f.tolerance < 0.5),
        ("J Gamma from 0.5 to 0.7", |f| {
            (0.5..0.7).contains(&f.tolerance)
        }),
        ("J Gamma above 0.7", |f| f.tolerance >= 0.7),
    ];
    let part = |(name, belongs): (&str, Belongs)| {
        let part = flights.iter().filter(|flown| belongs(flown)).copied();
        (name.to_owned(), part.collect())
    };
    parts.into_iter().map(part).collect()
}

//! Which entry points of `firmware-core` cannot panic, shown by the linker: a table in
//! docs/target.md, and a check that none is lost.
//!
//! `firmware/panics` has a program for each entry point, whose panic handler does not exist; see
//! there.

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
    process::Stdio,
};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use serde_json::Value;

use crate::{
    build,
    elf::{self, Sizes},
    figure::grouped,
    page,
    tools::Compiler,
};

const BEGIN: &str = "<!-- cargo xtask firmware panics: begin -->";
const END: &str = "<!-- cargo xtask firmware panics: end -->";

/// The options of `cargo xtask firmware panics`.
#[derive(Debug, Args)]
pub(crate) struct PanicsArguments {}

/// A program of `firmware/panics`.
#[derive(Clone, Copy, Debug)]
struct Probe {
    /// The name of the program.
    name: &'static str,
    /// The entry point.
    entry_point: &'static str,
    /// Whether the command fails if the entry point can panic.
    gated: bool,
    /// Whether the command fails if the entry point calculates in double precision.
    single: bool,
}

const fn gated(name: &'static str, entry_point: &'static str) -> Probe {
    Probe {
        name,
        entry_point,
        gated: true,
        single: false,
    }
}

/// An entry point that neither panics nor calculates in double precision.
const fn single(name: &'static str, entry_point: &'static str) -> Probe {
    Probe {
        single: true,
        ..gated(name, entry_point)
    }
}

/// An entry point with a panic that is accepted.
const fn accepted(name: &'static str, entry_point: &'static str) -> Probe {
    Probe {
        gated: false,
        ..gated(name, entry_point)
    }
}

const PROBES: [Probe; 43] = [
    single(
        "slot_exact",
        "slot problem, exact: `Workspace::sensors`, `SensorField::solve`",
    ),
    gated("slot_exact_f64", "the same in double precision"),
    single(
        "slot_bounded",
        "slot problem, gains within bounds: `Workspace::guarantee`",
    ),
    single(
        "slot_uncertain",
        "slot problem with error statistics: `SensorUncertainty::with_phase_error`, `UncertainWorkspace::sensors_of_amplitude`, `SensorField::allocate`, `UncertainWorkspace::guarantee`",
    ),
    single(
        "slot_methods",
        "slot problem, any method, Alg. 1 included: `SensorField::allocate`",
    ),
    single(
        "shield_waypoint",
        "shield: `ReachableSet::of_slot_with`, `shield::admissible_waypoint`",
    ),
    single(
        "shield_user",
        "shield: `shield::admissible_user`, `Fairness::revise`",
    ),
    single("mission_new", "`Mission::new`, `Mission::change`"),
    single("controller_new", "`Controller::new`"),
    gated(
        "controller_plan",
        "`Controller::plan`, with a trained policy",
    ),
    single("controller_allocate", "`Controller::allocate`"),
    gated(
        "controller_allocate_predicted",
        "`Controller::allocate_predicted`",
    ),
    single("controller_change", "`Controller::note_change`"),
    single("controller_quality", "`Controller::note_quality`"),
    gated(
        "controller_exact",
        "a whole controller with the exact solver: `Controller::new`, `Controller::plan`, `Controller::allocate`",
    ),
    gated(
        "controller_any_method",
        "the same with any method, Alg. 1 included: `Controller::with_solver`",
    ),
    single(
        "policy_load",
        "a `.policy` file read and tested: `Mlp::load`",
    ),
    single("policy_decide", "the network: `Mlp::decide`"),
    single(
        "sets_load",
        "a `.policy` file for any mission read and tested: `SetsNetwork::load`",
    ),
    single(
        "sets_evaluate",
        "the network for any mission: `SetsNetwork::evaluate`",
    ),
    gated(
        "sets_decide",
        "a decision for any mission: `SetsPolicy::decide`",
    ),
    gated(
        "sets_revise",
        "policy for any mission: `SetsPolicy::new`, `SetsPolicy::revise`",
    ),
    gated("planner_new", "planner: `console::board_planner`"),
    gated("planner_advance", "planner: `Planner::advance`"),
    gated("planner_decide", "planner: `Planner::decide`"),
    gated("planner_revise", "planner: `Planner::revise`"),
    gated("planner_note_gains", "planner: `Planner::note_gains`"),
    single("link_decode", "ground link: `link::Decoder::push`"),
    single("link_encode", "ground link: `link::encode`"),
    single(
        "mavlink_receive",
        "MAVLink: bytes to frames and messages, `wire::Decoder::next_frame`, `Frame::client_message`",
    ),
    single("mavlink_encode", "MAVLink: `Encoder::encode_of_client`"),
    gated("autopilot_new", "MAVLink client: `Autopilot::new`"),
    gated(
        "autopilot_control",
        "MAVLink client: `Autopilot::launch`, `Autopilot::stop`, `Autopilot::refusals` and the like",
    ),
    gated("autopilot_receive", "MAVLink client: `Autopilot::receive`"),
    gated("autopilot_poll", "MAVLink client: `Autopilot::poll`"),
    gated(
        "autopilot_fly",
        "MAVLink client: `Autopilot::fly_leg`, `Autopilot::leg_ended`",
    ),
    gated(
        "mission_upload",
        "`MissionUpload::receive`, `MissionUpload::poll`",
    ),
    gated(
        "onboard_poll",
        "the whole onboard computer, all policies: `Onboard::receive_ground`, `Onboard::receive_mavlink`, `Onboard::poll`, `Onboard::take_ground_frame`, `Onboard::take_mavlink_frame`",
    ),
    gated(
        "onboard_poll_any",
        "the same with the policy for any mission",
    ),
    single("console_decode", "console: `Calls::push`"),
    gated("console_build", "console: `MissionOrder::build`"),
    single("console_report", "console: `console::encode_report`"),
    accepted(
        "console_words",
        "console: `console::words`, of an event and of a refused order",
    ),
];

/// The result for an entry point.
#[derive(Debug)]
struct Outcome {
    probe: Probe,
    /// The size of its code, bytes.
    size: u32,
    /// Whether it calculates in double precision.
    double: bool,
    /// The places from which a panic is left; `None` if the program links without a panic handler.
    panics: Option<Vec<String>>,
}

/// Links the programs, writes the table, and fails if a gated entry point can panic.
pub(crate) fn run(root: &Path, _: &PanicsArguments) -> Result<()> {
    check_list(&root.join("firmware/panics/src/bin"))?;
    let compiler = Compiler::find(root)?;
    let names = |wanted: &dyn Fn(&Probe) -> bool| {
        let wanted = PROBES.iter().filter(|probe| wanted(probe));
        wanted.map(|probe| probe.name).collect::<Vec<_>>()
    };
    let free = link(root, &compiler, &names(&|probe| probe.gated), false)?;
    let others = names(&|probe| !free.contains_key(probe.name));
    let others = link(root, &compiler, &others, true)?;
    let outcomes = PROBES.map(|probe| {
        let linked = free.get(probe.name);
        let file = linked.or_else(|| others.get(probe.name));
        let file = file.with_context(|| format!("{}: not built", probe.name))?;
        let panics = match linked {
            Some(_) => None,
            None => Some(elf::panic_locations(file, root)?),
        };
        let size = Sizes::read(file)?.text;
        let double = elf::has_double_precision(file)?;
        Ok(Outcome {
            probe,
            size,
            double,
            panics,
        })
    });
    let outcomes = outcomes.into_iter().collect::<Result<Vec<_>>>()?;
    let table = table(&outcomes, &compiler.version(root)?)?;
    println!("{table}");
    page::replace(&root.join("docs/target.md"), [BEGIN, END], &table)?;
    check(&outcomes)
}

/// Checks that every program of the folder has a row in the table.
fn check_list(folder: &Path) -> Result<()> {
    for entry in fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let file = entry?.path();
        let known = file
            .file_stem()
            .is_some_and(|name| PROBES.iter().any(|probe| name == probe.name));
        ensure!(
            known,
            "{}: not in PROBES of xtask/src/panics.rs",
            file.display()
        );
    }
    Ok(())
}

/// Builds programs and returns those that link, by name. With `diagnose` a panic handler exists.
fn link(
    root: &Path,
    compiler: &Compiler,
    names: &[&str],
    diagnose: bool,
) -> Result<BTreeMap<String, PathBuf>> {
    if names.is_empty() {
        return Ok(BTreeMap::new());
    }
    let mut cargo = build::cargo();
    cargo
        .args([
            "build",
            "--release",
            "--locked",
            "--quiet",
            "--package",
            "panics",
        ])
        .args(["--keep-going", "--message-format=json-render-diagnostics"])
        .args(names.iter().flat_map(|name| ["--bin", name]))
        .current_dir(root.join("firmware"))
        .env("CARGO_TARGET_DIR", build::folder(root))
        // Not those of the image's processor, which has double precision: see `elf`.
        .env("RUSTFLAGS", "-C link-arg=-Tlink.x")
        .stderr(Stdio::inherit());
    if diagnose {
        cargo.args(["--features", "diagnose"]);
    }
    compiler.prepare(&mut cargo);
    // The command fails where a program does not link, which is a result.
    let output = cargo.output().context("cargo could not be started")?;
    let mut built = BTreeMap::new();
    for line in String::from_utf8(output.stdout)?.lines() {
        let message: Value = serde_json::from_str(line).with_context(|| line.to_owned())?;
        let name = message["target"]["name"].as_str();
        if let (Some(name), Some(file)) = (name, message["executable"].as_str()) {
            built.insert(name.to_owned(), PathBuf::from(file));
        }
    }
    ensure!(!built.is_empty(), "no program was built");
    Ok(built)
}

fn table(outcomes: &[Outcome], compiler: &str) -> Result<String> {
    let mut table = String::from(
        "| entry point | panic-free | double precision | code, bytes |\n|---|---|---|--:|\n",
    );
    for outcome in outcomes {
        let free = match &outcome.panics {
            None => "yes".to_owned(),
            Some(places) => {
                let mut files: Vec<_> = places.iter().map(|place| file_of(place)).collect();
                files.dedup();
                match files.as_slice() {
                    [] => "no".to_owned(),
                    files => format!("no: panics are left in {}", files.join(", ")),
                }
            }
        };
        let (entry_point, size) = (outcome.probe.entry_point, grouped(outcome.size.into()));
        let double = if outcome.double { "yes" } else { "no" };
        writeln!(table, "| {entry_point} | {free} | {double} | {size} |")?;
    }
    write!(table, "\nLinked by {compiler}.")?;
    Ok(table)
}

/// Returns the file of a place `file:line`.
fn file_of(place: &str) -> &str {
    place.rsplit_once(':').map_or(place, |(file, _)| file)
}

/// Fails if a gated entry point can panic, or if one calculates in double precision that must not.
fn check(outcomes: &[Outcome]) -> Result<()> {
    let double = outcomes
        .iter()
        .find(|outcome| outcome.double && outcome.probe.single);
    if let Some(outcome) = double {
        bail!("{} calculates in double precision", outcome.probe.name);
    }
    let lost: Vec<String> = outcomes
        .iter()
        .filter(|outcome| outcome.probe.gated)
        .filter_map(|outcome| {
            let places = outcome.panics.as_ref()?;
            Some(format!(
                "{} can panic: {}",
                outcome.probe.name,
                places.join(", ")
            ))
        })
        .collect();
    ensure!(lost.is_empty(), "{}", lost.join("\n"));
    println!("no gated entry point can panic");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gated_entry_point_that_can_panic_is_an_error() {
        let outcome = |probe, panics: Option<&str>| Outcome {
            probe,
            size: 1234,
            double: false,
            panics: panics.map(|place| vec![place.to_owned(), place.to_owned()]),
        };
        let (free, other) = (gated("plan", "`plan`"), accepted("words", "`words`"));
        let good = [outcome(free, None), outcome(other, Some("core/fmt.rs:7"))];
        assert!(check(&good).is_ok());
        let table = table(&good, "rustc 1").unwrap();
        assert!(table.contains("| `plan` | yes | no | 1,234 |\n"), "{table}");
        let left = "| `words` | no: panics are left in core/fmt.rs | no | 1,234 |\n";
        assert!(table.contains(left), "{table}");
        let lost = check(&[outcome(free, Some("src/level.rs:9"))]).unwrap_err();
        assert!(
            lost.to_string().contains("plan can panic: src/level.rs:9"),
            "{lost}"
        );
        let double = Outcome {
            double: true,
            ..outcome(single("plan", "`plan`"), None)
        };
        let refused = check(&[double]).unwrap_err().to_string();
        assert!(refused.contains("plan calculates in double"), "{refused}");
    }

    #[test]
    fn every_program_has_one_row() {
        let names: std::collections::BTreeSet<_> = PROBES.iter().map(|probe| probe.name).collect();
        assert_eq!(names.len(), PROBES.len());
    }
}

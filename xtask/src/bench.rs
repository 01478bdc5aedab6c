//! The cost of the image, measured in QEMU and read from its ELF file: a table in docs/target.md,
//! and a check against growth.

use std::{collections::BTreeMap, fmt::Write as _, fs, path::Path, process::Command};

use anyhow::{Context, Result, ensure};
use clap::Args;
use serde_json::{Value, json};

use crate::{
    build::{self, BuildArguments, Controller, Images},
    elf::Sizes,
    figure::{Figure, grouped, printed},
    hil::{self, Flight},
    order, page, planner,
    qemu::Board,
    sets,
    tools::Compiler,
};

/// The fraction by which a figure may grow over the baseline.
const GROWTH: f64 = 0.03;
/// The same if the baseline was measured with another compiler, which by itself changes the
/// figures.
const GROWTH_BETWEEN_COMPILERS: f64 = 0.1;

const BEGIN: &str = "<!-- cargo xtask firmware bench: begin -->";
const END: &str = "<!-- cargo xtask firmware bench: end -->";

/// The options of `cargo xtask firmware bench`.
#[derive(Debug, Args)]
pub(crate) struct BenchArguments {
    #[command(flatten)]
    build: BuildArguments,
    /// Store the measured figures as the new baseline
    #[arg(long)]
    accept: bool,
}

/// One kind of work that a bench image measures many times.
struct Part {
    /// As the image names it.
    printed: &'static str,
    /// In the table.
    name: &'static str,
    unit: &'static str,
    aim: Option<u64>,
    limit: Option<u64>,
}

impl Part {
    const fn of_slot(printed: &'static str, name: &'static str) -> Self {
        Self {
            printed,
            name,
            unit: "instructions",
            aim: None,
            limit: None,
        }
    }

    const fn aim(self, aim: u64) -> Self {
        Self {
            aim: Some(aim),
            ..self
        }
    }

    const fn of_byte(printed: &'static str, name: &'static str) -> Self {
        Self {
            printed,
            name,
            unit: "instructions a byte",
            aim: None,
            limit: Some(BYTE_LIMIT),
        }
    }
}

/// The largest number of instructions for a received byte. At 921,600 Bd, this is a quarter of a
/// processor that does 400 million instructions a second.
const BYTE_LIMIT: u64 = 1_085;

/// The parts of a slot.
const SLOT: [Part; 9] = [
    Part::of_slot("link decode", "ground link: a channel state decoded"),
    Part::of_slot("allocate", "allocate, exact, J = 36").aim(12_000),
    Part::of_slot("command encode", "ground link: a slot command encoded"),
    Part::of_slot("plan", "plan: network and shield"),
    Part::of_slot("plan: MLP", "of that, the network (19-128-128-17)").aim(80_000),
    Part::of_slot(
        "plan: shield",
        "of that, the shield and the slot's bookkeeping",
    ),
    Part::of_slot("MAVLink encode", "MAVLink: a setpoint encoded"),
    Part::of_slot("MAVLink decode", "MAVLink: a position decoded"),
    Part::of_slot(
        "slot",
        "a whole slot: all of the above but the last, and an arrival",
    )
    .aim(120_000),
];

/// The streams of received bytes.
const BYTES: [Part; 7] = [
    Part::of_byte("MAVLink: telemetry", "MAVLink received: telemetry"),
    Part::of_byte("MAVLink: noise", "MAVLink received: noise"),
    Part::of_byte(
        "MAVLink: crafted",
        "MAVLink received: as many false headers as possible",
    ),
    Part::of_byte(
        "MAVLink: signatures",
        "MAVLink received, signed: short frames with wrong signatures",
    ),
    Part::of_byte("ground link: noise", "ground link received: noise"),
    Part::of_byte(
        "ground link: short frames",
        "ground link received: the shortest good frames",
    ),
    Part::of_byte(
        "ground link: forged",
        "ground link received, with a key: the shortest forged frames",
    ),
];

/// Measures the image, writes the table, and compares it with the baseline.
pub(crate) fn run(root: &Path, arguments: &BenchArguments) -> Result<()> {
    let images = build::run(root, &arguments.build)?;
    let mut figures = instructions(root, &images.bench, &SLOT)?;
    figures.extend(instructions(root, &images.bench_bytes, &BYTES)?);
    figures.extend(planner::figures(root, &images)?);
    figures.extend(bytes(root, &images, &arguments.build)?);
    let stack = stack_with_changes(root, &images.any_mission, &arguments.build, "shipped")?;
    figures.extend(sets::figures(root, &images, stack)?);
    let compiler = Compiler::find(root)?.version(root)?;
    let table = table(&figures, &compiler)?;
    println!("{table}");
    page::replace(&root.join("docs/target.md"), [BEGIN, END], &table)?;
    check_limits(&figures)?;
    let baseline = root.join("firmware/baseline.json");
    if arguments.accept {
        return accept(&baseline, &figures, &compiler);
    }
    compare(&baseline, &figures, &compiler)
}

/// Returns the figures that a bench image prints.
fn instructions(root: &Path, image: &Path, parts: &[Part]) -> Result<Vec<Figure>> {
    let lines = printed(root, image)?;
    let figure = |part: &Part| {
        let name = part.printed;
        let line = lines
            .get(name)
            .with_context(|| format!("the bench printed no line for {name}"))?;
        let number = |key: &str| {
            line[key]
                .as_u64()
                .with_context(|| format!("{name}: no {key}"))
        };
        ensure!(
            number("count")? >= 10_000,
            "{name}: measured fewer than 10,000 times"
        );
        Ok(Figure {
            name: part.name,
            unit: part.unit,
            value: number("worst")?,
            mean: Some(number("mean")?),
            aim: part.aim,
            limit: part.limit,
        })
    };
    parts.iter().map(figure).collect()
}

/// Returns the flash usage from the ELF file and the stack usage from a flight.
fn bytes(root: &Path, images: &Images, arguments: &BuildArguments) -> Result<Vec<Figure>> {
    let controller = &images.one_mission;
    let sizes = Sizes::read(&controller.image)?;
    let weights = fs::metadata(&controller.policy)?.len();
    let planner = u64::from(sizes.planner);
    ensure!(planner > 0, "the image has no statics of the planner");
    let zeroed = u64::from(sizes.bss)
        .checked_sub(planner)
        .context("the planner's statics are not in .bss")?;
    let statics = u64::from(sizes.data) + zeroed;
    let folder = build::folder(root).join("bench");
    let stack = stack_bytes(root, controller, arguments, (&folder, &[]))?;
    let stack_planned = stack_with_changes(root, controller, arguments, "plan")?;
    let figure = |name, value, aim| Figure {
        name,
        unit: "bytes",
        value,
        aim,
        ..Figure::default()
    };
    let code = u64::from(sizes.text) + u64::from(sizes.rodata) + u64::from(sizes.data) - weights;
    Ok(vec![
        figure("flash: .text and vectors", sizes.text.into(), None),
        figure("flash: .rodata, policy included", sizes.rodata.into(), None),
        figure("flash: the policy", weights, None),
        figure("flash in all, without the policy", code, Some(96 * 1024)),
        figure("RAM: .data", sizes.data.into(), None),
        figure("RAM: .bss and .uninit", zeroed, None),
        figure("RAM: stack, the most of a flight", stack, None),
        figure(
            "RAM: stack, the most of a flight with the planner and changes",
            stack_planned,
            None,
        ),
        figure(
            "RAM in all, without the planner's tables",
            statics + stack.max(stack_planned),
            Some(32 * 1024),
        ),
        Figure {
            limit: Some(256 * 1024),
            ..figure("RAM: the planner's tables", planner, None)
        },
    ])
}

/// Returns the largest stack usage of a whole mission that changes in flight.
fn stack_with_changes(
    root: &Path,
    controller: &Controller,
    arguments: &BuildArguments,
    policy: &str,
) -> Result<u64> {
    let folder = build::folder(root).join("bench");
    let events = hil::write_events(&folder, order::DEFAULT)?;
    let events = events.display().to_string();
    let options: &[&str] = &["--policy", policy, "--events", &events];
    stack_bytes(root, controller, arguments, (&folder, options))
}

/// Returns the largest stack usage of a whole mission, from take-off to landing.
fn stack_bytes(
    root: &Path,
    controller: &Controller,
    arguments: &BuildArguments,
    (out, more): (&Path, &[&str]),
) -> Result<u64> {
    let host = hil::host(root, arguments)?;
    let board = Board::start(root, &controller.image, false)?;
    let there = format!("tcp:127.0.0.1:{}", board.port);
    let output = Command::new(host)
        .current_dir(root)
        .args(["run", "--json", "--controller", &there])
        .args(more)
        .arg("--out")
        .arg(out)
        .output()?;
    let flight = Flight::of(&output, out)?;
    let said = flight.note.split("board: ").nth(1);
    let bytes = said.and_then(|said| said.split(' ').find_map(|word| word.parse().ok()));
    let bytes = bytes.with_context(|| format!("no stack in {:?}", flight.note))?;
    ensure!(
        flight.note.contains("0 bytes lost, 0 frames unsent"),
        "the board's queues were too short: {}",
        flight.note
    );
    Ok(bytes)
}

fn table(figures: &[Figure], compiler: &str) -> Result<String> {
    let mut table = String::new();
    writeln!(
        table,
        "| | worst | mean | aim | limit |\n|---|--:|--:|--:|--:|"
    )?;
    for figure in figures {
        let optional = |number: Option<u64>| number.map(grouped).unwrap_or_default();
        writeln!(
            table,
            "| {} | {} {} | {} | {} | {} |",
            figure.name,
            grouped(figure.value),
            figure.unit,
            optional(figure.mean),
            optional(figure.aim),
            optional(figure.limit),
        )?;
    }
    write!(table, "\nMeasured with {compiler}.")?;
    Ok(table)
}

/// Checks the figures that have a limit. No baseline can replace it.
fn check_limits(figures: &[Figure]) -> Result<()> {
    let above: Vec<String> = figures
        .iter()
        .filter_map(|figure| {
            let limit = figure.limit.filter(|&limit| figure.value > limit)?;
            Some(format!(
                "{}: {} {}, above the limit of {}",
                figure.name,
                grouped(figure.value),
                figure.unit,
                grouped(limit)
            ))
        })
        .collect();
    ensure!(above.is_empty(), "{}", above.join("\n"));
    Ok(())
}

fn accept(path: &Path, figures: &[Figure], compiler: &str) -> Result<()> {
    let values: BTreeMap<_, _> = figures
        .iter()
        .map(|figure| (figure.name, figure.value))
        .collect();
    let baseline = json!({ "compiler": compiler, "figures": values });
    fs::write(path, serde_json::to_string_pretty(&baseline)? + "\n")?;
    println!("{}: written", path.display());
    Ok(())
}

fn compare(path: &Path, figures: &[Figure], compiler: &str) -> Result<()> {
    let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let baseline: Value =
        serde_json::from_str(&text).with_context(|| path.display().to_string())?;
    let said =
        check_growth(&baseline, figures, compiler).with_context(|| path.display().to_string())?;
    println!("{said}");
    Ok(())
}

/// Returns the message to print if nothing has grown too much.
fn check_growth(baseline: &Value, figures: &[Figure], compiler: &str) -> Result<String> {
    let than = baseline["compiler"].as_str().unwrap_or_default();
    let (growth, between) = if than == compiler {
        (GROWTH, String::new())
    } else {
        let between = format!(" (measured with {compiler}, the baseline with {than})");
        (GROWTH_BETWEEN_COMPILERS, between)
    };
    let mut grown = Vec::new();
    for figure in figures {
        let known = baseline["figures"][figure.name].as_f64();
        let known = known.with_context(|| {
            format!(
                "no figure {:?}; --accept writes a new baseline",
                figure.name
            )
        })?;
        let more = figure.value as f64 / known - 1.0;
        if more > growth {
            grown.push(format!(
                "{}: {} {}, {:.1} % over {}",
                figure.name,
                grouped(figure.value),
                figure.unit,
                100.0 * more,
                grouped(known as u64)
            ));
        }
    }
    let percent = 100.0 * growth;
    ensure!(
        grown.is_empty(),
        "figures have grown by more than {percent} % over the baseline{between} (--accept stores them as \
         the new baseline):\n{}",
        grown.join("\n")
    );
    Ok(format!(
        "no figure has grown by more than {percent} %{between}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(value: u64, compiler: &str) -> Result<String> {
        let figure = Figure {
            name: "plan",
            unit: "instructions",
            value,
            ..Figure::default()
        };
        let baseline = json!({ "compiler": "rustc 1", "figures": { "plan": 1000 } });
        check_growth(&baseline, &[figure], compiler)
    }

    /// Another compiler changes the figures by some per cent, but must not disable the check.
    #[test]
    fn growth_is_refused_whatever_the_compiler() {
        assert!(judged(1029, "rustc 1").is_ok());
        assert!(judged(1031, "rustc 1").is_err());
        let said = judged(1099, "rustc 2").unwrap();
        assert!(
            said.contains("rustc 1") && said.contains("rustc 2"),
            "{said}"
        );
        let refused = judged(1101, "rustc 2").unwrap_err().to_string();
        assert!(refused.contains("plan: 1,101 instructions"), "{refused}");
        assert!(judged(500, "rustc 2").is_ok());
    }

    #[test]
    fn a_figure_without_a_baseline_is_an_error() {
        let baseline = json!({ "compiler": "rustc 1", "figures": {} });
        let figure = Figure {
            name: "plan",
            unit: "instructions",
            value: 1,
            ..Figure::default()
        };
        assert!(check_growth(&baseline, &[figure], "rustc 1").is_err());
    }

    #[test]
    fn a_figure_above_its_limit_is_refused() {
        let figure = |value| Figure {
            name: "poll",
            unit: "instructions",
            value,
            aim: Some(1),
            limit: Some(2_000_000),
            ..Figure::default()
        };
        assert!(check_limits(&[figure(1), figure(2_000_000)]).is_ok());
        let refused = check_limits(&[figure(1), figure(2_000_001)]).unwrap_err();
        let refused = refused.to_string();
        assert!(
            refused.contains("poll: 2,000,001 instructions"),
            "{refused}"
        );
    }
}

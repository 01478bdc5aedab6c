//! `cargo xtask`: developer commands that need more than cargo.
//!
//! `cargo xtask firmware build|bench|panics|hil|faults` builds the microcontroller image, measures
//! its cost, shows what cannot panic, and flies missions with it in QEMU, some of them over a damaged
//! link; docs/target.md
//! explains the purpose. `cargo xtask flights` writes the table of flights on real autopilots.

mod bench;
mod build;
mod elf;
mod faults;
mod figure;
mod flights;
mod hil;
mod order;
mod page;
mod panics;
mod planner;
mod qemu;
mod sets;
mod tools;

use std::{
    env,
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};

/// Developer commands that need more than cargo
#[derive(Debug, Parser)]
#[command(name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Build, measure and test the microcontroller image
    #[command(subcommand)]
    Firmware(Firmware),
    /// Write the table of flights on real autopilots into docs/sitl.md, from docs/flights
    Flights(flights::FlightsArguments),
}

#[derive(Debug, Subcommand)]
enum Firmware {
    /// Build the images around trained policies
    Build(build::BuildArguments),
    /// Measure the instructions and bytes of the image, write the table in docs/target.md, and fail
    /// if a figure has grown by more than 3 % over firmware/baseline.json
    Bench(bench::BenchArguments),
    /// Link a program for each entry point of firmware-core against a panic handler that does not
    /// exist, write the table in docs/target.md, and fail if an entry point that could not panic now
    /// can
    Panics(panics::PanicsArguments),
    /// Fly a mission with the image in QEMU as controller, fly it again with the same controller in
    /// a host process, and fail if the flights differ
    Hil(hil::HilArguments),
    /// Inject faults into the ground link of the image in QEMU by random schedules; fail if the image
    /// differs from the same controller in a host process, counts faults wrongly, or does not
    /// recover after them
    Faults(faults::FaultsArguments),
}

fn main() -> ExitCode {
    let command = Arguments::parse().command;
    let done = root().and_then(|root| match command {
        Command::Flights(arguments) => flights::run(&root, &arguments),
        Command::Firmware(command) => firmware(&root, command),
    });
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn firmware(root: &Path, command: Firmware) -> Result<()> {
    match command {
        Firmware::Build(arguments) => build::run(root, &arguments).map(drop),
        Firmware::Bench(arguments) => bench::run(root, &arguments),
        Firmware::Panics(arguments) => panics::run(root, &arguments),
        Firmware::Hil(arguments) => hil::run(root, &arguments),
        Firmware::Faults(arguments) => faults::run(root, &arguments),
    }
}

/// Returns the workspace's root directory.
fn root() -> Result<PathBuf> {
    let own = env::var_os("CARGO_MANIFEST_DIR")
        .context("CARGO_MANIFEST_DIR is not set: run this program as `cargo xtask`")?;
    let root = Path::new(&own)
        .parent()
        .context("CARGO_MANIFEST_DIR has no parent directory")?;
    Ok(root.to_owned())
}

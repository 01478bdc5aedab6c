//! `cargo xtask`: developer commands that need more than cargo.
//!
//! `cargo xtask firmware build|bench|hil|faults` builds the microcontroller image, measures its
//! cost, and flies missions with it in QEMU, some of them over a damaged link; docs/target.md
//! explains the purpose. `cargo xtask flights` writes the table of flights on real autopilots.

mod bench;
mod build;
mod elf;
mod faults;
mod flights;
mod hil;
mod qemu;
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
    /// The microcontroller image
    #[command(subcommand)]
    Firmware(Firmware),
    /// Write the table of flights on real autopilots into docs/sitl.md, from docs/flights
    Flights(flights::FlightsArguments),
}

#[derive(Debug, Subcommand)]
enum Firmware {
    /// Build the image around a trained policy
    Build(build::BuildArguments),
    /// Measure the image in instructions and bytes, write docs/target.md's table, and fail where
    /// a figure has grown by more than 3 % over firmware/baseline.json
    Bench(bench::BenchArguments),
    /// Fly a mission whose controller is the image in QEMU, and the same in this machine's
    /// process; fail where they differ
    Hil(hil::HilArguments),
    /// Damage the ground link of the image in QEMU by random schedules; fail where it differs from
    /// the same in this machine's process, miscounts, or is not in order again after them
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
        Firmware::Hil(arguments) => hil::run(root, &arguments),
        Firmware::Faults(arguments) => faults::run(root, &arguments),
    }
}

/// Returns the workspace's root directory.
fn root() -> Result<PathBuf> {
    let own = env::var_os("CARGO_MANIFEST_DIR").context("run me as `cargo xtask`")?;
    let root = Path::new(&own)
        .parent()
        .context("xtask lies in the workspace")?;
    Ok(root.to_owned())
}

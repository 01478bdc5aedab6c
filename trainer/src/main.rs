//! `trainer`: train, export, convert and evaluate policies.
//!
//! Exit codes: 0 (success), 1 (a run failed), 2 (bad usage or bad input).

mod command;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Trains policies for the outer problem on the onboard controller and exports them
#[derive(Debug, Parser)]
#[command(
    version,
    about,
    subcommand_required = true,
    arg_required_else_help = true
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Train a policy on a scenario
    Train(command::Train),
    Sweep(command::RunSweep),
    /// Write a checkpoint's best (or latest) policy as ONNX
    Export(command::Export),
    /// Write an ONNX policy as a .policy file for the microcontroller
    Convert(command::Convert),
    /// Fly a policy once, deterministically, and print the result
    Evaluate(command::Evaluate),
    /// Print random observations and a policy's outputs as JSON lines, to compare runtimes
    Probe(command::Probe),
    /// Write a run's best policy with its model card and learning curve
    Publish(command::Publish),
    /// Compare the best policies of several runs with the straight line, the search and the bound
    Compare(command::Compare),
    /// Write the learning curves of several runs to one CSV file
    Curves(command::Curves),
}

fn main() -> ExitCode {
    let outcome = match Arguments::parse().command {
        Command::Train(train) => train.execute(),
        Command::Sweep(sweep) => sweep.execute(),
        Command::Export(export) => export.execute(),
        Command::Convert(convert) => convert.execute(),
        Command::Evaluate(evaluate) => evaluate.execute(),
        Command::Probe(probe) => probe.execute(),
        Command::Publish(publish) => publish.execute(),
        Command::Compare(compare) => compare.execute(),
        Command::Curves(curves) => curves.execute(),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

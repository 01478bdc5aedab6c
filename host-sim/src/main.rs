//! `host-sim`: run missions, serve the vehicle, solve slots, make scenarios.
//!
//! Exit codes: 0, 1 (a run failed), 2 (bad usage or bad input).

mod command;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use command::scenario;

/// A UAV that serves users and averages sensors over the air: flies missions, end to end.
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
    /// Make, check or draw a scenario
    #[command(subcommand)]
    Scenario(scenario::Command),
}

fn main() -> ExitCode {
    let outcome = match Arguments::parse().command {
        Command::Scenario(command) => scenario::execute(command),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

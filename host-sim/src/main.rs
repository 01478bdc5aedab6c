//! `host-sim`: flies missions, runs the built-in vehicle, solves slot problems, computes bounds and
//! generates scenarios.
//!
//! Exit codes: 0 (success), 1 (a run failed), 2 (invalid usage or invalid input).

mod command;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use command::{
    benchmark, bound, doctor, experiment, faults, plan, run, scenario, solve, upload, vehicle,
};

/// Simulates a UAV that serves users and averages sensor values over the air, from the slot problem
/// to the flight through a MAVLink autopilot
#[derive(Debug, Parser)]
#[command(version, about, long_about = None, args_conflicts_with_subcommands = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    /// The options of `run`, which is the default command.
    #[command(flatten)]
    run: run::RunArguments,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Fly one mission and write its report (default command)
    Run(Box<run::RunArguments>),
    /// Run the built-in vehicle as a separate process that speaks MAVLink
    Vehicle(vehicle::VehicleArguments),
    /// Plan the whole mission and upload it to an autopilot
    Upload(upload::UploadArguments),
    /// Check an autopilot and report what would stop or slow a mission, without moving it; with
    /// --restore, restore the parameters that an interrupted run left changed
    Doctor(doctor::DoctorArguments),
    /// Solve slot problems given as JSON lines
    Solve(solve::SolveArguments),
    /// Compute a certified upper bound on the sum rate of a scenario, and a mission close to it
    Bound(bound::BoundArguments),
    /// Plan a mission once with the onboard planner, and write it as a QGroundControl file on request
    Plan(plan::PlanArguments),
    /// Fly policies on a set of missions and compare their sum rates with certified bounds
    Benchmark(benchmark::BenchmarkArguments),
    /// Reproduce the paper's figures as CSV and SVG files, and check the paper's claims against them
    Experiment(experiment::ExperimentArguments),
    /// Fly a mission with a board under injected faults on its ground link, compare every slot with
    /// the same controller in this process, and fail if they differ
    Faults(faults::FaultsArguments),
    /// Generate, check or draw scenarios
    #[command(subcommand)]
    Scenario(scenario::Command),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let command = arguments
        .command
        .unwrap_or(Command::Run(Box::new(arguments.run)));
    let outcome = match command {
        Command::Run(arguments) => run::execute(&arguments),
        Command::Vehicle(arguments) => vehicle::execute(&arguments),
        Command::Upload(arguments) => upload::execute(&arguments),
        Command::Doctor(arguments) => doctor::execute(&arguments),
        Command::Solve(arguments) => solve::execute(&arguments),
        Command::Bound(arguments) => bound::execute(&arguments),
        Command::Plan(arguments) => plan::execute(&arguments),
        Command::Benchmark(arguments) => benchmark::execute(&arguments),
        Command::Experiment(arguments) => experiment::execute(&arguments),
        Command::Faults(arguments) => faults::execute(&arguments),
        Command::Scenario(command) => scenario::execute(command),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

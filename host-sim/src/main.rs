//! `host-sim`: runs missions, serves the vehicle, solves slots and makes scenarios.
//!
//! Exit codes: 0 (success), 1 (a run failed), 2 (invalid usage or invalid input).

mod command;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use command::{
    benchmark, bound, doctor, experiment, faults, plan, run, scenario, solve, upload, vehicle,
};

/// A UAV that serves users and averages sensors over the air: flies missions, end to end.
#[derive(Debug, Parser)]
#[command(version, about, long_about = None, args_conflicts_with_subcommands = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    /// Without a command: run.
    #[command(flatten)]
    run: run::RunArguments,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Fly one mission; what happens without any command, too
    Run(run::RunArguments),
    /// The built-in vehicle as a process of its own, speaking MAVLink to anyone
    Vehicle(vehicle::VehicleArguments),
    /// Plan the whole mission and hand it to an autopilot
    Upload(upload::UploadArguments),
    /// Say what would stop or slow a mission with an autopilot; moves nothing. With --restore: put
    /// back the parameters that an interrupted run left changed
    Doctor(doctor::DoctorArguments),
    /// Solve slot problems given as JSON lines
    Solve(solve::SolveArguments),
    /// Certify the most that any mission can carry, and find a mission close to it
    Bound(bound::BoundArguments),
    /// Plan a mission once with the onboard planner; write it for QGroundControl
    Plan(plan::PlanArguments),
    /// Fly policies through a set of missions and compare them with certified bounds
    Benchmark(benchmark::BenchmarkArguments),
    /// The paper's figures, each as a CSV file and a drawing, with its claims judged
    Experiment(experiment::ExperimentArguments),
    /// Fly a mission with a board whose ground link is damaged, beside its twin; fail where they
    /// differ or the board miscounts
    Faults(faults::FaultsArguments),
    /// Make, check or draw a scenario
    #[command(subcommand)]
    Scenario(scenario::Command),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let command = arguments.command.unwrap_or(Command::Run(arguments.run));
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

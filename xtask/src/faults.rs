//! Fault schedules against the image in QEMU: its ground link is damaged in every way that
//! `link::faults` supports, and its output is compared with that of the twin on this machine. An
//! image accepts one order, so each mission has a separate QEMU; a schedule consists of some slots
//! of a mission.

use std::{
    collections::BTreeMap,
    path::Path,
    process::Command,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, ensure};
use clap::Args;

use crate::{
    build::{self, BuildArguments, Images},
    hil,
    qemu::Board,
};

/// The number of schedules in a mission.
const SCHEDULES_EACH: u64 = 20;

/// Every so many missions, one has a key of the ground link, and attackers on it.
const WITH_KEY_EACH: u64 = 5;

/// The counter that host-sim increments once per schedule.
const RECOVERED: &str = "resynchronized at the first clean frame";

type Tally = BTreeMap<String, u64>;

/// The options of `cargo xtask firmware faults`.
#[derive(Debug, Args)]
pub(crate) struct FaultsArguments {
    #[command(flatten)]
    build: BuildArguments,
    /// Number of fault schedules
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..))]
    schedules: u64,
    /// The scenario: a TOML file, or the name of a shipped scenario
    #[arg(long, default_value = "separated")]
    scenario: String,
    /// Seed of the first mission; the following missions have the following seeds
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Flies the missions, one on each core, and prints the injected faults and the counters.
pub(crate) fn run(root: &Path, arguments: &FaultsArguments) -> Result<()> {
    let images = build::run(root, &arguments.build)?;
    let host = hil::host(root, &arguments.build)?;
    let key = hil::write_key(&build::folder(root).join("faults"))?;
    let begun = Instant::now();
    let missions = arguments.schedules.div_ceil(SCHEDULES_EACH);
    let next = AtomicU64::new(0);
    let worker = || {
        let mut total = Tally::new();
        loop {
            let mission = next.fetch_add(1, Ordering::Relaxed);
            if mission >= missions {
                return Ok(total);
            }
            let schedules = SCHEDULES_EACH.min(arguments.schedules - mission * SCHEDULES_EACH);
            let seed = arguments.seed.wrapping_add(mission);
            let key = (mission % WITH_KEY_EACH == WITH_KEY_EACH - 1).then_some(key.as_path());
            for (what, count) in fly(root, (&host, &images), arguments, (seed, schedules, key))? {
                *total.entry(what).or_default() += count;
            }
        }
    };
    let mut total = Tally::new();
    thread::scope(|scope| {
        let workers = thread::available_parallelism().map_or(1, |cores| cores.get().min(8));
        let workers: Vec<_> = (0..workers).map(|_| scope.spawn(worker)).collect();
        for worker in workers {
            let flown: Result<Tally> = worker
                .join()
                .map_err(|_| anyhow::anyhow!("a thread panicked"))?;
            for (what, count) in flown? {
                *total.entry(what).or_default() += count;
            }
        }
        anyhow::Ok(())
    })?;
    for (what, count) in &total {
        println!("{count:9} {what}");
    }
    let of = |what: &str| total.get(what).copied().unwrap_or(0);
    ensure!(
        of("schedules") == arguments.schedules && of(RECOVERED) == arguments.schedules,
        "not every one of the {} schedules was completed and recovered from",
        arguments.schedules
    );
    println!(
        "{} schedules in {missions} missions, {:.0} s: image and host process agree in every slot, \
         and all faults were counted correctly",
        arguments.schedules,
        begun.elapsed().as_secs_f64()
    );
    Ok(())
}

/// Flies a mission; returns the injected faults and the counters.
fn fly(
    root: &Path,
    (host, images): (&Path, &Images),
    arguments: &FaultsArguments,
    (seed, schedules, key): (u64, u64, Option<&Path>),
) -> Result<Tally> {
    let board = {
        // Until QEMU has opened its ports, no other thread may look for free ones.
        static STARTING: Mutex<()> = Mutex::new(());
        let _turn = STARTING.lock().unwrap_or_else(PoisonError::into_inner);
        let board = Board::start(root, &images.chosen().image, false)?;
        thread::sleep(Duration::from_millis(200));
        board
    };
    let mut faults = Command::new(host);
    faults.args(["faults", "--scenario", &arguments.scenario]);
    if let Some(key) = key {
        faults.arg("--ground-key").arg(key);
    }
    let output = faults
        .current_dir(root)
        .args(["--board", &format!("127.0.0.1:{}", board.port)])
        .args(["--seed", &seed.to_string()])
        .args(["--schedules", &schedules.to_string()])
        .arg("--policy")
        .arg(&images.chosen().policy)
        .output()
        .context("host-sim could not be started")?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "seed {seed}: {}", said.trim());
    serde_json::from_slice(&output.stdout).context("output of host-sim faults")
}

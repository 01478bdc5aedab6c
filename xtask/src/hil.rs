//! Hardware in the loop: compares missions whose controller is the image in QEMU with the same
//! missions on this machine in the same precision: by the trained policy, by the planner, by the
//! planner with changes of the mission in flight and a key of the ground link, and with MAVLink
//! signing, which a board begins without a clock; and by the policy for any mission on two maps, with
//! changes. Waypoints and users must be equal, rates must agree within [`RATE_TOLERANCE`], every
//! signed frame must be valid; an image with a damaged policy must refuse to fly.

use std::{
    fs,
    io::Write,
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
    process::{Command, Output},
    time::Instant,
};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use firmware_core::{
    Position, USERS_MAX,
    autopilot::wire::{
        Decoder,
        signing::{SigningKey, SigningState, SigningTime, Verifier},
    },
};
use scenario::ScenarioChoice;
use serde_json::Value;

use crate::{
    build::{self, BuildArguments, Controller, Images},
    qemu::{self, Board},
};

/// The largest allowed difference of rates, bit/s/Hz.
const RATE_TOLERANCE: f64 = 1e-4;

/// The options of `cargo xtask firmware hil`.
#[derive(Debug, Args)]
pub(crate) struct HilArguments {
    #[command(flatten)]
    build: BuildArguments,
    /// The scenario: a TOML file, or the name of a shipped scenario
    #[arg(long, default_value = "separated")]
    scenario: String,
    /// Further options of `host-sim run` for both flights, for example -- --profile multirotor
    #[arg(last = true)]
    more: Vec<String>,
}

/// A mission that is flown twice.
struct Pair<'a> {
    name: &'static str,
    controller: &'a Controller,
    scenario: &'a str,
    /// The options that only the flight in the host process has.
    own: &'a [&'a str],
    /// The options of both flights.
    both: &'a [&'a str],
}

/// Flies the missions and compares them.
pub(crate) fn run(root: &Path, arguments: &HilArguments) -> Result<()> {
    let images = build::run(root, &arguments.build)?;
    let host = host(root, &arguments.build)?;
    for controller in [&images.one_mission, &images.any_mission] {
        refuses_damage(root, controller)?;
    }
    fly_scenario(root, (&host, &images), arguments)?;
    fly_any_mission(root, (&host, &images), arguments)
}

/// Flies the chosen scenario, by every rule of the image with the chosen policy.
fn fly_scenario(
    root: &Path,
    (host, images): (&Path, &Images),
    arguments: &HilArguments,
) -> Result<()> {
    let out = folder(root);
    let events = write_events(&out, &arguments.scenario)?;
    let events = events.display().to_string();
    let controller = images.chosen();
    let policy = controller.policy.display().to_string();
    let ground_key = write_key(&out)?.display().to_string();
    let mavlink_key = write_mavlink_key(&out)?.display().to_string();
    let changed = ["--policy", "plan", "--events", &events];
    let authenticated = [&changed[..], &["--ground-key", &ground_key]].concat();
    let signed = [
        "--policy",
        "straight-line",
        "--signing-key",
        &mavlink_key,
        "--signing-clock",
        "unknown",
    ];
    let pairs: [(&str, &[&str], &[&str]); 5] = [
        ("trained", &["--policy", &policy], &[]),
        ("plan", &[], &["--policy", "plan"]),
        ("plan-with-changes", &[], &changed),
        ("authenticated", &[], &authenticated),
        (SIGNED, &[], &signed),
    ];
    for (name, own, both) in pairs {
        let pair = Pair {
            name,
            controller,
            scenario: &arguments.scenario,
            own,
            both,
        };
        fly_pair(root, host, &pair, &arguments.more)?;
    }
    let state = |place: &str| fs::read(out.join(format!("{SIGNED}-{place}.signing.json")));
    let (own, image) = (state("in-process")?, state("image")?);
    ensure!(
        own == image,
        "the states of signing differ: {} in the host process, {} in the image",
        String::from_utf8_lossy(&own),
        String::from_utf8_lossy(&image)
    );
    println!("signing: the states after the flight are equal");
    Ok(())
}

/// Flies missions with different users and sensors by the policy for any mission, with changes in
/// flight.
fn fly_any_mission(
    root: &Path,
    (host, images): (&Path, &Images),
    arguments: &HilArguments,
) -> Result<()> {
    let controller = &images.any_mission;
    let policy = controller.policy.display().to_string();
    for (name, scenario) in [
        ("any-mission", "separated"),
        ("any-mission-random", "benchmarks/random-0001.toml"),
    ] {
        let events = write_changes(&folder(root), scenario)?;
        let events = events.display().to_string();
        let pair = Pair {
            name,
            controller,
            scenario,
            own: &["--policy", &policy],
            both: &["--events", &events],
        };
        fly_pair(root, host, &pair, &arguments.more)?;
    }
    Ok(())
}

/// Returns the directory for the files of the flights.
fn folder(root: &Path) -> PathBuf {
    build::folder(root).join("hil")
}

/// Flies a mission in a host process and with the image, and compares the flights.
fn fly_pair(root: &Path, host: &Path, pair: &Pair<'_>, more: &[String]) -> Result<()> {
    let is_signed = pair.name == SIGNED;
    let fly = |place: &str, controller: &[&str]| {
        let name = format!("{}, {place}", pair.name);
        let out = folder(root).join(name.replace(", ", "-"));
        let begun = Instant::now();
        let state = out.with_extension("signing.json");
        let mut run = Command::new(host);
        run.arg("run");
        if is_signed {
            // That of an earlier run would be later than the simulated time.
            let _ = fs::remove_file(&state);
            run.arg("--signing-state").arg(&state);
        }
        run.current_dir(root)
            .args(["--json", "--scenario", pair.scenario])
            .args(controller)
            .args(pair.both)
            .args(more)
            .arg("--out")
            .arg(&out);
        let flight = Flight::of(&run.output()?, &out).context(name.clone())?;
        println!(
            "{name}: {} slots, {:.3} bit/s/Hz, {:.1} m from the destination, {:.1} s{}",
            flight.slots.len(),
            flight.sum_rate,
            flight.arrival_distance_m,
            begun.elapsed().as_secs_f64(),
            flight.note
        );
        if is_signed {
            check_signatures(&out.join("mavlink.tlog"), &state).context(name)?;
        }
        anyhow::Ok(flight)
    };
    let in_process = [
        &["--controller", "in-process", "--precision", "f32"],
        pair.own,
    ]
    .concat();
    let own = fly("in-process", &in_process)?;
    let board = Board::start(root, &pair.controller.image, false)?;
    let there = format!("tcp:127.0.0.1:{}", board.port);
    let image = fly("image", &["--controller", &there])?;
    drop(board);
    compare(&image, &own)
}

/// The name of the signed flight.
const SIGNED: &str = "signed";
/// The key of the signed flight.
const KEY: [u8; 32] = *b"a key for the flight on a bench.";

/// Writes the key of the signed flight, which only the owner may read.
fn write_mavlink_key(folder: &Path) -> Result<PathBuf> {
    fs::create_dir_all(folder)?;
    let path = folder.join("mavlink.key");
    let mut options = fs::OpenOptions::new();
    let file = options.write(true).create(true).truncate(true).mode(0o600);
    file.open(&path)?.write_all(&KEY)?;
    Ok(path)
}

/// Checks that every frame of a flight, in both directions, has a valid signature, and that the
/// state that the computer saved afterwards refuses all that it has received.
fn check_signatures(log: &Path, state: &Path) -> Result<()> {
    // The component id of the vehicle.
    const VEHICLE: u8 = 1;
    // A record: 8 bytes of time, and a frame.
    const TIME: usize = 8;
    const PAYLOAD_LENGTH: usize = TIME + 1;
    const BESIDE_PAYLOAD: usize = 10 + 2 + 13;
    let log = fs::read(log)?;
    let saved: SigningState = serde_json::from_slice(&fs::read(state)?)?;
    let verifying = |state: &SigningState| {
        let mut decoder = Decoder::new();
        decoder.require_signatures(Verifier::new(SigningKey::new(KEY), state));
        decoder
    };
    let mut during = verifying(&SigningState::at(SigningTime::UNKNOWN));
    let mut afterwards = verifying(&saved);
    let (mut frames, mut received, mut rest) = (0, 0, log.as_slice());
    while let Some(&payload) = rest.get(PAYLOAD_LENGTH) {
        let record = TIME + BESIDE_PAYLOAD + usize::from(payload);
        ensure!(rest.len() >= record, "the log ends within a frame");
        let (record, further) = rest.split_at(record);
        let mut frame = &record[TIME..];
        let Some(valid) = during.next_frame(&mut frame) else {
            bail!(
                "frame {frames} has no valid signature: {:?}",
                during.counters()
            );
        };
        let is_received = valid.sender().component == VEHICLE;
        received += u32::from(is_received);
        let mut replayed = &record[TIME..];
        let accepted = is_received && afterwards.next_frame(&mut replayed).is_some();
        ensure!(!accepted, "frame {frames} would be accepted again");
        (frames, rest) = (frames + 1, further);
    }
    ensure!(
        received > 1000 && frames > received,
        "only {received} of {frames} frames were received"
    );
    println!("signing: {frames} frames are valid; the {received} received ones cannot be replayed");
    Ok(())
}

/// Writes events for a scenario: after a third of the slots the first user moves to the destination,
/// after two thirds the first sensor leaves. Returns the path of the file.
pub(crate) fn write_events(folder: &Path, scenario: &str) -> Result<PathBuf> {
    let chosen = ScenarioChoice::unchanged(scenario.into());
    let scenario = chosen.load().map_err(anyhow::Error::msg)?;
    let mission = scenario.mission.parameters();
    let (slots, to) = (mission.slots, mission.destination);
    let text = format!(
        "[[event]]\nslot = {}\nuser = 0\nposition_m = [{:?}, {:?}]\n\n[[event]]\nslot = {}\nsensor = \
         0\nleaves = true\n",
        slots / 3 + 1,
        to.x,
        to.y,
        slots * 2 / 3 + 1
    );
    fs::create_dir_all(folder)?;
    let path = folder.join("events.toml");
    fs::write(&path, text).with_context(|| path.display().to_string())?;
    Ok(path)
}

/// Writes changes of every kind for a scenario: the second user leaves and returns, the first user
/// moves to the destination, a user joins if there is one more, the first sensor leaves, and the
/// threshold changes. Returns the path of the file.
fn write_changes(folder: &Path, scenario: &str) -> Result<PathBuf> {
    let chosen = ScenarioChoice::unchanged(scenario.into());
    let scenario = chosen.load().map_err(anyhow::Error::msg)?;
    let mission = scenario.mission.parameters();
    let slot = |eighths: u32| mission.slots * eighths / 8 + 1;
    let at = |place: &Position<f64>| format!("position_m = [{:?}, {:?}]", place.x, place.y);
    let second = mission.users.get(1).context("only one user")?;
    let mut changes = vec![
        (slot(2), "user = 1\nleaves = true".to_owned()),
        (slot(3), format!("user = 0\n{}", at(&mission.destination))),
        (slot(4), format!("user = 1\n{}", at(second))),
        (slot(5), "sensor = 0\nleaves = true".to_owned()),
        (
            slot(6),
            format!("mse_threshold = {:?}", 1.01 * mission.mse_threshold),
        ),
    ];
    let users = mission.users.len();
    if users < USERS_MAX {
        changes.push((slot(3), format!("user = {users}\n{}", at(&mission.start))));
    }
    let event = |(slot, change): (u32, String)| format!("[[event]]\nslot = {slot}\n{change}\n\n");
    let text: String = changes.into_iter().map(event).collect();
    fs::create_dir_all(folder)?;
    let path = folder.join("changes.toml");
    fs::write(&path, text).with_context(|| path.display().to_string())?;
    Ok(path)
}

/// Writes a key of the ground link, which only the owner can read. Returns the path of the file.
pub(crate) fn write_key(folder: &Path) -> Result<PathBuf> {
    fs::create_dir_all(folder)?;
    let path = folder.join("ground.key");
    fs::write(&path, "5a".repeat(32))?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600))?;
    }
    Ok(path)
}

/// Builds the simulator if necessary, and returns its path.
pub(crate) fn host(root: &Path, arguments: &BuildArguments) -> Result<PathBuf> {
    if let Some(built) = &arguments.host_sim {
        return Ok(root.join(built));
    }
    let mut cargo = build::cargo();
    cargo
        .current_dir(root)
        .args(["build", "--release", "--quiet", "--package", "host-sim"]);
    build::complete(&mut cargo)?;
    Ok(root.join("target/release/host-sim"))
}

/// The result of a flight.
#[derive(Debug)]
pub(crate) struct Flight {
    pub(crate) slots: Vec<Slot>,
    pub(crate) sum_rate: f64,
    pub(crate) arrival_distance_m: f64,
    /// The text on standard error.
    pub(crate) note: String,
}

/// A row of slots.csv.
#[derive(Debug)]
pub(crate) struct Slot {
    user: String,
    /// The waypoint as it is written in the file.
    planned: [String; 2],
    rate: f64,
}

impl Flight {
    /// Reads the result of a run, which must have arrived and been fair, with no slot less accurate
    /// than required.
    pub(crate) fn of(output: &Output, out: &Path) -> Result<Self> {
        let note = String::from_utf8_lossy(&output.stderr)
            .trim()
            .replace('\n', "; ");
        ensure!(output.status.success(), "{note}");
        let summary: Value = serde_json::from_slice(&output.stdout).context("summary.json")?;
        for (key, wanted) in [("arrived", true), ("fair", true)] {
            ensure!(summary[key] == wanted, "{key} is {}", summary[key]);
        }
        for key in ["mse_violations", "constraint_violations"] {
            ensure!(summary[key] == 0, "{key}: {}", summary[key]);
        }
        let number = |key: &str| summary[key].as_f64().with_context(|| format!("no {key}"));
        Ok(Self {
            slots: slots(&out.join("slots.csv"))?,
            sum_rate: number("sum_rate")?,
            arrival_distance_m: number("arrival_distance_m")?,
            note: if note.is_empty() {
                note
            } else {
                format!("; {note}")
            },
        })
    }
}

fn slots(path: &Path) -> Result<Vec<Slot>> {
    let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let mut lines = text.lines();
    let names: Vec<&str> = lines
        .next()
        .context("slots.csv is empty")?
        .split(',')
        .collect();
    let column = |name: &str| {
        let found = names.iter().position(|&known| known == name);
        found.with_context(|| format!("slots.csv has no column {name}"))
    };
    let columns = [
        "served_user",
        "planned_east_m",
        "planned_north_m",
        "rate_bit_s_hz",
    ]
    .map(column);
    let [user, x, y, rate] = columns;
    let (user, x, y, rate) = (user?, x?, y?, rate?);
    lines
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            let cell = |at: usize| {
                cells
                    .get(at)
                    .copied()
                    .context("slots.csv has a row with too few columns")
            };
            Ok(Slot {
                user: cell(user)?.to_owned(),
                planned: [cell(x)?.to_owned(), cell(y)?.to_owned()],
                rate: cell(rate)?.parse()?,
            })
        })
        .collect()
}

fn compare(image: &Flight, own: &Flight) -> Result<()> {
    ensure!(
        image.slots.len() == own.slots.len(),
        "the image flew {} slots, the host process {}",
        image.slots.len(),
        own.slots.len()
    );
    let mut furthest: f64 = 0.0;
    for (index, (image, own)) in image.slots.iter().zip(&own.slots).enumerate() {
        let slot = index + 1;
        let same = image.planned == own.planned && image.user == own.user;
        ensure!(
            same,
            "slot {slot}: the image flies to {:?} and serves {}, the host process flies to {:?} and \
             serves {}",
            image.planned,
            image.user,
            own.planned,
            own.user
        );
        furthest = furthest.max((image.rate - own.rate).abs());
    }
    ensure!(
        furthest <= RATE_TOLERANCE,
        "rates differ by up to {furthest} bit/s/Hz, more than {RATE_TOLERANCE}"
    );
    println!(
        "{} slots: waypoints and users are equal, rates agree within {furthest:.1e} bit/s/Hz",
        image.slots.len()
    );
    Ok(())
}

/// Flips a bit of the policy in the image's flash: the image must report it and end as a failure.
fn refuses_damage(root: &Path, controller: &Controller) -> Result<()> {
    let policy = fs::read(&controller.policy)?;
    let mut image = fs::read(&controller.image)?;
    let at = image
        .windows(policy.len())
        .position(|window| window == policy)
        .context("the image does not contain its policy")?;
    image[at + policy.len() / 2] ^= 4;
    let damaged = build::folder(root).join("damaged");
    fs::write(&damaged, image)?;
    let output = qemu::run_to_end(root, &damaged)?;
    let said = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    if output.status.code() != Some(1) || !said.contains("checksum") {
        bail!(
            "an image with a damaged policy ended with {} and printed {said:?}",
            output.status
        );
    }
    println!("a damaged policy is refused: {said}");
    Ok(())
}

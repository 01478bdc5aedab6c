//! `host-sim scenario new|random|check|show`: generates, checks and draws scenarios.

use std::{
    fs::File,
    io::{self, Write},
    path::{Path, PathBuf},
};

use clap::{Args, Subcommand};
use firmware_core::{Position, autopilot::frames::MapFrame};
use host_sim::report;
use scenario::{Course, Layout, Scenario, Topology, generate_on, random};

use super::{Failure, load_scenario};

/// The subcommands of `host-sim scenario`.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Generate a scenario with the parameters of Table I and a random layout
    New(NewArguments),
    /// Generate random missions from the benchmark's distribution
    Random(RandomArguments),
    /// Check whether a scenario is valid, and report the first error if it is not
    Check {
        /// A TOML file, or the name of a shipped scenario: separated, mixed
        scenario: PathBuf,
    },
    /// Print the parameters of a scenario with a map in text characters, or draw it as SVG
    Show {
        /// A TOML file, or the name of a shipped scenario: separated, mixed
        #[arg(default_value = "separated")]
        scenario: PathBuf,
        /// Print the map as SVG instead
        #[arg(long)]
        svg: bool,
    },
}

/// The options of `host-sim scenario new`.
#[derive(Debug, Args)]
pub(crate) struct NewArguments {
    /// Arrangement of users and sensors
    #[arg(long, value_enum, default_value = "separated")]
    topology: Topology,
    /// Seed of the random layout
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of users (M)
    #[arg(long, default_value_t = 15)]
    users: usize,
    /// Number of sensors (J)
    #[arg(long, default_value_t = 36)]
    sensors: usize,
    /// MSE threshold (Gamma) [default: 0.54 / sensors, which is the paper's 0.015 for 36 sensors]
    #[arg(long, value_name = "GAMMA")]
    mse_threshold: Option<f64>,
    /// Number of slots (N)
    #[arg(long, default_value_t = Course::default().slots, value_name = "N")]
    slots: u32,
    /// Size of the area in m; the layout is scaled to it
    #[arg(long, default_value = "1000,1000", value_name = "EAST,NORTH", value_parser = pair)]
    area_m: [f64; 2],
    /// Start of the mission in m [default: near the south-west corner]
    #[arg(long, value_name = "EAST,NORTH", value_parser = pair)]
    start_m: Option<[f64; 2]>,
    /// Destination of the mission in m [default: near the north-east corner]
    #[arg(long, value_name = "EAST,NORTH", value_parser = pair)]
    destination_m: Option<[f64; 2]>,
    /// File to write [default: standard output]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Replace an existing file
    #[arg(long, requires = "out")]
    overwrite: bool,
}

/// Parses two numbers that are separated by a comma.
fn pair(text: &str) -> Result<[f64; 2], String> {
    let read = |part: &str| part.trim().parse().ok().filter(|x: &f64| x.is_finite());
    let numbers = text
        .split_once(',')
        .and_then(|(east, north)| read(east).zip(read(north)));
    let (east, north) = numbers.ok_or("must be two numbers of metres, EAST,NORTH")?;
    Ok([east, north])
}

/// The options of `host-sim scenario random`.
#[derive(Debug, Args)]
pub(crate) struct RandomArguments {
    /// Seed of the first mission; the following missions have the following seeds
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of missions
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    count: u64,
    /// Layout of both users and sensors [default: a random layout for each]
    #[arg(long, value_enum)]
    layout: Option<Layout>,
    /// Directory for the files random-SEED.toml [default: standard output, for one mission only]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace existing files
    #[arg(long, requires = "out")]
    overwrite: bool,
}

/// Generates random missions and writes them.
fn write_random(arguments: &RandomArguments, out: &mut impl Write) -> Result<(), Failure> {
    if arguments.out.is_none() && arguments.count != 1 {
        return Err(Failure::bad_input(format!(
            "--count is {}: more than one mission needs --out DIR",
            arguments.count
        )));
    }
    for offset in 0..arguments.count {
        let seed = arguments.seed.checked_add(offset);
        let seed = seed.ok_or_else(|| Failure::bad_input("--seed and --count are too large"))?;
        let scenario = random(seed, arguments.layout).map_err(Failure::bad_input)?;
        match &arguments.out {
            Some(folder) => {
                let failed = |error| Failure::failed(format!("{}: {error}", folder.display()));
                std::fs::create_dir_all(folder).map_err(failed)?;
                let path = folder.join(format!("{}.toml", scenario.name));
                save(&path, &scenario.to_toml(), arguments.overwrite)?;
            }
            None => out.write_all(scenario.to_toml().as_bytes())?,
        }
    }
    Ok(())
}

/// Executes the subcommand.
pub(crate) fn execute(command: Command) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    match command {
        Command::New(arguments) => {
            let scenario = generate_on(
                arguments.topology,
                arguments.seed,
                arguments.users,
                arguments.sensors,
                &Course {
                    slots: arguments.slots,
                    area_m: arguments.area_m,
                    start_m: arguments.start_m,
                    destination_m: arguments.destination_m,
                },
            )
            .map_err(Failure::bad_input)?;
            let scenario = match arguments.mse_threshold {
                Some(threshold) => scenario
                    .with_mse_threshold(threshold)
                    .map_err(Failure::bad_input)?,
                None => scenario,
            };
            let text = scenario.to_toml();
            match &arguments.out {
                Some(path) => save(path, &text, arguments.overwrite)?,
                None => out.write_all(text.as_bytes())?,
            }
        }
        Command::Random(arguments) => write_random(&arguments, &mut out)?,
        Command::Check { scenario } => {
            let loaded = load_scenario(&scenario)?;
            writeln!(
                out,
                "{}: a valid mission; {}",
                scenario.display(),
                facts(&loaded)
            )?;
        }
        Command::Show {
            scenario,
            svg: true,
        } => {
            let loaded = load_scenario(&scenario)?;
            out.write_all(report::scenario_svg(&loaded).as_bytes())?;
        }
        Command::Show {
            scenario,
            svg: false,
        } => {
            let loaded = load_scenario(&scenario)?;
            writeln!(out, "{}", map(&loaded))?;
            writeln!(out, "{}: {}", loaded.name, facts(&loaded))?;
            write!(out, "{}", places(&loaded))?;
        }
    }
    Ok(())
}

/// Formats the geographic positions of origin, start and destination. A simulated autopilot is
/// started at the start.
fn places(scenario: &Scenario) -> String {
    let p = scenario.mission.parameters();
    let frame = MapFrame::<f64>::new(scenario.map_origin());
    let elevation_m = scenario.origin.elevation_m;
    let line = |name: &str, place: Position<f64>| {
        let degrees = frame.to_geodetic(place);
        let (latitude, longitude) = (
            f64::from(degrees.latitude_e7) * 1e-7,
            f64::from(degrees.longitude_e7) * 1e-7,
        );
        format!(
            "{name:<11} ({:.1}, {:.1}) m east and north of the origin: latitude {latitude:.7}, \
             longitude {longitude:.7}, ground {elevation_m} m above sea level\n",
            place.x, place.y
        )
    };
    let mut lines = line("origin", Position::origin());
    lines += &line("start", p.start);
    lines += &line("destination", p.destination);
    lines += &format!("{:<11} {} m above the start\n", "altitude", p.altitude_m);
    lines
}

/// Writes a file. An existing file is an error unless `overwrite` is set.
fn save(path: &Path, text: &str, overwrite: bool) -> Result<(), Failure> {
    let file = File::options()
        .write(true)
        .create(true)
        .truncate(true)
        .create_new(!overwrite)
        .open(path);
    let failed = |error| Failure::failed(format!("{}: {error}", path.display()));
    match file {
        Ok(mut file) => file.write_all(text.as_bytes()).map_err(failed),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
            Err(Failure::bad_input(format!(
                "{} exists already; use --overwrite to replace it",
                path.display()
            )))
        }
        Err(error) => Err(failed(error)),
    }
}

/// Describes the mission in one line.
fn facts(scenario: &Scenario) -> String {
    let mission = &scenario.mission;
    let p = mission.parameters();
    format!(
        "{} slots of {} s, {} users (at least {} slots each), {} sensors, MSE threshold {}, \
         physical limit {:.3} bit/s/Hz a slot, digest {}",
        mission.slots(),
        p.slot_duration_s,
        mission.user_count(),
        mission.quota(),
        mission.sensor_count(),
        p.mse_threshold,
        mission.slot_rate_limit(),
        &scenario.digest()[..16],
    )
}

/// Draws a map in text characters: users `U`, sensors `s`, start `A`, destination `B`; north is up.
fn map(scenario: &Scenario) -> String {
    const COLUMNS: usize = 64;
    const ROWS: usize = 32;
    let p = scenario.mission.parameters();
    let mut cells = vec![vec!['.'; COLUMNS]; ROWS];
    let nodes = p.sensors.iter().map(|place| (place, 's'));
    let nodes = nodes.chain(p.users.iter().map(|place| (place, 'U')));
    for (place, mark) in nodes.chain([(&p.start, 'A'), (&p.destination, 'B')]) {
        let cell = |value: f64, extent: f64, cells: usize| {
            ((value / extent * cells as f64) as usize).min(cells - 1)
        };
        let column = cell(place.x, p.area.east_m, COLUMNS);
        let row = ROWS - 1 - cell(place.y, p.area.north_m, ROWS);
        cells[row][column] = mark;
    }
    let mut drawing: String = cells
        .iter()
        .flat_map(|row| row.iter().copied().chain(['\n']))
        .collect();
    drawing.push_str(&format!(
        "U user   s sensor   A start   B destination   {} m x {} m, north up",
        p.area.east_m, p.area.north_m
    ));
    drawing
}

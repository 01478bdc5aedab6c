//! Measures the planner: its share of certified bounds and its processor time.
//!
//! `planner_quality MISSIONS BOUNDS [NODES]`: directories with NAME.toml and NAME.json (as
//! `host-sim bound --json` prints). One line per mission, with the share after 0.1 s, after 0.3 s
//! and at the end of the work, then mean, 5 % quantile and worst.

use std::{env, error::Error, fs, path::Path, time::Duration};

use firmware_core::{
    Mission, Position,
    planner::{Capacity, Planner, Settings},
};
use host_sim::{scenario::Scenario, search::PlaceRates};
use rustix::time::{ClockId, clock_gettime};

fn processor_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}

fn single(mission: &Mission<f64, 16, 64>) -> Option<Mission<f32, 16, 64>> {
    let text = serde_json::to_string(mission).ok()?;
    serde_json::from_str(&text).ok()
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().collect();
    let (missions, bounds) = (Path::new(&arguments[1]), Path::new(&arguments[2]));
    let number = |index: usize, default: usize| {
        arguments
            .get(index)
            .and_then(|text| text.parse().ok())
            .unwrap_or(default)
    };
    let nodes = number(3, 25 * 25);
    let settings = Settings {
        first_iterations: number(5, Settings::default().first_iterations as usize) as u32,
        later_iterations: number(6, Settings::default().later_iterations as usize) as u32,
        rounds: number(7, Settings::default().rounds as usize) as u32,
        changes: number(8, Settings::default().changes as usize) as u32,
        ..Settings::default()
    };
    let mut files: Vec<_> = fs::read_dir(bounds)?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .collect();
    files.sort();
    let mut shares: Vec<Vec<f64>> = vec![];
    let mut times = vec![];
    for file in files
        .iter()
        .filter(|file| file.extension().is_some_and(|e| e == "json"))
    {
        let bound: serde_json::Value = serde_json::from_str(&fs::read_to_string(file)?)?;
        let (upper, lower) = (
            bound["upper"].as_f64().unwrap_or(0.0),
            bound["lower"].as_f64().unwrap_or(0.0),
        );
        let gap = bound["gap"].as_f64().unwrap_or(1.0);
        let name = file
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let scenario = Scenario::load(&missions.join(format!("{name}.toml")))?;
        let mission = single(&scenario.mission).ok_or("mission")?;
        let mut capacity = Capacity::new(mission.slots() as usize, mission.user_count());
        capacity.nodes = nodes;
        capacity.stages = number(4, capacity.stages).min(mission.slots() as usize);
        let memory = (
            vec![0.0_f32; capacity.values()],
            vec![0_u8; capacity.indices()],
        );
        let started = processor_time();
        let mut planner = Planner::new(&mission, capacity, memory)?.with_settings(settings);
        let mut rates = PlaceRates::new(&scenario.mission);
        let mut row = vec![0.0; mission.user_count()];
        let mut total = |planner: &mut Planner<f32, (Vec<f32>, Vec<u8>), 16, 64>| {
            (1..=mission.slots())
                .map(|slot| {
                    let place = planner.waypoint(slot).unwrap();
                    rates.write(
                        &Position::new(f64::from(place.x), f64::from(place.y)),
                        &mut row,
                    );
                    row[planner.served_user(slot).unwrap()]
                })
                .sum::<f64>()
        };
        let mut at = vec![];
        let mut excluded = Duration::ZERO;
        let mut operations = 0;
        let end = loop {
            let progress = planner.advance(200_000);
            operations += progress.operations;
            let now = processor_time() - started - excluded;
            let marks = [0.05, 0.1, 0.3];
            if at.len() < marks.len() && (now.as_secs_f64() > marks[at.len()]) {
                let before = processor_time();
                at.push(total(&mut planner) / upper);
                excluded += processor_time() - before;
            }
            if progress.finished {
                break now.as_secs_f64();
            }
        };
        let last = total(&mut planner) / upper;
        while at.len() < 3 {
            at.push(last);
        }
        at.push(last);
        println!(
            "{name} M {:2} J {:2} N {:2} upper {upper:7.2} gap {:.4} search {:.4} | 0.05 s {:.4} 0.1 s {:.4} 0.3 s {:.4} end {:.4} estimate {:.4} | {end:.3} s {:.0} Mop {:.0} kB",
            mission.user_count(),
            mission.sensor_count(),
            mission.slots(),
            gap,
            lower / upper,
            at[0],
            at[1],
            at[2],
            at[3],
            planner
                .upper_estimate()
                .map_or(f64::NAN, |x| f64::from(x) / upper),
            operations as f64 / 1e6,
            capacity.memory_bytes::<f32>() as f64 / 1e3
        );
        if gap <= 0.02 {
            shares.push(at);
            times.push(end);
        }
    }
    for (index, what) in ["0.05 s", "0.1 s", "0.3 s", "end"].iter().enumerate() {
        let mut column: Vec<f64> = shares.iter().map(|share| share[index]).collect();
        column.sort_by(f64::total_cmp);
        let n = column.len();
        println!(
            "{what:7} missions {n} mean {:.4} 5 % {:.4} worst {:.4}",
            column.iter().sum::<f64>() / n as f64,
            column[n / 20],
            column[0]
        );
    }
    times.sort_by(f64::total_cmp);
    println!(
        "time median {:.3} s, most {:.3} s",
        times[times.len() / 2],
        times[times.len() - 1]
    );
    Ok(())
}

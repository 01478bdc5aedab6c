//! The drawings of single flights: maps with trajectories, the served user of each slot, and the
//! data of each user.

use figures::{
    axis::{LEFT, RIGHT},
    chart::{Axis, Chart, Panel, SIZE},
    series::{Color, Line, Look, Marker, Series},
};
use firmware_core::Position;
use scenario::HostMission;

use super::{DataRow, SlotRow, data_of, flight_of, flights};
use crate::experiment::{
    Experiment,
    approach::Approach,
    cell::{Cell, MSE_THRESHOLDS, Preset, Topology},
};

const USERS: Look = marks(Marker::Ring, Color::Soft);
const SENSORS: Look = marks(Marker::Dot, Color::Soft);
const ENDS: Look = marks(Marker::Diamond, Color::Ink);

/// Returns the appearance of points without a line.
const fn marks(marker: Marker, color: Color) -> Look {
    Look {
        marker: Some(marker),
        line: Line::None,
        color,
    }
}

/// Returns the name of a threshold in legends.
fn threshold_name(mse_threshold: f64) -> String {
    format!("\u{393} = {mse_threshold:.3}")
}

/// Returns the users, the sensors, the start and the destination.
fn ground(mission: &HostMission) -> Vec<Series> {
    let p = mission.parameters();
    let place = |place: &Position<f64>| (place.x, place.y);
    let users: Vec<_> = p.users.iter().map(place).collect();
    let labels = (1..=users.len()).map(|user| user.to_string()).collect();
    vec![
        Series {
            labels: vec!["start".into(), "destination".into()],
            ..Series::new("", ENDS, vec![place(&p.start), place(&p.destination)])
        },
        Series {
            labels,
            ..Series::new("users", USERS, users)
        },
        Series::new("sensors", SENSORS, p.sensors.iter().map(place).collect()),
    ]
}

/// Returns the panels of a map: for each topology, or for the comparison of learners for each preset
/// and topology, so that only learners of the same preset are drawn together.
fn map_panels(experiment: Experiment) -> Vec<(Topology, Option<Preset>)> {
    let presets: &[Option<Preset>] = match experiment {
        Experiment::TrajectoriesCompared => &[Some(Preset::Tuned), Some(Preset::TableOne)],
        _ => &[None],
    };
    let of_preset =
        |&preset: &Option<Preset>| Topology::ALL.map(|topology: Topology| (topology, preset));
    presets.iter().flat_map(of_preset).collect()
}

/// Draws the trajectories on a map.
pub(in crate::experiment) fn map(
    experiment: Experiment,
    rows: &[SlotRow],
) -> Result<Chart, String> {
    let mut panels = Vec::new();
    for (topology, preset) in map_panels(experiment) {
        let is_shown = |approach: Approach| match (preset, approach) {
            (None, _) | (_, Approach::StraightLine) => true,
            (Some(preset), _) => {
                [Approach::sac(preset), Approach::ddpg(preset)].contains(&approach)
            }
        };
        let flights: Vec<_> = flights(experiment)
            .into_iter()
            .filter(|&(cell, approach)| cell.topology == topology && is_shown(approach))
            .collect();
        if flights.is_empty() {
            continue;
        }
        let scenario = Cell::table_one(topology).scenario()?;
        let p = scenario.mission.parameters();
        let mut series = Vec::new();
        for (index, (cell, approach)) in flights.into_iter().enumerate() {
            let flight = flight_of(rows, cell, approach);
            let path = flight.iter().map(|row| (row.east_m, row.north_m));
            let path = std::iter::once((p.start.x, p.start.y)).chain(path);
            let name = match (experiment, approach) {
                (_, Approach::StraightLine) => approach.title().to_owned(),
                (Experiment::TrajectoriesCompared, _) => {
                    let threshold = threshold_name(cell.mse_threshold);
                    format!("{}, {threshold}", approach.algorithm_title())
                }
                _ => threshold_name(cell.mse_threshold),
            };
            series.push(Series {
                mark_every: 4,
                ..Series::new(name, Look::nth(index), path.collect())
            });
        }
        series.extend(ground(&scenario.mission));
        panels.push(Panel {
            title: match preset {
                Some(preset) => format!("{}, {}", topology.title(), preset.title()),
                None => format!("{}, SAC (tuned)", topology.title()),
            },
            x: Axis::new("east, m", [0.0, p.area.east_m]),
            y: Axis::new("north, m", [0.0, p.area.north_m]),
            series,
        });
    }
    let side = RIGHT - LEFT;
    Ok(Chart {
        title: experiment.title().into(),
        columns: panels.len().min(2),
        panels,
        size: [side, side],
    })
}

/// Draws the served users over the slots.
pub(in crate::experiment) fn timeline(rows: &[SlotRow]) -> Chart {
    let users = rows.iter().map(|row| row.user).max().unwrap_or(1) as f64;
    let slots = rows.iter().map(|row| row.slot).max().unwrap_or(1);
    let panel = |topology: Topology| {
        let flights = flights(Experiment::Schedule);
        let flights = flights
            .into_iter()
            .filter(|(cell, _)| cell.topology == topology);
        // Both marks can be seen where two flights serve the same user.
        let looks = [Marker::Cross, Marker::Ring].into_iter().enumerate();
        let series = flights
            .zip(looks)
            .map(|((cell, approach), (index, marker))| {
                let flight = flight_of(rows, cell, approach);
                let points = flight
                    .iter()
                    .map(|row| (f64::from(row.slot), row.user as f64));
                let look = marks(marker, Color::Series(index));
                Series::new(threshold_name(cell.mse_threshold), look, points.collect())
            });
        Panel {
            title: format!("SAC (tuned), {}", topology.title()),
            x: Axis {
                ticks: 12,
                ..Axis::new("slot", [0.0, f64::from(slots) + 1.0])
            },
            y: Axis::new("served user", [0.2, users + 0.8]),
            series: series.collect(),
        }
    };
    Chart {
        title: Experiment::Schedule.title().into(),
        panels: Topology::ALL.map(panel).into(),
        columns: 1,
        size: [780.0, 300.0],
    }
}

/// Draws the data of the users, with one series per threshold.
pub(in crate::experiment) fn data_chart(rows: &[DataRow]) -> Chart {
    let users = rows.iter().map(|row| row.user).max().unwrap_or(1) as f64;
    let data = rows.iter().map(|row| row.data);
    let y = Axis::around("data of a user, bit/Hz", data).from_zero();
    let panel = |topology: Topology| {
        let series = MSE_THRESHOLDS
            .iter()
            .enumerate()
            .map(|(index, &threshold)| {
                let points = data_of(rows, topology, threshold);
                let points = points.iter().map(|row| (row.user as f64, row.data));
                let name = threshold_name(threshold);
                Series::new(name, Look::nth(index), points.collect())
            });
        Panel {
            title: format!("SAC (tuned), {}", topology.title()),
            x: Axis {
                ticks: 16,
                ..Axis::new("user", [0.4, users + 0.6])
            },
            y: y.clone(),
            series: series.collect(),
        }
    };
    Chart {
        title: Experiment::DataPerUser.title().into(),
        panels: Topology::ALL.map(panel).into(),
        columns: 2,
        size: SIZE,
    }
}

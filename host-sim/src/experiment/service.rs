//! Figures of single flights: the trajectory, the served user of each slot, and the data that each
//! user has sent. Every flight is that of seed 1.

mod verdicts;

use firmware_core::Position;
use plotters::chart::SeriesLabelPosition;
use serde::{Deserialize, Serialize};

use super::{
    Experiment,
    cell::{Cell, MSE_THRESHOLDS, Preset, Topology, Training},
    context::ExperimentContext,
    figure::{Axis, Figure, LOOKS, Line, Look, Marker, Panel, Series, look},
    rounded,
    totals::Approach,
};
use crate::{policy::PolicyChoice, record::FlightRecord};
use environment::Allocation;
use scenario::HostMission;

pub(super) use verdicts::{
    claims_of_approaches, claims_of_data, claims_of_schedule, claims_of_thresholds,
};

/// A slot of a flight.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SlotRow {
    /// The topology of the mission.
    pub topology: Topology,
    /// `Gamma`.
    pub mse_threshold: f64,
    /// The approach that was flown.
    pub approach: Approach,
    /// The slot, from 1.
    pub slot: u32,
    /// The position of the vehicle at the end of the slot, east, metres.
    pub east_m: f64,
    /// The position of the vehicle at the end of the slot, north, metres.
    pub north_m: f64,
    /// The served user, from 1 as in the paper. A slot in which no user was served has no row; with
    /// the ideal vehicle, whose channels are known, there is no such slot.
    pub user: usize,
    /// The rate, bit/s/Hz.
    pub rate: f64,
    /// The number of users that had not reached their quota yet, including the served one.
    pub open_users: usize,
    /// The number of these users that were nearer than the served one.
    pub nearer_users: usize,
}

/// The data that a user has sent in a flight.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct DataRow {
    /// The topology of the mission.
    pub topology: Topology,
    /// `Gamma`.
    pub mse_threshold: f64,
    /// The user, from 1.
    pub user: usize,
    /// The number of slots in which the user was served.
    pub slots: u32,
    /// The data, bit/Hz: the sum of the rates times the slot duration.
    pub data: f64,
}

/// Returns the flights of a figure.
fn flights(experiment: Experiment) -> Vec<(Cell, Approach)> {
    let over = |topology: Topology, thresholds: &[f64], approach: Approach| -> Vec<_> {
        let cell = Cell::table_one(topology);
        let cells = thresholds
            .iter()
            .map(|&threshold| cell.at_threshold(threshold));
        cells.map(|cell| (cell, approach)).collect()
    };
    let ends = [MSE_THRESHOLDS[0], MSE_THRESHOLDS[3]];
    match experiment {
        Experiment::TrajectoriesSeparated => {
            over(Topology::Separated, &MSE_THRESHOLDS, Approach::SacTuned)
        }
        Experiment::TrajectoriesMixed => over(Topology::Mixed, &MSE_THRESHOLDS, Approach::SacTuned),
        Experiment::TrajectoriesCompared => {
            let learners =
                Preset::ALL.map(|preset| [Approach::sac(preset), Approach::ddpg(preset)]);
            Topology::ALL
                .into_iter()
                .flat_map(|topology| {
                    let learners = learners.into_iter().flatten();
                    let flights = learners.flat_map(move |learner| over(topology, &ends, learner));
                    flights.chain(over(topology, &ends[..1], Approach::StraightLine))
                })
                .collect()
        }
        Experiment::Schedule => Topology::ALL
            .into_iter()
            .flat_map(|topology| over(topology, &ends, Approach::SacTuned))
            .collect(),
        _ => Topology::ALL
            .into_iter()
            .flat_map(|topology| over(topology, &MSE_THRESHOLDS, Approach::SacTuned))
            .collect(),
    }
}

fn fly(
    experiment: Experiment,
    context: &ExperimentContext<'_>,
) -> Result<Vec<(Cell, Approach, FlightRecord)>, String> {
    let flights = flights(experiment);
    let training = |cell: Cell, approach: Approach| {
        let learner = approach.learner();
        learner.map(|learner| Training::new(cell, learner, 1))
    };
    let wanted = flights
        .iter()
        .filter_map(|&(cell, approach)| training(cell, approach));
    let files = context.policies(&wanted.collect::<Vec<_>>())?;
    let mut files = files.into_iter();
    let mut flown = Vec::new();
    for (cell, approach) in flights {
        let file = training(cell, approach).and_then(|_| files.next());
        let policy = file.map_or(PolicyChoice::StraightLine, PolicyChoice::File);
        let record = context.fly(&cell, &policy, Allocation::Exact)?;
        flown.push((cell, approach, record));
    }
    Ok(flown)
}

/// Returns the slots of all flights of a figure.
pub(super) fn measure(
    experiment: Experiment,
    context: &mut ExperimentContext<'_>,
) -> Result<Vec<SlotRow>, String> {
    let mut rows = Vec::new();
    for (cell, approach, record) in fly(experiment, context)? {
        let mission = &record.scenario.mission;
        let users = &mission.parameters().users;
        let mut counts = vec![0; users.len()];
        for slot in &record.slots {
            let distance_m = |user: usize| (users[user] - slot.flown).norm();
            let Some(served) = slot.served_user else {
                continue;
            };
            let served_m = distance_m(served);
            let open = (0..users.len()).filter(|&user| counts[user] < mission.quota());
            let open: Vec<usize> = open.collect();
            let nearer = open.iter().filter(|&&user| distance_m(user) < served_m);
            rows.push(SlotRow {
                topology: cell.topology,
                mse_threshold: cell.mse_threshold,
                approach,
                slot: slot.slot,
                east_m: rounded(slot.flown.x),
                north_m: rounded(slot.flown.y),
                user: served + 1,
                rate: rounded(slot.rate),
                open_users: open.len(),
                nearer_users: nearer.count(),
            });
            counts[served] += 1;
        }
    }
    Ok(rows)
}

/// Returns the data that each user has sent in all flights of `data-per-user`.
pub(super) fn measure_data(context: &mut ExperimentContext<'_>) -> Result<Vec<DataRow>, String> {
    let mut rows = Vec::new();
    for (cell, _, record) in fly(Experiment::DataPerUser, context)? {
        let slot_s = record.scenario.mission.parameters().slot_duration_s;
        let users = record.users().into_iter().enumerate();
        rows.extend(users.map(|(user, sent)| DataRow {
            topology: cell.topology,
            mse_threshold: cell.mse_threshold,
            user: user + 1,
            slots: sent.slots,
            data: rounded(sent.data * slot_s),
        }));
    }
    Ok(rows)
}

/// Returns the rows that belong to one flight.
fn flight_of(rows: &[SlotRow], cell: Cell, approach: Approach) -> Vec<&SlotRow> {
    let belongs = |row: &&SlotRow| {
        row.topology == cell.topology
            && row.mse_threshold == cell.mse_threshold
            && row.approach == approach
    };
    rows.iter().filter(belongs).collect()
}

const USERS: Look = look(Marker::Triangle, Line::None, [90, 90, 90]);
const SENSORS: Look = look(Marker::Dot, Line::None, [150, 150, 150]);
const ENDS: Look = look(Marker::Diamond, Line::None, [0, 0, 0]);

/// Returns the users, the sensors, the start and the destination.
fn ground(mission: &HostMission) -> Vec<Series> {
    let p = mission.parameters();
    let place = |place: &Position<f64>| (place.x, place.y);
    let users: Vec<_> = p.users.iter().map(place).collect();
    let labels = (1..=users.len()).map(|user| user.to_string()).collect();
    vec![
        Series::new("sensors", SENSORS, p.sensors.iter().map(place).collect()),
        Series {
            labels,
            ..Series::new("users", USERS, users)
        },
        Series {
            labels: vec!["start".into(), "destination".into()],
            ..Series::new("", ENDS, vec![place(&p.start), place(&p.destination)])
        },
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
pub(super) fn map(experiment: Experiment, rows: &[SlotRow]) -> Result<Figure, String> {
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
        let axis = |label: &str, to: f64| Axis {
            label: label.into(),
            from: 0.0,
            to,
            ticks: 6,
            digits: 0,
        };
        let mut series = ground(&scenario.mission);
        for ((cell, approach), look) in flights.into_iter().zip(LOOKS) {
            let flight = flight_of(rows, cell, approach);
            let path = flight.iter().map(|row| (row.east_m, row.north_m));
            let path = std::iter::once((p.start.x, p.start.y)).chain(path);
            let name = match (experiment, approach) {
                (_, Approach::StraightLine) => approach.title().to_owned(),
                (Experiment::TrajectoriesCompared, _) => {
                    format!("{}, Gamma {:.3}", approach.title(), cell.mse_threshold)
                }
                _ => format!("Gamma {:.3}", cell.mse_threshold),
            };
            series.push(Series {
                mark_every: 4,
                ..Series::new(name, look, path.collect())
            });
        }
        panels.push(Panel {
            title: match preset {
                Some(preset) => format!("{}, {}", topology.title(), preset.title()),
                None => format!("{}, SAC (tuned)", topology.title()),
            },
            x: axis("east, m", p.area.east_m),
            y: axis("north, m", p.area.north_m),
            series,
            legend: match topology {
                Topology::Separated => SeriesLabelPosition::MiddleRight,
                Topology::Mixed => SeriesLabelPosition::LowerRight,
            },
        });
    }
    Ok(Figure {
        columns: panels.len().min(2),
        panels,
        size: (640, 620),
    })
}

/// Draws the served users over the slots.
pub(super) fn timeline(rows: &[SlotRow]) -> Figure {
    let users = rows.iter().map(|row| row.user).max().unwrap_or(1) as f64;
    let slots = rows.iter().map(|row| row.slot).max().unwrap_or(1);
    let panel = |topology: Topology| {
        let flights = flights(Experiment::Schedule);
        let flights = flights
            .into_iter()
            .filter(|(cell, _)| cell.topology == topology);
        let looks = [
            look(Marker::Circle, Line::None, LOOKS[0].color),
            look(Marker::Cross, Line::None, LOOKS[1].color),
        ];
        let series = flights.zip(looks).map(|((cell, approach), look)| {
            let flight = flight_of(rows, cell, approach);
            let points = flight
                .iter()
                .map(|row| (f64::from(row.slot), row.user as f64));
            let name = format!("Gamma {:.3}", cell.mse_threshold);
            Series::new(name, look, points.collect())
        });
        Panel {
            title: format!("SAC (tuned), {}", topology.title()),
            x: Axis {
                label: "slot".into(),
                from: 0.0,
                to: f64::from(slots) + 1.0,
                ticks: 12,
                digits: 0,
            },
            y: Axis {
                label: "served user".into(),
                from: 0.0,
                to: users + 4.0,
                ticks: 16,
                digits: 0,
            },
            series: series.collect(),
            legend: SeriesLabelPosition::UpperRight,
        }
    };
    Figure {
        panels: Topology::ALL.map(panel).into(),
        columns: 1,
        size: (860, 400),
    }
}

/// Draws the data of the users, with one series per threshold.
pub(super) fn data_figure(rows: &[DataRow]) -> Figure {
    let users = rows.iter().map(|row| row.user).max().unwrap_or(1) as f64;
    let most = rows.iter().map(|row| row.data);
    let y = Axis::around("data of a user, bit/Hz", most, 0).with_zero();
    let panel = |topology: Topology| {
        let series = MSE_THRESHOLDS.iter().zip(LOOKS).map(|(&threshold, look)| {
            let points = data_of(rows, topology, threshold);
            let points = points.iter().map(|row| (row.user as f64, row.data));
            Series::new(format!("Gamma {threshold:.3}"), look, points.collect())
        });
        let mut series: Vec<Series> = series.collect();
        // The loosest threshold is on top in the drawing, and therefore also in the legend.
        series.reverse();
        Panel {
            title: format!("SAC (tuned), {}", topology.title()),
            x: Axis {
                label: "user".into(),
                from: 0.0,
                to: users + 1.0,
                ticks: 16,
                digits: 0,
            },
            y: Axis {
                to: 1.3 * y.to,
                ..y.clone()
            },
            series,
            legend: SeriesLabelPosition::UpperRight,
        }
    };
    Figure {
        panels: Topology::ALL.map(panel).into(),
        columns: 2,
        size: (540, 420),
    }
}

fn data_of(rows: &[DataRow], topology: Topology, threshold: f64) -> Vec<&DataRow> {
    let belongs = |row: &&DataRow| row.topology == topology && row.mse_threshold == threshold;
    rows.iter().filter(belongs).collect()
}

//! Figures of single flights: the trajectory, the served user of each slot, and the data that each
//! user has sent. Every flight is that of seed 1.

mod drawing;
mod verdicts;

use serde::{Deserialize, Serialize};

use super::{
    Experiment,
    approach::Approach,
    cell::{Cell, MSE_THRESHOLDS, Preset, Topology, Training},
    context::ExperimentContext,
    rounded,
};
use crate::{policy::PolicyChoice, record::FlightRecord};
use environment::Allocation;

pub(super) use drawing::{data_chart, map, timeline};
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
    let files = context.trainings().policies(&wanted.collect::<Vec<_>>())?;
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

fn data_of(rows: &[DataRow], topology: Topology, threshold: f64) -> Vec<&DataRow> {
    let belongs = |row: &&DataRow| row.topology == topology && row.mse_threshold == threshold;
    rows.iter().filter(belongs).collect()
}

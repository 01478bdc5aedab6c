//! The drawings of total rates over the threshold or the mission time.

use figures::{
    chart::{Axis, Chart, Panel, SIZE},
    quantity,
    series::{Look, Series},
};

use super::{TotalRow, approaches};
use crate::experiment::{
    Experiment,
    approach::Approach,
    cell::{HIGH_NOISE_DBM, NOISE_DBM, Topology},
};

/// Returns the appearance of an approach, which is the same in every figure.
fn look(approach: Approach) -> Look {
    Look::nth(match approach {
        Approach::SacTuned => 0,
        Approach::DdpgTableOne | Approach::FixedPosition => 1,
        Approach::StraightLine | Approach::FixedUserPower => 2,
        Approach::Search | Approach::FixedSensorPower => 3,
        Approach::SacTableOne => 4,
        Approach::Bound => 5,
        Approach::DdpgTuned => 6,
        Approach::AnyMission => 7,
    })
}

/// Returns a noise power with its unit.
fn noise_name(noise_dbm: f64) -> String {
    format!("{} dBm", quantity::plain(noise_dbm))
}

/// Draws one panel per topology; for `approaches` one per topology and noise power.
pub(in crate::experiment) fn chart(experiment: Experiment, rows: &[TotalRow]) -> Chart {
    let over_time = experiment == Experiment::MissionTime;
    let noises: &[Option<f64>] = match experiment {
        Experiment::Approaches => &[Some(NOISE_DBM), Some(HIGH_NOISE_DBM)],
        _ => &[None],
    };
    let mut panels = Vec::new();
    for &noise in noises {
        for topology in Topology::ALL {
            let here: Vec<&TotalRow> = rows
                .iter()
                .filter(|row| row.topology == topology)
                .filter(|row| noise.is_none_or(|noise| row.noise_dbm == noise))
                .collect();
            if here.is_empty() {
                continue;
            }
            let abscissa = |row: &TotalRow| match over_time {
                true => f64::from(row.mission_time_s),
                false => row.mse_threshold,
            };
            let x_title = match over_time {
                true => "mission time, s",
                false => "MSE threshold \u{393}",
            };
            let rates = here.iter().map(|row| row.sum_rate);
            panels.push(Panel {
                title: match noise {
                    Some(noise) => format!("{}, {}", topology.title(), noise_name(noise)),
                    None => topology.title().to_owned(),
                },
                x: Axis {
                    ticks: 5,
                    ..Axis::around(x_title, here.iter().map(|row| abscissa(row)))
                },
                y: Axis::around("total rate, bit/s/Hz", rates).from_zero(),
                series: series(experiment, &here, abscissa),
            });
        }
    }
    Chart {
        title: experiment.title().into(),
        columns: panels.len().min(2),
        panels,
        size: SIZE,
    }
}

fn series(
    experiment: Experiment,
    rows: &[&TotalRow],
    abscissa: impl Fn(&TotalRow) -> f64,
) -> Vec<Series> {
    let of = |name: String, look: Look, chosen: &dyn Fn(&TotalRow) -> bool| {
        let chosen: Vec<&&TotalRow> = rows.iter().filter(|row| chosen(row)).collect();
        let points = chosen
            .iter()
            .map(|row| (abscissa(row), row.sum_rate))
            .collect();
        let band = chosen.iter().map(|row| {
            let half = row.interval_95.unwrap_or(0.0);
            (row.sum_rate - half, row.sum_rate + half)
        });
        let band = match chosen.iter().any(|row| row.interval_95.is_some()) {
            true => band.collect(),
            false => Vec::new(),
        };
        Series {
            band,
            ..Series::new(name, look, points)
        }
    };
    if experiment == Experiment::Noise {
        return [NOISE_DBM, HIGH_NOISE_DBM]
            .into_iter()
            .enumerate()
            .map(|(index, noise)| {
                let name = format!("SAC (tuned), {}", noise_name(noise));
                of(name, Look::nth(index), &|row| row.noise_dbm == noise)
            })
            .collect();
    }
    approaches(experiment)
        .iter()
        .map(|&approach| {
            of(approach.title().into(), look(approach), &|row| {
                row.approach == approach
            })
        })
        .filter(|series| !series.points.is_empty())
        .collect()
}

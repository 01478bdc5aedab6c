//! The drawings of total rates and outages: a row of panels per kind of error, a panel per group of missions.

use figures::{
    chart::{Axis, Chart, Panel},
    series::{Line, Look, Series},
};

use super::{
    error_kind::ErrorKind,
    row::{Group, Pilot, RobustnessRow},
};

/// The size of a panel: three in a row, eight rows.
const SIZE: [f64; 2] = [330.0, 180.0];

/// Returns the drawing of total rates.
pub(super) fn totals(rows: &[RobustnessRow]) -> Chart {
    let title =
        "Total rate in worlds that are not known exactly, over the planner's in the known one";
    chart(rows, title, ("share of the total", [0.0, 1.2]), |row| {
        (row.share, row.share_interval_95)
    })
}

/// Returns the drawing of outages.
pub(super) fn outage(rows: &[RobustnessRow]) -> Chart {
    let title = "Fraction of slots with an expected MSE above the threshold";
    chart(rows, title, ("outage", [0.0, 1.0]), |row| {
        (row.outage, row.outage_interval_95)
    })
}

/// Returns a drawing of one number of the rows with its interval.
fn chart(
    rows: &[RobustnessRow],
    title: &str,
    (axis, range): (&str, [f64; 2]),
    value: impl Fn(&RobustnessRow) -> (f64, Option<f64>),
) -> Chart {
    let mut panels = Vec::new();
    for kind in ErrorKind::ALL {
        for group in Group::ALL {
            let mut series = Vec::new();
            for (index, &pilot) in Pilot::ALL.iter().enumerate() {
                for robust in [true, false] {
                    let curve: Vec<&RobustnessRow> = (rows.iter())
                        .filter(|row| (row.group, row.kind, row.pilot) == (group, kind, pilot))
                        // In the known world there is nothing to ignore.
                        .filter(|row| row.robust == robust || row.level == 0.0)
                        .collect();
                    if curve.len() < 2 || curve.iter().all(|row| row.robust) && !robust {
                        continue;
                    }
                    let points = curve.iter().map(|row| (row.level, value(row)));
                    series.push(series_of(points, pilot, (index, robust)));
                }
            }
            panels.push(Panel {
                title: format!("{}: {}", group.title(), kind.axis()),
                x: Axis {
                    ticks: 4,
                    ..Axis::around(kind.axis(), kind.levels().into_iter())
                },
                y: Axis::new(axis, range),
                series,
            });
        }
    }
    Chart {
        title: title.into(),
        columns: Group::ALL.len(),
        panels,
        size: SIZE,
    }
}

/// Returns the curve of points `(level, (value, half of its interval))`.
fn series_of(
    points: impl Iterator<Item = (f64, (f64, Option<f64>))> + Clone,
    pilot: Pilot,
    (index, robust): (usize, bool),
) -> Series {
    let band = points.clone().map(|(_, (value, half))| {
        let half = half.unwrap_or(0.0);
        (value - half, value + half)
    });
    let points = points.clone().map(|(level, (value, _))| (level, value));
    let look = Look::nth(index);
    let (name, look) = match robust {
        true => (
            pilot.to_string(),
            Look {
                line: Line::Solid,
                ..look
            },
        ),
        false => (
            format!("{pilot}, errors ignored"),
            Look {
                line: Line::Dashed("6 4"),
                marker: None,
                ..look
            },
        ),
    };
    Series {
        band: band.collect(),
        ..Series::new(name, look, points.collect())
    }
}

//! The drawing of total rates: a row of panels per kind of error, a panel per group of missions.

use figures::{
    chart::{Axis, Chart, Panel},
    series::{Line, Look, Series},
};

use super::{ErrorKind, Group, Pilot, RobustnessRow};

/// The size of a panel: three in a row, eight rows.
const SIZE: [f64; 2] = [330.0, 180.0];

/// Returns the drawing.
pub(super) fn chart(rows: &[RobustnessRow]) -> Chart {
    let mut panels = Vec::new();
    for kind in ErrorKind::ALL {
        for group in Group::ALL {
            let here = |robust: bool, pilot: Pilot| -> Vec<&RobustnessRow> {
                let of = rows
                    .iter()
                    .filter(|row| (row.group, row.kind, row.pilot) == (group, kind, pilot));
                // In the known world there is nothing to ignore.
                of.filter(|row| row.robust == robust || row.level == 0.0)
                    .collect()
            };
            let mut series = Vec::new();
            for (index, &pilot) in Pilot::ALL.iter().enumerate() {
                for robust in [true, false] {
                    let rows = here(robust, pilot);
                    if rows.len() < 2 || rows.iter().all(|row| row.robust) && !robust {
                        continue;
                    }
                    series.push(curve(&rows, pilot, (index, robust)));
                }
            }
            let levels = kind.levels();
            panels.push(Panel {
                title: format!("{}: {}", group.title(), kind.axis()),
                x: Axis {
                    ticks: 4,
                    ..Axis::around(kind.axis(), levels.into_iter())
                },
                y: Axis::new("share of the total", [0.0, 1.2]),
                series,
            });
        }
    }
    Chart {
        title:
            "Total rate in worlds that are not known exactly, over the planner's in the known one"
                .into(),
        columns: Group::ALL.len(),
        panels,
        size: SIZE,
    }
}

fn curve(rows: &[&RobustnessRow], pilot: Pilot, (index, robust): (usize, bool)) -> Series {
    let points = rows.iter().map(|row| (row.level, row.share)).collect();
    let band = rows.iter().map(|row| {
        let half = row.share_interval_95.unwrap_or(0.0);
        (row.share - half, row.share + half)
    });
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
        ..Series::new(name, look, points)
    }
}

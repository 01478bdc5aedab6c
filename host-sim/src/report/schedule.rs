//! The user schedule and the total of each user.

use super::slot_axis;
use super::{map::cross, series::bar_width, slot_words};
use crate::record::FlightRecord;
use figures::{
    axis::{self, Key, LEFT, RIGHT, Scale, WIDTH},
    markup::{Element, PathData, element, label, line, rectangle},
    quantity::{self, significant},
    theme,
};

/// Draws the schedule: users as rows, slots as columns, and a cell in the colour of the rate for each
/// served slot.
pub(super) fn strip(record: &FlightRecord) -> Element {
    let axis = slot_axis(record);
    let limit = record.scenario.mission.slot_rate_limit();
    let users = record.scenario.mission.user_count();
    let row = (220.0 / users as f64).clamp(15.0, 24.0);
    let mut keys = vec![Key {
        mark: rectangle("bar", [-5.0, -5.0], [10.0, 10.0]).set("fill", theme::viridis(0.75)),
        words: "served, coloured by rate".into(),
    }];
    if record.slots.iter().any(|slot| slot.intervention.any()) {
        keys.push(Key {
            mark: shield_mark([0.0, 1.0], 4.0),
            words: "changed by the shield".into(),
        });
    }
    if record.slots.iter().any(|slot| !slot.feasible) {
        keys.push(Key {
            mark: cross([0.0, 0.0], 3.5),
            words: "threshold out of reach".into(),
        });
    }
    let (legend, foot) = axis::legend(keys, [LEFT, 12.0]);
    let top = foot + 16.0;
    let end_of_rows = top + row * users as f64;
    let bottom = end_of_rows + 12.0;

    let mut rows = element("g");
    for user in 0..users {
        let y = top + row * user as f64;
        let ground = if user % 2 == 0 {
            "stripe"
        } else {
            "stripe odd"
        };
        rows.push(rectangle(ground, [LEFT, y], [RIGHT - LEFT, row]));
        rows.push(label(
            "tick end",
            [LEFT - 7.0, y + row / 2.0 + 4.0],
            format!("u{user}"),
        ));
    }
    let mut cells = element("g");
    let width = bar_width(&axis).min(axis.band());
    for slot in &record.slots {
        let Some(user) = slot.served_user else {
            continue;
        };
        let y = top + row * user as f64;
        let x = axis.middle(slot.slot) - width / 2.0;
        cells.push(
            rectangle("bar", [x, y + 1.5], [width, row - 3.0])
                .set("fill", theme::viridis(slot.rate / limit)),
        );
        if !slot.feasible && axis.begins_mark(slot.slot) {
            let size = (axis.band() * 0.4).clamp(2.0, 4.0);
            cells.push(cross([axis.middle(slot.slot), y + row / 2.0], size));
        }
        if slot.intervention.any() {
            let size = (axis.band() * 0.45).clamp(1.5, 4.0);
            cells.push(shield_mark(
                [axis.middle(slot.slot), end_of_rows + 6.0],
                size,
            ));
        }
    }
    axis::figure(
        bottom + 40.0,
        "Schedule",
        "Which user is served in which slot",
    )
    .with(legend)
    .with(rows)
    .with(cells)
    .with(line("edge", [LEFT, bottom], [RIGHT, bottom]))
    .with(axis.draw(bottom))
    .with(
        axis.hover(
            [top, bottom],
            record
                .slots
                .iter()
                .map(|slot| (slot.slot, slot_words(record, slot))),
        ),
    )
}

fn shield_mark([x, y]: [f64; 2], size: f64) -> Element {
    let top = y - 0.8 * size;
    let corners = [[x - size, top], [x + size, top], [x, y + 0.9 * size]];
    let mut path = PathData::through(corners);
    path.close();
    path.path("shield")
}

/// Draws a bar per user that consists of its slots in the colours of their rates.
pub(super) fn totals(record: &FlightRecord) -> Element {
    let mission = &record.scenario.mission;
    let limit = mission.slot_rate_limit();
    let summaries = record.users();
    let row = (330.0 / summaries.len() as f64).clamp(19.0, 34.0);
    let most = summaries.iter().map(|user| user.data).fold(0.0, f64::max);
    // The space at the right is for the totals and the numbers of slots.
    let end = WIDTH - 132.0;
    let scale = Scale::linear([0.0, if most > 0.0 { most } else { 1.0 }], [LEFT, end]);
    let top = 8.0;
    let bottom = top + row * summaries.len() as f64 + 4.0;

    let mut drawing = axis::figure(
        bottom + 40.0,
        "Total per user",
        "Sum of the rates of each user over the slots in which it was served",
    );
    let title = "bit/s/Hz, summed over slots";
    drawing.push(axis::horizontal(&scale, [top, bottom], 5, title));
    for (user, summary) in summaries.iter().enumerate() {
        let y = top + row * user as f64 + 3.0;
        // Slots are separated by a gap if there is enough space.
        let width = (scale.at(summary.data) - LEFT) / f64::from(summary.slots.max(1));
        let gap = if width > 5.0 { 1.0 } else { -0.1 };
        let mut total = 0.0;
        let served = |slot: &&crate::record::SlotRecord| slot.served_user == Some(user);
        for slot in record.slots.iter().filter(served) {
            let from = scale.at(total);
            total += slot.rate;
            drawing.push(
                rectangle("bar", [from, y], [scale.at(total) - from - gap, row - 6.0])
                    .set("fill", theme::viridis(slot.rate / limit)),
            );
        }
        let base = y + row / 2.0 + 1.0;
        drawing.push(label("tick end", [LEFT - 7.0, base], format!("u{user}")));
        let owed = if summary.is_short() {
            "figure bad"
        } else {
            "figure"
        };
        drawing.push(
            label(
                owed,
                [scale.at(total) + 7.0, base],
                significant(summary.data, 3),
            )
            .with(
                element("tspan")
                    .class("soft")
                    .set("dx", "6")
                    .text(quantity::count(summary.slots as usize, "slot")),
            ),
        );
    }
    drawing.with(line("edge", [LEFT, top], [LEFT, bottom]))
}

//! The figures over the slots: rate, MSE, estimate and powers. They share one horizontal axis, so
//! that they are aligned when one is below the other.

use super::map::cross;
use super::slot_axis;
use crate::record::{FlightRecord, SlotRecord};
use figures::{
    axis::{self, Key, LEFT, Panel, RIGHT, Scale, SlotAxis},
    markup::{Element, PathData, circle, element, line, rectangle},
    quantity::{percent, plain, power_unit, shortened, significant, unit},
    theme,
};

/// The vertical coordinate of legends.
const LEGEND_Y: f64 = 12.0;

/// Draws `R_n` and its physical limit at any position, `log2(1 / (1 - J Gamma))`.
pub(super) fn rate(record: &FlightRecord) -> Element {
    let axis = slot_axis(record);
    let limit = record.scenario.mission.slot_rate_limit();
    let mut keys = vec![
        Key {
            mark: rectangle("bar", [-5.0, -5.0], [10.0, 10.0]).set("fill", theme::viridis(0.75)),
            words: "rate, coloured as on the map".into(),
        },
        Key {
            mark: line("bound", [-9.0, 0.0], [9.0, 0.0]),
            words: format!("physical limit {}", significant(limit, 4)),
        },
    ];
    infeasible_key(record, &mut keys);
    let (legend, foot) = axis::legend(keys, [LEFT, LEGEND_Y]);
    let panel = panel(foot + 16.0, 168.0, |range| {
        Scale::linear([0.0, limit * 1.06], range)
    });
    let mut bars = element("g");
    let width = bar_width(&axis);
    for slot in &record.slots {
        let y = panel.scale.at(slot.rate);
        let place = [axis.middle(slot.slot) - width / 2.0, y];
        bars.push(
            rectangle("bar", place, [width, panel.bottom - y])
                .set("fill", theme::viridis(slot.rate / limit)),
        );
        if !slot.feasible && axis.begins_mark(slot.slot) {
            bars.push(cross([axis.middle(slot.slot), panel.bottom - 8.0], 3.5));
        }
    }
    axis::figure(
        panel.bottom + 40.0,
        "Rate per slot",
        "Bars in bit/s/Hz under the physical limit",
    )
    .with(legend)
    .with(panel.draw("bit/s/Hz"))
    .with(infeasible_columns(record, &axis, &panel))
    .with(bars)
    .with(panel.bound(limit))
    .with(panel.base())
    .with(axis.draw(panel.bottom))
    .with(axis.hover(
        [panel.top, panel.bottom],
        record.slots.iter().map(|slot| {
            let words = format!(
                "slot {}: {} bit/s/Hz, {} of the limit",
                slot.slot,
                significant(slot.rate, 4),
                percent(slot.rate / limit)
            );
            (slot.slot, words)
        }),
    ))
}

/// Draws `MSE_n`, analytic and as measured with the drawn signals, and `Gamma`.
pub(super) fn mse(record: &FlightRecord) -> Element {
    let axis = slot_axis(record);
    let threshold = record.scenario.mission.parameters().mse_threshold;
    let mut keys = vec![
        Key {
            mark: line("computed", [-9.0, 0.0], [9.0, 0.0]),
            words: "analytic".into(),
        },
        Key {
            mark: circle("sample", [0.0, 0.0], 3.0),
            words: "from the signals".into(),
        },
        Key {
            mark: line("bound", [-9.0, 0.0], [9.0, 0.0]),
            words: format!("threshold Γ = {}", plain(threshold)),
        },
    ];
    infeasible_key(record, &mut keys);
    let (legend, foot) = axis::legend(keys, [LEFT, LEGEND_Y]);
    let panel = panel(foot + 16.0, 190.0, |range| {
        let both = |slot: &SlotRecord| [slot.mse, slot.signals.empirical_mse];
        let values = record.slots.iter().flat_map(both);
        Scale::around(values.chain([threshold]), range)
    });
    let words = |slot: &SlotRecord| {
        format!(
            "slot {}: MSE {} analytic, {} over {} symbols",
            slot.slot,
            significant(slot.mse, 4),
            significant(slot.signals.empirical_mse, 4),
            slot.signals.symbols,
        )
    };
    axis::figure(
        panel.bottom + 40.0,
        "MSE per slot",
        "Analytic and empirical mean square error of the average, against the threshold",
    )
    .with(legend)
    .with(panel.draw("MSE"))
    .with(infeasible_columns(record, &axis, &panel))
    .with(steps(record, &axis, &panel, "computed", |slot| slot.mse))
    // Drawn over the analytic line, so that both are visible where they coincide.
    .with(panel.bound(threshold))
    .with(dots(record, &axis, &panel, |slot| {
        slot.signals.empirical_mse
    }))
    .with(infeasible_crosses(record, &axis, &panel))
    .with(panel.base())
    .with(axis.draw(panel.bottom))
    .with(axis.hover(
        [panel.top, panel.bottom],
        record.slots.iter().map(|slot| (slot.slot, words(slot))),
    ))
}

/// Draws the function of the measurements and its estimate over the air in the scenario's unit, and
/// the error below.
pub(super) fn estimate(record: &FlightRecord) -> Element {
    let axis = slot_axis(record);
    let unit = unit(&record.scenario.sensing.unit);
    let keys = vec![
        Key {
            mark: line("computed", [-9.0, 0.0], [9.0, 0.0]),
            words: format!("true {}", record.scenario.sensing.function),
        },
        Key {
            mark: circle("sample", [0.0, 0.0], 3.0),
            words: "estimate over the air".into(),
        },
    ];
    let (legend, foot) = axis::legend(keys, [LEFT, LEGEND_Y]);
    let values = panel(foot + 16.0, 118.0, |range| {
        let both = |slot: &SlotRecord| [slot.signals.true_value, slot.signals.estimate];
        Scale::around(record.slots.iter().flat_map(both), range)
    });
    let errors = panel(values.bottom + 22.0, 92.0, |range| {
        let sizes = record.slots.iter().map(|slot| slot.signals.error().abs());
        let largest = sizes.filter(|size| size.is_finite()).fold(1e-12, f64::max) * 1.15;
        Scale::linear([-largest, largest], range)
    });
    let mut stems = PathData::default();
    let mut tips = element("g");
    let radius = dot_radius(&axis);
    for slot in &record.slots {
        let [x, y] = [
            axis.middle(slot.slot),
            errors.scale.at(slot.signals.error()),
        ];
        stems.move_to(x, errors.scale.at(0.0));
        stems.line_to(x, y);
        tips.push(circle("tip", [x, y], radius * 0.8));
    }
    let words = |slot: &SlotRecord| {
        format!(
            "slot {}: {} {unit} estimated, {} {unit} true, error {} {unit}",
            slot.slot,
            significant(slot.signals.estimate, 4),
            significant(slot.signals.true_value, 4),
            significant(slot.signals.error(), 3),
        )
    };
    let zero = errors.scale.at(0.0);
    axis::figure(
        errors.bottom + 40.0,
        "Estimate and true value per slot",
        "The function of the measurements and its estimate over the air; below, the error",
    )
    .with(legend)
    .with(values.draw(&shortened(unit, 14)))
    .with(steps(record, &axis, &values, "computed", |slot| {
        slot.signals.true_value
    }))
    .with(dots(record, &axis, &values, |slot| slot.signals.estimate))
    .with(values.base())
    .with(errors.draw(&format!("error ({})", shortened(unit, 8))))
    .with(line("edge", [LEFT, zero], [RIGHT, zero]))
    .with(stems.path("stem"))
    .with(tips)
    .with(errors.base())
    .with(axis.draw(errors.bottom))
    .with(axis.hover(
        [values.top, errors.bottom],
        record.slots.iter().map(|slot| (slot.slot, words(slot))),
    ))
}

/// Draws the power of the served user and the mean power of the sensors, each with its maximum.
pub(super) fn power(record: &FlightRecord) -> Element {
    let axis = slot_axis(record);
    let p = record.scenario.mission.parameters();
    let keys = vec![
        Key {
            mark: line("computed", [-9.0, 0.0], [9.0, 0.0]),
            words: "transmit power".into(),
        },
        Key {
            mark: line("bound", [-9.0, 0.0], [9.0, 0.0]),
            words: "maximum".into(),
        },
    ];
    let (legend, foot) = axis::legend(keys, [LEFT, LEGEND_Y]);
    let mut drawing = Vec::new();
    let mut top = foot + 16.0;
    let users: fn(&SlotRecord) -> f64 = |slot| slot.user_power_w;
    let sensors: fn(&SlotRecord) -> f64 = |slot| slot.sensor_power_mean_w;
    let [mut from, mut bottom] = [top, top];
    for (who, most_w, value_w) in [
        ("user", p.user_power_max.0, users),
        ("sensor mean", p.sensor_power_max.0, sensors),
    ] {
        let (unit, per_watt) = power_unit(most_w);
        let panel = panel(top, 128.0, |range| {
            let used = record.slots.iter().map(value_w);
            // The logarithm of zero power is drawn at the lower border.
            let used = used.filter(|power_w| *power_w > 0.0);
            let values = used.chain([most_w]).map(|power_w| power_w * per_watt);
            let scale = Scale::around(values.clone(), range);
            if scale.is_logarithmic() {
                scale
            } else {
                Scale::linear([0.0, values.fold(0.0, f64::max) * 1.12], range)
            }
        });
        drawing.push(panel.draw(&format!("{who} ({unit})")));
        drawing.push(panel.bound(most_w * per_watt));
        drawing.push(steps(record, &axis, &panel, "computed", |slot| {
            value_w(slot) * per_watt
        }));
        drawing.push(panel.base());
        from = from.min(panel.top);
        bottom = panel.bottom;
        top = bottom + 26.0;
    }
    let (user_unit, user_per_watt) = power_unit(p.user_power_max.0);
    let (sensor_unit, sensor_per_watt) = power_unit(p.sensor_power_max.0);
    let words = |slot: &SlotRecord| {
        format!(
            "slot {}: user {} {user_unit}, sensors' mean {} {sensor_unit}",
            slot.slot,
            significant(slot.user_power_w * user_per_watt, 4),
            significant(slot.sensor_power_mean_w * sensor_per_watt, 4),
        )
    };
    axis::figure(
        bottom + 40.0,
        "Transmit powers per slot",
        "The served user's power and the sensors' mean power, each under its maximum",
    )
    .with(legend)
    .with_all(drawing)
    .with(axis.draw(bottom))
    .with(axis.hover(
        [from, bottom],
        record.slots.iter().map(|slot| (slot.slot, words(slot))),
    ))
}

fn panel(top: f64, height: f64, scale: impl FnOnce([f64; 2]) -> Scale) -> Panel {
    let bottom = top + height;
    Panel {
        left: LEFT,
        right: RIGHT,
        top,
        bottom,
        scale: scale([bottom, top]),
    }
}

/// Draws bars, with gaps between them if there is enough space.
pub(super) fn bar_width(axis: &SlotAxis) -> f64 {
    match axis.band() {
        band if band > 3.0 => (band * 0.82).min(26.0),
        band => band + 0.1,
    }
}

fn dot_radius(axis: &SlotAxis) -> f64 {
    (axis.band() * 0.36).clamp(1.1, 3.0)
}

/// Draws a step line that is constant in each slot.
fn steps(
    record: &FlightRecord,
    axis: &SlotAxis,
    panel: &Panel,
    class: &'static str,
    value: impl Fn(&SlotRecord) -> f64,
) -> Element {
    let corners = record.slots.iter().flat_map(|slot| {
        let y = panel.scale.at(value(slot));
        let x = axis.begin(slot.slot);
        [[x, y], [x + axis.band(), y]]
    });
    PathData::through(corners).path(class)
}

fn dots(
    record: &FlightRecord,
    axis: &SlotAxis,
    panel: &Panel,
    value: impl Fn(&SlotRecord) -> f64,
) -> Element {
    let radius = dot_radius(axis);
    element("g").with_all(record.slots.iter().map(|slot| {
        let place = [axis.middle(slot.slot), panel.scale.at(value(slot))];
        circle("sample", place, radius)
    }))
}

/// Draws the background of the slots in which `Gamma` could not be met.
fn infeasible_columns(record: &FlightRecord, axis: &SlotAxis, panel: &Panel) -> Element {
    let slots = record.slots.iter().filter(|slot| !slot.feasible);
    element("g").with_all(slots.map(|slot| {
        rectangle(
            "veil",
            [axis.begin(slot.slot), panel.top],
            [axis.band(), panel.bottom - panel.top],
        )
    }))
}

fn infeasible_crosses(record: &FlightRecord, axis: &SlotAxis, panel: &Panel) -> Element {
    let slots = record
        .slots
        .iter()
        .filter(|slot| !slot.feasible && axis.begins_mark(slot.slot));
    element("g")
        .with_all(slots.map(|slot| cross([axis.middle(slot.slot), panel.scale.at(slot.mse)], 3.5)))
}

fn infeasible_key(record: &FlightRecord, keys: &mut Vec<Key>) {
    if record.slots.iter().any(|slot| !slot.feasible) {
        keys.push(Key {
            mark: cross([0.0, 0.0], 3.5),
            words: "threshold out of reach".into(),
        });
    }
}

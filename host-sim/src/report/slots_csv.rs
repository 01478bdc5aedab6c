//! `slots.csv`: one row per slot, with units in the column names. Numbers are written with as many
//! digits as are needed to read them back exactly. The two timings, which differ between runs with
//! the same seed, are the last columns.

use std::io;

use firmware_core::{
    controller::ChannelSource, inner::LimitedBy, shield::Intervention, time::Instant,
};
use serde::Serialize;

use crate::record::{FlightRecord, SlotRecord};

/// A row. The field names are the column names.
#[derive(Serialize)]
pub(crate) struct Row {
    slot: u32,
    planned_east_m: f64,
    planned_north_m: f64,
    flown_east_m: f64,
    flown_north_m: f64,
    vehicle_time_s: f64,
    extrapolated: bool,
    served_user: Option<usize>,
    user_power_w: f64,
    sensor_power_mean_w: f64,
    normalizing_factor: f64,
    rate_bit_s_hz: f64,
    mse: f64,
    mse_threshold: f64,
    limited_by: LimitedBy,
    feasible: bool,
    shield: String,
    channel_source: ChannelSource,
    age_slots: u32,
    empirical_mse: f64,
    symbols: u32,
    true_value: f64,
    estimate: f64,
    error: f64,
    plan_us: f64,
    allocate_us: f64,
}

/// What is added to a row where the world is not known exactly.
#[derive(Serialize)]
pub(crate) struct Knowledge {
    perfect_rate_bit_s_hz: Option<f64>,
    empirical_mse_standard_error: f64,
    at_error_floor: bool,
}

/// Returns the contents of the file.
pub(super) fn csv(record: &FlightRecord) -> io::Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for slot in &record.slots {
        let row = row(record, slot);
        let written = match knowledge(record, slot) {
            None => writer.serialize(row),
            Some(knowledge) => writer.serialize((row, knowledge)),
        };
        written.map_err(io::Error::from)?;
    }
    writer
        .into_inner()
        .map_err(|error| io::Error::other(error.to_string()))
}

/// Returns what is added to the row of a slot, where the world is not known exactly.
pub(crate) fn knowledge(record: &FlightRecord, slot: &SlotRecord) -> Option<Knowledge> {
    (!record.scenario.uncertainty.is_none()).then_some(Knowledge {
        perfect_rate_bit_s_hz: slot.perfect_rate,
        empirical_mse_standard_error: slot.signals.standard_error,
        at_error_floor: slot.at_error_floor,
    })
}

/// Returns the row of a slot.
pub(crate) fn row(record: &FlightRecord, slot: &SlotRecord) -> Row {
    Row {
        slot: slot.slot,
        planned_east_m: slot.planned.x,
        planned_north_m: slot.planned.y,
        flown_east_m: slot.flown.x,
        flown_north_m: slot.flown.y,
        vehicle_time_s: slot.tick.time.duration_since(Instant::ZERO).as_secs_f64(),
        extrapolated: slot.tick.extrapolated,
        served_user: slot.served_user,
        user_power_w: slot.user_power_w,
        sensor_power_mean_w: slot.sensor_power_mean_w,
        normalizing_factor: slot.normalizing_factor,
        rate_bit_s_hz: slot.rate,
        mse: slot.mse,
        mse_threshold: record
            .timeline()
            .in_slot(slot.slot)
            .parameters()
            .mse_threshold,
        limited_by: slot.limited_by,
        feasible: slot.feasible,
        shield: shield(&slot.intervention),
        channel_source: slot.channel_source,
        age_slots: slot.age_slots,
        empirical_mse: slot.signals.empirical_mse,
        symbols: slot.signals.symbols,
        true_value: slot.signals.true_value,
        estimate: slot.signals.estimate,
        error: slot.signals.error(),
        plan_us: slot.plan_us,
        allocate_us: slot.allocate_us,
    }
}

/// Returns the changes of the shield: `none`, or their names joined by `+`.
pub(super) fn shield(intervention: &Intervention) -> String {
    let changes = [
        (intervention.displacement, "displacement"),
        (intervention.user, "user"),
        (intervention.broken_output, "broken_output"),
        (intervention.out_of_reach, "out_of_reach"),
    ];
    let names: Vec<&str> = changes
        .into_iter()
        .filter_map(|(changed, name)| changed.then_some(name))
        .collect();
    match names.is_empty() {
        true => "none".into(),
        false => names.join("+"),
    }
}

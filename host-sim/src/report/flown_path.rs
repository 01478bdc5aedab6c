//! The flown path on the map, and which part of it belongs to each slot.

use super::ground::Ground;
use crate::record::{FlightRecord, PathSample};
use figures::{
    markup::{Element, PathData, element},
    theme,
};

/// Draws the flown path: an outline that contrasts with the background, and on it one segment per
/// slot in the colour of its rate.
pub(super) fn draw(record: &FlightRecord, ground: &Ground) -> Element {
    let pieces = pieces(record, ground);
    let whole = pieces.iter().flatten().copied();
    let limit = record.scenario.mission.slot_rate_limit();
    let mut group = element("g").with(PathData::through(whole).path("casing"));
    for (piece, slot) in pieces.iter().zip(&record.slots) {
        let piece = PathData::through(piece.iter().copied()).path("flown");
        group.push(piece.set("stroke", theme::viridis(slot.rate / limit)));
    }
    group
}

/// Returns the positions of the vehicle in each slot in coordinates of the drawing. Each slot begins
/// with the last position of the slot before. Samples that are too close together to be
/// distinguished are left out.
fn pieces(record: &FlightRecord, ground: &Ground) -> Vec<Vec<[f64; 2]>> {
    let start = record.scenario.mission.parameters().start;
    let ends = slot_ends(record);
    let first = record.path.first().map_or(start, |sample| sample.position);
    let mut here = ground.of(&first);
    let mut from = 0;
    let mut pieces = Vec::with_capacity(record.slots.len());
    for (slot, end) in record.slots.iter().zip(ends) {
        let mut piece = vec![here];
        for sample in &record.path[from..end] {
            let point = ground.of(&sample.position);
            if (point[0] - here[0]).hypot(point[1] - here[1]) >= 0.75 {
                piece.push(point);
                here = point;
            }
        }
        from = end;
        let end = ground.of(&slot.flown);
        if here != end || piece.len() == 1 {
            piece.push(end);
            here = end;
        }
        pieces.push(piece);
    }
    pieces
}

/// Returns the index of each slot's last sample in the path, which is also the first sample of the
/// next slot. A slot lasts `delta` plus the duration of the exchange of channel state, which the
/// record does not contain. Its last sample is therefore the one nearest to the position at the
/// slot's end; of several such samples, as in hovering flight, the one nearest to the nominal time.
fn slot_ends(record: &FlightRecord) -> Vec<usize> {
    let p = record.scenario.mission.parameters();
    let path = &record.path;
    let mut from = 0;
    let mut ends = Vec::with_capacity(record.slots.len());
    for slot in &record.slots {
        let nominal_s = path.get(from).map_or(0.0, |sample| sample.time_s) + p.slot_duration_s;
        let latest_s = nominal_s + 3.0 * p.slot_duration_s;
        // A time error of 1 % of a slot counts as much as a distance of 0.02 % of its reach.
        let late_mps = 0.02 * p.max_speed_mps;
        let misfit_m = |sample: &PathSample| {
            (sample.position - slot.flown).norm() + late_mps * (sample.time_s - nominal_s).abs()
        };
        let candidates = path.iter().enumerate().skip(from);
        from = candidates
            .take_while(|(_, sample)| sample.time_s <= latest_s)
            .map(|(index, sample)| (index, misfit_m(sample)))
            .min_by(|(_, a), (_, b)| a.total_cmp(b))
            .map_or(from, |(index, _)| index);
        ends.push(from);
    }
    ends
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::fixture;

    #[test]
    fn slots_end_where_they_ended_however_long_they_took() {
        let mut record = fixture::separated();
        // Hover through slots 21 to 30, and let every slot take a tenth longer than it should.
        let place = record.slots[19].flown;
        for slot in &mut record.slots[20..30] {
            slot.flown = place;
        }
        let start = record.scenario.mission.parameters().start;
        let mut samples = vec![(0.0, start)];
        let mut from = start;
        for slot in &record.slots {
            for step in 1..=11 {
                // The last tenth is spent waiting for channel state.
                let share = (f64::from(step) / 10.0).min(1.0);
                let time_s = 1.1 * f64::from(slot.slot - 1) + 0.1 * f64::from(step);
                samples.push((time_s, from + (slot.flown - from) * share));
            }
            from = slot.flown;
        }
        record.path = samples
            .into_iter()
            .map(|(time_s, position)| PathSample {
                time_s,
                position,
                altitude_m: 100.0,
            })
            .collect();
        let ends = slot_ends(&record);
        assert_eq!(ends.len(), record.slots.len());
        for (slot, end) in record.slots.iter().zip(ends) {
            let away_m = (record.path[end].position - slot.flown).norm();
            assert!(away_m < 1e-9, "slot {} ends {away_m} m away", slot.slot);
        }
    }
}

//! Verdicts on the paper's claims about single flights.

use firmware_core::Position;

use super::{DataRow, SlotRow, data_of, flight_of, flights};
use crate::experiment::{
    Experiment,
    approach::Approach,
    cell::{Cell, MSE_THRESHOLDS, Preset, Topology},
    claims::{Claim, Tally, Verdict, range},
    statistics,
};

/// Returns the mean over slots and places of the distance between them, metres.
fn mean_distance_m(flight: &[&SlotRow], places: &[Position<f64>]) -> f64 {
    let each = flight.iter().flat_map(|row| {
        let here = Position::new(row.east_m, row.north_m);
        places.iter().map(move |place| (here - place).norm())
    });
    statistics::mean(&each.collect::<Vec<_>>())
}

/// Returns the claims about fig:topo1 and fig:topo2.
pub(in crate::experiment) fn claims_of_thresholds(
    experiment: Experiment,
    rows: &[SlotRow],
) -> Result<Vec<Claim>, String> {
    let flights = flights(experiment);
    let Some(&(first, _)) = flights.first() else {
        return Ok(Vec::new());
    };
    let scenario = first.scenario()?;
    let p = scenario.mission.parameters();
    let to_all = |places: &[Position<f64>]| -> Vec<f64> {
        let each = flights
            .iter()
            .map(|&(cell, approach)| mean_distance_m(&flight_of(rows, cell, approach), places));
        each.collect()
    };
    let (sensors_m, users_m) = (to_all(&p.sensors), to_all(&p.users));
    let (mut away, mut towards) = <(Tally, Tally)>::default();
    for index in 1..flights.len() {
        away.add_above(sensors_m[index], sensors_m[index - 1]);
        towards.add_above(users_m[index - 1], users_m[index]);
    }
    let list = |values: &[f64]| -> String {
        let each = values.iter().map(|value| format!("{value:.0}"));
        each.collect::<Vec<_>>().join(", ")
    };
    let reason = "At -95 dBm most of the area meets the threshold with the sensors' power, so the \
                  rate is limited by the accuracy over the users as well, and SAC has little to \
                  gain near the sensors.";
    let mut claims = vec![Claim::new(
        "The tighter the threshold, the nearer the path to the sensors.",
        away.verdict(),
        format!(
            "Mean distance to the sensors from the tightest to the loosest threshold: {} m.",
            list(&sensors_m)
        ),
        reason,
    )];
    claims.push(match experiment {
        Experiment::TrajectoriesSeparated => Claim::new(
            "The looser the threshold, the nearer the path to the users.",
            towards.verdict(),
            format!("Mean distance to the users: {} m.", list(&users_m)),
            "",
        ),
        _ => Claim::new(
            "With a loose threshold the path keeps a certain distance from the sensors.",
            Verdict::of(usize::from(sensors_m.last() > sensors_m.first()), 1),
            format!(
                "Mean distance to the sensors at 0.025 against 0.010: {:.0} m more.",
                sensors_m.last().unwrap_or(&f64::NAN) - sensors_m.first().unwrap_or(&f64::NAN)
            ),
            reason,
        ),
    });
    Ok(claims)
}

/// Returns the claims about fig:topo_ddpg, one for each preset.
pub(in crate::experiment) fn claims_of_approaches(rows: &[SlotRow]) -> Vec<Claim> {
    Preset::ALL.map(|preset| similar_paths(rows, preset)).into()
}

fn similar_paths(rows: &[SlotRow], preset: Preset) -> Claim {
    let (sac_approach, ddpg_approach) = (Approach::sac(preset), Approach::ddpg(preset));
    let mut similar = Tally::default();
    let (mut to_ddpg, mut to_line) = (Vec::new(), Vec::new());
    for topology in Topology::ALL {
        let tight = Cell::table_one(topology).at_threshold(MSE_THRESHOLDS[0]);
        let line = flight_of(rows, tight, Approach::StraightLine);
        for threshold in [MSE_THRESHOLDS[0], MSE_THRESHOLDS[3]] {
            let cell = tight.at_threshold(threshold);
            let sac = flight_of(rows, cell, sac_approach);
            let ddpg = flight_of(rows, cell, ddpg_approach);
            similar.add_above(apart_m(&sac, &line), apart_m(&sac, &ddpg));
            to_ddpg.push(apart_m(&sac, &ddpg));
            to_line.push(apart_m(&sac, &line));
        }
    }
    let (ddpg, line) = (range(to_ddpg), range(to_line));
    Claim::new(
        format!(
            "DDPG's paths are similar to SAC's, unlike the straight line: {} against {}, seed 1.",
            ddpg_approach.title(),
            sac_approach.title()
        ),
        similar.verdict(),
        format!(
            "Mean distance from a place of SAC's path to the nearest of DDPG's: {:.0} to {:.0} m; \
             of the straight line: {:.0} to {:.0} m. DDPG's is the nearer one in {similar} cases.",
            ddpg.0, ddpg.1, line.0, line.1
        ),
        "",
    )
}

/// Returns the mean over one path of the distance to the nearest point of the other path, metres.
fn apart_m(path: &[&SlotRow], other: &[&SlotRow]) -> f64 {
    let each = path.iter().map(|here| {
        let away = other
            .iter()
            .map(|there| (here.east_m - there.east_m).hypot(here.north_m - there.north_m));
        away.fold(f64::INFINITY, f64::min)
    });
    statistics::mean(&each.collect::<Vec<_>>())
}

/// Returns the claims about fig:access.
pub(in crate::experiment) fn claims_of_schedule(rows: &[SlotRow]) -> Vec<Claim> {
    let (mut near, mut ranks, mut nearest) = (Tally::default(), Vec::new(), Vec::new());
    let (mut often, mut chances) = (Tally::default(), Vec::new());
    for (cell, approach) in flights(Experiment::Schedule) {
        let flight = flight_of(rows, cell, approach);
        // If only one user is left, there is no choice.
        let choices: Vec<&&SlotRow> = flight.iter().filter(|row| row.open_users > 1).collect();
        let place = |row: &&&SlotRow| row.nearer_users as f64 / (row.open_users - 1) as f64;
        let rank = statistics::mean(&choices.iter().map(place).collect::<Vec<_>>());
        near.add_above(0.25, rank);
        ranks.push(100.0 * rank);
        let first = choices.iter().filter(|row| row.nearer_users == 0).count();
        let share = first as f64 / choices.len() as f64;
        let even = choices.iter().map(|row| 1.0 / row.open_users as f64);
        let chance = statistics::mean(&even.collect::<Vec<_>>());
        often.add_above(share, chance);
        nearest.push(100.0 * share);
        chances.push(100.0 * chance);
    }
    let (ranks, nearest, chances) = (range(ranks), range(nearest), range(chances));
    vec![Claim::new(
        "The vehicle tends to serve users near to it first.",
        (near + often).verdict(),
        format!(
            "Of the other users that had not had their slots yet, {:.0} to {:.0} % were nearer than \
             the one served, by flight (chance: 50 %); less than 25 % in {near} flights. The \
             nearest was served in {:.0} to {:.0} % of the slots (chance: {:.0} to {:.0} %).",
            ranks.0, ranks.1, nearest.0, nearest.1, chances.0, chances.1
        ),
        "Where the accuracy limits the rate, the nearest user's rate is no higher than that of \
         the next ones, and serving a user that the vehicle leaves behind avoids a return flight.",
    )]
}

/// Returns the claims about fig:data.
pub(in crate::experiment) fn claims_of_data(rows: &[DataRow]) -> Vec<Claim> {
    let (mut rising, mut even) = <(Tally, Tally)>::default();
    let mut spreads = Vec::new();
    for topology in Topology::ALL {
        let mut before = 0.0;
        for threshold in MSE_THRESHOLDS {
            let data = data_of(rows, topology, threshold);
            let data: Vec<f64> = data.iter().map(|row| row.data).collect();
            let sum = data.iter().sum::<f64>();
            if before > 0.0 {
                rising.add_above(sum, before);
            }
            before = sum;
            let spread =
                100.0 * statistics::deviation(&data).unwrap_or(f64::NAN) / statistics::mean(&data);
            even.add_above(15.0, spread);
            spreads.push(spread);
        }
    }
    let (least, most) = range(spreads);
    vec![
        Claim::new(
            "What users send grows with the threshold.",
            rising.verdict(),
            format!("The sum rises in {rising} steps."),
            "",
        ),
        Claim::new(
            "At one threshold users differ little in what they send.",
            even.verdict(),
            format!(
                "Standard deviation over the users: {least:.1} to {most:.1} % of the mean; at most \
                 15 % in {even} cells."
            ),
            "Fairness counts slots, not data: users that are served on the way to and from the \
             favourable positions send less.",
        ),
    ]
}

//! Whole flights over a link that loses, duplicates, reorders and damages frames.

mod flight;

use firmware_core::Position;
use firmware_core::autopilot::Phase;
use firmware_core::time::Duration;
use flight::{Flight, SLOT, start};
use link::lossy::Faults;
use vehicle::Profile;

struct Outcome {
    /// The number of legs whose end was not confirmed in time.
    late: u32,
    /// The largest distance of the true position from the waypoint over confirmed legs, m.
    worst_m: f64,
    /// The largest distance of the measured position from the true one, m.
    mistaken_m: f64,
}

const LEGS: u32 = 12;

fn fly(faults: &Faults, seed: u64) -> Outcome {
    let settings = flight::settings(Profile::Ideal);
    let mut flight = Flight::new(settings, flight::vehicle(Profile::Ideal));
    flight.degrade(faults, seed);
    flight.client.launch(flight.now);
    flight.run_until_phase(Phase::Ready, Duration::from_secs(120));
    let begin = flight.now;
    let mut outcome = Outcome {
        late: 0,
        worst_m: 0.0,
        mistaken_m: 0.0,
    };
    for n in 0..LEGS {
        let angle = f64::from(n) * 0.9;
        let waypoint = start() + 25.0 * nalgebra::Vector2::new(angle.cos(), angle.sin());
        let ended = flight.fly_leg(waypoint, begin + SLOT * (n + 1));
        let truth = flight.vehicle.true_position();
        if ended.tick.extrapolated {
            outcome.late += 1;
        } else {
            outcome.worst_m = outcome.worst_m.max(distance(truth, waypoint));
            outcome.mistaken_m = outcome
                .mistaken_m
                .max(distance(truth, ended.sample.position));
        }
    }
    flight.client.land(flight.now);
    flight.run_until_phase(Phase::Landed, Duration::from_secs(120));
    assert_eq!(
        flight.client.fault(),
        None,
        "seed {seed}: {:#?}",
        flight.log
    );
    assert!(!flight.vehicle.armed(), "seed {seed}");
    assert_eq!(flight.vehicle.altitude_m(), 0.0, "seed {seed}");
    outcome
}

fn distance(a: Position<f64>, b: Position<f64>) -> f64 {
    (a - b).norm()
}

#[test]
fn a_thousand_flights_over_a_bad_link_all_end_well() {
    let faults = Faults {
        loss: 0.2,
        duplication: 0.05,
        reordering: 0.05,
        reordering_delay: Duration::from_millis(120),
        corruption: 0.01,
        ..Faults::default()
    };
    let outcomes: Vec<Outcome> = (0..1_000).map(|seed| fly(&faults, seed)).collect();
    let late: u32 = outcomes.iter().map(|o| o.late).sum();
    let worst = outcomes.iter().map(|o| o.worst_m).fold(0.0, f64::max);
    let mistaken = outcomes.iter().map(|o| o.mistaken_m).fold(0.0, f64::max);
    println!(
        "late {late} of {}, worst {worst:.4} m, mistaken {mistaken:.4} m",
        1_000 * LEGS
    );
    // A reordered older setpoint can pull an ideal vehicle back for a moment.
    assert!(
        late < 1_000 * LEGS / 50,
        "{late} legs were not confirmed in time"
    );
    assert!(mistaken < 10.0, "{mistaken}");
}

/// The outcome over the loss rate, as a table: the outcome degrades slowly.
#[test]
fn legs_are_confirmed_in_time_while_the_loss_is_bearable() {
    let mut table = Vec::new();
    for percent in [0, 5, 10, 20, 30] {
        let faults = Faults {
            loss: f64::from(percent) / 100.0,
            ..Faults::default()
        };
        let late: u32 = (0..20).map(|seed| fly(&faults, seed).late).sum();
        table.push((percent, late));
    }
    assert_eq!(table[0], (0, 0));
    assert!(table[3].1 <= 20 * LEGS / 50, "{table:?}");
    assert!(table[4].1 <= 20 * LEGS / 5, "{table:?}");
}

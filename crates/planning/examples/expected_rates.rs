//! Does it matter under fading that a plan counts with the rates at mean gains?
//!
//! ```console
//! cargo run --release -p planning --example expected_rates [SCENARIO]
//! ```
//!
//! For each Rician factor `K` the rates of all users over a grid of places are computed at the mean
//! gains and as means over draws of all gains. A plan compares places, so a common factor between the
//! two maps changes nothing. Printed are this factor and what a plan can lose: for each user, the
//! expected rate at the place with the highest rate at mean gains, below that at the best place.

use std::error::Error;

use firmware_core::{
    Position, PowerGain,
    channel::GroundNode,
    inner::{SlotLimits, Workspace},
};
use nalgebra::Complex;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use scenario::{HostMission, Scenario};

/// Places along each side of the area.
const SIDE: usize = 17;
/// Draws of all gains at a place.
const DRAWS: usize = 200;
/// Rician factors, dB.
const FACTORS_DB: [f64; 3] = [10.0, 5.0, 0.0];

/// Returns `|h|^2` of unit mean with a direct path of `K` times the power of the scattered ones.
fn fading(factor: f64, random: &mut Pcg64) -> f64 {
    let mut part = || -> f64 { StandardNormal.sample(random) };
    let scattered = Complex::new(part(), part()) * (0.5 / (factor + 1.0)).sqrt();
    (scattered + (factor / (factor + 1.0)).sqrt()).norm_sqr()
}

/// Returns the rate of every user, bit/s/Hz, with the vehicle over `place`, each gain times a factor.
fn rates(
    mission: &HostMission,
    place: &Position<f64>,
    mut factor: impl FnMut() -> f64,
) -> Result<Vec<f64>, Box<dyn Error>> {
    let mut gain = |node| PowerGain(mission.power_gain(node, place).0 * factor());
    let sensors: Vec<_> = (0..mission.sensor_count())
        .map(|sensor| gain(GroundNode::Sensor(sensor)))
        .collect();
    let users: Vec<_> = (0..mission.user_count())
        .map(|user| gain(GroundNode::User(user)))
        .collect();
    let mut workspace = Workspace::<f64, { firmware_core::SENSORS_MAX }>::default();
    let field = workspace.sensors(&SlotLimits::of_mission(mission), &sensors)?;
    let rate = |gain: PowerGain<f64>| {
        if field.is_feasible() {
            field.rate(gain)
        } else {
            0.0
        }
    };
    Ok(users.into_iter().map(rate).collect())
}

fn main() -> Result<(), Box<dyn Error>> {
    let name = std::env::args()
        .nth(1)
        .unwrap_or_else(|| "separated".into());
    let mission = Scenario::named(name.as_ref())?.mission;
    let area = mission.parameters().area;
    let step = |index: usize| (index as f64 + 0.5) / SIDE as f64;
    let places: Vec<_> = (0..SIDE * SIDE)
        .map(|index| {
            let (column, row) = (index % SIDE, index / SIDE);
            Position::new(area.east_m * step(column), area.north_m * step(row))
        })
        .collect();
    let at_mean = (places.iter())
        .map(|place| rates(&mission, place, || 1.0))
        .collect::<Result<Vec<_>, _>>()?;
    println!(
        "K, dB | expected over rate at mean gains | lost by the choice of places: mean, worst"
    );
    for factor_db in FACTORS_DB {
        let factor = 10_f64.powf(factor_db / 10.0);
        let mut random = Pcg64::seed_from_u64(1);
        let mut expected = vec![vec![0.0; mission.user_count()]; places.len()];
        for (place, means) in places.iter().zip(&mut expected) {
            for _ in 0..DRAWS {
                let drawn = rates(&mission, place, || fading(factor, &mut random))?;
                for (mean, rate) in means.iter_mut().zip(drawn) {
                    *mean += rate / DRAWS as f64;
                }
            }
        }
        let sum = |map: &[Vec<f64>]| map.iter().flatten().sum::<f64>();
        let ratio = sum(&expected) / sum(&at_mean);
        let losses: Vec<f64> = (0..mission.user_count())
            .map(|user| {
                let best_of = |map: &[Vec<f64>]| {
                    (0..places.len()).max_by(|&a, &b| map[a][user].total_cmp(&map[b][user]))
                };
                let chosen = best_of(&at_mean).map_or(0.0, |place| expected[place][user]);
                let best = best_of(&expected).map_or(0.0, |place| expected[place][user]);
                1.0 - chosen / best
            })
            .collect();
        let mean = losses.iter().sum::<f64>() / losses.len() as f64;
        let worst = losses.iter().copied().fold(0.0, f64::max);
        println!(
            "{factor_db:5} | {ratio:.3} | {:.1} %, {:.1} %",
            100.0 * mean,
            100.0 * worst
        );
    }
    Ok(())
}

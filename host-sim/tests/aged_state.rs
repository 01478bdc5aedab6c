//! The cost of missing channel states: the default mission with lost states, as a table that
//! `docs/link-protocol.md` contains.

use firmware_core::{
    aircomp,
    controller::{ChannelSource, ChannelState, Controller},
    policy::StraightLine,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use scenario::Scenario;

/// A mission in which each state is lost with this probability.
struct Row {
    lost: f64,
    sum_rate: f64,
    aged: u32,
    silent: u32,
    oldest: u32,
}

fn fly(lost: f64, seed: u64) -> Row {
    let mission = Scenario::shipped("separated").expect("shipped").mission;
    let p = mission.parameters();
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut controller = Controller::new(mission.clone(), StraightLine::new(&mission));
    let mut here = p.start;
    let (mut sum_rate, mut aged, mut silent, mut oldest) = (0.0, 0, 0, 0);
    while let Ok(plan) = controller.plan(here) {
        here = plan.waypoint;
        let state = ChannelState::predicted(&mission, plan.slot, &here);
        let command = if random.random_bool(lost) {
            controller.allocate_predicted(&here)
        } else {
            controller.allocate(&state)
        };
        let command = command.expect("under way");
        let user_gain = command.served_user.map(|user| state.user_gains[user]);
        let slot = aircomp::Slot {
            sensor_gains: &state.sensor_gains,
            sensor_coefficients: &command.sensor_coefficients,
            user_gain: user_gain.unwrap_or_default(),
            user_power: command.user_power,
            noise_power: p.noise_power,
        };
        let mse = slot.mse(command.normalizing_factor);
        if command.status.is_feasible() {
            assert!(mse <= p.mse_threshold * (1.0 + 1e-9), "{mse} {command:?}");
        } else {
            silent += 1;
        }
        aged += u32::from(command.source == ChannelSource::Predicted);
        oldest = oldest.max(command.age_slots);
        sum_rate += slot.rate();
    }
    assert!(mission.has_arrived(&here) && controller.fairness().is_fair());
    Row {
        lost,
        sum_rate,
        aged,
        silent,
        oldest,
    }
}

#[test]
fn lost_states_cost_rate_and_never_accuracy() {
    let rows = [0.0, 0.1, 0.3, 0.5, 0.9, 1.0].map(|lost| fly(lost, 41));
    let mut table = String::from(
        "| states lost | slots on aged state | oldest | without a guarantee | total rate |\n\
         |---|---|---|---|---|\n",
    );
    for row in &rows {
        table += &format!(
            "| {:.0} % | {} | {} slots | {} | {:.1} % |\n",
            row.lost * 100.0,
            row.aged,
            row.oldest,
            row.silent,
            100.0 * row.sum_rate / rows[0].sum_rate
        );
    }
    println!("{table}");
    let page = include_str!("../../docs/link-protocol.md");
    assert!(
        page.contains(&table),
        "docs/link-protocol.md has another table than\n{table}"
    );
    let share = |index: usize| rows[index].sum_rate / rows[0].sum_rate;
    assert_eq!((rows[0].aged, rows[0].silent), (0, 0));
    // States that are lost now and then cost little; the loss of all states costs nearly the whole
    // rate.
    assert!(share(1) > 0.95, "{}", share(1));
    assert!(share(3) > 0.6, "{}", share(3));
    assert!(
        rows.windows(2)
            .all(|pair| pair[1].sum_rate <= pair[0].sum_rate * 1.02)
    );
}

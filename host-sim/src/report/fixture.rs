//! Flights without a simulator, for tests: the onboard controller with the scenario's channel model,
//! a vehicle that reaches every waypoint, and errors drawn with their theoretical variance.

use firmware_core::{
    controller::{ChannelState, Controller},
    policy::StraightLine,
    time::Tick,
};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::record::{
    FlightNotes, FlightRecord, FlightTimes, LinkRecord, PathSample, SignalRecord, SlotRecord,
};
use scenario::{Events, Scenario};

const SYMBOLS: u32 = 334;

/// Returns the record of a flight of the policy `straight-line`.
pub(crate) fn straight_line(scenario: Scenario, seed: u64) -> FlightRecord {
    let mission = scenario.mission.clone();
    let p = mission.parameters();
    let mut controller = Controller::new(mission.clone(), StraightLine::new(&mission));
    let mut random = Pcg64::seed_from_u64(seed);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut random) };
    let mut here = p.start;
    let mut slots = Vec::new();
    let mut path = vec![PathSample {
        time_s: 0.0,
        position: here,
        altitude_m: p.altitude_m,
    }];
    while !controller.is_over() {
        let plan = controller.plan(here).expect("at rest");
        here = plan.waypoint;
        let state = ChannelState::predicted(&mission, plan.slot, &here);
        let command = controller.allocate(&state).expect("under way");
        let powers = command.sensor_coefficients.iter().map(|b| b * b);
        let true_value = 21.0 + 2.0 * (0.07 * f64::from(plan.slot)).sin();
        slots.push(SlotRecord {
            slot: plan.slot,
            planned: plan.waypoint,
            flown: here,
            tick: Tick::default(),
            served_user: command.served_user,
            user_power_w: command.user_power.0,
            normalizing_factor: command.normalizing_factor,
            sensor_power_mean_w: powers.sum::<f64>() / mission.sensor_count() as f64,
            rate: command.rate,
            planned_rate: command.rate,
            mse: command.mse,
            perfect_rate: None,
            limited_by: command.status.limited_by(),
            feasible: command.status.is_feasible(),
            at_error_floor: false,
            intervention: plan.intervention,
            channel_source: command.source,
            age_slots: command.age_slots,
            signals: SignalRecord {
                empirical_mse: command.mse * (1.0 + normal() / f64::from(SYMBOLS).sqrt()),
                standard_error: command.mse / f64::from(SYMBOLS).sqrt(),
                symbols: SYMBOLS,
                true_value,
                estimate: true_value + 4.0 * command.mse.sqrt() * normal(),
            },
            plan_us: 2.0,
            allocate_us: 1.0,
        });
        path.push(PathSample {
            time_s: f64::from(plan.slot) * p.slot_duration_s,
            position: here,
            altitude_m: p.altitude_m,
        });
    }
    FlightRecord {
        scenario,
        policy: "straight-line".into(),
        inner: "exact".into(),
        profile: "ideal".into(),
        seed,
        slots,
        path,
        link: LinkRecord::default(),
        changes: Events::default(),
        ignores_errors: false,
        events: Vec::new(),
        times: FlightTimes {
            slots_s: (1..=p.slots)
                .map(|slot| f64::from(slot) * p.slot_duration_s)
                .collect(),
            ..FlightTimes::default()
        },
        completed: true,
        ended: "landed".into(),
        notes: FlightNotes::default(),
    }
}

/// Returns the record of the default mission.
pub(crate) fn separated() -> FlightRecord {
    straight_line(Scenario::shipped("separated").expect("shipped"), 1)
}

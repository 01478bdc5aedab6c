use firmware_core::{
    Position, PowerGain, Watt,
    controller::{Controller, SensorQuality, UserQuality},
    link::{FRAME_MAX, encode},
    mission::{Area, Environment, ExcessLoss, MissionParameters, RadioModel},
    policy::StraightLine,
    time::Tick,
};

use super::*;

/// The capacities are those of the mission.
const USERS: usize = 2;
const SENSORS: usize = 3;

type TestMessage = Message<f32, USERS, SENSORS>;

/// A correct vehicle of three slots, and the auditor of its link.
struct Bench {
    auditor: LinkAuditor<f32, USERS, SENSORS>,
    controller: Controller<f32, StraightLine<f32, USERS>, USERS, SENSORS>,
    vehicle: Decoder,
}

impl Bench {
    fn new() -> Self {
        let users = [Position::new(20.0, 180.0), Position::new(60.0, 190.0)];
        let sensors = [150.0, 170.0, 190.0].map(|x| Position::new(x, 40.0));
        let mission = Mission::new(MissionParameters {
            slots: 3,
            slot_duration_s: 1.0,
            start: Position::new(100.0, 100.0),
            destination: Position::new(110.0, 100.0),
            area: Area {
                east_m: 200.0,
                north_m: 200.0,
            },
            altitude_m: 50.0,
            max_speed_mps: 10.0,
            carrier_hz: 2e9,
            radio_model: RadioModel::ProbabilisticLos,
            environment: Environment { a: 9.613, b: 0.158 },
            excess_loss_db: ExcessLoss {
                los: 1.0,
                nlos: 20.0,
            },
            noise_power: Watt::from_dbm(-95.0),
            mse_threshold: 0.1,
            user_power_max: Watt(0.2),
            sensor_power_max: Watt(0.05),
            users: users.into_iter().collect(),
            sensors: sensors.into_iter().collect(),
        });
        let mission = mission.unwrap_or_else(|error| panic!("{error}"));
        Self {
            auditor: LinkAuditor::new(mission.clone()),
            controller: Controller::new(mission.clone(), StraightLine::new(&mission)),
            vehicle: Decoder::new(),
        }
    }

    fn say(&mut self, message: &TestMessage) -> Result<(), Violation<f32>> {
        let mut frame = [0; FRAME_MAX];
        let frame = encode(message, &mut frame).expect("fits");
        self.auditor.from_vehicle(frame).map(|_| ())
    }

    fn hear(&mut self, message: &TestMessage) {
        let mut frame = [0; FRAME_MAX];
        let frame = encode(message, &mut frame).expect("fits");
        self.auditor.to_vehicle(frame);
        for &byte in frame {
            let _ = self.vehicle.push::<f32, USERS, SENSORS>(byte);
        }
    }

    /// Plans the next slot and returns its arrival.
    fn arrival(&mut self) -> Arrival<f32> {
        let place = self.controller.mission().parameters().start;
        let plan = self.controller.plan(place).expect("a plan");
        Arrival {
            plan,
            position: plan.waypoint,
            tick: Tick::default(),
        }
    }

    fn state(&self, arrival: &Arrival<f32>) -> ChannelState<f32, USERS, SENSORS> {
        let mission = self.controller.mission();
        ChannelState::predicted(mission, arrival.plan.slot, &arrival.position)
    }

    /// Flies slot 1 up to its command, which is from a state with one rejected gain and one sensor
    /// that is not heard.
    fn command(&mut self) -> SlotCommand<f32, SENSORS> {
        let arrival = self.arrival();
        self.say(&Message::Arrival(arrival)).expect("in turn");
        let mut state = self.state(&arrival);
        state.user_gains[0] = PowerGain(f32::NAN);
        state.sensor_gains[1] = PowerGain(0.0);
        self.hear(&Message::ChannelState(state.clone()));
        self.controller.allocate(&state).expect("under way")
    }

    fn status(&self) -> VehicleStatus {
        let mut status = self.auditor.expected();
        status.link = *self.vehicle.counters();
        status
    }
}

#[test]
fn a_correct_vehicle_keeps_the_rules() {
    let mut bench = Bench::new();
    let command = bench.command();
    assert_eq!((command.rejected_gains, command.unheard_sensors), (1, 1));
    bench.say(&Message::Command(command)).unwrap();
    bench.say(&Message::Status(bench.status())).unwrap();
    // Slot 2 is asked for twice, and its answer is lost.
    let arrival = Message::Arrival(bench.arrival());
    bench.say(&arrival).unwrap();
    bench.say(&arrival).unwrap();
    let place = bench.controller.mission().parameters().start;
    let aged = bench.controller.allocate_predicted(&place).unwrap();
    bench.say(&Message::Command(aged)).unwrap();
    let status = bench.status();
    bench.say(&Message::Status(status)).unwrap();
    let slots = status.slots;
    assert_eq!(
        (slots.measured, slots.stale, slots.arrivals_repeated),
        (1, 1, 1)
    );
    assert_eq!((status.slots_done, status.link.messages), (2, 1));
}

#[test]
fn what_the_ground_sends_is_counted_once() {
    let mut bench = Bench::new();
    bench.hear(&Message::Status(VehicleStatus::default()));
    let arrival = bench.arrival();
    let good = bench.state(&arrival);
    // Before the arrival no state is awaited.
    bench.hear(&Message::ChannelState(good.clone()));
    bench.say(&Message::Arrival(arrival)).unwrap();
    let mut state = good.clone();
    state.slot = 2;
    bench.hear(&Message::ChannelState(state));
    let mut state = good.clone();
    state.sensor_gains.pop();
    bench.hear(&Message::ChannelState(state));
    bench.hear(&Message::ChannelState(good.clone()));
    bench.hear(&Message::ChannelState(good));
    // Qualities: one that is taken, one of a slot to come, one that is too short.
    for (slot, users) in [(1, USERS), (2, USERS), (1, USERS - 1)] {
        bench.hear(&Message::Quality(ChannelQuality {
            slot,
            users: (0..users).map(|_| UserQuality::default()).collect(),
            sensors: (0..SENSORS).map(|_| SensorQuality::default()).collect(),
        }));
    }
    // A piece that is not a frame, and one that is not complete.
    for &byte in &[0, 7, 7, 0, 0, 9] {
        bench.auditor.to_vehicle(&[byte]);
        let _ = bench.vehicle.push::<f32, USERS, SENSORS>(byte);
    }
    let status = bench.status();
    bench.say(&Message::Status(status)).unwrap();
    let slots = status.slots;
    assert_eq!((slots.echoes, slots.states_out_of_turn), (1, 4));
    assert_eq!((slots.states_of_wrong_size, slots.measured), (2, 0));
    assert_eq!((status.link.messages, status.link.dropped()), (9, 1));
}

#[test]
fn each_broken_rule_is_a_violation() {
    type Command = SlotCommand<f32, SENSORS>;
    let broken = |change: fn(&mut Command)| {
        let mut bench = Bench::new();
        let mut command = bench.command();
        change(&mut command);
        let broken = bench.say(&Message::Command(command));
        broken.expect_err("a broken rule")
    };
    use Violation as V;
    assert!(matches!(broken(|c| c.slot = 2), V::CommandOutOfTurn { .. }));
    assert!(matches!(broken(|c| c.rate = -1.0), V::Command { .. }));
    assert!(matches!(broken(|c| c.age_slots = 1), V::Source { .. }));
    let predicted = broken(|c| c.source = ChannelSource::Predicted);
    assert!(matches!(predicted, V::Source { .. }));
    assert!(matches!(broken(|c| c.rejected_gains = 0), V::Gains { .. }));
    assert!(matches!(broken(|c| c.unheard_sensors = 2), V::Gains { .. }));
    let loud = broken(|c| c.sensor_coefficients[1] = 0.1);
    assert_eq!(loud, V::UnheardSensor { slot: 1, sensor: 1 });
    let deaf = broken(|c| c.served_user = Some(0));
    assert!(matches!(deaf, V::ServedUser { .. }));
    assert!(matches!(broken(|c| c.mse *= 0.9), V::Mse { .. }));

    let mut bench = Bench::new();
    let mut arrival = bench.arrival();
    bench.say(&Message::Arrival(arrival)).unwrap();
    arrival.plan.served_user = 1 - arrival.plan.served_user;
    let other = bench.say(&Message::Arrival(arrival));
    assert!(matches!(other, Err(V::OtherArrival { .. })));
    arrival.plan.slot = 2;
    let early = Bench::new().say(&Message::Arrival(arrival));
    assert_eq!(early, Err(V::Arrival { got: 2, next: 1 }));
    let state = bench.state(&arrival);
    let state = bench.say(&Message::ChannelState(state));
    assert_eq!(state, Err(V::ChannelState { slot: 2 }));
    let quality = ChannelQuality {
        slot: 3,
        ..ChannelQuality::default()
    };
    let quality = bench.say(&Message::Quality(quality));
    assert_eq!(quality, Err(V::Quality { slot: 3 }));
    let mut status = bench.status();
    status.slots.echoes = 1;
    let miscounted = bench.say(&Message::Status(status));
    assert!(matches!(miscounted, Err(V::Counters(_))));
    status.link.checksum = 1;
    let miscounted = bench.say(&Message::Status(status));
    assert!(matches!(miscounted, Err(V::Link { .. })));
    let damaged = bench.auditor.from_vehicle(&[0, 3, 1, 1, 0]);
    assert!(matches!(damaged, Err(V::Frame(_))));
}

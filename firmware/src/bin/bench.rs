//! What the parts of a slot cost, in instructions, over 10,000 slots.
//!
//! Half of the slots are flights of the trained policy over random maps, half are hostile: gains
//! over ten decades, equal, zero, negative, NaN or infinite; policies that ask for anything; a
//! vehicle that is thrown about. Everything is drawn from a fixed seed. One line of JSON per part
//! goes out by semihosting; `cargo xtask firmware bench` runs this under `-icount shift=6`, where
//! an instruction takes 64 ns of the timer's time.
#![no_std]
#![no_main]

use core::cell::Cell;

use cortex_m_semihosting::hprintln;
use firmware::{
    ONE_MISSION_POLICY,
    board::{
        Board,
        mps2::{self, Mps2},
    },
};
use firmware_core::{
    Displacement, Position, PowerGain, SENSORS_MAX, USERS_MAX, Watt,
    autopilot::wire::{self, Address, Encoder, MAX_FRAME},
    console::BoardMission,
    controller::{ChannelState, Controller},
    link::{self, Arrival, Decoder, FRAME_MAX, Message},
    mission::{Area, Environment, ExcessLoss, MissionChange, MissionParameters, RadioModel},
    policy::{Action, MeasuredGains, Observation, PlanQuality, Policy, mlp::Mlp},
    time::{Instant, Tick},
};
use mavlink::dialects::common::{
    LOCAL_POSITION_NED_DATA, MavMessage, SET_POSITION_TARGET_LOCAL_NED_DATA,
};

/// Nanoseconds of an instruction at `-icount shift=6`.
const NANOS_PER_INSTRUCTION: u64 = 64;
const MISSIONS: u32 = 168;
const SLOTS: u32 = 60;
const USERS: usize = 15;
const SENSORS: usize = 36;

type BoardMessage = Message<f32, USERS_MAX, SENSORS_MAX>;
type BoardState = ChannelState<f32, USERS_MAX, SENSORS_MAX>;

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(mut board) = Mps2::take() else {
        unreachable!("the board is taken once");
    };
    let trained = match Mlp::load(ONE_MISSION_POLICY) {
        Ok(policy) => policy,
        Err(error) => board.halt(&error),
    };
    let mut bench = Bench::new(&board, trained);
    for index in 0..MISSIONS {
        bench.fly(index);
    }
    bench.print();
    mps2::succeed()
}

/// PCG-XSH-RR, 64 bits of state.
#[derive(Clone, Debug)]
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u32 {
        let state = self.0;
        self.0 = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let folded = (((state >> 18) ^ state) >> 27) as u32;
        folded.rotate_right((state >> 59) as u32)
    }

    fn below(&mut self, end: u32) -> u32 {
        self.bits() % end
    }

    /// From `low` to `high`.
    fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * (self.bits() >> 8) as f32 / 16_777_216.0
    }

    fn place(&mut self, [west, south, east, north]: [f32; 4]) -> Position<f32> {
        Position::new(self.between(west, east), self.between(south, north))
    }
}

/// The largest and the sum, in cycles of the timer.
#[derive(Clone, Copy, Debug, Default)]
struct Part {
    worst: u32,
    sum: u64,
    count: u32,
}

impl Part {
    fn note(&mut self, cycles: u32) {
        self.worst = self.worst.max(cycles);
        self.sum += u64::from(cycles);
        self.count += 1;
    }

    fn print<B: Board>(&self, name: &str) {
        let instructions =
            |cycles: u64| cycles * u64::from(B::NANOS_PER_CYCLE) / NANOS_PER_INSTRUCTION;
        hprintln!(
            "{{\"part\":\"{}\",\"worst\":{},\"mean\":{},\"count\":{}}}",
            name,
            instructions(self.worst.into()),
            instructions(self.sum) / u64::from(self.count.max(1)),
            self.count
        );
    }
}

/// The trained policy, measured; in hostile missions what it says is replaced by anything.
struct Measured<'b> {
    board: &'b Mps2,
    trained: Mlp<&'static [u8]>,
    wild: Option<Random>,
    /// Of the last decision: the network, and drawing what replaces it, which is no cost of ours.
    cycles: &'b Cell<[u32; 2]>,
}

impl Policy<f32, USERS_MAX> for Measured<'_> {
    fn decide(&mut self, observation: &Observation<'_, f32>) -> Action<f32, USERS_MAX> {
        let begun = self.board.cycles();
        let mut action = self.trained.decide(observation);
        let decided = self.board.cycles();
        if let Some(random) = &mut self.wild {
            let mut component = || match random.below(12) {
                0 => f32::NAN,
                1 => f32::INFINITY,
                2 => 1e30,
                _ => random.between(-60.0, 60.0),
            };
            action.displacement = Displacement::new(component(), component());
            for score in &mut action.user_scores {
                *score = if random.below(200) == 0 {
                    f32::NAN
                } else {
                    random.between(-9.0, 9.0)
                };
            }
        }
        let drawn = self.board.cycles();
        self.cycles
            .set([decided.wrapping_sub(begun), drawn.wrapping_sub(decided)]);
        action
    }

    fn revise(&mut self, change: &MissionChange<f32>, slots_begun: u32) {
        Policy::<f32, USERS_MAX>::revise(&mut self.trained, change, slots_begun);
    }

    fn note_gains(&mut self, measured: &MeasuredGains<'_, f32>) {
        Policy::<f32, USERS_MAX>::note_gains(&mut self.trained, measured);
    }

    fn improve(&mut self, operations: u64) {
        Policy::<f32, USERS_MAX>::improve(&mut self.trained, operations);
    }

    fn quality(&self) -> Option<PlanQuality> {
        Policy::<f32, USERS_MAX>::quality(&self.trained)
    }
}

struct Bench<'b> {
    board: &'b Mps2,
    trained: Mlp<&'static [u8]>,
    random: Random,
    encoder: Encoder,
    decoder: wire::Decoder,
    ground: Decoder,
    decode: Part,
    allocate: Part,
    command: Part,
    network: Part,
    shield: Part,
    plan: Part,
    setpoint: Part,
    telemetry: Part,
    slot: Part,
}

impl<'b> Bench<'b> {
    fn new(board: &'b Mps2, trained: Mlp<&'static [u8]>) -> Self {
        Self {
            board,
            trained,
            random: Random(7),
            encoder: Encoder::new(Address {
                system: 255,
                component: 191,
            }),
            decoder: wire::Decoder::in_order(),
            ground: Decoder::new(),
            decode: Part::default(),
            allocate: Part::default(),
            command: Part::default(),
            network: Part::default(),
            shield: Part::default(),
            plan: Part::default(),
            setpoint: Part::default(),
            telemetry: Part::default(),
            slot: Part::default(),
        }
    }

    /// Table I over a map like the paper's two.
    fn mission(&mut self, index: u32) -> BoardMission {
        const ALL: [f32; 4] = [0.0, 0.0, 1000.0, 1000.0];
        let (users, sensors) = if index.is_multiple_of(4) {
            ([50.0, 550.0, 450.0, 950.0], [550.0, 50.0, 950.0, 450.0])
        } else {
            (ALL, ALL)
        };
        let random = &mut self.random;
        let parameters = MissionParameters {
            slots: SLOTS,
            slot_duration_s: 1.0,
            start: Position::new(50.0, 50.0),
            destination: Position::new(950.0, 950.0),
            area: Area {
                east_m: 1000.0,
                north_m: 1000.0,
            },
            altitude_m: 100.0,
            max_speed_mps: 30.0,
            carrier_hz: 2e9,
            radio_model: RadioModel::ProbabilisticLos,
            environment: Environment { a: 9.61, b: 0.16 },
            excess_loss_db: ExcessLoss {
                los: 1.0,
                nlos: 20.0,
            },
            noise_power: Watt(3.162_277_6e-13),
            mse_threshold: 0.015,
            user_power_max: Watt(0.2),
            sensor_power_max: Watt(0.05),
            users: (0..USERS).map(|_| random.place(users)).collect(),
            sensors: (0..SENSORS).map(|_| random.place(sensors)).collect(),
        };
        match BoardMission::new(parameters) {
            Ok(mission) => mission,
            Err(error) => panic!("{error}"),
        }
    }

    fn gains(
        &mut self,
        mission: &BoardMission,
        slot: u32,
        here: &Position<f32>,
        hostile: bool,
    ) -> BoardState {
        let mut state = ChannelState::predicted(mission, slot, here);
        if !hostile {
            return state;
        }
        let random = &mut self.random;
        let kind = random.below(5);
        let level = random.between(-16.0, -6.0);
        for PowerGain(gain) in state.user_gains.iter_mut().chain(&mut state.sensor_gains) {
            let decade = match kind {
                0 => level,
                1 => random.between(level - 0.01, level),
                _ => random.between(-16.0, -6.0),
            };
            *gain = match random.below(100) {
                0 if kind == 2 => f32::NAN,
                1 if kind == 2 => f32::INFINITY,
                2 if kind == 2 => -1e-12,
                3..30 if kind == 3 => 0.0,
                _ => libm::powf(10.0, decade),
            };
        }
        state
    }

    fn fly(&mut self, index: u32) {
        let hostile = index % 2 == 1;
        let mission = self.mission(index);
        let mut here = mission.parameters().start;
        let cycles = Cell::new([0; 2]);
        let policy = Measured {
            board: self.board,
            trained: self.trained.clone(),
            wild: hostile.then(|| self.random.clone()),
            cycles: &cycles,
        };
        let mut controller = Controller::new(mission.clone(), policy);
        for slot in 1..=SLOTS {
            let begun = self.board.cycles();
            let plan = controller.plan(here);
            let planning = self.board.cycles().wrapping_sub(begun);
            let [network, drawing] = cycles.get();
            let planning = planning - drawing;
            let Ok(plan) = plan else {
                panic!("slot {slot}")
            };
            self.plan.note(planning);
            self.network.note(network);
            self.shield.note(planning.saturating_sub(network));
            here = plan.waypoint;
            if hostile {
                here += Displacement::new(
                    self.random.between(-9.0, 9.0),
                    self.random.between(-9.0, 9.0),
                );
            }
            let arriving = self.arrival(&Arrival {
                plan,
                position: here,
                tick: Tick {
                    time: Instant::from_micros(u64::from(slot) * 1_000_000),
                    clock_rate: 1.0,
                    ..Tick::default()
                },
            });
            let state = self.gains(&mission, slot, &here, hostile);
            let (state, decoding) = self.decode(&BoardMessage::ChannelState(state));
            let begun = self.board.cycles();
            let command = controller.allocate(&state);
            let allocating = self.board.cycles().wrapping_sub(begun);
            let Ok(command) = command else {
                panic!("slot {slot}")
            };
            self.allocate.note(allocating);
            let commanding = self.encode(&BoardMessage::Command(command));
            self.command.note(commanding);
            let setpoint = self.setpoint(&here);
            self.telemetry(&here);
            let whole = planning + arriving + decoding + allocating + commanding + setpoint;
            self.slot.note(whole);
        }
    }

    fn arrival(&mut self, arrival: &Arrival<f32>) -> u32 {
        self.encode(&BoardMessage::Arrival(*arrival))
    }

    fn encode(&mut self, message: &BoardMessage) -> u32 {
        let mut frame = [0; FRAME_MAX];
        let begun = self.board.cycles();
        let sent = link::encode(message, &mut frame).is_ok();
        let cycles = self.board.cycles().wrapping_sub(begun);
        assert!(sent);
        cycles
    }

    fn decode(&mut self, message: &BoardMessage) -> (BoardState, u32) {
        let mut frame = [0; FRAME_MAX];
        let Ok(frame) = link::encode(message, &mut frame) else {
            panic!("a frame that does not fit");
        };
        let begun = self.board.cycles();
        let mut got = None;
        for &byte in frame {
            if let Some(message) = self.ground.push::<f32, USERS_MAX, SENSORS_MAX>(byte) {
                got = Some(message);
            }
        }
        let cycles = self.board.cycles().wrapping_sub(begun);
        self.decode.note(cycles);
        match got {
            Some(Ok(Message::ChannelState(state))) => (state, cycles),
            _ => panic!("a frame that did not arrive"),
        }
    }

    fn setpoint(&mut self, here: &Position<f32>) -> u32 {
        let message =
            MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA {
                x: here.y,
                y: here.x,
                z: -100.0,
                vx: 20.0,
                vy: 21.0,
                ..SET_POSITION_TARGET_LOCAL_NED_DATA::default()
            });
        let mut frame = [0; MAX_FRAME];
        let begun = self.board.cycles();
        // As `Onboard` does it: what flies knows the client's messages alone.
        let sent = self
            .encoder
            .encode_of_client(&message, &mut frame)
            .is_some();
        let cycles = self.board.cycles().wrapping_sub(begun);
        assert!(sent);
        self.setpoint.note(cycles);
        cycles
    }

    fn telemetry(&mut self, here: &Position<f32>) {
        let message = MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA {
            x: here.y,
            y: here.x,
            z: -100.0,
            vx: 20.0,
            vy: 21.0,
            vz: 0.1,
            ..LOCAL_POSITION_NED_DATA::default()
        });
        let mut frame = [0; MAX_FRAME];
        let mut bytes = self.encoder.encode(&message, &mut frame);
        let begun = self.board.cycles();
        let got = self
            .decoder
            .next_frame(&mut bytes)
            .map(|frame| frame.client_message());
        let cycles = self.board.cycles().wrapping_sub(begun);
        assert!(matches!(
            got,
            Some(Ok(Some(MavMessage::LOCAL_POSITION_NED(_))))
        ));
        self.telemetry.note(cycles);
    }

    fn print(&self) {
        let parts = [
            ("link decode", &self.decode),
            ("allocate", &self.allocate),
            ("command encode", &self.command),
            ("plan", &self.plan),
            ("plan: MLP", &self.network),
            ("plan: shield", &self.shield),
            ("MAVLink encode", &self.setpoint),
            ("MAVLink decode", &self.telemetry),
            ("slot", &self.slot),
        ];
        for (name, part) in parts {
            part.print::<Mps2>(name);
        }
    }
}

//! What a decision of the policy for any mission costs, in instructions, at full capacity: 16 users
//! and 64 sensors, with the policy that is in flash, over missions of each channel model.
//!
//! One line of JSON per part goes out by semihosting; `cargo xtask firmware bench` runs this under
//! `-icount shift=6`, where an instruction takes 64 ns of the timer's time.
#![no_std]
#![no_main]

use cortex_m_semihosting::hprintln;
use firmware::{
    ANY_MISSION_POLICY,
    board::{
        Board,
        mps2::{self, Mps2},
    },
};
use firmware_core::{
    Position, SENSORS_MAX, USERS_MAX,
    console::BoardMission,
    mission::{MissionParameters, RadioModel},
    policy::{
        Observation, Policy,
        sets::{
            EvaluateSets, NetworkWithWork, SetsNetwork, SetsObservation, SetsOutput, SetsPolicy,
            SetsWork,
        },
    },
    shield::Agility,
};

/// Nanoseconds of an instruction at `-icount shift=6`.
const NANOS_PER_INSTRUCTION: u64 = 64;
/// Missions of each channel model.
const MISSIONS_EACH: u32 = 8;
/// Decisions in each mission.
const DECISIONS: u32 = 8;
const MODELS: [RadioModel; 4] = [
    RadioModel::ProbabilisticLos,
    RadioModel::UmaAv,
    RadioModel::UmiAv,
    RadioModel::RmaAv,
];

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(mut board) = Mps2::take() else {
        unreachable!("the board is taken once");
    };
    let work = cortex_m::singleton!(SETS_WORK: SetsWork = const { SetsWork::new() });
    let Some(work) = work else {
        unreachable!("the memory is taken once");
    };
    let network = match SetsNetwork::load(ANY_MISSION_POLICY, work) {
        Ok(network) => network,
        Err(error) => board.halt(&error),
    };
    let mut measured = Measured {
        board: &board,
        network: NetworkWithWork { network, work },
        cycles: 0,
    };
    let mut noise = Noise(1);
    let [mut observation, mut decision] = [Part::default(); 2];
    for model in MODELS {
        for _ in 0..MISSIONS_EACH {
            let mission = mission(&mut noise, model);
            let policy = SetsPolicy::new(&mut measured, &mission);
            let Ok(mut policy) = policy else {
                unreachable!("the mission is within the capacity");
            };
            for _ in 0..DECISIONS {
                let state = Observation {
                    slot: 20,
                    counts: &[1; USERS_MAX],
                    rate: 0.0,
                    mse: 0.0,
                    position: noise.place(),
                    agility: Agility::ideal(&mission),
                };
                let begun = board.cycles();
                let action = policy.decide(&state);
                let whole = board.cycles().wrapping_sub(begun);
                assert!(action.user_scores.len() == USERS_MAX && action.displacement.norm() < 31.0);
                decision.note(whole);
                observation.note(whole - policy.network().cycles);
            }
        }
    }
    observation.print("observation");
    decision.print("decision");
    mps2::succeed()
}

/// Returns a mission of full capacity over a random map.
fn mission(noise: &mut Noise, radio_model: RadioModel) -> BoardMission {
    let mission = BoardMission::new(MissionParameters {
        users: (0..USERS_MAX).map(|_| noise.place()).collect(),
        sensors: (0..SENSORS_MAX).map(|_| noise.place()).collect(),
        mse_threshold: 0.6 / SENSORS_MAX as f32,
        radio_model,
        ..MissionParameters::table_one()
    });
    match mission {
        Ok(mission) => mission,
        Err(error) => panic!("{error}"),
    }
}

/// The network, measured.
struct Measured<'b> {
    board: &'b Mps2,
    network: NetworkWithWork<&'static [u8], &'static mut SetsWork>,
    /// Of the last evaluation.
    cycles: u32,
}

impl EvaluateSets for &mut Measured<'_> {
    fn evaluate(&mut self, observation: &SetsObservation) -> Option<SetsOutput> {
        let begun = self.board.cycles();
        let output = self.network.evaluate(observation);
        self.cycles = self.board.cycles().wrapping_sub(begun);
        output
    }
}

/// xorshift, for places.
struct Noise(u32);

impl Noise {
    /// A number from 0 to 1.
    fn unit(&mut self) -> f32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        (self.0 >> 8) as f32 / (1 << 24) as f32
    }

    fn place(&mut self) -> Position<f32> {
        Position::new(1000.0 * self.unit(), 1000.0 * self.unit())
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

    fn print(&self, name: &str) {
        let instructions = |cycles: u64| {
            (cycles * u64::from(Mps2::NANOS_PER_CYCLE)).div_ceil(NANOS_PER_INSTRUCTION)
        };
        hprintln!(
            "{{\"part\":\"{}\",\"worst\":{},\"mean\":{},\"count\":{}}}",
            name,
            instructions(self.worst.into()),
            instructions(self.sum / u64::from(self.count.max(1))),
            self.count
        );
    }
}

//! What a decision of the policy for any mission costs, in instructions, at full capacity: 16 users,
//! 64 sensors, a network of the intended size with random weights.
//!
//! One line of JSON per part goes out by semihosting. Run under `-icount shift=6`, where an
//! instruction takes 64 ns of the timer's time.
#![no_std]
#![no_main]

use cortex_m_semihosting::hprintln;
use firmware::board::{
    Board,
    mps2::{self, Mps2},
};
use firmware_core::{
    Mission, Position, SENSORS_MAX, USERS_MAX,
    inner::Workspace,
    mission::MissionParameters,
    policy::{
        Observation, Policy,
        sets::{
            Architecture, NetworkWithWork, Precision, SetsHeader, SetsNetwork, SetsObservation, SetsPolicy,
            SetsProvenance, SetsWork, write,
        },
    },
    shield::Agility,
};

/// Nanoseconds of an instruction at `-icount shift=6`.
const NANOS_PER_INSTRUCTION: u64 = 64;
const DECISIONS: u32 = 20;
/// The largest file.
const FILE_MAX: usize = 400_000;
const INTENDED: Architecture = Architecture {
    width: 64,
    hidden: 192,
    layers: 3,
};

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(board) = Mps2::take() else {
        unreachable!("the board is taken once");
    };
    measure(&board);
    mps2::succeed()
}

/// xorshift, for places and weights.
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

fn measure(board: &Mps2) {
    let mut noise = Noise(1);
    let mission = Mission::<f32>::new(MissionParameters {
        users: (0..USERS_MAX).map(|_| noise.place()).collect(),
        sensors: (0..SENSORS_MAX).map(|_| noise.place()).collect(),
        mse_threshold: 0.6 / SENSORS_MAX as f32,
        ..MissionParameters::table_one()
    })
    .expect("a valid mission");
    let mut workspace = Workspace::default();
    let mut observe = |slot: u32, position: Position<f32>| {
        let observation = Observation {
            slot,
            counts: &[1; USERS_MAX],
            rate: 0.0,
            mse: 0.0,
            position,
            agility: Agility::ideal(&mission),
        };
        SetsObservation::new(&mission, &observation, &mut workspace)
    };
    let memory = cortex_m::singleton!(: [u8; FILE_MAX] = [0; FILE_MAX]).expect("once");
    let work = cortex_m::singleton!(: Option<SetsWork> = None).expect("once");
    let work = work.insert(SetsWork::default());
    let test = observe(20, noise.place());
    let provenance = SetsProvenance {
        algorithm: heapless::String::new(),
        missions: heapless::String::new(),
        episodes: 0,
        seed: 0,
    };
    let header = SetsHeader::new(provenance, INTENDED, Precision::Half, &test);
    let weights = (0..INTENDED.weight_count()).map(|_| 0.4 * (noise.unit() - 0.5));
    let length = write(&header, weights, &test, work, memory).expect("fits");
    let file: &'static [u8] = &memory[..length];
    hprintln!("{{\"file_bytes\":{}}}", length);
    let network = SetsNetwork::load(file, work).expect("sound");
    let mut policy = SetsPolicy::new(NetworkWithWork { network, work }, &mission).expect("fits");
    let mut noise = Noise(7);
    part(board, "observation for any mission", || {
        let seen = observe(20, noise.place());
        assert_eq!(seen.user_count, USERS_MAX);
    });
    part(board, "decision for any mission", || {
        let observation = Observation {
            slot: 20,
            counts: &[1; USERS_MAX],
            rate: 0.0,
            mse: 0.0,
            position: noise.place(),
            agility: Agility::ideal(&mission),
        };
        let action = policy.decide(&observation);
        assert_eq!(action.user_scores.len(), USERS_MAX);
    });
}

/// Measures what a part costs, at most and on average.
fn part(board: &Mps2, name: &str, mut run: impl FnMut()) {
    let (mut worst, mut sum) = (0_u32, 0_u64);
    for _ in 0..DECISIONS {
        let begun = board.cycles();
        run();
        let cycles = board.cycles().wrapping_sub(begun);
        worst = worst.max(cycles);
        sum += u64::from(cycles);
    }
    let instructions =
        |cycles: u64| (cycles * u64::from(Mps2::NANOS_PER_CYCLE)).div_ceil(NANOS_PER_INSTRUCTION);
    hprintln!(
        "{{\"part\":\"{}\",\"worst\":{},\"mean\":{},\"count\":{}}}",
        name,
        instructions(worst.into()),
        instructions(sum / u64::from(DECISIONS)),
        DECISIONS
    );
}

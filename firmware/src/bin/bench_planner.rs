//! What the planner costs, in instructions, and how good its plans are.
//!
//! The mission is that of the order which the build includes. Its first plan is made in polls, as
//! before take-off; at mid-mission a user moves, and the plan is made again, as in flight. Then the
//! same is done with the largest mission that a board plans. One line of JSON per figure is printed
//! by semihosting; `cargo xtask firmware bench` runs this under `-icount shift=6`, where an
//! instruction takes 64 ns of the timer's time.
#![no_std]
#![no_main]

use cortex_m_semihosting::hprintln;
use firmware::{
    board::{
        Board,
        mps2::{self, Mps2},
    },
    planner::{PlannerMemory, StaticPlanner},
};
use firmware_core::{
    Displacement, Position, SENSORS_MAX, USERS_MAX,
    console::{BoardMission, Call, Calls, PLANNER_CAPACITY, PLANNER_OPERATIONS_PER_POLL},
    mission::MissionChange,
    policy::{Observation, Policy},
    shield::Agility,
};

/// An order of the default mission, as a frame of the console.
static ORDER: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/planned.order"));

/// Nanoseconds of an instruction at `-icount shift=6`.
const NANOS_PER_INSTRUCTION: u64 = 64;
/// The user that moves, and how far.
const MOVED_USER: u16 = 3;
const MOVED_M: f32 = 200.0;
/// The operations that are spent on the largest mission: enough for each kind of step.
const LARGEST_OPERATIONS: u64 = 120_000_000;

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(board) = Mps2::take() else {
        unreachable!("the board is taken once");
    };
    let mission = ordered();
    let mut memory = PlannerMemory::take();
    let mut bench = Bench::new(&board);
    let mut first_poll = Poll::new(&board);
    let planner = match PlannerMemory::planner(&mut memory, &mission) {
        Ok(planner) => planner,
        Err(error) => panic!("{error}"),
    };
    first_poll.end(&mut bench);
    bench.plan(planner);
    bench.print("first plan");
    print("first plan, value", scaled(planner.value()));
    bench.replan(planner, 0.5);
    bench.print("replan");
    print("replan, value", scaled(planner.value()));
    while !planner.advance(u64::MAX).finished {}
    print("replan, value without a limit", scaled(planner.value()));
    bench.print_worst("poll");

    let mut bench = Bench::new(&board);
    let largest = largest(&mission);
    if let Err(error) = planner.change_mission(&largest) {
        panic!("{error}");
    }
    bench.advance(planner, LARGEST_OPERATIONS);
    bench.replan(planner, 80.0);
    bench.print_worst("poll, largest mission");
    print("memory", PlannerMemory::BYTES as u64);
    mps2::succeed()
}

/// Returns the mission of the order.
#[inline(never)]
fn ordered() -> BoardMission {
    let mut calls = Calls::default();
    for &byte in ORDER {
        if let Some(Ok(Call::Order(order))) = calls.push(byte) {
            match BoardMission::new(order.mission) {
                Ok(mission) => return mission,
                Err(error) => panic!("{error}"),
            }
        }
    }
    panic!("no order")
}

/// Returns a mission with as many slots, users and sensors as a board plans, on the same map.
#[inline(never)]
fn largest(mission: &BoardMission) -> BoardMission {
    let mut parameters = mission.parameters().clone();
    parameters.slots = PLANNER_CAPACITY.slots as u32;
    let area = parameters.area;
    let place = |index: usize| {
        // Two irrational steps scatter the places evenly.
        let along = |step: f32, extent_m: f32| (index as f32 * step % 1.0) * extent_m;
        Position::new(
            along(0.754_877_7, area.east_m),
            along(0.569_840_3, area.north_m),
        )
    };
    parameters.users = (1..=USERS_MAX).map(place).collect();
    parameters.sensors = (1..=SENSORS_MAX).map(|index| place(100 + index)).collect();
    parameters.mse_threshold *= mission.sensor_count() as f32 / SENSORS_MAX as f32;
    match BoardMission::new(parameters) {
        Ok(mission) => mission,
        Err(error) => panic!("{error}"),
    }
}

/// Rates in 10^-4 bit/s/Hz.
fn scaled(value: f32) -> u64 {
    (f64::from(value) * 1e4) as u64
}

fn print(name: &str, value: u64) {
    hprintln!("{{\"part\":\"{}\",\"value\":{}}}", name, value);
}

/// A measurement of one poll.
struct Poll<'b> {
    board: &'b Mps2,
    begun: u32,
}

impl<'b> Poll<'b> {
    fn new(board: &'b Mps2) -> Self {
        Self {
            board,
            begun: board.cycles(),
        }
    }

    fn end(&mut self, bench: &mut Bench<'_>) {
        let cycles = self.board.cycles().wrapping_sub(self.begun);
        bench.worst = bench.worst.max(cycles);
        bench.sum += u64::from(cycles);
    }
}

/// The polls of a plan.
struct Bench<'b> {
    board: &'b Mps2,
    /// Cycles of the longest poll, and of all polls since the last figure.
    worst: u32,
    sum: u64,
}

impl<'b> Bench<'b> {
    fn new(board: &'b Mps2) -> Self {
        Self {
            board,
            worst: 0,
            sum: 0,
        }
    }

    /// Polls until the planner has spent its operations.
    fn plan(&mut self, planner: &mut StaticPlanner) {
        while planner.quality().is_some_and(|plan| plan.is_replanning) {
            let mut poll = Poll::new(self.board);
            planner.improve(PLANNER_OPERATIONS_PER_POLL);
            poll.end(self);
        }
    }

    /// Polls until `operations` are spent, for a plan that was begun otherwise.
    fn advance(&mut self, planner: &mut StaticPlanner, operations: u64) {
        let mut spent = 0;
        while spent < operations {
            let mut poll = Poll::new(self.board);
            let progress = planner.advance(PLANNER_OPERATIONS_PER_POLL);
            poll.end(self);
            if progress.finished {
                return;
            }
            spent += progress.operations;
        }
    }

    /// Decides a slot at mid-mission, from a position `off_m` away from the plan in both axes; moves
    /// a user; and plans again.
    fn replan(&mut self, planner: &mut StaticPlanner, off_m: f32) {
        let slots = planner.mission().slots();
        let slot = slots / 2;
        let mut counts = [0; USERS_MAX];
        for before in 1..slot {
            if let Some(count) = (planner.served_user(before)).and_then(|user| counts.get_mut(user))
            {
                *count += 1;
            }
        }
        let Some(planned) = planner.waypoint(slot - 1) else {
            panic!("no plan of slot {}", slot - 1)
        };
        let users = &planner.mission().parameters().users;
        let Some(user) = users.get(usize::from(MOVED_USER)).copied() else {
            panic!("no user {MOVED_USER}")
        };
        let observation = Observation {
            slot,
            counts: &counts[..users.len()],
            rate: 0.0,
            mse: 0.0,
            position: planned + Displacement::new(-off_m, off_m),
            agility: Agility::ideal(planner.mission()),
        };
        let mut poll = Poll::new(self.board);
        let _ = planner.decide(&observation);
        poll.end(self);
        self.sum = 0;
        let change = MissionChange::User {
            user: MOVED_USER,
            position_m: Position::new(user.x + MOVED_M, user.y),
        };
        let mut poll = Poll::new(self.board);
        planner.revise(&change, slot);
        poll.end(self);
        self.plan(planner);
    }

    fn instructions(cycles: u64) -> u64 {
        cycles * u64::from(Mps2::NANOS_PER_CYCLE) / NANOS_PER_INSTRUCTION
    }

    /// Prints the instructions of all polls since the last figure.
    fn print(&mut self, name: &str) {
        print(name, Self::instructions(self.sum));
        self.sum = 0;
    }

    fn print_worst(&self, name: &str) {
        print(name, Self::instructions(self.worst.into()));
    }
}

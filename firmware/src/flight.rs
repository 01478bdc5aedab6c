//! The loop: an order, then round after round until the vehicle has landed.
//!
//! A *round* takes what came on the ground link and from the autopilot, lets the onboard computer
//! go on, and queues what it has to say. In the air a round is begun by a byte or by the board's
//! timer; on a bench by a tick (see `firmware_core::console`). After a reset the image holds no
//! order and sends nothing: whoever flies the vehicle then keeps it.

use core::mem::MaybeUninit;

use firmware_core::{
    autopilot::{
        OwnAddress, Phase,
        wire::{Encoder, MAX_FRAME},
    },
    console::{
        self, BoardComputer, BoardReport, Call, Calls, Clock, Cost, Footprint, MissionOrder,
        OrderError, PolicyKind, REPORT_FRAME_MAX, Tick, Tock, TrainedPolicy,
    },
    link::FRAME_MAX,
    onboard::{Activity, Probe, Stage},
    time::Instant,
};

use crate::{
    board::{Board, Line},
    planner::{PlannerMemory, StaticPlanner},
    trained::{self, FlashPolicy},
};

/// The computer of an image whose trained policy is an `R`.
type Computer<R> = BoardComputer<R, &'static mut StaticPlanner>;

/// Bytes taken from a line at a time.
const PIECE: usize = 64;

/// Flies, with a policy of kind `K` in flash. A policy that is not sound is refused on the console and,
/// as a STATUSTEXT, to the autopilot's side; then nothing flies.
pub fn run<K: FlashPolicy, B: Board>(board: &mut B, file: &'static [u8]) -> ! {
    let mut trained = match K::load(file) {
        Ok(policy) => policy,
        Err(why) => {
            warn(board, &why);
            board.halt(&why)
        }
    };
    let mut calls = Calls::default();
    let mut memory = PlannerMemory::take();
    // The computer is built in static memory: the stack need not hold it.
    let mut place = K::computer_memory();
    let computer_bytes = size_of::<trained::Computer<K>>() as u32;
    let (computer, clock) = loop {
        match next_call(board, &mut calls) {
            Some(Call::Order(order)) => {
                let planner = prepare::<B>(&order, &mut memory);
                let built = planner.and_then(|planner| {
                    commission(board, &order, (&mut trained, planner), &mut place)
                });
                match built {
                    Ok(computer) => break (computer, order.clock),
                    Err(why) => report(board, &BoardReport::Refused(console::words(&why))),
                }
            }
            Some(Call::Footprint) => report_footprint(board, computer_bytes),
            Some(Call::Signing) => report(board, &BoardReport::Signing(None)),
            Some(Call::Tick(_) | Call::Stop) => {}
            None => board.rest(false),
        }
    };
    report(board, &console::ready(computer));
    let mut flight = Flight::default();
    loop {
        let call = next_call(board, &mut calls);
        match call {
            Some(Call::Footprint) => report_footprint(board, computer_bytes),
            Some(Call::Signing) => report(board, &BoardReport::Signing(computer.signing_state())),
            Some(Call::Stop) => flight.stop_asked = true,
            Some(Call::Tick(tick)) if clock == Clock::Console => {
                flight.bench_round(board, computer, &tick);
            }
            Some(Call::Tick(_) | Call::Order(_)) => {}
            None if clock == Clock::Board => {
                let now = board.now();
                flight.round(board, computer, now, None);
                board.rest(true);
            }
            None => board.rest(false),
        }
    }
}

/// Checks an order and, where it asks for a plan, creates the planner. This is not done in
/// [`commission`], so that the stack does not hold both the planner's and the computer's parts.
#[inline(never)]
fn prepare<B: Board>(
    order: &MissionOrder,
    memory: &mut Option<PlannerMemory>,
) -> Result<Option<&'static mut StaticPlanner>, OrderError> {
    order.check_watchdog(B::LONGEST_WATCH)?;
    if order.policy_kind != PolicyKind::Plan {
        return Ok(None);
    }
    let mission = order.check()?;
    Ok(Some(PlannerMemory::planner(memory, &mission)?))
}

/// Apart, so that what it needs of the stack is given back.
#[inline(never)]
fn commission<B: Board, K: FlashPolicy>(
    board: &mut B,
    order: &MissionOrder,
    (trained, planner): (&mut K, Option<&'static mut StaticPlanner>),
    place: &mut Option<&'static mut MaybeUninit<trained::Computer<K>>>,
) -> Result<&'static mut trained::Computer<K>, OrderError> {
    let trained = match order.policy_kind {
        PolicyKind::Trained => Some(trained.for_order(order)?),
        PolicyKind::StraightLine | PolicyKind::Plan => None,
    };
    let computer = order.build_in(place, trained, planner)?;
    let now = match order.clock {
        Clock::Board => board.now(),
        Clock::Console => Instant::ZERO,
    };
    order.launch(computer, now);
    Ok(computer)
}

/// The next call, if one has come. Frames that are damaged are dropped; a bench asks again.
fn next_call<B: Board>(board: &mut B, calls: &mut Calls) -> Option<Call> {
    let mut byte = [0];
    while board.receive(Line::Console, &mut byte) > 0 {
        if let Some(Ok(call)) = calls.push(byte[0]) {
            return Some(call);
        }
    }
    None
}

#[inline(never)]
fn report<B: Board>(board: &mut B, report: &BoardReport) {
    let mut frame = [0; REPORT_FRAME_MAX];
    if let Ok(frame) = console::encode_report(report, &mut frame) {
        // Without room it is dropped and counted: nobody may be listening.
        board.send(Line::Console, frame);
    }
}

#[inline(never)]
fn report_footprint<B: Board>(board: &mut B, computer_bytes: u32) {
    let (lost_bytes, unsent_frames) = board.losses();
    let footprint = Footprint {
        stack_bytes: board.stack_bytes(),
        computer_bytes,
        lost_bytes,
        unsent_frames,
    };
    report(board, &BoardReport::Footprint(footprint));
}

/// A line of text for whoever listens to MAVLink.
#[inline(never)]
fn warn<B: Board>(board: &mut B, text: &str) {
    let own = OwnAddress::ONBOARD_COMPUTER.resolve(None);
    let mut frame = [0; MAX_FRAME];
    let frame = Encoder::new(own).encode_critical_text(text, &mut frame);
    board.send(Line::Mavlink, frame);
}

/// What the loop keeps between rounds.
#[derive(Debug, Default)]
struct Flight {
    /// Modulo 2^32, on the ground link and MAVLink.
    received: [u32; 2],
    sent: [u32; 2],
    stop_asked: bool,
    /// Slots done, when the watchdog was last fed; `None` before slot 1.
    fed_at: Option<u32>,
    broken_off: bool,
}

impl Flight {
    /// A round at the time and with the bytes of a bench.
    fn bench_round<B: Board, R: TrainedPolicy>(
        &mut self,
        board: &mut B,
        computer: &mut Computer<R>,
        tick: &Tick,
    ) {
        let cost = self.round(board, computer, tick.now, Some(tick));
        let place = computer.autopilot().position();
        let tock = Tock {
            ground_bytes: self.sent[0],
            mavlink_bytes: self.sent[1],
            stage: computer.stage(),
            phase: computer.autopilot().phase(),
            place: place.map(|sample| (sample.position, sample.altitude_m)),
            cost,
        };
        report(board, &BoardReport::Tock(tock));
    }

    fn round<B: Board, R: TrainedPolicy>(
        &mut self,
        board: &mut B,
        computer: &mut Computer<R>,
        now: Instant,
        tick: Option<&Tick>,
    ) -> Cost {
        // On a bench, first all that belongs to this moment.
        let mut working = 0;
        loop {
            let begun = board.cycles();
            self.take(board, computer, now);
            working += board.cycles().wrapping_sub(begun);
            let due =
                tick.is_some_and(|tick| self.received != [tick.ground_bytes, tick.mavlink_bytes]);
            if !due {
                break;
            }
            board.rest(false);
        }
        let begun = board.cycles();
        if self.stop_asked {
            self.stop_asked = false;
            computer.autopilot_mut().stop(now);
        }
        let mut stopwatch = Stopwatch::new(board);
        computer.poll(now, &mut stopwatch);
        let Stopwatch { plan, allocate, .. } = stopwatch;
        self.give(board, computer, now);
        self.tell(board, computer);
        self.feed_watchdog(board, computer);
        working += board.cycles().wrapping_sub(begun);
        let nanos = |cycles: u32| cycles.saturating_mul(B::NANOS_PER_CYCLE);
        Cost {
            round_ns: nanos(working),
            plan_ns: nanos(plan),
            allocate_ns: nanos(allocate),
        }
    }

    /// What came.
    #[inline(never)]
    fn take<B: Board, R: TrainedPolicy>(
        &mut self,
        board: &mut B,
        computer: &mut Computer<R>,
        now: Instant,
    ) {
        let mut piece = [0; PIECE];
        for (received, line) in self.received.iter_mut().zip([Line::Ground, Line::Mavlink]) {
            loop {
                let length = board.receive(line, &mut piece);
                if length == 0 {
                    break;
                }
                *received = received.wrapping_add(length as u32);
                match line {
                    Line::Ground => computer.receive_ground(now, &piece[..length]),
                    _ => computer.receive_mavlink(now, &piece[..length], false),
                }
            }
        }
    }

    /// What is to be said.
    #[inline(never)]
    fn give<B: Board, R: TrainedPolicy>(
        &mut self,
        board: &mut B,
        computer: &mut Computer<R>,
        now: Instant,
    ) {
        let [ground, mavlink] = &mut self.sent;
        let mut frame = [0; MAX_FRAME];
        while let Some(frame) = computer.take_mavlink_frame(now, &mut frame) {
            if board.send(Line::Mavlink, frame) {
                *mavlink = mavlink.wrapping_add(frame.len() as u32);
            }
        }
        let mut frame = [0; FRAME_MAX];
        while let Some(frame) = computer.take_ground_frame(&mut frame) {
            if board.send(Line::Ground, frame) {
                *ground = ground.wrapping_add(frame.len() as u32);
            }
        }
    }

    /// What happened, in words.
    #[inline(never)]
    fn tell<B: Board, R: TrainedPolicy>(&mut self, board: &mut B, computer: &mut Computer<R>) {
        while let Some(event) = computer.autopilot_mut().take_next_event() {
            report(board, &BoardReport::Event(console::words(&event)));
        }
        if computer.stage() == Stage::Aborted && !self.broken_off {
            self.broken_off = true;
            let client = computer.autopilot();
            let why = match (computer.fault(), client.fault()) {
                (Some(fault), _) => console::words(&fault),
                (None, Some(cause)) => console::words(&cause),
                (None, None) => console::words(&client.phase()),
            };
            report(board, &BoardReport::Aborted(why));
        }
    }

    /// Only a finished slot feeds the watchdog, from the first slot to the last.
    fn feed_watchdog<B: Board, R: TrainedPolicy>(&mut self, board: &mut B, computer: &Computer<R>) {
        let controller = computer.controller();
        let flying = computer.autopilot().phase() == Phase::Leg
            || matches!(computer.stage(), Stage::Flying | Stage::Measuring);
        if !flying {
            if self.fed_at.take().is_some() {
                board.watch(None);
            }
            return;
        }
        let done = controller.slots_done();
        if self.fed_at != Some(done) {
            self.fed_at = Some(done);
            let slot_s = controller.mission().parameters().slot_duration_s;
            board.watch(Some(console::slot_patience(slot_s)));
        }
    }
}

/// Cycles of the two computations of a slot.
struct Stopwatch<'b, B> {
    board: &'b B,
    begun: u32,
    plan: u32,
    allocate: u32,
}

impl<'b, B: Board> Stopwatch<'b, B> {
    fn new(board: &'b B) -> Self {
        Self {
            board,
            begun: 0,
            plan: 0,
            allocate: 0,
        }
    }
}

impl<B: Board> Probe for Stopwatch<'_, B> {
    fn begin(&mut self, _: Activity) {
        self.begun = self.board.cycles();
    }

    fn end(&mut self, activity: Activity) {
        let cycles = self.board.cycles().wrapping_sub(self.begun);
        match activity {
            Activity::Plan => self.plan += cycles,
            Activity::Allocate => self.allocate += cycles,
        }
    }
}

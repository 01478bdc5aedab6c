//! An image and its twin under faults on the ground link: both receive the same damaged bytes and
//! must send the same bytes. Their output is compared with the injected faults.

use std::{
    collections::{BTreeMap, VecDeque},
    io,
};

use firmware_core::{
    PowerGain, SENSORS_MAX, USERS_MAX, Watt, aircomp,
    console::{self, BoardMission, Footprint, MissionOrder},
    controller::{ChannelSource, ChannelState, SlotCommand},
    link::{Decoder, Message, VehicleStatus},
    time::Instant,
};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::{ComputerState, Image, Notice, OnboardComputer, Round, RoundInput, Twin};
use crate::flight::outcome::FlightError;
use link::faults::{Direction, Fault, FaultyLink, Injected, Schedule};

/// The number of slots of a schedule: all but the last have faults; in the last one everything must
/// work again.
pub const SLOTS_EACH: u32 = 3;

/// The number of bytes that the board receives at a time: half of its queue, so that the effect of
/// a flood does not depend on the speed of the board.
const PIECE: usize = 512;

/// The tolerance for single precision.
const ROUNDING: f64 = 1e-4;

/// The number of times that something was injected, counted or seen.
pub type Tally = BTreeMap<&'static str, u64>;

/// The image of a board and its twin behind the same faulty link.
#[derive(Debug)]
pub struct Campaign {
    image: Image,
    twin: Twin,
    order: MissionOrder,
    schedule: Schedule,
    link: FaultyLink<f32>,
    /// A decoder behind the faults, like the vehicle's, whose counters are the expected values.
    witness: Decoder,
    /// A decoder of the vehicle's own messages, before the faults.
    said: Decoder,
    /// The present slot, whether its arrival was repeated, and the state that it should use.
    slot: u32,
    asked_again: bool,
    delivered: Option<ChannelState<f32, USERS_MAX, SENSORS_MAX>>,
    expected: VehicleStatus,
    /// The counters and the injected faults at the start of the schedule.
    begun: (VehicleStatus, Injected),
    tally: Tally,
    /// The notices of the image that were not taken yet.
    notices: VecDeque<Notice>,
}

impl Campaign {
    /// Creates a campaign of this number of schedules, one after the other from slot 1.
    pub fn new(
        (image, twin): (Image, Twin),
        order: &MissionOrder,
        schedules: u32,
        seed: u64,
    ) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut schedule = Schedule::default();
        let mut tally = Tally::new();
        for section in 0..schedules {
            let begin = section * SLOTS_EACH + 1;
            let drawn = Schedule::draw(&mut random, begin, begin + SLOTS_EACH - 1);
            for episode in &drawn.episodes {
                *tally.entry(kind(&episode.fault)).or_default() += 1;
            }
            schedule.episodes.extend(drawn.episodes);
            *tally.entry("schedules").or_default() += 1;
        }
        Self {
            image,
            twin,
            order: order.clone(),
            link: FaultyLink::new(schedule.clone(), seed),
            schedule,
            witness: Decoder::new(),
            said: Decoder::new(),
            slot: 0,
            asked_again: false,
            delivered: None,
            expected: VehicleStatus::default(),
            begun: Default::default(),
            tally,
            notices: VecDeque::new(),
        }
    }

    /// Ends the campaign after the flight, when no output is pending, and returns the tally.
    ///
    /// # Errors
    /// Returns an error if a slot is missing or the image has lost bytes.
    pub fn finish(mut self) -> io::Result<Tally> {
        let done = self.expected.slots_done;
        demand(done == self.order.mission.slots, || {
            format!("{done} slots were commanded")
        })?;
        let footprint = self.image.footprint()?.unwrap_or_default();
        demand(footprint.lost_bytes + footprint.unsent_frames == 0, || {
            format!("the image had no room: {footprint:?}")
        })?;
        self.count("bytes and frames without room in the image", 0);
        Ok(self.tally)
    }

    fn count(&mut self, what: &'static str, times: u32) {
        *self.tally.entry(what).or_default() += u64::from(times);
    }

    /// Sends the same bytes to both and compares their answers.
    fn both(&mut self, input: &RoundInput<'_>) -> Result<Round, FlightError> {
        self.predict(input.from_ground);
        let image = self.image.round(input)?;
        let twin = self.twin.round(input)?;
        let slot = self.slot;
        let apart = |what: &str| format!("slot {slot}: the image and its twin differ in {what}");
        demand(image.to_ground == twin.to_ground, || {
            apart("the ground link")
        })?;
        demand(image.to_vehicle == twin.to_vehicle, || apart("MAVLink"))?;
        let said_by_image = notices(&mut self.image, input.now);
        let said_by_twin = notices(&mut self.twin, input.now);
        demand(words(&said_by_image).eq(words(&said_by_twin)), || {
            apart("events")
        })?;
        self.notices.extend(said_by_image);
        demand(self.image.state() == self.twin.state(), || {
            apart("where they are")
        })?;
        self.count("bytes to the image", input.from_ground.len() as u32);
        self.count("bytes from the image, equal", image.to_ground.len() as u32);
        for &byte in &image.to_ground {
            match self.said.push(byte) {
                Some(Ok(message)) => self.heard(&message)?,
                Some(Err(error)) => {
                    return Err(violation(&format!("the image's own frame: {error}")).into());
                }
                None => {}
            }
        }
        Ok(image)
    }

    /// Predicts how the vehicle processes these bytes.
    fn predict(&mut self, bytes: &[u8]) {
        let mission = &self.order.mission;
        let counters = &mut self.expected.slots;
        for &byte in bytes {
            match self.witness.push::<f32, USERS_MAX, SENSORS_MAX>(byte) {
                Some(Ok(Message::ChannelState(state))) => {
                    let fits = state.user_gains.len() == mission.users.len()
                        && state.sensor_gains.len() == mission.sensors.len();
                    let awaited = state.slot == self.slot && self.expected.slots_done < self.slot;
                    if !awaited || (fits && self.delivered.is_some()) {
                        counters.states_out_of_turn += 1;
                    } else if !fits {
                        counters.states_of_wrong_size += 1;
                    } else {
                        self.delivered = Some(state);
                    }
                }
                Some(Ok(_)) => counters.echoes += 1,
                Some(Err(_)) | None => {}
            }
        }
    }

    fn heard(&mut self, message: &Message<f32, USERS_MAX, SENSORS_MAX>) -> io::Result<()> {
        match message {
            Message::Arrival(arrival) if arrival.plan.slot == self.slot => {
                self.expected.slots.arrivals_repeated += 1;
                self.asked_again = true;
                Ok(())
            }
            Message::Arrival(arrival) => {
                self.slot += 1;
                (self.asked_again, self.delivered) = (false, None);
                demand(arrival.plan.slot == self.slot, || {
                    format!("an arrival out of turn: {arrival:?}")
                })
            }
            Message::Command(command) => self.commanded(command),
            Message::Status(status) => self.counted(status),
            Message::ChannelState(_) | Message::Change(_) => {
                Err(violation("a message to the vehicle from the vehicle"))
            }
        }
    }

    /// Checks that every number is finite and within its limits, and that the guarantees for fresh
    /// state hold.
    fn commanded(&mut self, command: &SlotCommand<f32, SENSORS_MAX>) -> io::Result<()> {
        let slot = self.slot;
        let state = self.delivered.take();
        let must =
            |holds: bool, what: &str| demand(holds, || format!("slot {slot}: {what}: {command:?}"));
        let mission = &self.order.mission;
        must(command.slot == slot, "not the slot under way")?;
        let board_mission =
            BoardMission::new(mission.clone()).map_err(|error| violation(&error.to_string()))?;
        if let Err(error) = command.check(&board_mission) {
            must(false, &error.to_string())?;
        }
        let coefficients = &command.sensor_coefficients;
        let fresh = command.source == ChannelSource::Measured;
        must(fresh == state.is_some(), "the source of the gains")?;
        let (mut rejected, mut unheard) = (0, command.unheard_sensors);
        if let Some(state) = &state {
            let invalid =
                |gains: &[PowerGain<f32>]| gains.iter().filter(|g| !g.is_passive()).count();
            rejected = (invalid(&state.user_gains) + invalid(&state.sensor_gains)) as u16;
            let usable = |gain: &PowerGain<f32>| {
                PowerGain(if gain.is_passive() {
                    f64::from(gain.0)
                } else {
                    0.0
                })
            };
            let sensor_gains: Vec<_> = state.sensor_gains.iter().map(usable).collect();
            unheard = sensor_gains.iter().filter(|gain| gain.0 == 0.0).count() as u16;
            let user = command.served_user.and_then(|m| state.user_gains.get(m));
            let at_state = aircomp::Slot {
                sensor_gains: &sensor_gains,
                sensor_coefficients: &coefficients
                    .iter()
                    .map(|&b| f64::from(b))
                    .collect::<Vec<_>>(),
                user_gain: user.map(usable).unwrap_or_default(),
                user_power: Watt(f64::from(command.user_power.0)),
                noise_power: Watt(f64::from(mission.noise_power.0)),
            };
            let mse = at_state.mse(f64::from(command.normalizing_factor));
            must(
                mse <= f64::from(command.mse) * (1.0 + ROUNDING),
                "an MSE above what is promised",
            )?;
        }
        must(command.rejected_gains == rejected, "gains refused")?;
        must(command.unheard_sensors == unheard, "sensors not heard")?;
        if slot.is_multiple_of(SLOTS_EACH) {
            let in_order = fresh && !self.asked_again && (rejected, unheard) == (0, 0);
            must(in_order, "out of step after the faults")?;
            self.count("resynchronised at the first clean frame", 1);
        }
        let counters = &mut self.expected.slots;
        counters.measured += u32::from(fresh);
        counters.stale += u32::from(!fresh);
        counters.infeasible += u32::from(!command.status.is_feasible());
        counters.nobody_served += u32::from(command.served_user.is_none());
        counters.rejected_gains += u32::from(rejected);
        counters.unheard_sensors += u32::from(unheard);
        self.expected.slots_done += 1;
        self.count(
            match (fresh, command.status.is_feasible()) {
                (true, true) => "commands: fresh, Gamma kept",
                (true, false) => "commands: fresh, infeasible and said so",
                (false, true) => "commands: aged, Gamma kept",
                (false, false) => "commands: aged, infeasible and said so",
            },
            1,
        );
        Ok(())
    }

    /// Checks the vehicle's counters in the clean slot that ends a schedule.
    fn counted(&mut self, status: &VehicleStatus) -> io::Result<()> {
        if status.slots_done == 0 || !status.slots_done.is_multiple_of(SLOTS_EACH) {
            return Ok(());
        }
        let mut expected = self.expected;
        expected.link = *self.witness.counters();
        // These counters are not of the ground link, or cannot be determined from its bytes.
        expected.mavlink = status.mavlink;
        expected.mavlink_unreadable = status.mavlink_unreadable;
        expected.slots.user_replaced = status.slots.user_replaced;
        demand(*status == expected, || {
            format!("the image counts {status:?}, the link was sent {expected:?}")
        })?;
        let (link, slots) = (&status.link, &status.slots);
        let injected = *self.link.injected();
        demand(link.messages + link.dropped() == injected.pieces, || {
            format!("{link:?} do not add up to {injected:?}")
        })?;
        let used =
            slots.measured + slots.states_out_of_turn + slots.states_of_wrong_size + slots.echoes;
        demand(link.messages == used, || {
            format!("a message lost: {status:?}")
        })?;
        let (before, injected_before) = std::mem::replace(&mut self.begun, (*status, injected));
        let faults: Vec<Fault> = (status.slots_done + 1 - SLOTS_EACH..=status.slots_done)
            .flat_map(|slot| self.schedule.faults(slot, Direction::Up))
            .collect();
        let undecided =
            |fault: &Fault| fault.is_damage() || matches!(fault, Fault::Silence | Fault::Flood(_));
        if !faults.iter().any(undecided) {
            let counted = (
                link.version - before.link.version,
                link.dropped() - before.link.dropped(),
                slots.echoes - before.slots.echoes,
            );
            let other_version = injected.other_version - injected_before.other_version;
            let echoes = injected.echoes - injected_before.echoes;
            demand(counted == (other_version, other_version, echoes), || {
                format!("{counted:?} counted of {other_version} versions, {echoes} echoes")
            })?;
            self.count("schedules whose counts are decided exactly", 1);
        }
        for (what, now, then) in [
            (
                "counted: good messages",
                link.messages,
                before.link.messages,
            ),
            ("counted: too long", link.too_long, before.link.too_long),
            ("counted: malformed", link.malformed, before.link.malformed),
            ("counted: wrong CRC", link.checksum, before.link.checksum),
            ("counted: other version", link.version, before.link.version),
            ("counted: echoes", slots.echoes, before.slots.echoes),
            (
                "counted: states out of turn",
                slots.states_out_of_turn,
                before.slots.states_out_of_turn,
            ),
            (
                "counted: states of wrong size",
                slots.states_of_wrong_size,
                before.slots.states_of_wrong_size,
            ),
            (
                "counted: gains refused",
                slots.rejected_gains,
                before.slots.rejected_gains,
            ),
            (
                "counted: sensors not heard",
                slots.unheard_sensors,
                before.slots.unheard_sensors,
            ),
            (
                "counted: arrivals repeated",
                slots.arrivals_repeated,
                before.slots.arrivals_repeated,
            ),
        ] {
            self.count(what, now - then);
        }
        Ok(())
    }
}

impl OnboardComputer for Campaign {
    type Precision = f32;

    fn round(&mut self, input: &RoundInput<'_>) -> Result<Round, FlightError> {
        let up = self.link.up(input.from_ground);
        let mut pieces = up.chunks(PIECE);
        let mut round = self.both(&RoundInput {
            from_ground: pieces.next().unwrap_or_default(),
            ..*input
        })?;
        for piece in pieces {
            let mut next = self.both(&RoundInput {
                from_vehicle: &[],
                from_ground: piece,
                ..*input
            })?;
            round.to_vehicle.append(&mut next.to_vehicle);
            round.to_ground.append(&mut next.to_ground);
        }
        round.to_ground = self.link.down(&round.to_ground);
        Ok(round)
    }

    fn state(&self) -> ComputerState {
        self.image.state()
    }

    fn take_notice(&mut self, _: Instant) -> Option<Notice> {
        self.notices.pop_front()
    }

    fn stop(&mut self, now: Instant) -> io::Result<Option<&'static str>> {
        self.twin.stop(now)?;
        self.image.stop(now)
    }

    fn aborted_because(&self) -> Option<String> {
        self.image.aborted_because()
    }

    fn footprint(&mut self) -> io::Result<Option<Footprint>> {
        self.image.footprint()
    }
}

fn notices(computer: &mut impl OnboardComputer, now: Instant) -> Vec<Notice> {
    std::iter::from_fn(|| computer.take_notice(now)).collect()
}

/// Returns the events as the console of a board transfers them.
fn words(notices: &[Notice]) -> impl Iterator<Item = impl PartialEq> + '_ {
    notices.iter().filter_map(|notice| match notice {
        Notice::Event { text, .. } => Some(console::words(text)),
        _ => None,
    })
}

fn kind(fault: &Fault) -> &'static str {
    match fault {
        Fault::Lose(_) => "injected: bytes lost",
        Fault::Flip(_) => "injected: bytes flipped",
        Fault::Insert(_) => "injected: bytes inserted",
        Fault::Repeat(_) => "injected: bytes repeated",
        Fault::Cut => "injected: frames cut",
        Fault::Silence => "injected: silence",
        Fault::Flood(_) => "injected: floods",
        Fault::OtherVersion => "injected: another version",
        Fault::Echo => "injected: echoes",
        Fault::Twice => "injected: states twice",
        Fault::OtherSlot(_) => "injected: states of another slot",
        Fault::TooFew(_) => "injected: states with too few gains",
        Fault::Late => "injected: states too late",
        Fault::NoGain(_) => "injected: NaN, infinite, negative gains, gains above 1",
        Fault::SensorsVanish(_) => "injected: sensors vanish",
        Fault::UsersVanish(_) => "injected: users vanish",
    }
}

fn violation(what: &str) -> io::Error {
    io::Error::other(what.to_owned())
}

fn demand(holds: bool, otherwise: impl FnOnce() -> String) -> io::Result<()> {
    if holds {
        return Ok(());
    }
    Err(violation(&otherwise()))
}

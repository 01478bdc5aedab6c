//! An image and its twin under faults on the ground link: both receive the same damaged bytes and
//! must send the same bytes. An auditor of the link checks the rules of the protocol, and the
//! vehicle's counters are compared with the injected faults.

use std::{
    collections::{BTreeMap, VecDeque},
    io,
};

use firmware_core::{
    console::{self, BoardMission, Footprint, MissionOrder},
    controller::SlotCommand,
    link::{SecurityCounters, VehicleStatus},
    time::Instant,
};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::{ComputerState, Image, Notice, OnboardComputer, Round, RoundInput, Twin};
use crate::flight::outcome::FlightError;
use link::{
    audit::{Audited, LinkAuditor, Violation},
    faults::{Direction, Fault, FaultyLink, Injected, Schedule},
};

/// The number of slots of a schedule: all but the last have faults; in the last one everything must
/// work again.
pub const SLOTS_EACH: u32 = 3;

/// The number of bytes that the board receives at a time: half of its queue, so that the effect of
/// a flood does not depend on the speed of the board.
const PIECE: usize = 512;

/// The number of times that something was injected, counted or seen.
pub type Tally = BTreeMap<&'static str, u64>;

/// The image of a board and its twin behind the same faulty link.
#[derive(Debug)]
pub struct Campaign {
    image: Image,
    twin: Twin,
    /// The number of slots of the mission.
    slots: u32,
    schedule: Schedule,
    link: FaultyLink<f32>,
    /// The rules of the link, behind the faults.
    auditor: LinkAuditor<f32>,
    /// The counters and the injected faults at the start of the schedule.
    begun: (VehicleStatus, Injected),
    /// The counters of the vehicle's authentication at the start of the schedule, and the attacks in
    /// it: forged, replayed, reflected, without authentication.
    security: SecurityCounters,
    attacks: [u32; 4],
    /// The faults of the schedule determine what the vehicle counts.
    is_decided: bool,
    tally: Tally,
    /// The notices of the image that were not taken yet.
    notices: VecDeque<Notice>,
}

impl Campaign {
    /// Creates a campaign of this number of schedules, one after the other from slot 1. If the order
    /// has a key of the ground link, there are attackers on it as well.
    ///
    /// # Errors
    /// Returns the reason if the mission of the order is invalid, in words.
    pub fn new(
        (image, twin): (Image, Twin),
        order: &MissionOrder,
        schedules: u32,
        seed: u64,
    ) -> Result<Self, String> {
        let mission = BoardMission::new(order.mission.clone());
        let mission = mission.map_err(|error| error.to_string())?;
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut schedule = Schedule::default();
        let mut tally = Tally::new();
        for section in 0..schedules {
            let begin = section * SLOTS_EACH + 1;
            let draw = match order.ground_link {
                Some(_) => Schedule::draw_with_attacks,
                None => Schedule::draw,
            };
            let drawn = draw(&mut random, begin, begin + SLOTS_EACH - 1);
            for episode in &drawn.episodes {
                *tally.entry(kind(&episode.fault)).or_default() += 1;
            }
            schedule.episodes.extend(drawn.episodes);
            *tally.entry("schedules").or_default() += 1;
        }
        Ok(Self {
            image,
            twin,
            slots: mission.slots(),
            link: match &order.ground_link {
                Some(vehicle) => FaultyLink::authenticated(schedule.clone(), seed, &vehicle.key),
                None => FaultyLink::new(schedule.clone(), seed),
            },
            schedule,
            auditor: match &order.ground_link {
                Some(vehicle) => LinkAuditor::authenticated(mission, vehicle.clone()),
                None => LinkAuditor::new(mission),
            },
            begun: Default::default(),
            security: SecurityCounters::default(),
            attacks: [0; 4],
            is_decided: false,
            tally,
            notices: VecDeque::new(),
        })
    }

    /// Ends the campaign after the flight, when no output is pending, and returns the tally.
    ///
    /// # Errors
    /// Returns an error if a slot is missing or the image has lost bytes.
    pub fn finish(mut self) -> io::Result<Tally> {
        let done = self.auditor.expected().slots_done;
        demand(done == self.slots, || {
            format!("{done} slots were commanded")
        })?;
        let footprint = self.image.footprint()?.unwrap_or_default();
        demand(footprint.lost_bytes + footprint.unsent_frames == 0, || {
            format!("the image has lost bytes or frames: {footprint:?}")
        })?;
        self.count("bytes and frames lost in the image", 0);
        Ok(self.tally)
    }

    fn count(&mut self, what: &'static str, times: u32) {
        *self.tally.entry(what).or_default() += u64::from(times);
    }

    /// Sends the same bytes to both, compares their answers and audits them.
    fn both(&mut self, input: &RoundInput<'_>) -> Result<Round, FlightError> {
        self.auditor.to_vehicle(input.from_ground);
        let image = self.image.round(input)?;
        let twin = self.twin.round(input)?;
        let done = self.auditor.expected().slots_done;
        let difference =
            |what: &str| format!("after slot {done}: the image and its twin differ in {what}");
        demand(image.to_ground == twin.to_ground, || {
            difference("the ground link")
        })?;
        demand(image.to_vehicle == twin.to_vehicle, || {
            difference("MAVLink")
        })?;
        let said_by_image = notices(&mut self.image, input.now);
        let said_by_twin = notices(&mut self.twin, input.now);
        demand(words(&said_by_image).eq(words(&said_by_twin)), || {
            difference("events")
        })?;
        self.notices.extend(said_by_image);
        demand(self.image.state() == self.twin.state(), || {
            difference("state")
        })?;
        self.count("bytes to the image", input.from_ground.len() as u32);
        self.count("bytes from the image, equal", image.to_ground.len() as u32);
        let audited = self.auditor.from_vehicle(&image.to_ground);
        for message in audited.map_err(|error: Violation<f32>| violation(&error.to_string()))? {
            match message {
                Audited::Command {
                    command,
                    state,
                    was_repeated,
                    ..
                } => self.commanded(&command, state.is_some(), was_repeated)?,
                Audited::Status(status) => self.counted(&status)?,
                Audited::Security(counters) => self.refused(counters)?,
                Audited::Arrival { .. } => {}
            }
        }
        Ok(image)
    }

    /// Checks that everything works again in the clean slot that ends a schedule.
    fn commanded<const J: usize>(
        &mut self,
        command: &SlotCommand<f32, J>,
        fresh: bool,
        asked_again: bool,
    ) -> io::Result<()> {
        if command.slot.is_multiple_of(SLOTS_EACH) {
            let complete = (command.rejected_gains, command.unheard_sensors) == (0, 0);
            demand(fresh && !asked_again && complete, || {
                format!("out of step after the faults: {command:?}")
            })?;
            self.count("resynchronized at the first clean frame", 1);
        }
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

    /// Compares the counters of authentication with the attacks, after the status that ends a
    /// schedule.
    fn refused(&mut self, counters: SecurityCounters) -> io::Result<()> {
        let done = self.auditor.expected().slots_done;
        if done == 0 || !done.is_multiple_of(SLOTS_EACH) {
            return Ok(());
        }
        let before = std::mem::replace(&mut self.security, counters);
        let counted = [
            counters.forged - before.forged,
            counters.replayed - before.replayed,
            counters.reflected - before.reflected,
            counters.unauthenticated - before.unauthenticated,
        ];
        demand(!self.is_decided || counted == self.attacks, || {
            format!("{counted:?} refused of {:?} attacks", self.attacks)
        })?;
        demand(counters.sessions == 1, || {
            format!("{} sessions", counters.sessions)
        })?;
        let kinds = [
            "refused: forged",
            "refused: replayed",
            "refused: reflected",
            "refused: without authentication",
        ];
        for (what, times) in kinds.into_iter().zip(counted) {
            self.count(what, times);
        }
        Ok(())
    }

    /// Compares the vehicle's counters with the injected faults in the clean slot that ends a
    /// schedule.
    fn counted(&mut self, status: &VehicleStatus) -> io::Result<()> {
        if status.slots_done == 0 || !status.slots_done.is_multiple_of(SLOTS_EACH) {
            return Ok(());
        }
        let (link, slots) = (&status.link, &status.slots);
        let injected = *self.link.injected();
        let (before, injected_before) = std::mem::replace(&mut self.begun, (*status, injected));
        self.attacks = [
            injected.forged - injected_before.forged,
            injected.replayed - injected_before.replayed,
            injected.reflected - injected_before.reflected,
            injected.downgraded - injected_before.downgraded,
        ];
        let faults: Vec<Fault> = (status.slots_done + 1 - SLOTS_EACH..=status.slots_done)
            .flat_map(|slot| self.schedule.faults(slot, Direction::Up))
            .collect();
        let undecided =
            |fault: &Fault| fault.is_damage() || matches!(fault, Fault::Silence | Fault::Flood(_));
        self.is_decided = !faults.iter().any(undecided);
        if self.is_decided {
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
        Fault::Forged => "injected: forged frames",
        Fault::Replayed => "injected: replayed frames",
        Fault::Reflected => "injected: reflected frames",
        Fault::Downgraded => "injected: frames without authentication",
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

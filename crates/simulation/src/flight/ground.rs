//! The ground's end of the link: answers arrivals with channel states and executes commands.

use std::collections::VecDeque;

use firmware_core::{
    Position, SENSORS_MAX, Scalar, USERS_MAX,
    controller::DatedChange,
    inner::{Method, Status},
    link::{Arrival, Endpoint, FRAME_MAX, Message, NumberedChange, SecurityCounters},
    mission::MEASUREMENT_M,
    time::{Duration, Instant},
};

use scenario::Events;

use super::precision;
use crate::{
    record::{LinkRecord, SecurityRecord, SlotRecord},
    world::{HostChannelState, HostSlotCommand, World},
};

/// The ground station of a mission.
#[derive(Debug)]
pub(super) struct Ground {
    world: World,
    events: Events,
    /// The number of events that were announced, and those of them that were not taken yet, in
    /// words.
    announced: u32,
    announcements: Vec<String>,
    method: Method<f64>,
    /// The vehicle is not told the quality of estimates.
    ignores_errors: bool,
    /// What is sent later, and when.
    delayed: VecDeque<(Instant, Vec<u8>)>,
    end: Endpoint,
    /// The slot whose command is awaited, and the true position of the vehicle.
    arrival: Option<(Arrival<f64>, Position<f64>)>,
    slots: Vec<SlotRecord>,
    /// The counters of the ground except for those of its end.
    link: LinkRecord,
    /// The last counters of the vehicle's authentication.
    vehicle_security: SecurityCounters,
}

impl Ground {
    /// Creates a ground station that tells the vehicle of the world's events and, unless
    /// `ignores_errors`, of the quality of its estimates; `method` is the method with which the
    /// vehicle allocates, and `end` the ground's end of the link.
    pub(super) fn new(
        (world, events): (World, Events),
        ignores_errors: bool,
        method: Method<f64>,
        end: Endpoint,
    ) -> Self {
        Self {
            world,
            events,
            ignores_errors,
            delayed: VecDeque::new(),
            announced: 0,
            announcements: Vec::new(),
            method,
            end,
            arrival: None,
            slots: Vec::new(),
            link: LinkRecord::default(),
            vehicle_security: SecurityCounters::default(),
        }
    }

    /// Returns the counters of received and lost messages.
    pub(super) fn link(&self) -> LinkRecord {
        LinkRecord {
            ground: *self.end.counters(),
            security: self.end.security().map(|&ground| SecurityRecord {
                vehicle: self.vehicle_security,
                ground,
            }),
            ..self.link
        }
    }

    pub(super) fn slots(&self) -> &[SlotRecord] {
        &self.slots
    }

    pub(super) fn slots_mut(&mut self) -> &mut [SlotRecord] {
        &mut self.slots
    }

    pub(super) fn into_slots(self) -> Vec<SlotRecord> {
        self.slots
    }

    /// Takes bytes from a vehicle that computes with numbers of type `T`, and returns the bytes to
    /// send to it at this time. `truth` returns the position of the vehicle at a time of its clock; if that is
    /// unknown, the position that the vehicle measured is used.
    pub(super) fn receive<T: Scalar>(
        &mut self,
        now: Instant,
        bytes: &[u8],
        truth: impl Fn(Instant) -> Option<Position<f64>>,
    ) -> Vec<u8> {
        let mut uplink = Vec::new();
        for &byte in bytes {
            let outcome = self.end.push::<T, USERS_MAX, SENSORS_MAX>(byte);
            // Each offer is answered before the next one is read.
            let mut frame = [0; FRAME_MAX];
            uplink.extend_from_slice(self.end.take_handshake(&mut frame).unwrap_or_default());
            match outcome {
                Some(Ok(Message::Arrival(arrival))) => {
                    let truth = truth(arrival.tick.time);
                    if let Some(state) = self.answer(&precision::arrival(&arrival), truth) {
                        uplink.extend(self.due_changes::<T>(state.slot));
                        let answer = self.state_frames::<T>(&state);
                        match self.world.state_delay() {
                            Duration::ZERO => uplink.extend(answer),
                            delay => self.delayed.push_back((now + delay, answer)),
                        }
                    }
                }
                Some(Ok(Message::Command(command))) => self.execute(&precision::command(&command)),
                Some(Ok(Message::Status(status))) => self.link.vehicle = status,
                Some(Ok(Message::Security(counters))) => self.vehicle_security = counters,
                Some(
                    Ok(Message::ChannelState(_) | Message::Change(_) | Message::Quality(_))
                    | Err(_),
                )
                | None => {}
            }
        }
        let due = self
            .delayed
            .iter()
            .take_while(|(due, _)| *due <= now)
            .count();
        uplink.extend(self.delayed.drain(..due).flat_map(|(_, late)| late));
        uplink
    }

    /// Returns the channel state of a slot as frames, after that of its quality; none if it gets lost.
    fn state_frames<T: Scalar>(&mut self, state: &HostChannelState) -> Vec<u8> {
        let mut frames = Vec::new();
        if self.world.loses_state(state.slot) {
            return frames;
        }
        if let Some(quality) = self
            .world
            .quality(state.slot)
            .filter(|_| !self.ignores_errors)
        {
            frames.extend(self.encode::<T>(&Message::Quality(quality)));
        }
        let state = precision::channel_state::<T>(state);
        frames.extend(self.encode(&Message::ChannelState(state)));
        frames
    }

    /// Encodes a message as a frame. What is said is an answer to a message of a session, so there is
    /// one; and every message fits, or `encode` would not compile.
    fn encode<T: Scalar>(&mut self, message: &Message<T, USERS_MAX, SENSORS_MAX>) -> Vec<u8> {
        let mut frame = [0; FRAME_MAX];
        let frame = self.end.encode(message, &mut frame);
        frame.map_or_else(|_| Vec::new(), <[u8]>::to_vec)
    }

    /// Returns the changes up to the slot after `slot` that the vehicle does not have yet, as
    /// frames.
    fn due_changes<T: Scalar>(&mut self, slot: u32) -> Vec<u8> {
        let is_late = self.is_out_of_reach_after(slot);
        let known = self.link.vehicle.slots.changes;
        let numbered = (1..).zip(self.events.changes());
        let due = numbered.filter(|(_, change)| change.from_slot <= slot + 1);
        let due = due.filter(|(number, _)| *number > known);
        let due: Vec<_> = due.map(|(number, change)| (number, *change)).collect();
        let mut frames = Vec::new();
        for (number, change) in due {
            if number > self.announced {
                self.announced = number;
                let DatedChange { from_slot, change } = change;
                let mut words = format!("from slot {from_slot} on, {change}");
                if is_late {
                    words += ", and the destination is out of reach";
                }
                // Nodes that move by themselves would be announced in every slot.
                if self.events.are_announced() {
                    self.announcements.push(words);
                }
            }
            let change = precision::change::<T>(&change);
            let message = Message::Change(NumberedChange { number, change });
            frames.extend(self.encode(&message));
        }
        frames
    }

    /// Returns whether the events of the slot after `slot` leave too little time for the way to the
    /// destination.
    fn is_out_of_reach_after(&self, slot: u32) -> bool {
        let mission = self.world.timeline().in_slot(slot + 1);
        let slots_left = f64::from(mission.slots().saturating_sub(slot) + 1);
        let destination = mission.parameters().destination;
        let reach_m = slots_left * mission.reach_m() + MEASUREMENT_M;
        let way = self.arrival.map(|(_, position)| position - destination);
        way.is_some_and(|way| way.norm() > reach_m)
    }

    /// Takes what was announced to the vehicle since the last call, in words.
    pub(super) fn take_announcements(&mut self) -> Vec<String> {
        std::mem::take(&mut self.announcements)
    }

    /// Returns the channels of the slot that the vehicle has flown; `None` if its command was
    /// already received.
    fn answer(
        &mut self,
        arrival: &Arrival<f64>,
        truth: Option<Position<f64>>,
    ) -> Option<HostChannelState> {
        if !self.world.has_slot(arrival.plan.slot) {
            self.link.nonsense += 1;
            return None;
        }
        if self.is_recorded(arrival.plan.slot) {
            self.link.repeated += 1;
            return None;
        }
        let position = match self.arrival {
            // A repeated request gets the same answer.
            Some((known, position)) if known == *arrival => {
                self.link.repeated += 1;
                position
            }
            earlier => {
                self.link.slots_missed += u32::from(earlier.is_some());
                truth.unwrap_or(arrival.position)
            }
        };
        self.arrival = Some((*arrival, position));
        Some(self.world.channel_state(arrival.plan.slot, &position))
    }

    fn is_recorded(&self, slot: u32) -> bool {
        self.slots.last().is_some_and(|last| last.slot >= slot)
    }

    /// Makes users and sensors transmit, and records the slot.
    fn execute(&mut self, command: &HostSlotCommand) {
        let served = command.served_user;
        let has_user = |user| self.world.has_user(command.slot, user);
        if !self.world.has_slot(command.slot) || served.is_some_and(|user| !has_user(user)) {
            self.link.nonsense += 1;
            return;
        }
        if self.is_recorded(command.slot) {
            self.link.repeated += 1;
            return;
        }
        let about_this = |(arrival, _): &mut (Arrival<f64>, _)| arrival.plan.slot == command.slot;
        let Some((arrival, position)) = self.arrival.take_if(about_this) else {
            // The position of the vehicle is not known.
            self.link.slots_missed += 1;
            return;
        };
        let outcome = self.world.transmit(command, &position);
        let waypoint = arrival.plan.waypoint;
        let planned_rate = if waypoint == position {
            outcome.rate
        } else {
            let user = command.served_user;
            self.world
                .rate_at(&self.method, command.slot, user, &waypoint)
        };
        let coefficients = &command.sensor_coefficients;
        let power_w: f64 = coefficients.iter().map(|b| b * b).sum();
        let sensors = self
            .world
            .timeline()
            .in_slot(command.slot)
            .sensors()
            .count();
        self.slots.push(SlotRecord {
            slot: command.slot,
            planned: waypoint,
            flown: position,
            tick: arrival.tick,
            served_user: command.served_user,
            user_power_w: command.user_power.0,
            normalizing_factor: command.normalizing_factor,
            sensor_power_mean_w: power_w / sensors as f64,
            rate: outcome.rate,
            planned_rate,
            mse: outcome.mse,
            perfect_rate: outcome.perfect_rate,
            limited_by: command.status.limited_by(),
            feasible: command.status.is_feasible(),
            at_error_floor: matches!(command.status, Status::ErrorFloor { .. }),
            intervention: arrival.plan.intervention,
            channel_source: command.source,
            age_slots: command.age_slots,
            signals: outcome.signals,
            plan_us: 0.0,
            allocate_us: 0.0,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_core::{controller::ChannelState, link};
    use firmware_core::{
        controller::{Controller, SlotCommand},
        policy::StraightLine,
        time::Tick,
    };
    use scenario::{Scenario, Topology, generate};

    fn frame(message: &Message<f64, USERS_MAX, SENSORS_MAX>) -> Vec<u8> {
        let mut buffer = [0; FRAME_MAX];
        link::encode(message, &mut buffer).expect("fits").to_vec()
    }

    /// Returns an arrival and a command of slot 1 as a correct vehicle sends them.
    fn slot_one(scenario: &Scenario) -> (Arrival<f64>, SlotCommand<f64, SENSORS_MAX>) {
        let mission = &scenario.mission;
        let mut controller = Controller::new(mission.clone(), StraightLine::new(mission));
        let plan = controller.plan(mission.parameters().start).expect("a plan");
        let state = ChannelState::predicted(mission, 1, &plan.waypoint);
        let command = controller.allocate(&state).expect("a command");
        let position = plan.waypoint;
        let tick = Tick::default();
        let arrival = Arrival {
            plan,
            position,
            tick,
        };
        (arrival, command)
    }

    /// The other end of a socket may send anything: slots and users that the mission does not have
    /// are counted and otherwise ignored.
    #[test]
    fn a_board_that_talks_nonsense_is_counted_and_ignored() {
        let scenario = generate(Topology::Mixed, 2, 3, 5).expect("a scenario");
        let slots = scenario.mission.slots();
        let world = World::new(&scenario, &Events::default(), 1, 10);
        let world = (world, Events::default());
        let mut ground = Ground::new(world, false, Method::Exact, Endpoint::new());
        let (arrival, command) = slot_one(&scenario);
        let mut said = 0;
        let say = |ground: &mut Ground, message| {
            ground
                .receive::<f64>(Instant::ZERO, &frame(&message), |_| None)
                .len()
        };
        for slot in [0, slots + 1, u32::MAX] {
            let mut astray = arrival;
            astray.plan.slot = slot;
            let command = SlotCommand {
                slot,
                ..command.clone()
            };
            assert_eq!(say(&mut ground, Message::Arrival(astray)), 0);
            assert_eq!(say(&mut ground, Message::Command(command)), 0);
            said += 2;
        }
        assert!(say(&mut ground, Message::Arrival(arrival)) > 0);
        for user in [3, usize::MAX] {
            let command = SlotCommand {
                served_user: Some(user),
                ..command.clone()
            };
            say(&mut ground, Message::Command(command));
            said += 1;
        }
        assert_eq!(ground.slots().len(), 0);
        assert_eq!(
            (ground.link().nonsense, ground.link().slots_missed),
            (said, 0)
        );
        // A valid command is still accepted.
        say(&mut ground, Message::Command(command));
        assert_eq!(ground.slots().len(), 1);
    }
}

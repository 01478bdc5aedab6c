//! An auditor of the ground link: it sees the bytes that the vehicle receives and sends, and
//! demands the rules of the protocol, whatever was damaged on the way.
//!
//! ```text
//!   ground --- faults ---> to_vehicle   ---> vehicle
//!   ground <-- faults ---- from_vehicle <--- vehicle
//! ```
//!
//! | the vehicle's | must |
//! |---|---|
//! | frames | be whole, and of the kinds that a vehicle sends |
//! | arrivals | be about the next slot, or the same arrival again while its command is missing |
//! | commands | follow the arrival of their slot and [keep every limit](firmware_core::controller::SlotCommand::check) of the mission |
//! | commands from a state that was received | state the rejected gains and the unheard sensors, give no power to the latter, serve a user that is heard if there is one, and keep the promised MSE at these gains, in expectation where the quality of the state says that they are not exact |
//! | other commands | say that they are from an aged state |
//! | changes | be taken in turn, and have their effect in their slot |
//! | counters | be those that follow from these bytes: each piece, message, state and slot is counted once |
//! | frames on an authenticated link | be of the session that the vehicle has taken, with the next counter |
//!
//! The auditor is generic over precision and capacities. It does not know the true channels, and it
//! does not see MAVLink or the policy: the counters of MAVLink and the quality of the plan are not
//! audited.

mod command;
#[cfg(test)]
mod tests;
mod violation;

use firmware_core::{
    Mission, SENSORS_MAX, Scalar, USERS_MAX,
    controller::{
        CHANGES_MAX, ChannelQuality, ChannelSource, ChannelState, DatedChange, Plan, SlotCommand,
    },
    link::{
        Arrival, Credentials, Decoder, Endpoint, LinkCounters, Message, NumberedChange,
        SecurityCounters, VehicleStatus,
    },
    mission::MissionChange,
};

use command::{check_against_state, check_count};
pub use violation::Violation;

/// A message of the vehicle that keeps the rules.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // one at a time is used
pub enum Audited<T: Scalar, const M: usize = USERS_MAX, const J: usize = SENSORS_MAX> {
    /// The vehicle is at the end of a slot.
    Arrival {
        /// The message.
        arrival: Arrival<T>,
        /// Whether the same arrival was sent before.
        is_repeated: bool,
    },
    /// The transmissions of a slot.
    Command {
        /// The message.
        command: SlotCommand<T, J>,
        /// The plan of the slot, according to its arrival.
        plan: Plan<T>,
        /// The state that was received for the slot and used.
        state: Option<ChannelState<T, M, J>>,
        /// Whether the arrival of the slot was sent more than once.
        was_repeated: bool,
    },
    /// The counters of the vehicle.
    Status(VehicleStatus),
    /// The counters of the vehicle's authentication.
    Security(SecurityCounters),
}

/// A slot whose command is awaited.
#[derive(Debug)]
struct Awaited<T: Scalar, const M: usize, const J: usize> {
    plan: Plan<T>,
    /// The state that the command must be from.
    state: Option<ChannelState<T, M, J>>,
    was_repeated: bool,
}

/// The auditor of the link between a ground and a vehicle.
#[derive(Debug)]
pub struct LinkAuditor<T: Scalar, const M: usize = USERS_MAX, const J: usize = SENSORS_MAX> {
    /// The mission as the vehicle knows it.
    mission: Mission<T, M, J>,
    /// The changes of the mission that are not in effect yet.
    pending: Vec<DatedChange<T>>,
    /// An end like the vehicle's.
    vehicle: Endpoint,
    /// The number of pieces between delimiters that were sent to the vehicle, and whether the last
    /// one is not delimited yet.
    pieces: u32,
    is_within_piece: bool,
    /// A decoder like the ground's, on a link without faults.
    ground: Decoder,
    awaited: Option<Awaited<T, M, J>>,
    /// The quality of the states, and the number of qualities that the vehicle has taken.
    quality: ChannelQuality<M, J>,
    qualities_taken: u32,
    /// The counters that follow from the bytes, except for those of the decoder.
    expected: VehicleStatus,
}

impl<T: Scalar, const M: usize, const J: usize> LinkAuditor<T, M, J> {
    /// Creates an auditor of a vehicle that has just been started with this mission.
    pub fn new(mission: Mission<T, M, J>) -> Self {
        Self {
            mission,
            pending: Vec::new(),
            vehicle: Endpoint::new(),
            pieces: 0,
            is_within_piece: false,
            ground: Decoder::new(),
            awaited: None,
            quality: ChannelQuality::default(),
            qualities_taken: 0,
            expected: VehicleStatus::default(),
        }
    }

    /// Creates an auditor of a vehicle with these credentials.
    pub fn authenticated(mission: Mission<T, M, J>, credentials: Credentials) -> Self {
        Self {
            vehicle: Endpoint::vehicle(credentials),
            ..Self::new(mission)
        }
    }

    /// Returns the counters of authentication that the vehicle should have.
    pub fn security(&self) -> Option<&SecurityCounters> {
        self.vehicle.security()
    }

    /// Returns the counters that the vehicle should have; those of MAVLink are 0.
    pub fn expected(&self) -> VehicleStatus {
        VehicleStatus {
            link: *self.vehicle.counters(),
            ..self.expected
        }
    }

    /// Takes bytes that are about to be delivered to the vehicle. A state of slot 1 is expected
    /// after its arrival only: the link does not show when the vehicle begins slot 1.
    pub fn to_vehicle(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.pieces += u32::from(byte != 0 && !self.is_within_piece);
            self.is_within_piece = byte != 0;
            match self.vehicle.push::<T, M, J>(byte) {
                Some(Ok(Message::ChannelState(state))) => self.expect_state(state),
                Some(Ok(Message::Change(change))) => self.expect_change(&change),
                Some(Ok(Message::Quality(quality))) => self.expect_quality(quality),
                Some(Ok(_)) => self.expected.slots.echoes += 1,
                Some(Err(_)) | None => {}
            }
        }
    }

    /// Returns whether a slot is known to be under way: from slot 2 on the next slot begins with the
    /// command of the last one.
    fn is_under_way(&self) -> bool {
        let done = self.expected.slots_done;
        self.awaited.is_some() || (1..self.mission.slots()).contains(&done)
    }

    /// Predicts what the vehicle does with a change.
    fn expect_change(&mut self, change: &NumberedChange<T>) {
        let counters = &mut self.expected.slots;
        let change_now = change.change.from_slot <= self.expected.slots_done + 1;
        let has_space = change_now || self.pending.len() < CHANGES_MAX;
        if change.number != counters.changes + 1 || !has_space {
            counters.changes_out_of_turn += 1;
            return;
        }
        counters.changes += 1;
        if change_now {
            self.make_change(&change.change.change);
        } else {
            self.pending.push(change.change);
        }
    }

    fn make_change(&mut self, change: &MissionChange<T>) {
        let begun = self.expected.slots_done + u32::from(self.is_under_way());
        let refused = self.mission.change(change, begun).is_err();
        self.expected.slots.changes_refused += u32::from(refused);
    }

    /// Makes the changes of the slot that begins with a command.
    fn begin_slot(&mut self) {
        let (slots_done, slot) = (self.expected.slots_done, self.expected.slots_done + 1);
        let (due, later) = self
            .pending
            .drain(..)
            .partition::<Vec<_>, _>(|change| change.from_slot <= slot);
        self.pending = later;
        for DatedChange { change, .. } in due {
            let refused = self.mission.change(&change, slots_done).is_err();
            self.expected.slots.changes_refused += u32::from(refused);
        }
    }

    /// Predicts how the vehicle counts a state.
    fn expect_state(&mut self, state: ChannelState<T, M, J>) {
        let has_begun = self.is_under_way();
        let counters = &mut self.expected.slots;
        let fits = state.user_gains.len() == self.mission.user_count()
            && state.sensor_gains.len() == self.mission.sensor_count();
        let done = self.expected.slots_done;
        if !has_begun || state.slot != done + 1 {
            counters.states_out_of_turn += 1;
        } else if !fits {
            counters.states_of_wrong_size += 1;
        } else if let Some(awaited) = self.awaited.as_mut().filter(|slot| slot.state.is_none()) {
            awaited.state = Some(state);
        } else {
            counters.states_out_of_turn += 1;
        }
    }

    /// Predicts what the vehicle does with a quality.
    fn expect_quality(&mut self, quality: ChannelQuality<M, J>) {
        let slots = self.quality.slot..=self.expected.slots_done + 1;
        let fits = quality.users.len() == self.mission.user_count()
            && quality.sensors.len() == self.mission.sensor_count();
        if !slots.contains(&quality.slot) {
            self.expected.slots.states_out_of_turn += 1;
        } else if !fits {
            self.expected.slots.states_of_wrong_size += 1;
        } else {
            self.quality = quality;
            self.qualities_taken += 1;
        }
    }

    /// Takes bytes as the vehicle has sent them, without faults, and returns their messages.
    ///
    /// # Errors
    /// Returns the first violation of a rule.
    pub fn from_vehicle(&mut self, bytes: &[u8]) -> Result<Vec<Audited<T, M, J>>, Violation<T>> {
        let mut messages = Vec::new();
        for &byte in bytes {
            let message = self.vehicle.observe::<T, M, J>(&mut self.ground, byte);
            if let Some(message) = message {
                messages.push(match message.map_err(Violation::Frame)? {
                    Message::Arrival(arrival) => self.audit_arrival(arrival)?,
                    Message::Command(command) => self.audit_command(command)?,
                    Message::Status(status) => {
                        self.check_status(&status)?;
                        Audited::Status(status)
                    }
                    Message::Security(counters) => {
                        let expected = self.security();
                        if expected != Some(&counters) {
                            return Err(Violation::Security {
                                counters,
                                expected: expected.copied(),
                            });
                        }
                        Audited::Security(counters)
                    }
                    Message::ChannelState(state) => {
                        return Err(Violation::ChannelState { slot: state.slot });
                    }
                    Message::Change(change) => {
                        return Err(Violation::Change {
                            number: change.number,
                        });
                    }
                    Message::Quality(quality) => {
                        return Err(Violation::Quality { slot: quality.slot });
                    }
                });
            }
        }
        Ok(messages)
    }

    fn audit_arrival(&mut self, arrival: Arrival<T>) -> Result<Audited<T, M, J>, Violation<T>> {
        let plan = arrival.plan;
        let is_repeated = self.awaited.is_some();
        if let Some(awaited) = &mut self.awaited {
            if awaited.plan != plan {
                return Err(Violation::OtherArrival {
                    slot: awaited.plan.slot,
                    got: plan.slot,
                });
            }
            awaited.was_repeated = true;
            self.expected.slots.arrivals_repeated += 1;
        } else {
            let next = self.expected.slots_done + 1;
            if plan.slot != next || next > self.mission.slots() {
                let got = plan.slot;
                return Err(Violation::Arrival { got, next });
            }
            self.awaited = Some(Awaited {
                plan,
                state: None,
                was_repeated: false,
            });
        }
        Ok(Audited::Arrival {
            arrival,
            is_repeated,
        })
    }

    fn audit_command(
        &mut self,
        command: SlotCommand<T, J>,
    ) -> Result<Audited<T, M, J>, Violation<T>> {
        let slot = command.slot;
        let awaited = self.awaited.take_if(|awaited| awaited.plan.slot == slot);
        let awaited = awaited.ok_or(Violation::CommandOutOfTurn { slot })?;
        let broken = |error| Violation::Command { slot, error };
        command.check(&self.mission).map_err(broken)?;
        let fresh = command.source == ChannelSource::Measured;
        if fresh != awaited.state.is_some() || fresh != (command.age_slots == 0) {
            return Err(Violation::Source {
                slot,
                named: command.source,
                age_slots: command.age_slots,
                received: awaited.state.is_some(),
            });
        }
        match &awaited.state {
            Some(state) => {
                check_against_state(&self.mission, &command, (state, &self.quality))?;
            }
            None => check_count(slot, "rejected gains", command.rejected_gains, 0)?,
        }
        let counters = &mut self.expected.slots;
        counters.measured += u32::from(fresh);
        counters.stale += u32::from(!fresh);
        counters.infeasible += u32::from(!command.status.is_feasible());
        counters.nobody_served += u32::from(command.served_user.is_none());
        let planned = awaited.plan.served_user;
        counters.user_replaced += u32::from(command.served_user.is_some_and(|m| m != planned));
        counters.rejected_gains += u32::from(command.rejected_gains);
        counters.unheard_sensors += u32::from(command.unheard_sensors);
        self.expected.slots_done += 1;
        self.begin_slot();
        Ok(Audited::Command {
            command,
            plan: awaited.plan,
            state: awaited.state,
            was_repeated: awaited.was_repeated,
        })
    }

    /// Checks the counters of the vehicle against the bytes so far.
    ///
    /// # Errors
    /// Returns an error if a counter has another value, or if something was not counted.
    pub fn check_status(&self, status: &VehicleStatus) -> Result<(), Violation<T>> {
        self.check_link_counters(&status.link)?;
        let expected = VehicleStatus {
            mavlink: status.mavlink,
            mavlink_unreadable: status.mavlink_unreadable,
            plan: status.plan,
            ..self.expected()
        };
        if *status != expected {
            return Err(Violation::Counters(Box::new((*status, expected))));
        }
        let slots = &status.slots;
        let waiting = self
            .awaited
            .as_ref()
            .is_some_and(|slot| slot.state.is_some());
        let used = slots.measured
            + slots.states_out_of_turn
            + slots.states_of_wrong_size
            + slots.changes
            + slots.changes_out_of_turn
            + slots.echoes
            + self.qualities_taken
            + u32::from(waiting);
        let messages = status.link.messages;
        if messages != used || slots.measured + slots.stale != status.slots_done {
            return Err(Violation::Uncounted { messages, used });
        }
        Ok(())
    }

    /// Checks the counters of the vehicle's decoder against the bytes so far: each piece between
    /// delimiters is counted once.
    ///
    /// # Errors
    /// Returns an error if a counter has another value, or if a piece was not counted.
    pub fn check_link_counters(&self, counters: &LinkCounters) -> Result<(), Violation<T>> {
        let expected = self.vehicle.counters();
        let authentication = self
            .security()
            .map_or(0, |security| security.refused() + security.handshakes);
        let counted = counters.messages + counters.dropped() + authentication;
        let pieces = self.pieces - u32::from(self.is_within_piece);
        if counters == expected && counted == pieces {
            return Ok(());
        }
        Err(Violation::Link {
            counters: *counters,
            expected: *expected,
            pieces,
        })
    }
}

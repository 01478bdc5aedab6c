//! The ground's end of the link: answers arrivals with channel state, does what is commanded.

use firmware_core::{
    Position, SENSORS_MAX, USERS_MAX,
    link::{self, Arrival, Decoder, FRAME_MAX, Message},
};

use crate::{
    record::SlotRecord,
    world::{HostSlotCommand, World},
};

type HostMessage = Message<f64, USERS_MAX, SENSORS_MAX>;

/// The ground station of a mission.
#[derive(Debug)]
pub(super) struct Ground {
    world: World,
    decoder: Decoder,
    /// The slot whose command is awaited, and where the vehicle truly is.
    arrival: Option<(Arrival<f64>, Position<f64>)>,
    slots: Vec<SlotRecord>,
}

impl Ground {
    pub(super) fn new(world: World) -> Self {
        Self {
            world,
            decoder: Decoder::new(),
            arrival: None,
            slots: Vec::new(),
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

    /// Takes bytes from the vehicle and returns those that go up to it. Where the vehicle's true
    /// position is not known, the one it measured counts.
    pub(super) fn receive(&mut self, bytes: &[u8], truth: Option<Position<f64>>) -> Vec<u8> {
        let mut uplink = Vec::new();
        for &byte in bytes {
            let outcome = self.decoder.push::<f64, USERS_MAX, SENSORS_MAX>(byte);
            match outcome {
                Some(Ok(Message::Arrival(arrival))) => {
                    let position = truth.unwrap_or(arrival.position);
                    let state = self.world.channel_state(arrival.plan.slot, &position);
                    self.arrival = Some((arrival, position));
                    let mut frame = [0; FRAME_MAX];
                    let message: HostMessage = Message::ChannelState(state);
                    if let Ok(frame) = link::encode(&message, &mut frame) {
                        uplink.extend_from_slice(frame);
                    }
                }
                Some(Ok(Message::Command(command))) => self.obey(&command),
                Some(Ok(Message::ChannelState(_)) | Err(_)) | None => {}
            }
        }
        uplink
    }

    /// Users and sensors transmit; the slot is recorded.
    fn obey(&mut self, command: &HostSlotCommand) {
        let Some((arrival, position)) = self.arrival.take() else {
            return;
        };
        let outcome = self.world.transmit(command, &position);
        let coefficients = &command.sensor_coefficients;
        let power_w: f64 = coefficients.iter().map(|b| b * b).sum();
        self.slots.push(SlotRecord {
            slot: command.slot,
            planned: arrival.plan.waypoint,
            flown: position,
            served_user: command.served_user,
            user_power_w: command.user_power.0,
            normalizing_factor: command.normalizing_factor,
            sensor_power_mean_w: power_w / coefficients.len().max(1) as f64,
            rate: outcome.rate,
            mse: outcome.mse,
            limited_by: command.status.limited_by(),
            feasible: command.status.is_feasible(),
            intervention: arrival.plan.intervention,
            channel_source: command.source,
            signals: outcome.signals,
            plan_us: 0.0,
            allocate_us: 0.0,
        });
    }
}

//! The vehicle's side of the mission protocol, with the peculiarities of each autopilot, and the
//! flight of an uploaded mission.

// Autopilots still send the request that MAVLink has since deprecated.
#![allow(deprecated)]

use firmware_core::autopilot::frames::Geodetic;
use firmware_core::autopilot::profile::Firmware;
use firmware_core::autopilot::wire::Address;
use firmware_core::time::{Duration, Instant};
use mavlink::dialects::common::{
    MISSION_ACK_DATA, MISSION_COUNT_DATA, MISSION_CURRENT_DATA, MISSION_ITEM_INT_DATA,
    MISSION_ITEM_REACHED_DATA, MISSION_REQUEST_DATA, MISSION_REQUEST_INT_DATA, MavCmd, MavFrame,
    MavMessage, MavMissionResult, MavMissionType, MavResult,
};

use super::body::Demand;
use super::mission_store::{Incoming, Missions};
use super::simulated::{FlightMode, Vehicle};

const ASK_AGAIN: Duration = Duration::from_secs(1);
/// A transfer ends after this time without progress.
const GIVE_UP: Duration = Duration::from_secs(8);
/// PX4 does not start a mission that was stored less than this time ago.
const SETTLE: Duration = Duration::from_millis(500);
/// A waypoint counts as reached within this distance, m.
const REACHED_M: f64 = 2.0;
/// ArduCopter does not accept a mission until this long after it has booted.
const NO_SPACE_UNTIL: Instant = Instant::from_micros(2_400_000);
/// The largest number of items that are stored.
const CAPACITY: u16 = 700;

const MISSION: MavMissionType = MavMissionType::MAV_MISSION_TYPE_MISSION;

impl Vehicle {
    /// Handles a message of the mission protocol. Returns false if the message does not belong to
    /// it.
    pub(super) fn handle_mission(
        &mut self,
        now: Instant,
        from: Address,
        message: &MavMessage,
    ) -> bool {
        match message {
            MavMessage::MISSION_COUNT(offer) => {
                let early = self.behavior().boots_without_mission_space && now < NO_SPACE_UNTIL;
                if early || offer.count > CAPACITY {
                    self.answer_mission(from, MavMissionResult::MAV_MISSION_NO_SPACE);
                    return true;
                }
                // ArduCopter overwrites the old mission as items are received; PX4 replaces it at
                // the end.
                if self.behavior().overwrites_mission_items {
                    self.missions.items.clear();
                }
                self.missions.incoming = Some(Incoming {
                    from,
                    count: offer.count,
                    items: Vec::new(),
                    new_requests: false,
                    asked: now,
                    progress: now,
                });
                self.ask_for_item(now);
            }
            MavMessage::MISSION_ITEM_INT(item) => self.take_item(now, from, item),
            MavMessage::MISSION_CLEAR_ALL(_) => {
                self.missions = Missions::default();
                self.answer_mission(from, MavMissionResult::MAV_MISSION_ACCEPTED);
            }
            MavMessage::MISSION_REQUEST_LIST(_) => {
                let count = self.missions.items.len() as u16;
                self.send(&MavMessage::MISSION_COUNT(MISSION_COUNT_DATA {
                    count,
                    target_system: from.system,
                    target_component: from.component,
                    mission_type: MISSION,
                    opaque_id: 0,
                }));
            }
            MavMessage::MISSION_REQUEST_INT(request) => self.give_item(from, request.seq),
            MavMessage::MISSION_REQUEST(request) => self.give_item(from, request.seq),
            // PX4 sends the deprecated request for the first item. A client that does not support
            // it says so (as MAVSDK does), and PX4 then sends the new one.
            MavMessage::MISSION_ACK(ack)
                if self.behavior().repeats_refused_requests
                    && ack.mavtype == MavMissionResult::MAV_MISSION_UNSUPPORTED =>
            {
                let incoming = self.missions.incoming.as_mut();
                if let Some(incoming) = incoming.filter(|i| i.from == from && !i.new_requests) {
                    incoming.new_requests = true;
                    self.ask_for_item(now);
                }
            }
            MavMessage::MISSION_ACK(ack) => {
                let over = ack.mavtype != MavMissionResult::MAV_MISSION_ACCEPTED;
                if over
                    && self
                        .missions
                        .incoming
                        .as_ref()
                        .is_some_and(|i| i.from == from)
                {
                    self.missions.incoming = None;
                }
            }
            _ => return false,
        }
        true
    }

    fn answer_mission(&mut self, to: Address, result: MavMissionResult) {
        self.send(&MavMessage::MISSION_ACK(MISSION_ACK_DATA {
            target_system: to.system,
            target_component: to.component,
            mavtype: result,
            mission_type: MISSION,
            opaque_id: 0,
        }));
    }

    fn ask_for_item(&mut self, now: Instant) {
        let Some(incoming) = &mut self.missions.incoming else {
            return;
        };
        incoming.asked = now;
        let (to, seq) = (incoming.from, incoming.items.len() as u16);
        // ArduCopter sends the deprecated request and accepts the new item. PX4 does the same at
        // first.
        let old = match self.firmware {
            Firmware::ArduCopter => true,
            Firmware::Px4 => seq == 0 && !incoming.new_requests,
            Firmware::Generic => false,
        };
        self.send(&if old {
            MavMessage::MISSION_REQUEST(MISSION_REQUEST_DATA {
                seq,
                target_system: to.system,
                target_component: to.component,
                mission_type: MISSION,
            })
        } else {
            MavMessage::MISSION_REQUEST_INT(MISSION_REQUEST_INT_DATA {
                seq,
                target_system: to.system,
                target_component: to.component,
                mission_type: MISSION,
            })
        });
    }

    fn take_item(&mut self, now: Instant, from: Address, item: &MISSION_ITEM_INT_DATA) {
        let behavior = self.behavior();
        let Some(incoming) = &mut self.missions.incoming else {
            return;
        };
        let numbers = [item.param1, item.param2, item.param3, item.param4, item.z];
        if incoming.from != from || usize::from(item.seq) != incoming.items.len() {
            return;
        }
        if !numbers.iter().all(|v| v.is_finite()) {
            self.missions.incoming = None;
            self.answer_mission(from, MavMissionResult::MAV_MISSION_INVALID);
            return;
        }
        // PX4 accepts commands without a position only in the frame MISSION.
        let placeless = matches!(
            item.command,
            MavCmd::MAV_CMD_DO_CHANGE_SPEED | MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH
        );
        let wrong_frame = placeless != (item.frame == MavFrame::MAV_FRAME_MISSION);
        if wrong_frame && behavior.requires_mission_frame {
            self.missions.incoming = None;
            self.answer_mission(from, MavMissionResult::MAV_MISSION_UNSUPPORTED);
            return;
        }
        incoming.items.push(item.clone());
        incoming.progress = now;
        if behavior.overwrites_mission_items {
            self.missions.items.clone_from(&incoming.items);
        }
        if incoming.items.len() < usize::from(incoming.count) {
            self.ask_for_item(now);
            return;
        }
        self.missions.items = std::mem::take(&mut incoming.items);
        self.missions.incoming = None;
        self.missions.stored_at = Some(now);
        self.missions.current = 0;
        self.answer_mission(from, MavMissionResult::MAV_MISSION_ACCEPTED);
    }

    fn give_item(&mut self, to: Address, seq: u16) {
        match self.missions.items.get(usize::from(seq)) {
            Some(item) => {
                let item = MISSION_ITEM_INT_DATA {
                    target_system: to.system,
                    target_component: to.component,
                    ..item.clone()
                };
                self.send(&MavMessage::MISSION_ITEM_INT(item));
            }
            None => self.answer_mission(to, MavMissionResult::MAV_MISSION_INVALID_SEQUENCE),
        }
    }

    /// Requests an item again if it was not received, and finally gives up.
    pub(super) fn tend_mission_transfer(&mut self, now: Instant) {
        let Some(incoming) = &self.missions.incoming else {
            return;
        };
        if now - incoming.progress >= GIVE_UP {
            let from = incoming.from;
            // ArduCopter keeps the part that was received, and AUTO flies it.
            self.missions.incoming = None;
            self.answer_mission(from, MavMissionResult::MAV_MISSION_OPERATION_CANCELLED);
        } else if now - incoming.asked >= ASK_AGAIN {
            self.ask_for_item(now);
        }
    }

    /// Returns whether a mission was stored so recently that PX4 does not start it.
    pub(super) fn mission_settles(&self, now: Instant) -> bool {
        let fresh = self.missions.stored_at.is_some_and(|at| now - at < SETTLE);
        fresh && self.behavior().settles_missions
    }

    /// Handles MISSION_START.
    pub(super) fn start_mission(&mut self, now: Instant) -> MavResult {
        if self.missions.items.is_empty() || !self.armed {
            MavResult::MAV_RESULT_FAILED
        } else if self.mission_settles(now) {
            MavResult::MAV_RESULT_TEMPORARILY_REJECTED
        } else {
            self.set_mode(FlightMode::Auto);
            self.missions.current = 0;
            MavResult::MAV_RESULT_ACCEPTED
        }
    }

    /// Returns the demand of the present item, or `None` if there is nothing (more) to fly.
    pub(super) fn mission_demand(&self) -> Option<Demand> {
        let item = self.missions.items.get(self.missions.current)?;
        let altitude_m = f64::from(item.z);
        Some(match item.command {
            MavCmd::MAV_CMD_NAV_TAKEOFF => Demand::Hold { altitude_m },
            MavCmd::MAV_CMD_NAV_WAYPOINT => Demand::Go {
                position: self.local_frame().from_geodetic(Geodetic {
                    latitude_e7: item.x,
                    longitude_e7: item.y,
                }),
                altitude_m,
                speed_mps: self.missions.speed_mps.unwrap_or(f64::INFINITY),
            },
            _ => Demand::Hold {
                altitude_m: self.hold_altitude_m,
            },
        })
    }

    /// Proceeds to the next item when the present one is complete.
    pub(super) fn fly_mission(&mut self) {
        if self.mode != FlightMode::Auto || !self.armed {
            return;
        }
        let Some(item) = self.missions.items.get(self.missions.current).cloned() else {
            self.set_mode(FlightMode::Loiter);
            return;
        };
        let is_home = self.missions.current == 0 && self.firmware.mission_begins_with_home();
        let high = (self.body.altitude_m - f64::from(item.z)).abs() < 0.5;
        let done = match item.command {
            _ if is_home => true,
            MavCmd::MAV_CMD_NAV_TAKEOFF => high,
            MavCmd::MAV_CMD_NAV_WAYPOINT => match self.mission_demand() {
                Some(Demand::Go { position, .. }) => {
                    (position - self.body.position).norm() < REACHED_M
                }
                _ => true,
            },
            MavCmd::MAV_CMD_DO_CHANGE_SPEED => {
                self.missions.speed_mps = Some(f64::from(item.param2).max(0.5));
                true
            }
            MavCmd::MAV_CMD_NAV_LAND => {
                self.set_mode(FlightMode::Land);
                false
            }
            MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH => {
                self.set_mode(FlightMode::Return);
                false
            }
            _ => true,
        };
        if !done {
            return;
        }
        self.hold_altitude_m = self.body.altitude_m;
        // PX4 sends this more than once.
        for _ in 0..self.behavior().reached_messages {
            let seq = item.seq;
            self.send(&MavMessage::MISSION_ITEM_REACHED(
                MISSION_ITEM_REACHED_DATA { seq },
            ));
        }
        self.missions.current += 1;
        self.send(&MavMessage::MISSION_CURRENT(MISSION_CURRENT_DATA {
            seq: self.missions.current as u16,
            ..MISSION_CURRENT_DATA::DEFAULT
        }));
    }
}

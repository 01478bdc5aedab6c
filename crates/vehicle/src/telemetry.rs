//! The messages that the vehicle sends by itself.

use firmware_core::autopilot::frames::MapFrame;
use firmware_core::autopilot::profile::Firmware;
use firmware_core::autopilot::wire::{MAX_FRAME, ekf_status_report};
use firmware_core::time::Instant;
use firmware_core::{Displacement, Position};
use mavlink::MessageData;
use mavlink::dialects::common::{
    ATTITUDE_DATA, CURRENT_MODE_DATA, ESTIMATOR_STATUS_DATA, EXTENDED_SYS_STATE_DATA,
    EstimatorStatusFlags, GLOBAL_POSITION_INT_DATA, GPS_GLOBAL_ORIGIN_DATA, HEARTBEAT_DATA,
    LOCAL_POSITION_NED_DATA, MavLandedState, MavMessage, MavModeFlag, MavSeverity, MavState,
    MavSysStatusSensor, MavSysStatusSensorExtended, MavType, MavVtolState, STATUSTEXT_DATA,
    SYS_STATUS_DATA,
};

use super::simulated::{FlightMode, Vehicle};

impl Vehicle {
    pub(super) fn transmit_due(&mut self, now: Instant) {
        while let Some(message) = self.streams.take_due(now) {
            self.streams.sending = true;
            self.send_message(now, message);
            self.streams.sending = false;
        }
    }

    /// Sends the message with this id once. Returns false if there is no such message.
    pub(super) fn send_message(&mut self, now: Instant, message: u32) -> bool {
        let sampled = self.sampled(now, message);
        let time_boot_ms = sampled.millis_wrapping();
        let position_muted = self.faults.no_position || !self.has_position();
        match message {
            HEARTBEAT_DATA::ID => {
                if !self.faults.no_heartbeat {
                    self.send_heartbeat();
                }
            }
            SYS_STATUS_DATA::ID => self.send_sys_status(),
            LOCAL_POSITION_NED_DATA::ID if position_muted => {}
            GLOBAL_POSITION_INT_DATA::ID if position_muted => {}
            LOCAL_POSITION_NED_DATA::ID => {
                let frame = self.local_frame();
                let (x, y) = frame.to_local(self.reported_position(sampled));
                let velocity = self.body.velocity;
                self.send(&MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA {
                    time_boot_ms,
                    x,
                    y,
                    z: -self.body.altitude_m as f32,
                    vx: velocity.y as f32,
                    vy: velocity.x as f32,
                    vz: -self.body.climb_mps as f32,
                }));
            }
            GLOBAL_POSITION_INT_DATA::ID => {
                let place = self
                    .local_frame()
                    .to_geodetic(self.reported_position(sampled));
                let altitude_m = self.body.altitude_m;
                let centi = |v: f64| (v * 100.0).round() as i16;
                self.send(&MavMessage::GLOBAL_POSITION_INT(GLOBAL_POSITION_INT_DATA {
                    time_boot_ms,
                    lat: place.latitude_e7,
                    lon: place.longitude_e7,
                    alt: ((altitude_m + self.settings.elevation_m) * 1e3).round() as i32,
                    relative_alt: (altitude_m * 1e3).round() as i32,
                    vx: centi(self.body.velocity.y),
                    vy: centi(self.body.velocity.x),
                    vz: centi(-self.body.climb_mps),
                    hdg: 0,
                }));
            }
            ATTITUDE_DATA::ID => self.send(&MavMessage::ATTITUDE(ATTITUDE_DATA {
                time_boot_ms,
                ..ATTITUDE_DATA::DEFAULT
            })),
            GPS_GLOBAL_ORIGIN_DATA::ID if !self.is_ready() => return false,
            GPS_GLOBAL_ORIGIN_DATA::ID => {
                let origin = self.local_origin();
                self.send(&MavMessage::GPS_GLOBAL_ORIGIN(GPS_GLOBAL_ORIGIN_DATA {
                    latitude: origin.latitude_e7,
                    longitude: origin.longitude_e7,
                    altitude: (self.settings.elevation_m * 1e3).round() as i32,
                    time_usec: now.as_micros(),
                }));
            }
            ESTIMATOR_STATUS_DATA::ID
                if self.firmware.estimator_message() == ESTIMATOR_STATUS_DATA::ID =>
            {
                let flags = self.estimator_flags();
                self.send(&MavMessage::ESTIMATOR_STATUS(ESTIMATOR_STATUS_DATA {
                    time_usec: now.as_micros(),
                    flags,
                    pos_horiz_accuracy: 0.3,
                    ..ESTIMATOR_STATUS_DATA::DEFAULT
                }));
            }
            ekf_status_report::ID if self.firmware.estimator_message() == ekf_status_report::ID => {
                let mut buffer = [0; MAX_FRAME];
                let flags = self.estimator_flags();
                let frame = self
                    .encoder
                    .encode_ekf_status_report(flags, &mut buffer)
                    .to_vec();
                self.enqueue(frame);
            }
            EXTENDED_SYS_STATE_DATA::ID => {
                let landed_state = if self.body.is_on_ground() {
                    MavLandedState::MAV_LANDED_STATE_ON_GROUND
                } else {
                    MavLandedState::MAV_LANDED_STATE_IN_AIR
                };
                self.send(&MavMessage::EXTENDED_SYS_STATE(EXTENDED_SYS_STATE_DATA {
                    vtol_state: MavVtolState::MAV_VTOL_STATE_UNDEFINED,
                    landed_state,
                }));
            }
            CURRENT_MODE_DATA::ID if self.behavior().reports_current_mode => {
                let custom_mode = self.custom_mode(self.mode);
                self.send(&MavMessage::CURRENT_MODE(CURRENT_MODE_DATA {
                    custom_mode,
                    intended_custom_mode: custom_mode,
                    ..CURRENT_MODE_DATA::DEFAULT
                }));
            }
            _ => return false,
        }
        true
    }

    pub(super) fn send_heartbeat(&mut self) {
        let mut base_mode = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
        if self.armed && !self.faults.disarmed {
            base_mode |= MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED;
        }
        if matches!(self.mode, FlightMode::Guided | FlightMode::Auto) {
            base_mode |= MavModeFlag::MAV_MODE_FLAG_GUIDED_ENABLED;
        }
        self.send(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: self.custom_mode(self.mode),
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            autopilot: self.firmware.autopilot(),
            base_mode,
            system_status: if self.faults.battery_low {
                MavState::MAV_STATE_CRITICAL
            } else if self.armed && !self.faults.disarmed {
                MavState::MAV_STATE_ACTIVE
            } else {
                MavState::MAV_STATE_STANDBY
            },
            mavlink_version: 3,
        }));
    }

    fn send_sys_status(&mut self) {
        use MavSysStatusSensor as S;
        let present = S::MAV_SYS_STATUS_SENSOR_3D_GYRO
            | S::MAV_SYS_STATUS_SENSOR_3D_ACCEL
            | S::MAV_SYS_STATUS_SENSOR_GPS
            | S::MAV_SYS_STATUS_SENSOR_BATTERY
            | S::MAV_SYS_STATUS_PREARM_CHECK;
        let health = if self.is_ready() {
            present
        } else {
            present - S::MAV_SYS_STATUS_PREARM_CHECK
        };
        self.send(&MavMessage::SYS_STATUS(SYS_STATUS_DATA {
            onboard_control_sensors_present: present,
            onboard_control_sensors_enabled: present,
            onboard_control_sensors_health: health,
            load: 100,
            voltage_battery: 16_000,
            current_battery: -1,
            battery_remaining: self.faults.battery_percent.unwrap_or(100),
            onboard_control_sensors_present_extended: MavSysStatusSensorExtended::empty(),
            onboard_control_sensors_enabled_extended: MavSysStatusSensorExtended::empty(),
            onboard_control_sensors_health_extended: MavSysStatusSensorExtended::empty(),
            ..SYS_STATUS_DATA::DEFAULT
        }));
    }

    /// Sends a status text for people.
    pub(super) fn say(&mut self, severity: MavSeverity, text: &str) {
        self.send(&MavMessage::STATUSTEXT(STATUSTEXT_DATA {
            severity,
            text: text.into(),
            id: 0,
            chunk_seq: 0,
        }));
    }

    /// Returns the flags of the estimator, as recorded. PX4 sets the flag for a constant position
    /// while it stands still.
    fn estimator_flags(&self) -> EstimatorStatusFlags {
        use EstimatorStatusFlags as F;
        let ready = F::ESTIMATOR_ATTITUDE
            | F::ESTIMATOR_VELOCITY_HORIZ
            | F::ESTIMATOR_VELOCITY_VERT
            | F::ESTIMATOR_POS_HORIZ_REL
            | F::ESTIMATOR_POS_HORIZ_ABS
            | F::ESTIMATOR_POS_VERT_ABS
            | F::ESTIMATOR_PRED_POS_HORIZ_REL
            | F::ESTIMATOR_PRED_POS_HORIZ_ABS;
        let waiting = F::ESTIMATOR_ATTITUDE
            | F::ESTIMATOR_VELOCITY_VERT
            | F::ESTIMATOR_POS_VERT_ABS
            | F::ESTIMATOR_CONST_POS_MODE;
        match (self.firmware, self.is_ready()) {
            (Firmware::Px4, true) if self.body.is_on_ground() => {
                ready | F::ESTIMATOR_POS_VERT_AGL | F::ESTIMATOR_CONST_POS_MODE
            }
            (Firmware::Px4, true) => ready | F::ESTIMATOR_POS_VERT_AGL,
            (Firmware::Px4, false) => waiting | F::ESTIMATOR_POS_VERT_AGL,
            (Firmware::ArduCopter, false) => waiting | F::ESTIMATOR_VELOCITY_HORIZ,
            (Firmware::Generic | Firmware::ArduCopter, true) => ready,
            (Firmware::Generic, false) => waiting,
        }
    }

    /// Returns the time at which the content of a message was measured.
    fn sampled(&mut self, now: Instant, message: u32) -> Instant {
        match message {
            LOCAL_POSITION_NED_DATA::ID | GLOBAL_POSITION_INT_DATA::ID | ATTITUDE_DATA::ID => {
                self.timing.sampled(now)
            }
            _ => now,
        }
    }

    /// Returns whether a local position is reported. ArduPilot and PX4 report one only once the
    /// estimator has one.
    fn has_position(&self) -> bool {
        self.is_ready() || !self.behavior().samples_in_its_loop
    }

    /// Returns the reported position at that time, which must be near the present.
    fn reported_position(&self, at: Instant) -> Position<f64> {
        let offset: Displacement<f64> = self.faults.position_offset_m;
        let moved = if !self.behavior().samples_in_its_loop {
            Displacement::zeros() // measured when it is sent
        } else {
            self.body.velocity * ((at - self.time).as_secs_f64() - (self.time - at).as_secs_f64())
        };
        self.body.position + moved + offset
    }

    /// Returns the origin of the local frame: the map's own, or the place where the estimator
    /// started.
    pub(super) fn local_origin(&self) -> firmware_core::autopilot::frames::Geodetic {
        match self.firmware {
            Firmware::Generic => self.settings.map_origin,
            Firmware::ArduCopter | Firmware::Px4 => {
                self.settings.map_origin.offset(self.settings.start.coords)
            }
        }
    }

    pub(super) fn local_frame(&self) -> MapFrame<f64> {
        let mut frame = MapFrame::new(self.settings.map_origin);
        frame.set_local_origin(self.local_origin());
        frame
    }
}

//! A client on a link in real time, used by the doctor and the mission upload.

use std::io;
use std::time::Duration as WallDuration;

use firmware_core::autopilot::Autopilot;
use firmware_core::autopilot::wire::Address;
use firmware_core::time::Instant;
use mavlink::dialects::common::MavMessage;

use crate::flight::{ProfileChoice, WrongProfile};
use link::{NoHeartbeat, Port};

/// A port and a clock that runs `speed` times as fast as real time.
#[derive(Debug)]
pub struct Session {
    port: Port,
    begin: std::time::Instant,
    speed: f64,
    profile: Option<ProfileChoice>,
    wrong_profile: Option<WrongProfile>,
}

impl Session {
    /// Starts a session. `speed` is the speed of the vehicle's simulation; 1 for a real vehicle.
    pub fn new(port: Port, speed: f64) -> Self {
        Self {
            port,
            begin: std::time::Instant::now(),
            speed,
            profile: None,
            wrong_profile: None,
        }
    }

    /// Makes the client plan within the limits of the profile of this choice, as soon as its
    /// autopilot was received.
    pub fn choosing(mut self, profile: ProfileChoice) -> Self {
        self.profile = Some(profile);
        self
    }

    /// Returns whether the specified profile is for another autopilot than the one that answers.
    pub fn wrong_profile(&self) -> Option<WrongProfile> {
        self.wrong_profile
    }

    /// Returns the time on the session's clock.
    pub fn now(&self) -> Instant {
        Instant::from_micros((self.begin.elapsed().as_secs_f64() * self.speed * 1e6) as u64)
    }

    /// Returns the error to report if no autopilot was received since `since`.
    pub fn silence(&self, since: Instant) -> NoHeartbeat {
        NoHeartbeat {
            waited_s: (self.now() - since).as_secs_f64(),
            refused: self.port.counters().refused(),
            last_error: self.port.last_error(),
        }
    }

    /// Flushes the log of the messages, if there is one.
    ///
    /// # Errors
    /// Returns an error if the log cannot be written.
    pub fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }

    /// Sends a message.
    pub fn send(&mut self, message: &MavMessage) -> io::Result<bool> {
        self.port.send(self.now(), message)
    }

    /// Sends the messages of `client`, waits for answers until it has more messages (50 ms at
    /// most), and passes the answers to the client and to `also`.
    pub fn turn(
        &mut self,
        client: &mut Autopilot<f64>,
        mut also: impl FnMut(Instant, Address, &MavMessage),
    ) -> io::Result<()> {
        let now = self.now();
        while let Some(message) = client.poll(now) {
            self.port.send_as(client.own());
            self.port.send(now, &message)?;
        }
        let nap = (client.poll_at(now) - now).as_secs_f64() / self.speed;
        let mut nap = WallDuration::from_secs_f64(nap);
        while let Some((from, message)) = self.port.receive(self.now(), nap)? {
            let now = self.now();
            client.receive(now, from, &message);
            if let Some(Err(wrong)) = self.profile.as_mut().map(|choice| choice.settle(client)) {
                self.wrong_profile = Some(wrong);
            }
            // The caller's messages are also sent under the vehicle's system id.
            self.port.send_as(client.own());
            also(now, from, &message);
            nap = WallDuration::ZERO;
        }
        Ok(())
    }
}

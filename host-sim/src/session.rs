//! A client on a link in real time: who the doctor and the mission upload talk through.

use std::io;
use std::time::Duration as WallDuration;

use firmware_core::autopilot::Autopilot;
use firmware_core::autopilot::wire::Address;
use firmware_core::time::Instant;
use mavlink::dialects::common::MavMessage;

use crate::flight::{ProfileChoice, WrongProfile};
use link::{NoHeartbeat, Port};

/// A port and a clock that runs `speed` times as fast as the wall's.
#[derive(Debug)]
pub struct Session {
    port: Port,
    begin: std::time::Instant,
    speed: f64,
    profile: Option<ProfileChoice>,
    wrong_profile: Option<WrongProfile>,
}

impl Session {
    /// Begins now. `speed` is that of the vehicle's simulation; 1 for a real one.
    pub fn new(port: Port, speed: f64) -> Self {
        Self {
            port,
            begin: std::time::Instant::now(),
            speed,
            profile: None,
            wrong_profile: None,
        }
    }

    /// The client plans within the limits of this choice's profile, as soon as its autopilot was
    /// heard.
    pub fn choosing(mut self, profile: ProfileChoice) -> Self {
        self.profile = Some(profile);
        self
    }

    /// Whether the profile that was given is for another autopilot than the one that answers.
    pub fn wrong_profile(&self) -> Option<WrongProfile> {
        self.wrong_profile
    }

    /// The time in the vehicle's pace.
    pub fn now(&self) -> Instant {
        Instant::from_micros((self.begin.elapsed().as_secs_f64() * self.speed * 1e6) as u64)
    }

    /// What to say when nobody was heard since `since`.
    pub fn silence(&self, since: Instant) -> NoHeartbeat {
        NoHeartbeat {
            waited_s: (self.now() - since).as_secs_f64(),
            refused: self.port.counters().refused(),
            last_error: self.port.last_error(),
        }
    }

    /// Writes out the log of what passed, if there is one.
    ///
    /// # Errors
    /// The log cannot be written.
    pub fn flush(&mut self) -> io::Result<()> {
        self.port.flush()
    }

    /// Sends a message.
    pub fn send(&mut self, message: &MavMessage) -> io::Result<bool> {
        self.port.send(self.now(), message)
    }

    /// Sends what `client` has to say, waits for answers until it has more to say (50 ms at
    /// most) and gives them to it, and to `also`.
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
            // What the caller sends goes out under the vehicle's system id, too.
            self.port.send_as(client.own());
            also(now, from, &message);
            nap = WallDuration::ZERO;
        }
        Ok(())
    }
}

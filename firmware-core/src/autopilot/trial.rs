// SPDX-License-Identifier: MIT OR Apache-2.0
//! The trial leg measures the speed that the airframe reaches.
//!
//! Parameters that the client has raised say nothing about the airframe any more. Where the mission
//! needs more speed than they allowed before, the vehicle flies from the start towards the
//! destination and back, from rest to rest and as fast as the mission, before the first slot. The
//! speed that it reaches is its limit from then on; if that is too low to reach the destination in
//! time, it lands where it took off and the mission is refused with both speeds.

use super::{
    client::Autopilot,
    event::Event,
    failsafe::Cause,
    preflight::PreflightRefusal,
    state::{PhaseState, Trial},
};
use crate::{
    autopilot::guidance::Trajectory,
    scalar::{Position, Scalar},
    time::Instant,
};

/// The fraction of the reference's largest speed below which the airframe limits the speed.
const REACHED: f64 = 0.8;
/// The fraction of the measured speed that is planned with, so that the vehicle can catch up.
const MARGIN: f64 = 0.95;

impl<T: Scalar> Autopilot<T> {
    /// Starts a trial leg if one is needed; otherwise the vehicle is ready for slots.
    pub(super) fn prepare_slots(&mut self, now: Instant) {
        match self.trial_turn() {
            Some(turn) if self.start_transit(now, turn) => {
                let trial = Trial {
                    turn,
                    returns: false,
                    asked_mps: T::zero(),
                    reached_mps: T::zero(),
                };
                self.enter(now, PhaseState::Trial(trial));
            }
            _ => self.enter(now, PhaseState::Ready),
        }
    }

    /// Returns the turning point of the trial leg, or `None` where none is needed.
    fn trial_turn(&self) -> Option<Position<T>> {
        let preflight = &self.settings.preflight;
        let needed_mps = preflight.needed_speed_mps?;
        let way = preflight.destination? - self.settings.start;
        if self.airframe_mps.is_some() {
            return None;
        }
        let found_mps = T::of(f64::from(self.parameter_manager.found_mps()?));
        if needed_mps <= found_mps || way.norm() <= T::zero() {
            return None;
        }
        let speed_mps = self.limits.speed_mps.min(self.settings.transit_speed_mps);
        let fraction = Trajectory::run_up_m(speed_mps, &self.limits) / way.norm();
        Some(self.settings.start + way * fraction.min(T::one()))
    }

    /// Advances the trial leg.
    pub(super) fn advance_trial(&mut self, now: Instant, mut trial: Trial<T>) {
        let Some(sample) = self.telemetry.sample else {
            return;
        };
        if !trial.returns {
            let asked_mps = self.stream.as_ref().map(|s| s.last.velocity.norm());
            trial.asked_mps = trial.asked_mps.max(asked_mps.unwrap_or(T::zero()));
            trial.reached_mps = trial.reached_mps.max(sample.velocity.norm());
            self.state = PhaseState::Trial(trial);
        }
        let goal = if trial.returns {
            self.settings.start
        } else {
            trial.turn
        };
        if !self.has_arrived_at(now, goal) {
            return;
        }
        if !trial.returns {
            self.state = PhaseState::Trial(Trial {
                returns: true,
                ..trial
            });
            if trial.reached_mps < trial.asked_mps * T::of(REACHED) {
                self.airframe_mps = Some(trial.reached_mps * T::of(MARGIN));
                self.events.push(Event::SlowAirframe {
                    asked_mps: trial.asked_mps.to_f64() as f32,
                    reached_mps: trial.reached_mps.to_f64() as f32,
                });
                self.update_limits();
            }
            self.start_transit(now, self.settings.start);
            return;
        }
        let needed_mps = self.settings.preflight.needed_speed_mps;
        match needed_mps.filter(|&needed| self.limits.speed_mps < needed) {
            Some(needed_mps) => {
                let refusal = PreflightRefusal::SlowAirframe {
                    needed_mps: needed_mps.to_f64() as f32,
                    reached_mps: trial.reached_mps.to_f64() as f32,
                };
                self.refusal = Some(refusal);
                self.events.push(Event::Refused(refusal));
                self.fail(now, Cause::TooSlow);
            }
            None => self.enter(now, PhaseState::Ready),
        }
    }
}

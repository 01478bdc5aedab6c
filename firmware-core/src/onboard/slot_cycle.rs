// SPDX-License-Identifier: MIT OR Apache-2.0
//! The slot cycle: plan, fly, report the arrival, allocate.

use super::{
    computer::{Measuring, Onboard},
    probe::{Activity, Probe},
    stage::{Fault, Stage},
};
use crate::{
    autopilot::{Leg, LegEnd, Phase},
    controller::{ChannelSource, SlotCommand},
    counter::count,
    inner::SlotSolver,
    limits::MotionLimits,
    link::Arrival,
    policy::Policy,
    scalar::{Position, Scalar},
    time::{Duration, Instant},
};

/// The fraction of the guidance's acceleration that the shield relies on for braking and turning.
/// The rest is needed for jerk and for following the reference.
const RELIABLE_FRACTION: f64 = 0.5;

/// The time after which the vehicle offers a session of the ground link again, while there is none.
const OFFER_INTERVAL: Duration = Duration::from_secs(1);

impl<T: Scalar, P: Policy<T, M>, const M: usize, const J: usize, S: SlotSolver<T>, const F: usize>
    Onboard<T, P, M, J, S, F>
{
    /// Returns when [`poll`](Self::poll) must be called next if nothing is received before.
    pub fn poll_at(&self, now: Instant) -> Instant {
        let mut next = self.autopilot.poll_at(now);
        if !self.ground.has_session() {
            next = next.min(self.offer_at.unwrap_or(now));
        }
        match &self.measuring {
            Some(measuring) => next
                .min(measuring.since + self.settings.channel_patience)
                .min(measuring.repeat_at),
            None => next,
        }
    }

    /// Offers a session of the ground link while there is none.
    fn offer_session(&mut self, now: Instant) {
        let is_due = self.offer_at.is_none_or(|at| now >= at);
        if is_due && !self.ground.has_session() {
            self.ground.offer();
            self.offer_at = Some(now + OFFER_INTERVAL);
        }
    }

    /// Advances the slot cycle as far as what was received allows.
    pub fn poll(&mut self, now: Instant, probe: &mut impl Probe) {
        self.offer_session(now);
        let phase = self.autopilot.phase();
        if phase.is_final() {
            let whole = matches!(self.stage, Stage::Landing | Stage::Completed);
            self.stage = if whole && phase == Phase::Landed {
                Stage::Completed
            } else {
                Stage::Aborted
            };
            return;
        }
        match self.stage {
            Stage::Preparing if self.autopilot.phase() == Phase::Ready => {
                // The limits that the vehicle's parameters impose are known by now; guidance uses
                // them.
                let limits = *self.autopilot.limits();
                self.controller.rely_on(&MotionLimits {
                    acceleration_mps2: limits.acceleration_mps2 * T::of(RELIABLE_FRACTION),
                    ..limits
                });
                let measured = self.autopilot.position();
                self.begin_slot(now, measured.map(|sample| sample.position), probe);
            }
            Stage::Preparing => {
                let operations = self.settings.planning_operations;
                self.controller.improve_plan(operations);
                self.launch_if_planned(now);
            }
            Stage::Flying => {
                if let Some(end) = self.autopilot.leg_ended(now) {
                    self.end_leg(now, &end);
                } else {
                    let operations = self.settings.planning_operations;
                    self.controller.improve_plan(operations);
                }
            }
            Stage::Measuring => self.measure(now, probe),
            _ => {}
        }
    }

    /// Returns the tick that ends slot `n`, on the vehicle's clock.
    fn tick(&self, began: Instant, slot: u32) -> Instant {
        began + Duration::from_secs_f64(self.slot_duration_s * f64::from(slot))
    }

    /// Plans the next slot from where the last one ended, and starts its leg. The vehicle's present
    /// position is not used: eq:traj1 constrains the ends of slots, however long the exchange
    /// between them took.
    fn begin_slot(&mut self, now: Instant, from: Option<Position<T>>, probe: &mut impl Probe) {
        if self.controller.is_over() {
            self.stage = Stage::Landing;
            self.autopilot.land(now);
            return;
        }
        let Some(position) = from else {
            self.abort(now, Fault::NoPosition);
            return;
        };
        let vehicle_now = self.autopilot.vehicle_time(now);
        let Some(began) = self.began.or(vehicle_now) else {
            self.abort(now, Fault::NoPosition);
            return;
        };
        self.began = Some(began);
        probe.begin(Activity::Plan);
        let plan = self.controller.plan(position);
        probe.end(Activity::Plan);
        let flown = plan.map_err(Fault::from).and_then(|plan| {
            let leg = Leg {
                waypoint: plan.waypoint,
                end: self.tick(began, plan.slot),
            };
            self.autopilot.fly_leg(now, leg).map_err(Fault::from)
        });
        match flown {
            Ok(()) => self.stage = Stage::Flying,
            Err(fault) => self.abort(now, fault),
        }
    }

    /// Reports where the leg ended and waits for the channels there.
    fn end_leg(&mut self, now: Instant, end: &LegEnd<T>) {
        let Some(&plan) = self.controller.under_way() else {
            return;
        };
        let arrival = Arrival {
            plan,
            position: end.sample.position,
            tick: end.tick,
        };
        self.measuring = Some(Measuring {
            since: now,
            arrival,
            repeat_at: now + self.settings.arrival_interval,
        });
        self.stage = Stage::Measuring;
        self.report(arrival);
    }

    fn report(&mut self, arrival: Arrival<T>) {
        if self.arrival.replace(arrival).is_some() {
            count(&mut self.slots.unsent);
        }
    }

    /// Allocates as soon as the channel state is received, or has been missing for too long.
    fn measure(&mut self, now: Instant, probe: &mut impl Probe) {
        let Some(measuring) = &mut self.measuring else {
            return;
        };
        let arrival = measuring.arrival;
        let overdue = now.duration_since(measuring.since) >= self.settings.channel_patience;
        let state = self.channel_state.take();
        if state.is_none() && !overdue {
            if now >= measuring.repeat_at {
                measuring.repeat_at = now + self.settings.arrival_interval;
                count(&mut self.slots.arrivals_repeated);
                self.report(arrival);
            }
            return;
        }
        probe.begin(Activity::Allocate);
        let command = match &state {
            Some(state) => self.controller.allocate(state),
            None => self.controller.allocate_predicted(&arrival.position),
        };
        probe.end(Activity::Allocate);
        match command {
            Ok(command) => {
                self.measuring = None;
                // An answer is too late from here on, and so is the question.
                self.arrival = None;
                self.command_slot(arrival.plan.served_user, command);
                self.begin_slot(now, Some(arrival.position), probe);
            }
            Err(error) => self.abort(now, error.into()),
        }
    }

    /// Updates the counters for a slot's command and queues the command.
    fn command_slot(&mut self, planned_user: usize, command: SlotCommand<T, J>) {
        let slots = &mut self.slots;
        count(match command.source {
            ChannelSource::Measured => &mut slots.measured,
            ChannelSource::Predicted => &mut slots.stale,
        });
        match command.served_user {
            None => count(&mut slots.nobody_served),
            Some(user) if user != planned_user => count(&mut slots.user_replaced),
            Some(_) => {}
        }
        if !command.status.is_feasible() {
            count(&mut slots.infeasible);
        }
        let add = |counter: &mut u32, more: u16| *counter = counter.saturating_add(more.into());
        add(&mut slots.unheard_sensors, command.unheard_sensors);
        add(&mut slots.rejected_gains, command.rejected_gains);
        if self.command.replace(command).is_some() {
            count(&mut slots.unsent);
        }
        self.status_due = true;
        // A ground that was restarted answers it.
        self.ground.offer();
    }

    fn abort(&mut self, now: Instant, fault: Fault) {
        self.fault = Some(fault);
        self.stage = Stage::Aborted;
        self.measuring = None;
        self.status_due = true;
        self.autopilot.land(now);
    }
}

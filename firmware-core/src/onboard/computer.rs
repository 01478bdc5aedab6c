// SPDX-License-Identifier: MIT OR Apache-2.0
//! The onboard computer: its parts and its state.

use core::mem::MaybeUninit;

use super::stage::{Fault, Stage};
use crate::{
    SENSORS_MAX, USERS_MAX,
    autopilot::{Autopilot, AutopilotSettings, SettingsError, wire},
    controller::{ChannelState, Controller, SlotCommand},
    inner::{ExactSolver, SlotSolver},
    link::{
        Arrival, Credentials, Endpoint, FRAME_MAX, SecurityCounters, SlotCounters, VehicleStatus,
        secure_frame_max,
    },
    mission::Mission,
    policy::Policy,
    scalar::Scalar,
    time::{Duration, Instant},
};

/// Settings of the slot cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OnboardSettings {
    /// The longest time that the ground may take to answer an arrival; never longer than half a
    /// slot.
    pub channel_patience: Duration,
    /// The time without an answer after which the arrival is sent again.
    pub arrival_interval: Duration,
    /// The operations that the policy may spend on a better plan in a [`poll`](Onboard::poll)
    /// before slot 1, and on the way to a waypoint after a change of the mission.
    pub planning_operations: u64,
}

impl Default for OnboardSettings {
    fn default() -> Self {
        Self {
            channel_patience: Duration::from_millis(500),
            arrival_interval: Duration::from_millis(125),
            planning_operations: 500_000,
        }
    }
}

/// The end of a slot, while the computer waits for its channel state.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measuring<T: Scalar> {
    pub(super) since: Instant,
    pub(super) arrival: Arrival<T>,
    pub(super) repeat_at: Instant,
}

/// The onboard computer.
///
/// `M` and `J` are its capacities for users and sensors, `S` solves the slot problems, and `F` is the
/// length of the longest frame on the ground link. With users and sensors grow the mission, the channel
/// states, the solver's memory and the frames. What does not depend on them is the MAVLink client, the
/// decoder of its frames, the authentication of both links, and the changes that wait for their slot
/// ([`CHANGES_MAX`](crate::controller::CHANGES_MAX)). Sizes on a 64-bit host:
///
/// ```
/// # use firmware_core::{inner::ExactSolver, onboard::Onboard, policy::StraightLine};
/// # use firmware_core::link::secure_frame_max;
/// # let about = |bytes: usize, size: usize| assert!(size.abs_diff(bytes) <= bytes / 20, "{size}");
/// type Computer<const M: usize, const J: usize, const F: usize> =
///     Onboard<f32, StraightLine<f32, M>, M, J, ExactSolver, F>;
///
/// about(9_370, size_of::<Computer<4, 8, { secure_frame_max::<f32>(4, 8) }>>());
/// about(12_010, size_of::<Computer<16, 64, { secure_frame_max::<f32>(16, 64) }>>());
/// about(60_490, size_of::<Computer<256, 1024, { secure_frame_max::<f32>(256, 1024) }>>());
/// // The default: frames for double precision.
/// about(12_310, size_of::<Onboard<f32, StraightLine<f32, 16>>>());
/// ```
#[derive(Debug)]
pub struct Onboard<
    T: Scalar,
    P,
    const M: usize = USERS_MAX,
    const J: usize = SENSORS_MAX,
    S = ExactSolver,
    const F: usize = FRAME_MAX,
> {
    pub(super) settings: OnboardSettings,
    pub(super) slot_duration_s: f64,
    pub(super) controller: Controller<T, P, M, J, S>,
    pub(super) autopilot: Autopilot<T>,
    pub(super) stage: Stage,
    /// The flight starts as soon as the first plan is made.
    is_launch_due: bool,
    pub(super) fault: Option<Fault>,
    pub(super) measuring: Option<Measuring<T>>,
    /// `t_0`, when slot 1 began, on the vehicle's clock.
    pub(super) began: Option<Instant>,
    pub(super) mavlink_in: wire::Decoder,
    pub(super) mavlink_out: wire::Encoder,
    pub(super) ground: Endpoint<F>,
    /// When a session of the ground link is offered again, while there is none.
    pub(super) offer_at: Option<Instant>,
    pub(super) channel_state: Option<ChannelState<T, M, J>>,
    pub(super) arrival: Option<Arrival<T>>,
    pub(super) command: Option<SlotCommand<T, J>>,
    pub(super) status_due: bool,
    pub(super) security_due: bool,
    pub(super) slots: SlotCounters,
    pub(super) mavlink_unreadable: u32,
}

impl<T: Scalar, P: Policy<T, M>, const M: usize, const J: usize, S: SlotSolver<T>>
    Onboard<T, P, M, J, S>
{
    /// Creates a computer before take-off that has received nothing from either side. Its ground link
    /// has frames of up to [`FRAME_MAX`] bytes, which is enough for the default capacities.
    pub fn new(
        settings: OnboardSettings,
        controller: Controller<T, P, M, J, S>,
        autopilot: Autopilot<T>,
    ) -> Self {
        Self::with_frames(settings, controller, autopilot)
    }
}

impl<T: Scalar, P: Policy<T, M>, const M: usize, const J: usize, S: SlotSolver<T>, const F: usize>
    Onboard<T, P, M, J, S, F>
{
    /// As [`new`](Onboard::new), with frames of up to `F` bytes on the ground link.
    pub fn with_frames(
        settings: OnboardSettings,
        controller: Controller<T, P, M, J, S>,
        autopilot: Autopilot<T>,
    ) -> Self {
        Self::assemble(settings, controller, autopilot)
    }

    /// Creates a computer that stays in `place`, from its mission, policy and solver and the settings
    /// of its MAVLink client. With a static `place`, such as that of a `StaticCell`, the stack does not
    /// hold the computer: the client, the links and the buffers are built where they stay, and only the
    /// controller passes over the stack. (Safe Rust leaves this to the optimizer. `cargo xtask firmware
    /// bench` measures the stack of an image that does it.)
    ///
    /// # Errors
    /// Returns an error if a setting is invalid; nothing is then written to `place`.
    ///
    /// ```
    /// # use firmware_core::{
    /// #     Mission, Position, autopilot::{AutopilotSettings, frames::Geodetic}, inner::ExactSolver,
    /// #     link::secure_frame_max, mission::MissionParameters, policy::StraightLine,
    /// #     onboard::{Onboard, OnboardSettings, Stage},
    /// # };
    /// use std::mem::MaybeUninit;
    ///
    /// const FRAME: usize = secure_frame_max::<f32>(4, 8);
    /// type Computer = Onboard<f32, StraightLine<f32, 4>, 4, 8, ExactSolver, FRAME>;
    ///
    /// # let mission = Mission::new(MissionParameters::<f32, 4, 8> {
    /// #     users: [Position::new(200.0, 700.0)].into_iter().collect(),
    /// #     sensors: [Position::new(700.0, 100.0)].into_iter().collect(),
    /// #     ..MissionParameters::table_one()
    /// # })?;
    /// # let p = mission.parameters();
    /// # let origin = Geodetic { latitude_e7: 473_977_420, longitude_e7: 85_455_940 };
    /// # let autopilot = AutopilotSettings::new(origin, p.start, p.altitude_m, p.max_speed_mps);
    /// # let policy = StraightLine::new(&mission);
    /// // On a board: `static PLACE: StaticCell<Computer>` and `PLACE.uninit()`.
    /// let place: &'static mut MaybeUninit<Computer> = Box::leak(Box::new(MaybeUninit::uninit()));
    /// let parts = (policy, ExactSolver);
    /// let settings = OnboardSettings::default();
    /// let computer = Onboard::new_in(place, settings, mission, parts, autopilot)?;
    /// assert_eq!(computer.stage(), Stage::Preparing);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn new_in(
        place: &mut MaybeUninit<Self>,
        settings: OnboardSettings,
        mission: Mission<T, M, J>,
        (policy, solver): (P, S),
        autopilot: AutopilotSettings<T>,
    ) -> Result<&mut Self, SettingsError> {
        autopilot.check()?;
        let computer = place.write(Self::assemble(
            settings,
            Controller::with_solver(mission, policy, solver),
            Autopilot::with_checked(autopilot),
        ));
        computer.autopilot.update_limits();
        Ok(computer)
    }

    #[inline(always)] // so that it is built where it stays: see `new_in`
    fn assemble(
        settings: OnboardSettings,
        controller: Controller<T, P, M, J, S>,
        autopilot: Autopilot<T>,
    ) -> Self {
        const {
            assert!(
                secure_frame_max::<T>(M, J) <= F,
                "the frames of this `Onboard` are too short for M users and J sensors: in its type, \
                 `Onboard<T, P, M, J, S, F>`, F must be at least \
                 `link::secure_frame_max::<T>(M, J)`, and it is created by `with_frames` or `new_in`"
            )
        };
        let slot_duration_s = controller.mission().parameters().slot_duration_s.to_f64();
        // The exchange takes place in the next slot, which has to be flown as well.
        let half_slot = Duration::from_secs_f64(slot_duration_s / 2.0);
        let settings = OnboardSettings {
            channel_patience: settings.channel_patience.min(half_slot),
            ..settings
        };
        Self {
            settings,
            slot_duration_s,
            controller,
            mavlink_out: wire::Encoder::new(autopilot.own()),
            autopilot,
            stage: Stage::Preparing,
            is_launch_due: false,
            fault: None,
            measuring: None,
            began: None,
            mavlink_in: wire::Decoder::in_order(),
            ground: Endpoint::new(),
            offer_at: None,
            channel_state: None,
            arrival: None,
            command: None,
            status_due: false,
            security_due: false,
            slots: SlotCounters::default(),
            mavlink_unreadable: 0,
        }
    }

    /// Authenticates the ground link from now on: only messages of a ground with the same key are
    /// taken. Must be called before bytes of the ground are received. See [`Credentials`] for what
    /// they require of the caller.
    pub fn authenticate_ground(&mut self, credentials: Credentials) {
        self.ground = Endpoint::vehicle(credentials);
    }

    /// Returns the counters of the authentication of the ground link; `None` if it is not
    /// authenticated.
    pub fn security(&self) -> Option<&SecurityCounters> {
        self.ground.security()
    }

    /// Returns the stage of the mission.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// Returns why the onboard computer aborted the mission, if it did.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Returns the controller.
    pub fn controller(&self) -> &Controller<T, P, M, J, S> {
        &self.controller
    }

    /// Returns the MAVLink client.
    pub fn autopilot(&self) -> &Autopilot<T> {
        &self.autopilot
    }

    /// Returns the MAVLink client, to launch, to stop and to take its events.
    pub fn autopilot_mut(&mut self) -> &mut Autopilot<T> {
        &mut self.autopilot
    }

    /// Starts the flight: at once, or as soon as the policy's first plan is made. The operations of
    /// [`OnboardSettings::planning_operations`] are spent on it in each [`poll`](Self::poll).
    pub fn launch(&mut self, now: Instant) {
        self.is_launch_due = true;
        self.launch_if_planned(now);
    }

    pub(super) fn launch_if_planned(&mut self, now: Instant) {
        let quality = self.controller.policy().quality();
        let is_planning = quality.is_some_and(|quality| quality.is_replanning);
        if self.is_launch_due && !is_planning {
            self.is_launch_due = false;
            self.autopilot.launch(now);
        }
    }

    /// Returns the counters of everything that was received, dropped or missing.
    pub fn status(&self) -> VehicleStatus {
        VehicleStatus {
            slots_done: self.controller.slots_done(),
            slots: SlotCounters {
                changes_refused: self.controller.changes_refused(),
                ..self.slots
            },
            link: *self.ground.counters(),
            mavlink: self.mavlink_in.counters(),
            mavlink_unreadable: self.mavlink_unreadable,
            plan: self.controller.policy().quality(),
        }
    }
}

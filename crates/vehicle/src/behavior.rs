//! Differences between the simulated autopilots that the client's [`Firmware`] does not define.

use firmware_core::autopilot::profile::Firmware;

/// The behaviour of an autopilot. [`Behavior::of`] has an exhaustive match, so the compiler requires
/// every property of a new firmware.
#[derive(Clone, Copy, Debug)]
pub(super) struct Behavior {
    /// A setpoint that is not a number crashes the autopilot in its control mode.
    pub(super) crashes_on_nan: bool,
    /// Accepted global setpoints are echoed.
    pub(super) echoes_setpoints: bool,
    /// After the last setpoint, the vehicle flies to its position instead of stopping.
    pub(super) flies_to_last_setpoint: bool,
    /// Telemetry is sent from the loop that moves the body, and the position is measured there.
    /// Otherwise it is measured when it is sent, also before the estimator is ready.
    pub(super) samples_in_its_loop: bool,
    /// CURRENT_MODE is supported.
    pub(super) reports_current_mode: bool,
    /// A mission is refused for lack of space in the first seconds after booting.
    pub(super) boots_without_mission_space: bool,
    /// The items of a new mission overwrite the old mission one by one; otherwise the complete
    /// mission replaces it.
    pub(super) overwrites_mission_items: bool,
    /// After a client has refused the deprecated request for an item, the new one is sent.
    pub(super) repeats_refused_requests: bool,
    /// Commands without a position are accepted in the frame MISSION only.
    pub(super) requires_mission_frame: bool,
    /// A mission is not started immediately after it was stored.
    pub(super) settles_missions: bool,
    /// The number of times that MISSION_ITEM_REACHED is sent.
    pub(super) reached_messages: u8,
}

impl Behavior {
    /// Returns the behaviour of a firmware.
    pub(super) const fn of(firmware: Firmware) -> Self {
        match firmware {
            Firmware::Generic => Self {
                crashes_on_nan: false,
                echoes_setpoints: true,
                flies_to_last_setpoint: false,
                samples_in_its_loop: false,
                reports_current_mode: false,
                boots_without_mission_space: false,
                overwrites_mission_items: true,
                repeats_refused_requests: false,
                requires_mission_frame: false,
                settles_missions: false,
                reached_messages: 1,
            },
            Firmware::ArduCopter => Self {
                crashes_on_nan: true,
                echoes_setpoints: true,
                flies_to_last_setpoint: false,
                samples_in_its_loop: true,
                reports_current_mode: true,
                boots_without_mission_space: true,
                overwrites_mission_items: true,
                repeats_refused_requests: false,
                requires_mission_frame: false,
                settles_missions: false,
                reached_messages: 1,
            },
            Firmware::Px4 => Self {
                crashes_on_nan: false,
                echoes_setpoints: false,
                flies_to_last_setpoint: true,
                samples_in_its_loop: true,
                reports_current_mode: true,
                boots_without_mission_space: false,
                overwrites_mission_items: false,
                repeats_refused_requests: true,
                requires_mission_frame: true,
                settles_missions: true,
                reached_messages: 2,
            },
        }
    }
}

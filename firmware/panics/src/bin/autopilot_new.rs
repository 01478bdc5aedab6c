//! The creation of a MAVLink client, with the checks of its settings.
#![no_std]
#![no_main]

use firmware_core::autopilot::{Autopilot, AutopilotSettings, SettingsError};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(settings: AutopilotSettings<f32>) -> Result<Autopilot<f32>, SettingsError> {
    Autopilot::new(settings)
}

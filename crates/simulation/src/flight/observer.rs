//! The observer of a flight: it displays events and may ask for the end.

use crate::record::{FlightEvent, SlotRecord};

/// Receives the events of a flight for display. Every method has a default.
pub trait Observer {
    /// Called when a slot is finished.
    fn slot(&mut self, slot: &SlotRecord) {
        let _ = slot;
    }
    /// Called for each event of the autopilot and its client.
    fn event(&mut self, event: &FlightEvent) {
        let _ = event;
    }
    /// Called after the flight for something that the user must do.
    fn duty(&mut self, words: &str) {
        let _ = words;
    }
    /// Called after the flight for further information.
    fn note(&mut self, words: &str) {
        let _ = words;
    }
    /// Called when the flight waits for something that may take long, or whose end the user has
    /// just asked for.
    fn waiting(&mut self, words: &str) {
        let _ = words;
    }
    /// Returns whether to stop: the vehicle is landed then.
    fn wants_stop(&self) -> bool {
        false
    }
    /// Returns whether to end at once, wherever the vehicle is: parameters are restored if that
    /// takes at most 3 s.
    fn wants_end(&self) -> bool {
        false
    }
}

/// Ignores all events.
impl Observer for () {}

//! The observer of a flight: it shows what happens, and may ask for the end.

use crate::record::{FlightEvent, SlotRecord};

/// What happens while a mission is flown, for whoever shows it.
pub trait Observer {
    /// A slot is done.
    fn slot(&mut self, slot: &SlotRecord) {
        let _ = slot;
    }
    /// Something happened between the autopilot and its client.
    fn event(&mut self, event: &FlightEvent) {
        let _ = event;
    }
    /// Something that a person must do, now that the flight is over.
    fn duty(&mut self, words: &str) {
        let _ = words;
    }
    /// Something that is good to know, now that the flight is over.
    fn note(&mut self, words: &str) {
        let _ = words;
    }
    /// What the flight waits for, where that can take long or a person has just asked for its end.
    fn waiting(&mut self, words: &str) {
        let _ = words;
    }
    /// Whether to stop: the vehicle is then landed.
    fn wants_stop(&self) -> bool {
        false
    }
    /// Whether to end at once, wherever the vehicle is: parameters are put back if that takes no
    /// more than 3 s.
    fn wants_end(&self) -> bool {
        false
    }
}

/// Watches nothing.
impl Observer for () {}

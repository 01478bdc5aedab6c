//! What is displayed during a flight: a progress bar over the slots, and the events above it.

use host_sim::{
    flight::Observer,
    interrupt::Presses,
    record::{FlightEvent, SlotRecord},
};
use indicatif::{ProgressBar, ProgressStyle};
use scenario::Scenario;

use crate::command::{Failure, terminal};

/// Displays a progress bar over the slots and the events above it, and watches for Ctrl-C.
pub(super) struct Progress {
    bar: ProgressBar,
    data: f64,
    /// Whether events are displayed when they happen.
    events: bool,
    presses: Presses,
}

impl Progress {
    /// Displays the bar; `events` is whether events are displayed when they happen.
    pub(super) fn new(scenario: &Scenario, events: bool) -> Result<Self, Failure> {
        let slots = u64::from(scenario.mission.slots());
        let bar = ProgressBar::with_draw_target(Some(slots), terminal()).with_style(
            ProgressStyle::with_template("slot {pos}/{len} {wide_bar} {msg} {elapsed}")
                .map_err(Failure::failed)?,
        );
        Ok(Self {
            bar,
            data: 0.0,
            events,
            presses: Presses::watch(),
        })
    }

    /// Removes the bar.
    pub(super) fn clear(&self) {
        self.bar.finish_and_clear();
    }
}

impl Observer for Progress {
    fn slot(&mut self, slot: &SlotRecord) {
        self.data += slot.rate;
        self.bar.set_message(format!(
            "user {} {:.3} bit/s/Hz, sum {:.2}",
            slot.user_name(),
            slot.rate,
            self.data
        ));
        self.bar.set_position(u64::from(slot.slot));
    }

    fn event(&mut self, event: &FlightEvent) {
        if self.events && event.notable {
            self.bar.suspend(|| eprintln!("{}", line(event)));
        }
        if self.bar.position() == 0 {
            self.bar.set_message(event.text.clone());
        }
    }

    fn waiting(&mut self, words: &str) {
        self.bar.suspend(|| eprintln!("{words}"));
    }

    fn duty(&mut self, words: &str) {
        self.bar.suspend(|| eprintln!("warning: {words}"));
    }

    fn note(&mut self, words: &str) {
        self.bar.suspend(|| eprintln!("note: {words}"));
    }

    fn wants_stop(&self) -> bool {
        self.presses.count() >= 1
    }

    fn wants_end(&self) -> bool {
        self.presses.count() >= 2
    }
}

/// Formats an event as one line.
pub(super) fn line(event: &FlightEvent) -> String {
    format!("{:9.2} s  {}", event.time_s, event.text)
}

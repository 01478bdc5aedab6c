//! The reason why a flight ended, in words that name the true cause: the fault that the client
//! detected, and the autopilot's messages shortly before it.

use firmware_core::{
    autopilot::{Event, Finding, LegError, failsafe::Cause},
    onboard::Fault,
    time::{Duration, Instant},
};

/// A message of the autopilot within this time before a fault counts as its reason.
const BEFORE: Duration = Duration::from_secs(5);
/// The same for a start that took too long: pre-arm texts are sent every 30 s.
const BEFORE_TIME_OUT: Duration = Duration::from_secs(60);
/// The reason of a change of mode may be received within this time after it.
pub(super) const AFTER: Duration = Duration::from_secs(1);
/// If nothing is received any more, the position times out first and the heartbeat within this
/// time.
const BOTH: Duration = Duration::from_secs(10);
/// MAV_SEVERITY_WARNING: messages of this or a lower value are shown to the user.
const WARNING: u8 = 4;
/// MAV_SEVERITY_NOTICE: ArduCopter uses it for the reason why it left our mode (`Circle fence
/// breached`).
const NOTICE: u8 = 5;

/// Returns whether the event is shown to the user when it happens.
pub fn is_notable(event: &Event) -> bool {
    match event {
        Event::Text { severity, .. } => *severity <= WARNING,
        // A parameter that was not restored is reported as something to do.
        Event::Repeated { .. }
        | Event::SampleLate
        | Event::Finding(Finding::NotRestored { .. }) => false,
        _ => true,
    }
}

/// The same for an event that a board reports in words.
pub(super) fn are_notable(words: &str) -> bool {
    !(words.contains(", attempt ") || words.starts_with("no position sample after"))
}

/// Collects the events that explain the end of a flight.
#[derive(Debug, Default)]
pub(super) struct Reasons {
    /// The first fault.
    fault: Option<(Instant, Cause)>,
    /// The last mode that was entered.
    mode: Option<String>,
    /// The last text of the autopilot with severity warning or worse.
    warning: Option<(Instant, String)>,
    /// The last text with severity notice or worse.
    notice: Option<(Instant, String)>,
    /// The last command that was refused or not answered.
    refusal: Option<(Instant, String)>,
    /// The last obstacle that the checks waited for.
    obstacle: Option<String>,
    /// The warning that belongs to the fault.
    said: Option<String>,
    /// The mode at the fault.
    taken: Option<String>,
    /// The heartbeat was lost soon after the position.
    link_lost: bool,
}

impl Reasons {
    /// Records an event.
    pub(super) fn note(&mut self, now: Instant, event: &Event) {
        match event {
            Event::Text { severity, text } if *severity <= NOTICE => {
                self.notice = Some((now, text.to_string()));
                if *severity <= WARNING {
                    self.warning = self.notice.clone();
                }
                let taken = |(since, cause): &(Instant, Cause)| {
                    matches!(cause, Cause::ControlTaken(_) | Cause::Disarmed)
                        && now.duration_since(*since) <= AFTER
                };
                if self.said.is_none() && self.fault.as_ref().is_some_and(taken) {
                    self.said = Some(text.to_string());
                }
            }
            Event::Mode { firmware, mode } => {
                self.mode = Some(firmware.mode_name(*mode).to_string());
            }
            Event::Failed { .. } => self.refusal = Some((now, event.to_string())),
            Event::Waiting(obstacle) => self.obstacle = Some(obstacle.to_string()),
            Event::Failsafe { cause, .. } if self.fault.is_none() => {
                self.fault = Some((now, *cause));
                let window = match cause {
                    Cause::StageTimedOut => BEFORE_TIME_OUT,
                    _ => BEFORE,
                };
                self.said = lately(&self.warning, now, window);
                if matches!(cause, Cause::ControlTaken(_)) {
                    self.said = self.said.take().or(lately(&self.notice, now, window));
                }
                self.taken = self.mode.clone();
            }
            Event::Failsafe {
                cause: Cause::HeartbeatLost,
                ..
            } => {
                self.link_lost |= self.fault.is_some_and(|(since, cause)| {
                    cause == Cause::PositionLost && now.duration_since(since) < BOTH
                });
            }
            _ => {}
        }
    }

    /// Returns the first cause in words; `None` if there was no fault.
    pub(super) fn words(&self) -> Option<String> {
        let (since, cause) = self.fault?;
        let by_itself = match cause {
            Cause::ControlTaken(_) => {
                let mode = self.taken.as_deref().unwrap_or("another mode");
                return Some(match &self.said {
                    Some(said) => format!("control taken by the autopilot: {mode} ({said})"),
                    None => format!("{cause}: {mode}"),
                });
            }
            Cause::PositionLost if self.link_lost => format!("link lost: {cause}, then heartbeat"),
            Cause::CommandFailed => match lately(&self.refusal, since, BEFORE) {
                Some(refusal) => format!("{cause}: {refusal}"),
                None => cause.to_string(),
            },
            Cause::StageTimedOut => match &self.obstacle {
                Some(obstacle) => format!("{cause}: {obstacle}"),
                None => cause.to_string(),
            },
            _ => cause.to_string(),
        };
        Some(match &self.said {
            Some(said) => format!("{by_itself} (autopilot: {said})"),
            None => by_itself,
        })
    }
}

/// Returns the text that was recorded at most `window` before `now`.
fn lately(noted: &Option<(Instant, String)>, now: Instant, window: Duration) -> Option<String> {
    let (at, words) = noted.as_ref()?;
    (now.duration_since(*at) <= window).then(|| words.clone())
}

/// Selects the true cause from the fault of the onboard computer and that of its client: a leg that
/// was refused because the client had already begun to land is a consequence, not a cause.
pub(super) fn first(fault: Option<Fault>, client: Option<String>) -> Option<String> {
    match (fault, client) {
        (Some(Fault::Leg(LegError::Phase(_))), Some(client)) => Some(client),
        (Some(fault), _) => Some(fault.to_string()),
        (None, client) => client,
    }
}

#[cfg(test)]
mod tests {
    use firmware_core::autopilot::{failsafe::Reaction, profile::Firmware, profile::Mode};

    use super::*;

    fn at(seconds: u64) -> Instant {
        Instant::ZERO + Duration::from_secs(seconds)
    }

    fn text(severity: u8, text: &str) -> Event {
        Event::Text {
            severity,
            text: text.try_into().unwrap(),
        }
    }

    fn taken(reasons: &mut Reasons, now: Instant) {
        // ArduCopter's RTL.
        let mode = Mode(6);
        let firmware = Firmware::ArduCopter;
        reasons.note(now, &Event::Mode { firmware, mode });
        let event = Event::Failsafe {
            cause: Cause::ControlTaken(mode),
            reaction: Reaction::Release,
        };
        reasons.note(now, &event);
    }

    #[test]
    fn the_autopilots_own_words_name_the_cause() {
        let mut reasons = Reasons::default();
        assert_eq!(reasons.words(), None);
        reasons.note(at(9), &text(6, "EKF3 IMU0 is using GPS"));
        reasons.note(at(10), &text(4, "GCS Failsafe"));
        taken(&mut reasons, at(12));
        let mut fence = Reasons::default();
        fence.note(at(10), &text(5, "Circle fence breached"));
        taken(&mut fence, at(10));
        let words = "control taken by the autopilot: RTL (Circle fence breached)";
        assert_eq!(fence.words().as_deref(), Some(words));
        let words = "control taken by the autopilot: RTL (GCS Failsafe)";
        assert_eq!(reasons.words().unwrap(), words);
        // A consequence does not replace the cause.
        reasons.note(at(12), &text(4, "Something else"));
        let later = Event::Failsafe {
            cause: Cause::StopAsked,
            reaction: Reaction::Land,
        };
        reasons.note(at(13), &later);
        assert_eq!(reasons.words().unwrap(), words);
    }

    #[test]
    fn without_words_nobody_is_blamed_and_late_words_count() {
        let mut reasons = Reasons::default();
        reasons.note(at(1), &text(4, "long ago"));
        taken(&mut reasons, at(12));
        let nobody = "control taken by the pilot or the autopilot: RTL";
        assert_eq!(reasons.words().unwrap(), nobody);
        reasons.note(at(13), &text(2, "Battery 1 is low 21.0V used 3000 mAh"));
        assert!(
            reasons
                .words()
                .unwrap()
                .ends_with("RTL (Battery 1 is low 21.0V used 3000 mAh)")
        );
    }
}

//! The options of MAVLink signing.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use firmware_core::autopilot::wire::signing::{LinkSigning, SigningState, SigningTime};
use host_sim::signing::{SigningClock, SigningUpkeep};
use link::key;

use super::Failure;

/// The key and the link id.
#[derive(Clone, Debug, Args)]
pub(crate) struct KeyArguments {
    /// Sign all sent messages with the key in this file (64 hexadecimal digits or 32 bytes, mode
    /// 600), and accept only messages with a valid signature
    #[arg(long, value_name = "FILE")]
    signing_key: Option<PathBuf>,
    /// Link id in the signatures of sent messages [default: 1, and 0 for a vehicle]
    #[arg(long, value_name = "ID", requires = "signing_key")]
    signing_link: Option<u8>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ClockChoice {
    /// The system's clock, or that of the simulation
    System,
    /// None: the time is that of the saved state, and then of received messages
    Unknown,
}

/// The options of a program that may run for long, and be restarted.
#[derive(Clone, Debug, Args)]
pub(crate) struct SigningArguments {
    #[command(flatten)]
    key: KeyArguments,
    /// File in which the time and the replay state of signatures survive a restart: recorded messages
    /// from before it are refused
    #[arg(long, value_name = "FILE", requires = "signing_key")]
    signing_state: Option<PathBuf>,
    /// Clock of the signatures: system, or unknown as on a device without a real-time clock
    #[arg(
        long,
        value_name = "CLOCK",
        default_value = "system",
        requires = "signing_key"
    )]
    signing_clock: ClockChoice,
}

impl KeyArguments {
    /// Reads the key. `link` is the default link id.
    pub(super) fn load(&self, link: u8) -> Result<Option<LinkSigning>, Failure> {
        let key = self.signing_key.as_deref().map(key::read).transpose();
        let key = key.map_err(Failure::bad_input)?;
        Ok(key.map(|key| LinkSigning {
            key,
            link: self.signing_link.unwrap_or(link),
            state: SigningState::default(),
        }))
    }
}

impl SigningArguments {
    /// Reads the key and the saved state. `link` is the default link id, `unix_us` the date of the
    /// clock.
    pub(super) fn load(
        &self,
        link: u8,
        unix_us: u64,
    ) -> Result<Option<(LinkSigning, SigningUpkeep)>, Failure> {
        let Some(mut signing) = self.key.load(link)? else {
            return Ok(None);
        };
        let mut upkeep = SigningUpkeep::new(match self.signing_clock {
            ClockChoice::System => SigningClock::System,
            ClockChoice::Unknown => SigningClock::Unknown,
        });
        if let Some(path) = &self.signing_state {
            signing.state = upkeep.keep_in(path).map_err(Failure::bad_input)?;
        }
        // "The maximum of the timestamp implied by the system clock and the stored timestamp."
        let date = upkeep.date(unix_us).and_then(SigningTime::from_unix_us);
        signing.state.time = signing.state.time.max(date.unwrap_or_default());
        Ok(Some((signing, upkeep)))
    }
}

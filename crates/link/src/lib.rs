//! Links to autopilots: they transfer bytes in both directions and never block indefinitely.
//!
//! ```text
//! LinkAddress (a --link string) ─ open ─ Link (udpin, udpout, tcpout, serial)
//!                                          ├ Port: frames, checks, numbers, signs, logs
//!                                          ├ GroundStationTap: a ground station that observes the flight
//!                                          └ lossy::Impaired: a bad radio, seeded
//! ```

#![deny(missing_docs)]

pub mod audit;
pub mod faults;
mod ground_station_tap;
pub mod key;
pub mod lossy;
mod port;
mod serial;
mod tcp;
pub mod tlog;
mod udp;

use std::fmt;
use std::io;
use std::str::FromStr;
use std::time::Duration;

pub use ground_station_tap::GroundStationTap;
pub use port::Port;

/// A bidirectional link to one place.
pub trait Link: Send + fmt::Debug {
    /// Sends a frame. A link that is down drops the frame and returns `Ok(false)`. It recovers by
    /// itself.
    fn send(&mut self, frame: &[u8]) -> io::Result<bool>;

    /// Waits at most `timeout` for bytes and puts them into `buffer`, which is cleared first.
    /// Returns false if no bytes were received.
    fn receive(&mut self, buffer: &mut Vec<u8>, timeout: Duration) -> io::Result<bool>;

    /// Returns whether bytes that are received together were sent together. A frame then never
    /// continues in the next piece.
    fn is_datagram(&self) -> bool;

    /// Returns why the link is down, if it is known. It is part of the message that reports missing
    /// heartbeats.
    fn last_error(&self) -> Option<String> {
        None
    }
}

/// Error returned when nothing was heard from the other end of a link.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("no heartbeat of an autopilot in {waited_s:.0} s: {}", self.likely_reason())]
pub struct NoHeartbeat {
    /// The time that was waited, seconds of the vehicle's time.
    pub waited_s: f64,
    /// The number of frames that were rejected because of their signature.
    pub refused: u32,
    /// The reason why the link is down, if it is known.
    pub last_error: Option<String>,
}

impl NoHeartbeat {
    fn likely_reason(&self) -> String {
        match (&self.last_error, self.refused) {
            (Some(last_error), _) => last_error.clone(),
            (None, 0) => "is it running, and at the other end of --link?".into(),
            (None, refused) => format!(
                "{refused} frames came that were not signed with the key of --signing-key, or \
                 replayed"
            ),
        }
    }
}

/// The address of an autopilot, as given by `--link`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum LinkAddress {
    /// The built-in vehicle, in this process.
    Builtin,
    /// UDP datagrams are sent to this address; answers are received from it.
    UdpOut(HostPort),
    /// UDP datagrams are received at this address; every sender is answered.
    UdpIn(HostPort),
    /// A connection is made to this TCP server.
    TcpOut(HostPort),
    /// A serial device.
    Serial {
        /// The path of the device.
        device: String,
        /// The rate, bits per second.
        baud: u32,
    },
}

/// A host name or address, and a port.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct HostPort {
    /// The name, IPv4 address, or IPv6 address without brackets.
    pub host: String,
    /// The port.
    pub port: u16,
}

/// Error returned when a `--link` string is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "link {given:?}: {problem}; expected builtin, udpout:HOST:PORT, udpin:HOST:PORT, \
     tcpout:HOST:PORT or serial:DEVICE:BAUD"
)]
pub struct LinkAddressError {
    given: String,
    problem: String,
}

const BAUDS: std::ops::RangeInclusive<u32> = 1_200..=4_000_000;

impl FromStr for LinkAddress {
    type Err = LinkAddressError;

    fn from_str(given: &str) -> Result<Self, LinkAddressError> {
        let error = |problem: String| LinkAddressError {
            given: given.to_owned(),
            problem,
        };
        if given == "builtin" {
            return Ok(Self::Builtin);
        }
        let Some((kind, rest)) = given.split_once(':') else {
            return Err(error(format!("{given:?} is not a kind of link")));
        };
        match kind {
            "udpout" => host_port(rest).map(Self::UdpOut).map_err(error),
            "udpin" => host_port(rest).map(Self::UdpIn).map_err(error),
            "tcpout" => host_port(rest).map(Self::TcpOut).map_err(error),
            "serial" => {
                let Some((device, baud)) = rest.rsplit_once(':').filter(|(d, _)| !d.is_empty())
                else {
                    return Err(error("a device and a baud rate are needed".into()));
                };
                let rate = baud.parse().ok().filter(|rate| BAUDS.contains(rate));
                let Some(baud) = rate else {
                    return Err(error(format!(
                        "{baud:?} is not a baud rate (1200 to 4000000)"
                    )));
                };
                Ok(Self::Serial {
                    device: device.to_owned(),
                    baud,
                })
            }
            other => Err(error(format!("{other:?} is not a kind of link"))),
        }
    }
}

fn host_port(text: &str) -> Result<HostPort, String> {
    let Some((host, port)) = text.rsplit_once(':') else {
        return Err("a host and a port are needed".into());
    };
    let host = host
        .strip_prefix('[')
        .and_then(|h| h.strip_suffix(']'))
        .unwrap_or(host);
    if host.is_empty() {
        return Err("the host is empty".into());
    }
    match port.parse() {
        Ok(0) | Err(_) => Err(format!("{port:?} is not a port (1 to 65535)")),
        Ok(port) => Ok(HostPort {
            host: host.to_owned(),
            port,
        }),
    }
}

impl FromStr for HostPort {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        host_port(text)
    }
}

impl fmt::Display for HostPort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.host.contains(':') {
            write!(f, "[{}]:{}", self.host, self.port)
        } else {
            write!(f, "{}:{}", self.host, self.port)
        }
    }
}

impl fmt::Display for LinkAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Builtin => f.write_str("builtin"),
            Self::UdpOut(to) => write!(f, "udpout:{to}"),
            Self::UdpIn(at) => write!(f, "udpin:{at}"),
            Self::TcpOut(to) => write!(f, "tcpout:{to}"),
            Self::Serial { device, baud } => write!(f, "serial:{device}:{baud}"),
        }
    }
}

impl LinkAddress {
    /// Opens the link. Sockets are bound at once. If a TCP server or a serial device is not
    /// available yet, opening it is retried while the link is used. The built-in vehicle cannot be
    /// opened as a link.
    pub fn open(&self) -> io::Result<Box<dyn Link>> {
        Ok(match self {
            Self::Builtin => {
                let message = "the built-in vehicle is not reached over a link";
                return Err(io::Error::new(io::ErrorKind::InvalidInput, message));
            }
            Self::UdpOut(to) => Box::new(udp::UdpOut::open(to)?),
            Self::UdpIn(at) => Box::new(udp::UdpIn::open(at)?),
            Self::TcpOut(to) => Box::new(tcp::TcpOut::open(to)),
            Self::Serial { device, baud } => Box::new(serial::Serial::open(device, *baud)?),
        })
    }
}

/// The wait before a retry. It doubles each time, up to a limit.
#[derive(Debug)]
struct BackOff {
    wait: Duration,
    next: Option<std::time::Instant>,
    /// The last error.
    reason: Option<io::Error>,
}

impl BackOff {
    const FIRST: Duration = Duration::from_millis(100);
    const LONGEST: Duration = Duration::from_secs(5);

    fn new() -> Self {
        Self {
            wait: Self::FIRST,
            next: None,
            reason: None,
        }
    }

    fn may_try(&self) -> bool {
        self.next
            .is_none_or(|next| std::time::Instant::now() >= next)
    }

    fn failed(&mut self, reason: io::Error) {
        self.reason = Some(reason);
        self.next = Some(std::time::Instant::now() + self.wait);
        self.wait = (self.wait * 2).min(Self::LONGEST);
    }
}

/// Returns whether an error means that nothing is available now, rather than that the link is
/// broken.
fn is_idle(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted
    )
}

/// The interval at which a socket is polled.
const ASK_EVERY: Duration = Duration::from_micros(200);

/// Polls a non-blocking socket until it has something to return, or returns `Ok(None)` when
/// `timeout` has passed. A socket's own time-out is rounded up to ticks of the kernel (8 ms where
/// this was measured), which is too coarse for a loop that polls every 2 ms.
fn patiently<T>(
    timeout: Duration,
    mut attempt: impl FnMut() -> io::Result<T>,
) -> io::Result<Option<T>> {
    let begin = std::time::Instant::now();
    loop {
        match attempt() {
            Ok(value) => return Ok(Some(value)),
            Err(error) if is_idle(&error) => {}
            Err(error) => return Err(error),
        }
        let left = timeout.saturating_sub(begin.elapsed());
        if left.is_zero() {
            return Ok(None);
        }
        std::thread::sleep(left.min(ASK_EVERY));
    }
}

/// The largest number of bytes that are received at once.
const PIECE: usize = 4096;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn link_strings_are_read_and_written_alike() {
        for text in [
            "builtin",
            "udpout:127.0.0.1:14550",
            "udpin:0.0.0.0:14550",
            "tcpout:localhost:5760",
            "udpin:[::1]:14550",
            "serial:/dev/ttyACM0:921600",
            "serial:/dev/serial/by-id/usb-x:y-if00:57600",
        ] {
            assert_eq!(text.parse::<LinkAddress>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn wrong_link_strings_say_what_would_be_right() {
        for (text, problem) in [
            ("", "\"\" is not a kind of link"),
            ("udp:1.2.3.4:5", "\"udp\" is not a kind of link"),
            ("udpout:127.0.0.1", "a host and a port are needed"),
            ("udpout::14550", "the host is empty"),
            ("udpin:0.0.0.0:0", "\"0\" is not a port"),
            ("tcpout:localhost:99999", "\"99999\" is not a port"),
            ("serial:/dev/ttyACM0", "a device and a baud rate are needed"),
            ("serial:/dev/ttyACM0:fast", "\"fast\" is not a baud rate"),
        ] {
            let error = text.parse::<LinkAddress>().unwrap_err().to_string();
            assert!(error.contains(problem), "{error}");
            assert!(
                error.contains("expected builtin, udpout:HOST:PORT"),
                "{error}"
            );
        }
    }
}

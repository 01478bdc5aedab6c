//! A TCP connection to a server that may become unavailable and available again.
//!
//! A separate thread resolves the name and makes the connection, because both can take seconds
//! while a flight continues.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};
use std::time::Duration;

use super::{BackOff, HostPort, Link, PIECE, patiently};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);
const WRITE_TIMEOUT: Duration = Duration::from_millis(500);
/// Data that has not been acknowledged for this long is dropped together with the connection. A
/// command for a vehicle must not arrive long after it was given, nor after this process has ended.
#[cfg(target_os = "linux")]
const UNACKNOWLEDGED: Duration = Duration::from_secs(3);

/// A connection that is made when it is needed, and made again after it has failed.
#[derive(Debug)]
pub(super) struct TcpOut {
    to: HostPort,
    stream: Option<TcpStream>,
    /// The attempt to connect that is in progress.
    attempt: Option<Receiver<io::Result<TcpStream>>>,
    back_off: BackOff,
}

impl TcpOut {
    pub(super) fn open(to: &HostPort) -> Self {
        Self {
            to: to.clone(),
            stream: None,
            attempt: None,
            back_off: BackOff::new(),
        }
    }

    /// Returns the connection, if there is one. Never waits: if there is no connection, an attempt
    /// to make one is started.
    fn connected(&mut self) -> Option<&mut TcpStream> {
        if self.stream.is_none() {
            match &self.attempt {
                Some(attempt) => match attempt.try_recv() {
                    Ok(outcome) => self.concluded(outcome),
                    Err(TryRecvError::Empty) => {}
                    Err(TryRecvError::Disconnected) => {
                        self.concluded(Err(io::ErrorKind::ConnectionAborted.into()));
                    }
                },
                None if self.back_off.may_try() => {
                    let (outcome, attempt) = sync_channel(1);
                    let to = self.to.clone();
                    std::thread::spawn(move || {
                        // If the link has been closed, the result is no longer needed.
                        let _ = outcome.send(connect(&to));
                    });
                    self.attempt = Some(attempt);
                }
                None => {}
            }
        }
        self.stream.as_mut()
    }

    fn concluded(&mut self, outcome: io::Result<TcpStream>) {
        self.attempt = None;
        match outcome {
            Ok(stream) => {
                self.stream = Some(stream);
                self.back_off = BackOff::new();
            }
            Err(error) => self.back_off.failed(error),
        }
    }

    fn broken(&mut self, reason: io::Error) {
        self.stream = None;
        self.back_off.failed(reason);
    }
}

fn connect(to: &HostPort) -> io::Result<TcpStream> {
    let addresses = (to.host.as_str(), to.port).to_socket_addrs()?;
    let stream = connect_to_any(&addresses.collect::<Vec<_>>())?;
    // Setpoints are small and must not be collected into larger segments.
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
    #[cfg(target_os = "linux")]
    rustix::net::sockopt::set_tcp_user_timeout(&stream, UNACKNOWLEDGED.as_millis() as u32)?;
    Ok(stream)
}

/// Connects to the first address of a name that answers. All attempts together take at most
/// [`CONNECT_TIMEOUT`].
fn connect_to_any(addresses: &[SocketAddr]) -> io::Result<TcpStream> {
    let share = CONNECT_TIMEOUT / addresses.len().max(1) as u32;
    let mut last = io::Error::new(io::ErrorKind::NotFound, "the name has no address");
    for address in addresses {
        match TcpStream::connect_timeout(address, share) {
            Ok(stream) => return Ok(stream),
            Err(error) => last = error,
        }
    }
    Err(last)
}

impl Link for TcpOut {
    fn send(&mut self, frame: &[u8]) -> io::Result<bool> {
        let Some(stream) = self.connected() else {
            return Ok(false);
        };
        // A frame that was sent in part cannot be taken back, so a new connection is made.
        let sent = stream.write_all(frame);
        sent.map_or_else(
            |error| {
                self.broken(error);
                Ok(false)
            },
            |()| Ok(true),
        )
    }

    fn receive(&mut self, buffer: &mut Vec<u8>, timeout: Duration) -> io::Result<bool> {
        buffer.clear();
        let Some(stream) = self.connected() else {
            std::thread::sleep(timeout.min(BackOff::FIRST));
            return Ok(false);
        };
        buffer.resize(PIECE, 0);
        // Writing blocks for at most its time-out; reading does not block.
        let received = stream
            .set_nonblocking(true)
            .and_then(|()| patiently(timeout, || stream.read(buffer)));
        let received = stream.set_nonblocking(false).and(received);
        match received {
            Ok(Some(length)) if length > 0 => {
                buffer.truncate(length);
                Ok(true)
            }
            Ok(None) => {
                buffer.clear();
                Ok(false)
            }
            Ok(Some(_)) => {
                buffer.clear();
                self.broken(io::ErrorKind::ConnectionAborted.into());
                Ok(false)
            }
            Err(error) => {
                buffer.clear();
                self.broken(error);
                Ok(false)
            }
        }
    }

    fn is_datagram(&self) -> bool {
        false
    }

    fn last_error(&self) -> Option<String> {
        let reason = self.back_off.reason.as_ref()?;
        Some(format!("tcpout:{}: {reason}", self.to))
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;
    use std::time::Instant;

    use super::*;

    fn receive_until(link: &mut TcpOut, wanted: &[u8]) {
        let begin = Instant::now();
        let mut got = Vec::new();
        let mut buffer = Vec::new();
        while got != wanted {
            assert!(begin.elapsed() < Duration::from_secs(20), "got {got:?}");
            if link
                .receive(&mut buffer, Duration::from_millis(20))
                .unwrap()
            {
                got.extend_from_slice(&buffer);
            }
        }
    }

    /// A name may have an address that no server listens on: `localhost` is often ::1 first.
    #[test]
    fn the_address_that_answers_is_taken() {
        let free = TcpListener::bind("127.0.0.1:0").unwrap();
        let nobody = free.local_addr().unwrap();
        drop(free);
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let somebody = listener.local_addr().unwrap();
        for addresses in [[nobody, somebody], [somebody, nobody]] {
            let stream = connect_to_any(&addresses).unwrap();
            assert_eq!(stream.peer_addr().unwrap(), somebody);
        }
        let refused = connect_to_any(&[nobody]).unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::ConnectionRefused);
        let none = connect_to_any(&[]).unwrap_err();
        assert_eq!(none.to_string(), "the name has no address");
    }

    /// An address that does not answer an attempt, as a host behind a cut cable does not, and a
    /// name that takes long to resolve: neither may delay a flight, which polls every few
    /// milliseconds.
    #[test]
    fn an_attempt_that_hangs_holds_nothing_up() {
        // The queue of a listener that does not accept connections fills up, and further attempts
        // hang.
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let waiting: Vec<_> = (0..300)
            .map_while(|_| {
                let address = listener.local_addr().unwrap();
                TcpStream::connect_timeout(&address, Duration::from_millis(100)).ok()
            })
            .collect();
        assert!(waiting.len() < 300, "the queue never filled");
        for host in ["127.0.0.1", "no-such-host.invalid"] {
            let host = host.into();
            let mut link = TcpOut::open(&HostPort { host, port });
            let begin = Instant::now();
            for _ in 0..20 {
                assert!(!link.send(b"frame").unwrap());
                let timeout = Duration::from_millis(2);
                assert!(!link.receive(&mut Vec::new(), timeout).unwrap());
            }
            assert!(begin.elapsed() < Duration::from_millis(500));
        }
    }

    #[test]
    fn it_connects_late_and_again() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let host = "127.0.0.1".into();
        let mut link = TcpOut::open(&HostPort { host, port });
        let server = std::thread::spawn(move || {
            for word in [b"one", b"two"] {
                let (mut stream, _) = listener.accept().unwrap();
                stream.write_all(word).unwrap();
            } // and hangs up
        });
        receive_until(&mut link, b"one");
        receive_until(&mut link, b"two");
        server.join().unwrap();
    }
}

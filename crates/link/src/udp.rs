//! UDP: one datagram per frame, in both directions.

use std::io;
use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};
use std::time::{Duration, Instant};

use super::{ASK_EVERY, HostPort, Link, PIECE, is_idle, patiently};

/// A peer that was not heard for this long is no longer answered.
const PEER_TIMEOUT: Duration = Duration::from_secs(30);
/// The largest number of ground stations and clients that are answered at the same time.
const PEERS: usize = 8;

fn resolve(at: &HostPort) -> io::Result<SocketAddr> {
    let found = (at.host.as_str(), at.port)
        .to_socket_addrs()
        .map_err(|error| io::Error::new(error.kind(), format!("{at}: {error}")))?;
    preferred(found)
        .ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, format!("{at}: no address")))
}

/// Returns the first IPv4 address of a name, because autopilots listen at IPv4 addresses, or the
/// first address if none is IPv4. It cannot be determined whether anything listens at an address,
/// and both ends must use the same one.
fn preferred(mut found: impl Iterator<Item = SocketAddr>) -> Option<SocketAddr> {
    let first = found.next()?;
    if first.is_ipv4() {
        return Some(first);
    }
    Some(found.find(SocketAddr::is_ipv4).unwrap_or(first))
}

/// Waits for a datagram. Returns `None` if none was received or if the peer is not available (any
/// more), which UDP reports as an error of the *next* call. Other errors (an interface that is
/// down, a missing route) are stored in `last_error`. They may disappear when the cable is
/// connected again, and they must not end a flight.
fn receive_datagram(
    socket: &UdpSocket,
    buffer: &mut Vec<u8>,
    timeout: Duration,
    last_error: &mut Option<io::Error>,
) -> Option<SocketAddr> {
    buffer.resize(PIECE, 0);
    let received = patiently(timeout, || socket.recv_from(buffer));
    match received {
        Ok(Some((length, from))) => {
            buffer.truncate(length);
            *last_error = None;
            Some(from)
        }
        Ok(None) => {
            buffer.clear();
            None
        }
        Err(error) => {
            buffer.clear();
            // Without this pause, a caller that retries at once would do so in a busy loop.
            std::thread::sleep(timeout.min(ASK_EVERY));
            note(last_error, error);
            None
        }
    }
}

/// Returns whether the datagram was sent. If it was not, it is lost, as any datagram may be.
fn send_datagram(
    socket: &UdpSocket,
    frame: &[u8],
    to: SocketAddr,
    last_error: &mut Option<io::Error>,
) -> bool {
    match socket.send_to(frame, to) {
        Ok(_) => true,
        Err(error) => {
            note(last_error, error);
            false
        }
    }
}

/// Stores an error, unless it only means that nothing listens at the other end.
fn note(last_error: &mut Option<io::Error>, error: io::Error) {
    let absent = matches!(
        error.kind(),
        io::ErrorKind::ConnectionRefused | io::ErrorKind::ConnectionReset
    );
    if !absent && !is_idle(&error) {
        *last_error = Some(error);
    }
}

/// Sends to one address and accepts answers only from there.
#[derive(Debug)]
pub(super) struct UdpOut {
    socket: UdpSocket,
    to: SocketAddr,
    last_error: Option<io::Error>,
}

impl UdpOut {
    pub(super) fn open(to: &HostPort) -> io::Result<Self> {
        let to = resolve(to)?;
        let any: SocketAddr = if to.is_ipv4() {
            ([0, 0, 0, 0], 0).into()
        } else {
            ([0u16; 8], 0).into()
        };
        let socket = UdpSocket::bind(any)?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            socket,
            to,
            last_error: None,
        })
    }
}

impl Link for UdpOut {
    fn send(&mut self, frame: &[u8]) -> io::Result<bool> {
        Ok(send_datagram(
            &self.socket,
            frame,
            self.to,
            &mut self.last_error,
        ))
    }

    fn receive(&mut self, buffer: &mut Vec<u8>, timeout: Duration) -> io::Result<bool> {
        match receive_datagram(&self.socket, buffer, timeout, &mut self.last_error) {
            Some(from) if from == self.to => Ok(true),
            _ => {
                buffer.clear();
                Ok(false)
            }
        }
    }

    fn is_datagram(&self) -> bool {
        true
    }

    fn last_error(&self) -> Option<String> {
        let last_error = self.last_error.as_ref()?;
        Some(format!("udpout:{}: {last_error}", self.to))
    }
}

/// Listens, and answers every peer that was heard recently, so that a ground station can observe
/// the flight as well.
#[derive(Debug)]
pub(super) struct UdpIn {
    socket: UdpSocket,
    peers: Vec<(SocketAddr, Instant)>,
    last_error: Option<io::Error>,
}

impl UdpIn {
    pub(super) fn open(at: &HostPort) -> io::Result<Self> {
        let address = resolve(at)?;
        let socket = UdpSocket::bind(address).map_err(|error| {
            io::Error::new(error.kind(), format!("cannot listen at udp {at}: {error}"))
        })?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            socket,
            peers: Vec::new(),
            last_error: None,
        })
    }

    fn heard(&mut self, from: SocketAddr) {
        let now = Instant::now();
        self.peers
            .retain(|(peer, heard)| *peer != from && now - *heard < PEER_TIMEOUT);
        if self.peers.len() == PEERS {
            self.peers.remove(0); // the one that was silent longest
        }
        self.peers.push((from, now));
    }
}

impl Link for UdpIn {
    fn send(&mut self, frame: &[u8]) -> io::Result<bool> {
        let mut sent = false;
        for (peer, _) in &self.peers {
            sent |= send_datagram(&self.socket, frame, *peer, &mut self.last_error);
        }
        Ok(sent)
    }

    fn receive(&mut self, buffer: &mut Vec<u8>, timeout: Duration) -> io::Result<bool> {
        let from = receive_datagram(&self.socket, buffer, timeout, &mut self.last_error);
        if let Some(from) = from {
            self.heard(from);
        }
        Ok(from.is_some())
    }

    fn is_datagram(&self) -> bool {
        true
    }

    fn last_error(&self) -> Option<String> {
        self.last_error.as_ref().map(io::Error::to_string)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair() -> (UdpIn, UdpOut) {
        // With port 0, the system chooses a free port.
        let local = HostPort {
            host: "127.0.0.1".into(),
            port: 0,
        };
        let inward = UdpIn::open(&local).unwrap();
        let port = inward.socket.local_addr().unwrap().port();
        let outward = UdpOut::open(&HostPort { port, ..local }).unwrap();
        (inward, outward)
    }

    /// UDP cannot show whether anything listens at an address, and both ends must use the same one.
    #[test]
    fn of_the_addresses_of_a_name_an_ipv4_one_is_taken() {
        let chosen = |addresses: &[&str]| {
            let addresses: Vec<SocketAddr> = addresses.iter().map(|a| a.parse().unwrap()).collect();
            preferred(addresses.into_iter()).map(|address| address.to_string())
        };
        let four = Some("127.0.0.1:5".to_owned());
        assert_eq!(chosen(&["[::1]:5", "127.0.0.1:5", "127.0.0.2:5"]), four);
        assert_eq!(chosen(&["127.0.0.1:5", "[::1]:5"]), four);
        assert_eq!(chosen(&["[::1]:5"]), Some("[::1]:5".into()));
        assert_eq!(chosen(&[]), None);
    }

    const SOON: Duration = Duration::from_millis(500);

    #[test]
    fn datagrams_go_both_ways_and_to_every_listener() {
        let (mut inward, mut first) = pair();
        let port = inward.socket.local_addr().unwrap().port();
        let host = "127.0.0.1".into();
        let mut second = UdpOut::open(&HostPort { host, port }).unwrap();
        let mut buffer = Vec::new();
        assert!(!inward.send(b"nobody yet").unwrap());
        for link in [&mut first, &mut second] {
            assert!(link.send(b"hello").unwrap());
            assert!(inward.receive(&mut buffer, SOON).unwrap());
            assert_eq!(buffer, b"hello");
        }
        assert!(inward.send(b"both").unwrap());
        for link in [&mut first, &mut second] {
            assert!(link.receive(&mut buffer, SOON).unwrap());
            assert_eq!(buffer, b"both");
        }
    }

    #[test]
    fn nobody_there_is_no_error_and_no_wait_for_ever() {
        let (inward, mut outward) = pair();
        drop(inward);
        let begin = Instant::now();
        let mut buffer = Vec::new();
        for _ in 0..3 {
            outward.send(b"anyone?").unwrap();
            let wait = Duration::from_millis(5);
            assert!(!outward.receive(&mut buffer, wait).unwrap());
        }
        assert!(!outward.receive(&mut buffer, Duration::ZERO).unwrap());
        assert!(begin.elapsed() < Duration::from_secs(5));
    }

    #[test]
    fn a_taken_port_is_named() {
        let (inward, _) = pair();
        let port = inward.socket.local_addr().unwrap().port();
        let host = "127.0.0.1".into();
        let error = UdpIn::open(&HostPort { host, port })
            .unwrap_err()
            .to_string();
        assert!(error.contains(&format!("127.0.0.1:{port}")), "{error}");
    }
}

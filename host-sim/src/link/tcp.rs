//! TCP to a server that may come and go.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::time::Duration;

use super::{BackOff, HostPort, Link, PIECE, patiently};

const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);
const WRITE_TIMEOUT: Duration = Duration::from_millis(500);

/// A connection that is made when it is needed, and again when it broke.
#[derive(Debug)]
pub(super) struct TcpOut {
    to: HostPort,
    stream: Option<TcpStream>,
    back_off: BackOff,
}

impl TcpOut {
    pub(super) fn open(to: &HostPort) -> Self {
        Self {
            to: to.clone(),
            stream: None,
            back_off: BackOff::new(),
        }
    }

    fn connect(&self) -> io::Result<TcpStream> {
        let addresses = (self.to.host.as_str(), self.to.port).to_socket_addrs()?;
        let stream = connect_to_any(&addresses.collect::<Vec<_>>())?;
        // Setpoints are small and must not wait for company.
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
        Ok(stream)
    }

    fn connected(&mut self) -> Option<&mut TcpStream> {
        if self.stream.is_none() && self.back_off.may_try() {
            match self.connect() {
                Ok(stream) => {
                    self.stream = Some(stream);
                    self.back_off = BackOff::new();
                }
                Err(error) => self.back_off.failed(error),
            }
        }
        self.stream.as_mut()
    }

    fn broken(&mut self, reason: io::Error) {
        self.stream = None;
        self.back_off.failed(reason);
    }
}

/// To the first address of a name that answers. All together may take [`CONNECT_TIMEOUT`]: a flight
/// waits meanwhile.
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
        // A frame that was sent in part cannot be taken back: the connection starts anew.
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
        // Writing blocks, for at most its time-out; reading does not.
        stream.set_nonblocking(true)?;
        let received = patiently(timeout, || stream.read(buffer));
        stream.set_nonblocking(false)?;
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

    fn trouble(&self) -> Option<String> {
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

    /// A name may have an address at which nobody listens: `localhost` is often ::1 first.
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

//! A second link at which somebody listens beside: a ground station.
//!
//! It has a thread of its own, so that a ground station that hangs cannot hold up a flight. It
//! hears every frame in both directions, and what it sends goes to the vehicle as it came: the
//! vehicle judges it, and a pilot can take over from there. None of it reaches our client.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use firmware_core::autopilot::wire::Decoder;

use super::Link;

/// Frames that wait for the thread; when it hangs, further ones are lost, as on a radio.
const QUEUE: usize = 1024;
/// How long the thread waits for something to come before it looks for something to send.
const LOOK: Duration = Duration::from_millis(2);
/// A link that fails is left alone for this long.
const PAUSE: Duration = Duration::from_millis(200);

/// A link beside; it ends with its owner.
#[derive(Debug)]
pub struct GroundStationTap {
    heard: SyncSender<Vec<u8>>,
    said: Receiver<Vec<u8>>,
    contact: Arc<Mutex<Contact>>,
}

/// Whether anybody was there.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Contact {
    /// A frame has gone, or something has come. (What UDP takes may still be heard by nobody.)
    Made,
    /// Nobody yet, and why, where that is known.
    None { last_error: Option<String> },
}

impl GroundStationTap {
    /// Serves this link from now on.
    pub fn new(link: Box<dyn Link>) -> Self {
        let (heard, to_send) = sync_channel(QUEUE);
        let (came, said) = sync_channel(QUEUE);
        let contact = Arc::new(Mutex::new(Contact::None { last_error: None }));
        thread::spawn({
            let contact = Arc::clone(&contact);
            move || serve(link, &to_send, &came, &contact)
        });
        Self {
            heard,
            said,
            contact,
        }
    }

    /// Where nobody was ever reached: why, or an empty reason where that is not known.
    pub fn unreached(&self) -> Option<String> {
        let contact = self.contact.lock().unwrap_or_else(PoisonError::into_inner);
        match &*contact {
            Contact::Made => None,
            Contact::None { last_error } => Some(last_error.clone().unwrap_or_default()),
        }
    }

    /// Lets it hear a frame.
    pub fn hear(&self, frame: &[u8]) {
        // Full, or gone: the flight goes on without it.
        let _ = self.heard.try_send(frame.to_vec());
    }

    /// The next frame that it said.
    pub fn take_said(&self) -> Option<Vec<u8>> {
        self.said.try_recv().ok()
    }
}

fn serve(
    mut link: Box<dyn Link>,
    to_send: &Receiver<Vec<u8>>,
    came: &SyncSender<Vec<u8>>,
    contact: &Mutex<Contact>,
) {
    let note = |made: bool, last_error: Option<String>| {
        let mut contact = contact.lock().unwrap_or_else(PoisonError::into_inner);
        if made {
            *contact = Contact::Made;
        } else if let Contact::None { last_error: known } = &mut *contact
            && last_error.is_some()
        {
            *known = last_error;
        }
    };
    let mut decoder = Decoder::new();
    let mut piece = Vec::new();
    loop {
        loop {
            match to_send.try_recv() {
                Ok(frame) => match link.send(&frame) {
                    Ok(sent) => note(sent, link.last_error()),
                    Err(error) => {
                        note(false, Some(error.to_string()));
                        thread::sleep(PAUSE);
                    }
                },
                Err(std::sync::mpsc::TryRecvError::Empty) => break,
                Err(std::sync::mpsc::TryRecvError::Disconnected) => return,
            }
        }
        match link.receive(&mut piece, LOOK) {
            Ok(true) => note(true, None),
            Ok(false) => continue,
            Err(error) => {
                note(false, Some(error.to_string()));
                thread::sleep(PAUSE);
                continue;
            }
        }
        let mut frames = Vec::new();
        let mut bytes = piece.as_slice();
        while let Some(frame) = decoder.next_frame(&mut bytes) {
            frames.push(frame.bytes().to_vec());
        }
        while link.is_datagram()
            && let Some(frame) = decoder.end_of_datagram()
        {
            frames.push(frame.bytes().to_vec());
        }
        for frame in frames {
            if let Err(TrySendError::Disconnected(_)) = came.try_send(frame) {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::time::Instant;

    use super::*;

    /// A link that hangs, as a connection to a host that is down does.
    #[derive(Debug)]
    struct Hangs;

    impl Link for Hangs {
        fn send(&mut self, _: &[u8]) -> io::Result<bool> {
            thread::sleep(Duration::from_secs(1));
            Ok(false)
        }

        fn receive(&mut self, _: &mut Vec<u8>, _: Duration) -> io::Result<bool> {
            Err(io::ErrorKind::BrokenPipe.into())
        }

        fn is_datagram(&self) -> bool {
            false
        }
    }

    /// A link to where nobody is, until it is `up`.
    #[derive(Debug)]
    struct Down {
        up: bool,
    }

    impl Link for Down {
        fn send(&mut self, _: &[u8]) -> io::Result<bool> {
            Ok(self.up)
        }

        fn receive(&mut self, _: &mut Vec<u8>, timeout: Duration) -> io::Result<bool> {
            thread::sleep(timeout);
            Ok(false)
        }

        fn is_datagram(&self) -> bool {
            false
        }

        fn last_error(&self) -> Option<String> {
            (!self.up).then(|| "nobody listens".into())
        }
    }

    #[test]
    fn whether_anybody_was_reached_is_known() {
        for (up, expected) in [(true, None), (false, Some("nobody listens".to_owned()))] {
            let beside = GroundStationTap::new(Box::new(Down { up }));
            assert_eq!(
                beside.unreached(),
                Some(String::new()),
                "nothing was said yet"
            );
            beside.hear(b"frame");
            let begun = Instant::now();
            while beside.unreached() != expected {
                assert!(begun.elapsed() < Duration::from_secs(10), "{up}");
                thread::sleep(Duration::from_millis(1));
            }
        }
    }

    #[test]
    fn a_ground_station_that_hangs_holds_nothing_up() {
        let beside = GroundStationTap::new(Box::new(Hangs));
        let begun = Instant::now();
        for _ in 0..3 * QUEUE {
            beside.hear(b"frame");
            assert_eq!(beside.take_said(), None);
        }
        assert!(begun.elapsed() < Duration::from_millis(500));
    }
}

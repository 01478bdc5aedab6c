//! A second link, on which a ground station observes the flight.
//!
//! The link has its own thread, so that a ground station that hangs cannot delay a flight. It
//! receives every frame of both directions. What it sends is forwarded to the vehicle unchanged:
//! the vehicle decides whether to accept it, and a pilot can take over from there. None of it
//! reaches our client.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use firmware_core::autopilot::wire::Decoder;

use super::Link;

/// The number of frames that may wait for the thread. If it hangs, further frames are lost, as on a
/// radio.
const QUEUE: usize = 1024;
/// How long the thread waits for input before it checks whether there is something to send.
const LOOK: Duration = Duration::from_millis(2);
/// The time for which a link that failed is not used.
const PAUSE: Duration = Duration::from_millis(200);

/// A second link for a ground station. It is closed when it is dropped.
#[derive(Debug)]
pub struct GroundStationTap {
    heard: SyncSender<Vec<u8>>,
    said: Receiver<Vec<u8>>,
    contact: Arc<Mutex<Contact>>,
}

/// Whether the ground station has been reached.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Contact {
    /// A frame was sent or something was received. (On UDP, a frame that was sent may not have been
    /// received by anyone.)
    Made,
    /// Nothing has been reached yet, and the reason, if it is known.
    None { last_error: Option<String> },
}

impl GroundStationTap {
    /// Starts to serve this link.
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

    /// Returns the reason why the ground station was never reached, which is empty if it is not
    /// known, or `None` if it was reached.
    pub fn unreached(&self) -> Option<String> {
        let contact = self.contact.lock().unwrap_or_else(PoisonError::into_inner);
        match &*contact {
            Contact::Made => None,
            Contact::None { last_error } => Some(last_error.clone().unwrap_or_default()),
        }
    }

    /// Forwards a frame to the ground station.
    pub fn hear(&self, frame: &[u8]) {
        // If the queue is full or the thread has ended, the flight continues without the ground
        // station.
        let _ = self.heard.try_send(frame.to_vec());
    }

    /// Returns the next frame that the ground station sent.
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

    /// A link that hangs, as a connection to an unavailable host does.
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

    /// A link whose other end is not available until it is `up`.
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

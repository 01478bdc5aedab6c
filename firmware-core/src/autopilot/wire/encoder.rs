// SPDX-License-Identifier: MIT OR Apache-2.0
//! Messages to frames.

use mavlink::dialects::common::{EstimatorStatusFlags, MavMessage, MavSeverity, STATUSTEXT_DATA};
use mavlink::{MavlinkVersion, Message, calculate_crc};

use super::client;
use super::frame::Address;
use super::layout::{HEADER, MAX_FRAME, SIGNED, START, ekf_status_report, field};
use super::signing::Signer;

/// Turns messages into frames and numbers them.
#[derive(Clone, Debug)]
pub struct Encoder {
    own: Address,
    sequence: u8,
    signer: Option<Signer>,
}

/// A buffer for one frame.
pub type FrameBuffer = [u8; MAX_FRAME];

impl Encoder {
    /// Creates an encoder that sends as `own`.
    pub const fn new(own: Address) -> Self {
        Self {
            own,
            sequence: 0,
            signer: None,
        }
    }

    /// Signs every frame from now on. The times of an earlier signer with the same key go on.
    pub fn sign_with(&mut self, mut signer: Signer) {
        if let Some(older) = &self.signer {
            signer.continue_from(older);
        }
        self.signer = Some(signer);
    }

    /// Returns the signer, for example to read its clock.
    pub fn signer(&self) -> Option<&Signer> {
        self.signer.as_ref()
    }

    /// Returns the signer, for example to set its clock.
    pub fn signer_mut(&mut self) -> Option<&mut Signer> {
        self.signer.as_mut()
    }

    /// Sends as `own` from now on. The client uses the vehicle's system id, which it learns from
    /// the first heartbeat.
    pub fn send_as(&mut self, own: Address) {
        self.own = own;
    }

    /// Returns the address that frames are sent from.
    pub fn own(&self) -> Address {
        self.own
    }

    /// Writes `message` as the next frame into `buffer` and returns it.
    pub fn encode<'b>(&mut self, message: &MavMessage, buffer: &'b mut FrameBuffer) -> &'b [u8] {
        let length = message.ser(MavlinkVersion::V2, &mut buffer[field::LARGEST_PAYLOAD]);
        let id = message.message_id();
        self.finish(id, length as u8, MavMessage::extra_crc(id), buffer)
    }

    /// As [`encode`](Self::encode), for the messages that [`Autopilot`](crate::autopilot::Autopilot)
    /// sends; `None` for any other. The counterpart of
    /// [`client_message`](super::Frame::client_message).
    pub fn encode_of_client<'b>(
        &mut self,
        message: &MavMessage,
        buffer: &'b mut FrameBuffer,
    ) -> Option<&'b [u8]> {
        let length = client::write(message, &mut buffer[field::LARGEST_PAYLOAD])?;
        let id = message.message_id();
        Some(self.finish(id, length as u8, MavMessage::extra_crc(id), buffer))
    }

    /// Writes ArduPilot's form of ESTIMATOR_STATUS, an EKF_STATUS_REPORT with these flags, as the
    /// next frame.
    pub fn encode_ekf_status_report<'b>(
        &mut self,
        flags: EstimatorStatusFlags,
        buffer: &'b mut FrameBuffer,
    ) -> &'b [u8] {
        use ekf_status_report::{CHECKSUM_SEED, FLAGS, ID};
        let payload = &mut buffer[field::payload(FLAGS.end)];
        payload[..FLAGS.start].fill(0);
        payload[FLAGS].copy_from_slice(&flags.bits().to_le_bytes());
        self.finish(ID, FLAGS.end as u8, CHECKSUM_SEED, buffer)
    }

    /// Writes a STATUSTEXT of severity CRITICAL with the first 50 bytes of `text` as the next frame.
    pub fn encode_critical_text<'b>(
        &mut self,
        text: &str,
        buffer: &'b mut FrameBuffer,
    ) -> &'b [u8] {
        let mut bytes = [0; 50];
        for (slot, byte) in bytes.iter_mut().zip(text.bytes()) {
            *slot = byte;
        }
        let message = STATUSTEXT_DATA {
            severity: MavSeverity::MAV_SEVERITY_CRITICAL,
            text: bytes.into(),
            ..STATUSTEXT_DATA::default()
        };
        // STATUSTEXT is one of the client's messages.
        self.encode_of_client(&MavMessage::STATUSTEXT(message), buffer)
            .unwrap_or_default()
    }

    /// Writes what surrounds a payload of `length` bytes. No message is longer than a byte can say.
    fn finish<'b>(
        &mut self,
        id: u32,
        length: u8,
        seed: u8,
        buffer: &'b mut FrameBuffer,
    ) -> &'b [u8] {
        let header = &mut buffer[..HEADER];
        header[field::START] = START;
        header[field::LENGTH] = length;
        header[field::INCOMPATIBILITY_FLAGS] = if self.signer.is_some() { SIGNED } else { 0 };
        header[field::COMPATIBILITY_FLAGS] = 0;
        header[field::SEQUENCE] = self.sequence;
        header[field::SYSTEM] = self.own.system;
        header[field::COMPONENT] = self.own.component;
        header[field::MESSAGE_ID].copy_from_slice(&id.to_le_bytes()[..field::MESSAGE_ID.len()]);
        self.sequence = self.sequence.wrapping_add(1);
        let length = usize::from(length);
        let checksum = calculate_crc(&buffer[field::checked(length)], seed);
        buffer[field::checksum(length)].copy_from_slice(&checksum.to_le_bytes());
        let end = field::checksum(length).end;
        match &mut self.signer {
            Some(signer) => {
                let signature = signer.sign(&buffer[..end]);
                buffer[end..end + signature.len()].copy_from_slice(&signature);
                &buffer[..end + signature.len()]
            }
            None => &buffer[..end],
        }
    }
}

//! Messages to frames.

use mavlink::dialects::common::{EstimatorStatusFlags, MavMessage, MavSeverity, STATUSTEXT_DATA};
use mavlink::{MavlinkVersion, Message, calculate_crc};

use super::client;
use super::signing::Signer;
use super::{Address, CHECKSUM, EKF_STATUS_REPORT, HEADER, MAX_FRAME, SIGNED, START};

/// Messages in, frames out; numbers them.
#[derive(Clone, Debug)]
pub struct Encoder {
    own: Address,
    sequence: u8,
    signer: Option<Signer>,
}

/// Room for one frame.
pub type FrameBuffer = [u8; MAX_FRAME];

impl Encoder {
    /// An encoder that sends as `own`.
    pub const fn new(own: Address) -> Self {
        Self {
            own,
            sequence: 0,
            signer: None,
        }
    }

    /// Signs every frame from now on.
    pub fn sign_with(&mut self, signer: Signer) {
        self.signer = Some(signer);
    }

    /// What signs, to set its clock.
    pub fn signer_mut(&mut self) -> Option<&mut Signer> {
        self.signer.as_mut()
    }

    /// Sends as `own` from now on: the client speaks under the vehicle's system id, which it
    /// learns from the first heartbeat.
    pub fn send_as(&mut self, own: Address) {
        self.own = own;
    }

    /// Who it sends as.
    pub fn own(&self) -> Address {
        self.own
    }

    /// Writes `message` as the next frame into `buffer` and returns it.
    pub fn encode<'b>(&mut self, message: &MavMessage, buffer: &'b mut FrameBuffer) -> &'b [u8] {
        let length = message.ser(MavlinkVersion::V2, &mut buffer[HEADER..HEADER + 255]);
        let id = message.message_id();
        self.finish(id, length, MavMessage::extra_crc(id), buffer)
    }

    /// As [`encode`](Self::encode), for the messages that [`Autopilot`](crate::autopilot::Autopilot)
    /// sends; `None` for any other. The counterpart of
    /// [`client_message`](super::Frame::client_message).
    pub fn encode_of_client<'b>(
        &mut self,
        message: &MavMessage,
        buffer: &'b mut FrameBuffer,
    ) -> Option<&'b [u8]> {
        let length = client::write(message, &mut buffer[HEADER..HEADER + 255])?;
        let id = message.message_id();
        Some(self.finish(id, length, MavMessage::extra_crc(id), buffer))
    }

    /// ArduPilot's form of ESTIMATOR_STATUS: an EKF_STATUS_REPORT with these flags.
    pub fn encode_ekf_status_report<'b>(
        &mut self,
        flags: EstimatorStatusFlags,
        buffer: &'b mut FrameBuffer,
    ) -> &'b [u8] {
        let (id, seed, offset) = EKF_STATUS_REPORT;
        buffer[HEADER..HEADER + offset].fill(0);
        buffer[HEADER + offset..HEADER + offset + 2].copy_from_slice(&flags.bits().to_le_bytes());
        self.finish(id, offset + 2, seed, buffer)
    }

    /// A STATUSTEXT of severity CRITICAL: the first 50 bytes of `text`.
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
        // It is one of the client's.
        self.encode_of_client(&MavMessage::STATUSTEXT(message), buffer)
            .unwrap_or_default()
    }

    fn finish<'b>(
        &mut self,
        id: u32,
        length: usize,
        seed: u8,
        buffer: &'b mut FrameBuffer,
    ) -> &'b [u8] {
        let [id0, id1, id2, _] = id.to_le_bytes();
        buffer[..HEADER].copy_from_slice(&[
            START,
            length as u8,
            if self.signer.is_some() { SIGNED } else { 0 },
            0,
            self.sequence,
            self.own.system,
            self.own.component,
            id0,
            id1,
            id2,
        ]);
        self.sequence = self.sequence.wrapping_add(1);
        let end = HEADER + length;
        let checksum = calculate_crc(&buffer[1..end], seed);
        buffer[end..end + CHECKSUM].copy_from_slice(&checksum.to_le_bytes());
        let end = end + CHECKSUM;
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

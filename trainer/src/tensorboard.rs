//! TensorBoard event files with scalars.
//!
//! A record consists of its length (u64), the masked CRC-32C of the length, the data, and the masked
//! CRC-32C of the data, all little endian. The data is an `Event` message.

use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::Path,
    time::{SystemTime, UNIX_EPOCH},
};

use crc::{CRC_32_ISCSI, Crc};
use prost::Message;

const CRC_32C: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);

#[derive(Clone, PartialEq, Message)]
struct Event {
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(string, optional, tag = "3")]
    file_version: Option<String>,
    #[prost(message, optional, tag = "5")]
    summary: Option<Summary>,
}

#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Value>,
}

#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, optional, tag = "2")]
    simple_value: Option<f32>,
}

/// A writer of one event file.
#[derive(Debug)]
pub struct EventWriter {
    file: BufWriter<File>,
}

impl EventWriter {
    /// Creates a new file in `directory`. TensorBoard reads all event files of a directory as one run.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn create(directory: &Path) -> io::Result<Self> {
        let name = format!("events.out.tfevents.{:.0}.{}", now(), std::process::id());
        let file = BufWriter::new(File::create(directory.join(name))?);
        let mut writer = Self { file };
        writer.write(&Event {
            wall_time: now(),
            file_version: Some("brain.Event:2".into()),
            ..Event::default()
        })?;
        Ok(writer)
    }

    /// Adds the scalars of a step.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn scalars<'a>(
        &mut self,
        step: u64,
        scalars: impl Iterator<Item = (&'a str, f32)>,
    ) -> io::Result<()> {
        let value = scalars.map(|(tag, value)| Value {
            tag: tag.into(),
            simple_value: Some(value),
        });
        self.write(&Event {
            wall_time: now(),
            step: step.try_into().unwrap_or(i64::MAX),
            file_version: None,
            summary: Some(Summary {
                value: value.collect(),
            }),
        })
    }

    /// Writes buffered data to the file.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }

    fn write(&mut self, event: &Event) -> io::Result<()> {
        self.file.write_all(&record(&event.encode_to_vec()))
    }
}

/// Frames data as a record.
fn record(data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u64).to_le_bytes();
    let mut record = Vec::with_capacity(data.len() + 16);
    record.extend(length);
    record.extend(masked_crc(&length).to_le_bytes());
    record.extend(data);
    record.extend(masked_crc(data).to_le_bytes());
    record
}

/// Returns the CRC rotated and offset, because a CRC over data that contains its own CRC detects few
/// errors.
fn masked_crc(data: &[u8]) -> u32 {
    CRC_32C
        .checksum(data)
        .rotate_right(15)
        .wrapping_add(0xa282_ead8)
}

/// Returns the seconds since the Unix epoch.
fn now() -> f64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0.0, |since| since.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares with the first record that TensorFlow 2 writes at wall time 0, byte by byte.
    #[test]
    fn the_version_record_is_what_tensorboard_expects() {
        let event = Event {
            file_version: Some("brain.Event:2".into()),
            ..Event::default()
        };
        let bytes = record(&event.encode_to_vec());
        assert_eq!(bytes[..8], 15_u64.to_le_bytes());
        assert_eq!(bytes[12..14], [0x1a, 13]);
        assert_eq!(&bytes[14..27], b"brain.Event:2");
        // Check value of CRC-32C ("123456789"), then the published mask.
        assert_eq!(CRC_32C.checksum(b"123456789"), 0xe306_9283);
        let masked = 0x2507_c60d_u32.wrapping_add(0xa282_ead8);
        assert_eq!(masked_crc(b"123456789"), masked);
    }

    #[test]
    fn records_follow_one_another_and_decode() {
        let directory = tempfile::tempdir().expect("temporary");
        let mut writer = EventWriter::create(directory.path()).expect("writable");
        let scalars = [("charts/episodic_return", 1.5), ("losses/qf1_loss", 0.25)];
        writer.scalars(60, scalars.into_iter()).expect("writable");
        writer.flush().expect("writable");
        let entry = std::fs::read_dir(directory.path())
            .expect("readable")
            .next();
        let path = entry.expect("one file").expect("readable").path();
        let mut bytes = &std::fs::read(path).expect("readable")[..];
        let mut events = Vec::new();
        while !bytes.is_empty() {
            let length = u64::from_le_bytes(bytes[..8].try_into().expect("8")) as usize;
            assert_eq!(bytes[8..12], masked_crc(&bytes[..8]).to_le_bytes());
            let data = &bytes[12..12 + length];
            assert_eq!(
                bytes[12 + length..16 + length],
                masked_crc(data).to_le_bytes()
            );
            events.push(Event::decode(data).expect("an event"));
            bytes = &bytes[16 + length..];
        }
        assert_eq!(events.len(), 2);
        assert_eq!(events[1].step, 60);
        let values = &events[1].summary.as_ref().expect("a summary").value;
        assert_eq!(values[0].tag, "charts/episodic_return");
        assert_eq!(values[1].simple_value, Some(0.25));
    }
}

//! Serial devices: 8 data bits, no parity, one stop bit, no flow control.

#[cfg(unix)]
pub(super) use unix::Serial;

#[cfg(unix)]
mod unix {
    use std::fs::{File, OpenOptions};
    use std::io::{self, Read, Write};
    use std::os::unix::fs::OpenOptionsExt;
    use std::time::Duration;

    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    use rustix::fs::OFlags;
    use rustix::termios::{ControlModes, OptionalActions, tcgetattr, tcsetattr};

    use crate::{BackOff, Link, PIECE, is_idle};

    /// A device that may be unplugged and plugged in again.
    #[derive(Debug)]
    pub(crate) struct Serial {
        device: String,
        baud: u32,
        file: Option<File>,
        back_off: BackOff,
    }

    impl Serial {
        /// Opens the device. An error here means invalid input; after later errors, opening is
        /// retried.
        pub(crate) fn open(device: &str, baud: u32) -> io::Result<Self> {
            Ok(Self {
                file: Some(configured(device, baud)?),
                device: device.to_owned(),
                baud,
                back_off: BackOff::new(),
            })
        }

        fn connected(&mut self) -> Option<&mut File> {
            if self.file.is_none() && self.back_off.may_try() {
                match configured(&self.device, self.baud) {
                    Ok(file) => {
                        self.file = Some(file);
                        self.back_off = BackOff::new();
                    }
                    Err(error) => self.back_off.failed(error),
                }
            }
            self.file.as_mut()
        }

        fn broken(&mut self, reason: io::Error) {
            self.file = None;
            self.back_off.failed(reason);
        }
    }

    fn configured(device: &str, baud: u32) -> io::Result<File> {
        let name = |error: io::Error| {
            io::Error::new(error.kind(), format!("serial device {device}: {error}"))
        };
        let flags = (OFlags::NOCTTY | OFlags::NONBLOCK).bits();
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(flags as i32)
            .open(device)
            .map_err(name)?;
        let mut settings = tcgetattr(&file).map_err(|error| name(error.into()))?;
        settings.make_raw();
        settings.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
        settings.control_modes &= !(ControlModes::CSTOPB | ControlModes::CRTSCTS);
        settings
            .set_speed(baud)
            .and_then(|()| tcsetattr(&file, OptionalActions::Now, &settings))
            .map_err(|error| name(error.into()))?;
        Ok(file)
    }

    impl Link for Serial {
        fn send(&mut self, frame: &[u8]) -> io::Result<bool> {
            let Some(file) = self.connected() else {
                return Ok(false);
            };
            match file.write_all(frame) {
                Ok(()) => Ok(true),
                // The device's buffer is full: the receiver resynchronizes on the next frame.
                Err(error) if is_idle(&error) => Ok(false),
                Err(error) => {
                    self.broken(error);
                    Ok(false)
                }
            }
        }

        fn receive(&mut self, buffer: &mut Vec<u8>, timeout: Duration) -> io::Result<bool> {
            buffer.clear();
            let Some(file) = self.connected() else {
                std::thread::sleep(timeout.min(BackOff::FIRST));
                return Ok(false);
            };
            let wait = Timespec {
                tv_sec: timeout.as_secs().min(3_600) as i64,
                tv_nsec: timeout.subsec_nanos().into(),
            };
            match poll(&mut [PollFd::new(file, PollFlags::IN)], Some(&wait)) {
                Ok(0) | Err(rustix::io::Errno::INTR) => return Ok(false),
                Ok(_) => {}
                Err(error) => {
                    self.broken(error.into());
                    return Ok(false);
                }
            }
            buffer.resize(PIECE, 0);
            let length = match file.read(buffer) {
                Ok(0) => {
                    self.broken(io::ErrorKind::UnexpectedEof.into());
                    0
                }
                Ok(length) => length,
                Err(error) => {
                    if !is_idle(&error) {
                        self.broken(error);
                    }
                    0
                }
            };
            buffer.truncate(length);
            Ok(length > 0)
        }

        fn is_datagram(&self) -> bool {
            false
        }

        fn last_error(&self) -> Option<String> {
            self.back_off.reason.as_ref().map(io::Error::to_string)
        }
    }

    #[cfg(test)]
    mod tests {
        use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

        use super::*;

        #[test]
        fn bytes_pass_unchanged_through_a_terminal() {
            let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
            grantpt(&master).unwrap();
            unlockpt(&master).unwrap();
            let name = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
            let mut link = Serial::open(&name, 57_600).unwrap();
            let mut other = File::from(master);
            // Every byte value is sent, because a terminal that is not in raw mode would change
            // some.
            let bytes: Vec<u8> = (0..=255).collect();
            assert!(link.send(&bytes).unwrap());
            let mut got = vec![0; 256];
            other.read_exact(&mut got).unwrap();
            assert_eq!(got, bytes);
            other.write_all(&bytes).unwrap();
            let (mut got, mut piece) = (Vec::new(), Vec::new());
            while got.len() < 256 {
                assert!(link.receive(&mut piece, Duration::from_secs(2)).unwrap());
                got.extend_from_slice(&piece);
            }
            assert_eq!(got, bytes);
            assert!(!link.receive(&mut piece, Duration::from_millis(5)).unwrap());
        }

        #[test]
        fn a_missing_device_is_named() {
            let error = Serial::open("/dev/no-such-tty", 57_600).unwrap_err();
            assert!(error.to_string().contains("/dev/no-such-tty"), "{error}");
        }
    }
}

#[cfg(not(unix))]
pub(super) use elsewhere::Serial;

#[cfg(not(unix))]
mod elsewhere {
    use std::io;
    use std::time::Duration;

    use crate::Link;

    /// Serial devices are supported on Unix only.
    #[derive(Debug)]
    pub(crate) enum Serial {}

    impl Serial {
        pub(crate) fn open(device: &str, _: u32) -> io::Result<Self> {
            let message = format!("serial device {device}: serial links need Linux or macOS");
            Err(io::Error::new(io::ErrorKind::Unsupported, message))
        }
    }

    impl Link for Serial {
        fn send(&mut self, _: &[u8]) -> io::Result<bool> {
            match *self {}
        }

        fn receive(&mut self, _: &mut Vec<u8>, _: Duration) -> io::Result<bool> {
            match *self {}
        }

        fn is_datagram(&self) -> bool {
            match *self {}
        }
    }
}

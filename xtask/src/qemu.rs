//! Runs the board in QEMU.

use std::{
    net::TcpListener,
    path::Path,
    process::{Child, Command, Output, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail};

use crate::tools;

/// The longest time that a board may take for a bench, which is some seconds on an idle machine.
const PATIENCE: Duration = Duration::from_secs(240);

/// Makes an instruction take 2^6 ns of virtual time: the counts are exact and the same in every
/// run.
pub(crate) const COUNTING: [&str; 2] = ["-icount", "shift=6"];

fn board(root: &Path, image: &Path) -> Result<Command> {
    let mut qemu = Command::new(tools::qemu(root)?);
    qemu.args([
        "-machine",
        "mps2-an500",
        "-display",
        "none",
        "-monitor",
        "none",
    ])
    .args(["-semihosting-config", "enable=on,target=native"])
    .arg("-kernel")
    .arg(image)
    .stdin(Stdio::null());
    Ok(qemu)
}

/// Runs an image that ends by itself.
pub(crate) fn run_to_end(root: &Path, image: &Path) -> Result<Output> {
    let mut child = board(root, image)?
        .args(COUNTING)
        .args(["-serial", "null"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .context("QEMU could not be started")?;
    let begun = Instant::now();
    while child.try_wait()?.is_none() {
        if begun.elapsed() > PATIENCE {
            child.kill()?;
            bail!(
                "{}: did not end within {} s",
                image.display(),
                PATIENCE.as_secs()
            );
        }
        thread::sleep(Duration::from_millis(20));
    }
    Ok(child.wait_with_output()?)
}

/// A board whose serial lines are TCP servers.
#[derive(Debug)]
pub(crate) struct Board {
    child: Child,
    /// The port of the ground link; MAVLink and the console use the next two.
    pub(crate) port: u16,
}

impl Board {
    /// Starts the board; with `counting`, an instruction takes 64 ns.
    pub(crate) fn start(root: &Path, image: &Path, counting: bool) -> Result<Self> {
        let port = free_ports()?;
        let mut qemu = board(root, image)?;
        for line in port..port + 3 {
            let server = format!("tcp:127.0.0.1:{line},server=on,wait=off,nodelay=on");
            qemu.args(["-serial", &server]);
        }
        if counting {
            qemu.args(COUNTING);
        }
        let child = qemu.spawn().context("QEMU could not be started")?;
        Ok(Self { child, port })
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        // The process may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Returns the first of three consecutive free ports.
fn free_ports() -> Result<u16> {
    for _ in 0..50 {
        let first = TcpListener::bind("127.0.0.1:0")?;
        let port = first.local_addr()?.port();
        let next = |offset: u16| {
            let port = port.checked_add(offset)?;
            TcpListener::bind(("127.0.0.1", port)).ok()
        };
        if next(1).zip(next(2)).is_some() {
            return Ok(port);
        }
    }
    bail!("no three consecutive TCP ports are free")
}

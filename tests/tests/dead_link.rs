//! Nothing hangs: a link that goes dead in flight, and ctrl-C, once and twice.
#![cfg(unix)]

use std::{
    fs,
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    path::Path,
    process::{Child, Command, Output, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use end_to_end::{free_port, program};
use serde_json::Value;
use tempfile::{TempDir, tempdir};

/// So many seconds of flight in a second. With 10, a machine that stood still for a third of a second
/// was enough to lose the autopilot's heartbeat during the takeoff.
const SPEED: &str = "5";

/// A run ends so long after its link died at the latest: 25 s of flight, and a margin for a machine
/// that is busy.
const BOUND: Duration = Duration::from_secs(30);

/// A process that ends with the test, however that ends.
struct Server(Child);

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The built-in vehicle, speaking at `link`.
fn vehicle(link: &str, parameters: &[&str]) -> Server {
    let mut command = program("host-sim");
    command.args(["vehicle", "--profile", "arducopter", "--speed", SPEED]);
    for parameter in parameters {
        command.args(["--param", parameter]);
    }
    command.args(["--listen", link]);
    Server(command.stderr(Stdio::null()).spawn().unwrap())
}

/// A run that changes parameters, under way in a folder of its own.
struct Run {
    process: Server,
    folder: TempDir,
}

impl Run {
    fn start(link: &str) -> Self {
        let folder = tempdir().unwrap();
        let log = fs::File::create(folder.path().join("stderr")).unwrap();
        let mut command = program("host-sim");
        command.args(["run", "--profile", "arducopter", "--speed", SPEED]);
        command.args(["--policy", "straight-line", "--set-params", "--json"]);
        command.args(["--link", link, "--out"]).arg(folder.path());
        let process = command.stderr(log).stdout(Stdio::piped()).spawn().unwrap();
        let process = Server(process);
        Self { process, folder }
    }

    fn said(&self) -> String {
        fs::read_to_string(self.folder.path().join("stderr")).unwrap()
    }

    /// Waits until the run has said something, which it does when it happens.
    fn wait_for(&self, words: &str) {
        let begin = Instant::now();
        while !self.said().contains(words) {
            let waited = begin.elapsed();
            assert!(waited < Duration::from_secs(60), "{words}: {}", self.said());
            thread::sleep(Duration::from_millis(20));
        }
    }

    fn interrupt(&self) {
        let id = self.process.0.id().to_string();
        let status = Command::new("kill").args(["-INT", &id]).status();
        assert!(status.unwrap().success());
    }

    /// Waits for the end, within the bound; the code, the summary and what was said.
    fn end(mut self) -> (i32, Value, String, TempDir) {
        let begin = Instant::now();
        let status = loop {
            if let Some(status) = self.process.0.try_wait().unwrap() {
                break status;
            }
            assert!(begin.elapsed() < BOUND, "it hangs: {}", self.said());
            thread::sleep(Duration::from_millis(20));
        };
        let mut printed = String::new();
        let stdout = self.process.0.stdout.as_mut().unwrap();
        stdout.read_to_string(&mut printed).unwrap();
        let written = fs::read_to_string(self.folder.path().join("summary.json")).unwrap();
        let summary: Value = serde_json::from_str(&written).unwrap();
        assert_eq!(serde_json::from_str::<Value>(&printed).unwrap(), summary);
        for file in ["slots.csv", "report.html", "mavlink.tlog"] {
            let length = fs::metadata(self.folder.path().join(file)).unwrap().len();
            assert!(length > 0 || file == "slots.csv", "{file} is empty");
        }
        (status.code().unwrap(), summary, self.said(), self.folder)
    }
}

fn journal(folder: &TempDir) -> std::path::PathBuf {
    folder.path().join("parameters.journal.json")
}

fn restore(link: &str, journal: &Path) -> Output {
    let log = journal.with_file_name("doctor.tlog");
    program("host-sim")
        .args(["doctor", "--restore", "--speed", SPEED, "--link", link])
        .arg("--journal")
        .arg(journal)
        .arg("--tlog")
        .arg(log)
        .output()
        .unwrap()
}

/// The autopilot is killed in flight: the run ends in time with everything written, and the doctor
/// restores what it left changed.
#[test]
fn a_killed_autopilot_ends_the_run_and_the_doctor_restores() {
    let port = free_port();
    let (listen, link) = (
        format!("udpin:127.0.0.1:{port}"),
        format!("udpout:127.0.0.1:{port}"),
    );
    let killed = vehicle(&listen, &[]);
    let run = Run::start(&link);
    run.wait_for("  ready");
    drop(killed);
    let (code, summary, said, folder) = run.end();
    assert_eq!(code, 1, "{said}");
    assert_eq!(summary["completed"], false);
    let ended = summary["ended"].as_str().unwrap();
    assert!(ended.contains("nothing heard for 25 s"), "{ended}");
    assert!(
        said.contains("FAILSAFE link dead: release control"),
        "{said}"
    );
    assert!(said.contains("host-sim doctor --restore"), "{said}");

    let left = [
        "WPNAV_SPEED=3500",
        "WPNAV_ACCEL=1000",
        "ANGLE_MAX=4500",
        "PSC_JERK_XY=20",
    ];
    let _vehicle = vehicle(&listen, &left);
    let journal = journal(&folder);
    let doctor = restore(&link, &journal);
    let words = String::from_utf8(doctor.stderr).unwrap();
    assert!(doctor.status.success(), "{words}");
    for value in [
        "WPNAV_SPEED restored to 1000",
        "WPNAV_ACCEL restored to 250",
        "ANGLE_MAX restored to 3000",
        "PSC_JERK_XY restored to 5",
    ] {
        assert!(words.contains(value), "{words}");
    }
    assert!(!journal.exists());
    let log = folder.path().join("doctor.tlog");
    assert!(fs::metadata(log).unwrap().len() > 0);
    let again = restore(&link, &journal);
    let words = String::from_utf8(again.stdout).unwrap();
    assert!(words.contains("no parameters to restore"), "{words}");
}

/// Carries bytes from one to the other until `cut`; then both sockets stay open and nothing comes.
fn carry(mut from: TcpStream, mut to: TcpStream, cut: Arc<AtomicBool>) {
    thread::spawn(move || {
        let mut piece = [0; 4096];
        while let Ok(length) = from.read(&mut piece) {
            if length == 0 {
                return;
            }
            if !cut.load(Ordering::Relaxed) && to.write_all(&piece[..length]).is_err() {
                return;
            }
        }
    });
}

/// TCP without a FIN, as behind a cable that is out: ctrl-C ends a run at once that waits there.
#[test]
fn a_tcp_link_that_falls_silent_ends_the_run_and_ctrl_c_does_not_wait() {
    let fly = |interrupted: bool| {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let link = format!("tcpout:{}", listener.local_addr().unwrap());
        let cut = Arc::new(AtomicBool::new(false));
        let _vehicle = vehicle(&link, &[]);
        let (one, _) = listener.accept().unwrap();
        let run = Run::start(&link);
        let (other, _) = listener.accept().unwrap();
        for (from, to) in [(&one, &other), (&other, &one)] {
            let (from, to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
            carry(from, to, Arc::clone(&cut));
        }
        run.wait_for("  ready");
        cut.store(true, Ordering::Relaxed);
        if interrupted {
            run.wait_for("FAILSAFE autopilot heartbeat lost");
            let asked = Instant::now();
            run.interrupt();
            let (code, summary, said, _) = run.end();
            assert!(asked.elapsed() < Duration::from_secs(2), "{said}");
            assert_eq!((code, &summary["completed"]), (1, &Value::Bool(false)));
        } else {
            let (code, summary, said, folder) = run.end();
            assert_eq!(code, 1, "{said}");
            let ended = summary["ended"].as_str().unwrap();
            assert!(ended.contains("nothing heard for 25 s"), "{ended}");
            assert!(journal(&folder).exists());
        }
    };
    thread::scope(|scope| {
        scope.spawn(|| fly(false));
        scope.spawn(|| fly(true));
    });
}

/// The first ctrl-C lands and says so; a second leaves at once, with parameters restored.
#[test]
fn ctrl_c_says_what_it_waits_for_and_a_second_one_leaves() {
    let fly = |presses: u32| {
        let port = free_port();
        let _vehicle = vehicle(&format!("udpin:127.0.0.1:{port}"), &[]);
        let run = Run::start(&format!("udpout:127.0.0.1:{port}"));
        run.wait_for("  ready");
        let asked = Instant::now();
        run.interrupt();
        run.wait_for("ctrl-C: landing; waiting for the motors to stop");
        assert!(asked.elapsed() < Duration::from_secs(2), "{}", run.said());
        if presses == 2 {
            run.interrupt();
        }
        let (code, _, said, folder) = run.end();
        assert_eq!(code, if presses == 2 { 130 } else { 1 }, "{said}");
        assert_eq!(said.contains("  landed"), presses == 1, "{said}");
        for name in ["WPNAV_SPEED", "WPNAV_ACCEL", "ANGLE_MAX", "PSC_JERK_XY"] {
            assert!(said.contains(&format!("{name} restored")), "{said}");
        }
        assert!(!journal(&folder).exists());
    };
    thread::scope(|scope| {
        scope.spawn(|| fly(1));
        scope.spawn(|| fly(2));
    });
}

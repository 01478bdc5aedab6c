//! The doctor and the upload with the vehicle process, over real UDP, faster than real time.

mod flight;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use firmware_core::autopilot::Autopilot;
use firmware_core::autopilot::mission::Ending;
use firmware_core::autopilot::profile::Firmware;
use firmware_core::autopilot::wire::signing::{LinkSigning, SigningKey, SigningState};
use firmware_core::time::Duration;
use flight::{free_port, zigzag};
use host_sim::doctor::{Diagnosis, examine};
use host_sim::serve::serve;
use host_sim::session::Session;
use host_sim::signing::SigningUpkeep;
use host_sim::upload::{FailedUpload, Upload, UploadProgress};
use link::{LinkAddress, Port};
use vehicle::{Profile, Vehicle, VehicleSettings};

const SPEED: f64 = 20.0;

struct Process {
    port: u16,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<std::io::Result<()>>>,
}

impl Process {
    fn start(settings: VehicleSettings) -> Self {
        let port = free_port();
        let stop = Arc::new(AtomicBool::new(false));
        let listen: LinkAddress = format!("udpin:127.0.0.1:{port}").parse().unwrap();
        let thread = std::thread::spawn({
            let stop = Arc::clone(&stop);
            move || {
                serve(
                    listen.open()?.as_mut(),
                    Vehicle::new(settings),
                    SPEED,
                    &stop,
                    &mut SigningUpkeep::default(),
                )
            }
        });
        Self {
            port,
            stop,
            thread: Some(thread),
        }
    }

    fn visit(&self, profile: Profile, key: Option<u8>) -> (Session, Autopilot<f64>) {
        let settings = flight::settings(profile);
        let link: LinkAddress = format!("udpout:127.0.0.1:{}", self.port).parse().unwrap();
        let mut port = Port::new(link.open().unwrap(), settings.own.resolve(None));
        if let Some(key) = key {
            port.sign_with(signing(key, 1));
        }
        (Session::new(port, SPEED), Autopilot::new(settings).unwrap())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap().unwrap();
        }
    }
}

fn signing(key: u8, link: u8) -> LinkSigning {
    LinkSigning {
        key: SigningKey::new([key; 32]),
        link,
        state: SigningState::default(),
    }
}

fn diagnose(process: &Process, profile: Profile, key: Option<u8>, seconds: u64) -> Diagnosis {
    let (mut session, mut client) = process.visit(profile, key);
    let patience = Duration::from_secs(seconds);
    examine(
        &mut session,
        &mut client,
        patience,
        &AtomicBool::new(false),
        |_| {},
    )
    .unwrap()
}

#[test]
fn the_doctor_says_what_stops_and_what_slows_a_mission() {
    let process = Process::start(flight::vehicle(Profile::ArduCopter));
    let early = diagnose(&process, Profile::ArduCopter, None, 15);
    assert!(!early.is_ready());
    let text = early.to_string();
    assert!(text.contains("stops a mission: no position yet"), "{text}");
    let later = diagnose(&process, Profile::ArduCopter, None, 60);
    let text = later.to_string();
    assert!(later.is_ready(), "{text}");
    assert!(text.contains("connected: ArduCopter, system 1"), "{text}");
    let slows = "slows a mission: WPNAV_SPEED is 1000: it clips speed; set it to 3500";
    assert!(text.contains(slows), "{text}");
    assert!(
        text.contains("note: FS_GCS_ENABLE is 0: the vehicle keeps hovering"),
        "{text}"
    );
    assert!(text.ends_with("a mission would fly"), "{text}");
}

/// The parameters stay set for a mission that is flown later, and their former values are reported.
#[test]
fn an_upload_sets_parameters_and_says_what_they_were() {
    let mut settings = flight::vehicle(Profile::ArduCopter);
    settings.ready_after = Duration::from_secs(2);
    let process = Process::start(settings);
    let (session, client) = process.visit(Profile::ArduCopter, None);
    let settings = firmware_core::autopilot::AutopilotSettings {
        set_parameters: true,
        ..*client.settings()
    };
    let (mut session, mut client) = (session, Autopilot::new(settings).unwrap());
    let waypoints = zigzag();
    let upload = Upload {
        waypoints: &waypoints,
        speed_mps: 30.0,
        ending: Ending::Land,
        start: false,
        watch: false,
        patience: Duration::from_secs(60),
    };
    let mut notes = vec![];
    let go_on = AtomicBool::new(false);
    upload
        .run(&mut session, &mut client, &go_on, |progress| {
            notes.extend(match progress {
                UploadProgress::Note(words) => Some(words),
                UploadProgress::Items { .. } => None,
            });
        })
        .unwrap();
    let notes = notes.join("\n");
    assert!(
        notes.contains("half of the legs are shorter than 30 m"),
        "{notes}"
    );
    let old =
        "their former values: WPNAV_SPEED 1000, WPNAV_ACCEL 250, ANGLE_MAX 3000, PSC_JERK_XY 5";
    assert!(notes.contains(old), "{notes}");
    let diagnosis = diagnose(&process, Profile::ArduCopter, None, 60);
    assert!(diagnosis.slows.is_empty(), "{diagnosis}");
}

/// The mission is followed to its end, and the parameters are restored; if a pilot lands and
/// thereby ends it, the error contains the item that was reached.
#[test]
fn an_uploaded_mission_is_followed_to_its_end() {
    for profile in [Profile::ArduCopter, Profile::Px4] {
        let mut settings = flight::vehicle(profile);
        settings.ready_after = Duration::from_secs(2);
        let process = Process::start(settings);
        let (mut session, client) = process.visit(profile, None);
        let settings = firmware_core::autopilot::AutopilotSettings {
            set_parameters: true,
            ..*client.settings()
        };
        let mut client = Autopilot::new(settings).unwrap();
        let waypoints = zigzag();
        let upload = Upload {
            waypoints: &waypoints,
            speed_mps: 30.0,
            ending: Ending::Land,
            start: true,
            watch: true,
            patience: Duration::from_secs(60),
        };
        let (mut notes, mut items) = (vec![], vec![]);
        let go_on = AtomicBool::new(false);
        let count = upload
            .run(
                &mut session,
                &mut client,
                &go_on,
                |progress| match progress {
                    UploadProgress::Note(words) => notes.push(words),
                    UploadProgress::Items { done, .. } => items.push(done),
                },
            )
            .unwrap();
        assert!(items.iter().any(|&done| done + 2 >= count), "{items:?}");
        let notes = notes.join("\n");
        assert!(notes.contains("disarmed"), "{notes}");
        assert!(!notes.contains("stay set"), "{notes}");
        let set = notes.matches(" set from ").count();
        assert!(set > 2, "{notes}");
        assert_eq!(notes.matches(" restored to ").count(), set, "{notes}");
    }
}

#[test]
fn the_doctor_hears_nobody() {
    let process = Process::start(flight::vehicle(Profile::Ideal));
    let (mut session, mut client) = process.visit(Profile::Ideal, None);
    drop(process);
    let patience = Duration::from_secs(3);
    let diagnosis = examine(
        &mut session,
        &mut client,
        patience,
        &AtomicBool::new(false),
        |_| {},
    )
    .unwrap();
    assert!(diagnosis.to_string().starts_with("no autopilot"));
    assert!(!diagnosis.is_ready());
}

#[test]
fn a_signed_vehicle_listens_to_its_key_only() {
    let mut settings = flight::vehicle(Profile::Multirotor);
    settings.signing = Some(signing(7, 0));
    let process = Process::start(settings);
    let signed = diagnose(&process, Profile::Multirotor, Some(7), 30);
    assert!(signed.is_ready(), "{signed}");
    assert_eq!(signed.vehicle, Some((1, Firmware::Generic)));
    for key in [None, Some(8)] {
        assert!(!diagnose(&process, Profile::Multirotor, key, 5).is_ready());
    }
}

#[test]
fn a_mission_is_uploaded_and_started_over_udp() {
    for profile in [Profile::ArduCopter, Profile::Px4] {
        let mut settings = flight::vehicle(profile);
        settings.ready_after = Duration::from_secs(2);
        let process = Process::start(settings);
        let (mut session, client) = process.visit(profile, None);
        // A mission with slots would be refused; an uploaded one may take longer.
        let mut settings = *client.settings();
        settings.preflight.needed_speed_mps = Some(20.0);
        let mut client = Autopilot::new(settings).unwrap();
        let waypoints = zigzag();
        let upload = Upload {
            waypoints: &waypoints,
            speed_mps: 10.0,
            ending: Ending::Return,
            start: true,
            watch: false,
            patience: Duration::from_secs(60),
        };
        let go_on = AtomicBool::new(false);
        let mut last = 0;
        let items = upload
            .run(&mut session, &mut client, &go_on, |progress| {
                if let UploadProgress::Items { done, .. } = progress {
                    last = done;
                }
            })
            .unwrap();
        assert_eq!(
            usize::from(items),
            waypoints.len() + if profile == Profile::Px4 { 3 } else { 4 }
        );
        assert_eq!(last, items);
        // The start is confirmed before the heartbeat that reports the vehicle as armed.
        let deadline = std::time::Instant::now() + std::time::Duration::from_secs(20);
        while !client.is_armed() && std::time::Instant::now() < deadline {
            session.turn(&mut client, |_, _, _| {}).unwrap();
        }
        assert!(client.is_armed(), "{profile:?} did not start the mission");
        // Ctrl-C before the upload begins: nothing is left in an intermediate state.
        let stop = AtomicBool::new(true);
        let (mut session, mut client) = process.visit(profile, None);
        let failed = upload
            .run(&mut session, &mut client, &stop, |_| {})
            .unwrap_err();
        assert!(
            matches!(
                failed,
                FailedUpload::NotReady(_) | FailedUpload::NoHeartbeat(_)
            ),
            "{failed}"
        );
    }
}

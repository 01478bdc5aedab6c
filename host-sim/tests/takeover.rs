//! Parameters that were set for a flight are restored, even if someone else ends the flight.

use std::{
    path::Path,
    sync::{Arc, Mutex},
    time::Duration as WallDuration,
};

use environment::Allocation;
use firmware_core::{
    policy::StraightLine,
    time::{Duration, Instant},
};
use host_sim::{
    flight::{
        ClientSettings, FailedFlight, FlightSettings, Observer, Peer, RealTimeFactor,
        computer::InProcess, fly_with, vehicle_settings,
    },
    journal::{FILE_NAME, ParameterJournal},
    record::{FlightEvent, FlightRecord},
};
use link::Link;
use scenario::{Events, Scenario};
use vehicle::{FlightMode, Profile, Vehicle};

/// The number of seconds of flight per second.
const SPEED: f64 = 20.0;

/// A vehicle with a clock of its own, and a link to it that can be cut.
#[derive(Debug)]
struct Aloft {
    begin: std::time::Instant,
    now: Instant,
    vehicle: Vehicle,
    cut: bool,
}

impl Aloft {
    fn step(&mut self) {
        let passed_s = self.begin.elapsed().as_secs_f64() * SPEED;
        let clock = Instant::ZERO + Duration::from_secs_f64(passed_s);
        while self.now < clock {
            self.now = clock.min(self.now + Duration::from_millis(10));
            self.vehicle.step(self.now);
        }
    }
}

#[derive(Clone, Debug)]
struct Shared(Arc<Mutex<Aloft>>);

impl Shared {
    fn new(scenario: &Scenario) -> Self {
        let vehicle = Vehicle::new(vehicle_settings(scenario, Profile::ArduCopter));
        Self(Arc::new(Mutex::new(Aloft {
            begin: std::time::Instant::now(),
            now: Instant::ZERO,
            vehicle,
            cut: false,
        })))
    }

    fn pilot_sets(&self, mode: FlightMode) {
        let mut aloft = self.0.lock().unwrap();
        let now = aloft.now;
        aloft.vehicle.pilot_sets_mode(now, mode);
    }

    fn is_armed(&self) -> bool {
        self.0.lock().unwrap().vehicle.armed()
    }
}

impl Link for Shared {
    fn send(&mut self, frame: &[u8]) -> std::io::Result<bool> {
        let mut aloft = self.0.lock().unwrap();
        aloft.step();
        if !aloft.cut {
            let now = aloft.now;
            aloft.vehicle.receive(now, frame);
            aloft.vehicle.end_of_datagram(now);
        }
        Ok(true)
    }

    fn receive(&mut self, buffer: &mut Vec<u8>, timeout: WallDuration) -> std::io::Result<bool> {
        buffer.clear();
        let mut aloft = self.0.lock().unwrap();
        aloft.step();
        while let Some(frame) = aloft.vehicle.next_frame() {
            if !aloft.cut {
                buffer.extend_from_slice(&frame);
            }
        }
        drop(aloft);
        if buffer.is_empty() {
            std::thread::sleep(timeout.min(WallDuration::from_micros(500)));
        }
        Ok(!buffer.is_empty())
    }

    fn is_datagram(&self) -> bool {
        true
    }
}

/// The actions in slot 3 and after it.
struct Person<'a> {
    vehicle: &'a Shared,
    in_slot_3: fn(&Shared),
    when_waiting: fn(&Shared),
    waited_armed: bool,
    said: Vec<String>,
}

impl Observer for Person<'_> {
    fn slot(&mut self, slot: &host_sim::record::SlotRecord) {
        if slot.slot == 3 {
            (self.in_slot_3)(self.vehicle);
        }
    }

    fn event(&mut self, event: &FlightEvent) {
        self.said.push(event.text.clone());
    }

    fn waiting(&mut self, words: &str) {
        self.said.push(words.into());
        if words.starts_with("waiting for the vehicle to be disarmed") {
            self.waited_armed = self.vehicle.is_armed();
            (self.when_waiting)(self.vehicle);
        }
    }
}

fn flown(
    vehicle: &Shared,
    out: &Path,
    in_slot_3: fn(&Shared),
    when_waiting: fn(&Shared),
) -> (Result<FlightRecord, FailedFlight>, Vec<String>, bool) {
    let scenario = Scenario::shipped("separated").unwrap();
    let policy = StraightLine::new(&scenario.mission);
    let journal = ParameterJournal::open(&out.join(FILE_NAME), "test").unwrap();
    let peer = Peer::external(Box::new(vehicle.clone()));
    let client = ClientSettings::default()
        .with_parameters_set()
        .with_journal(journal);
    let settings = FlightSettings {
        ground_link: None,
        policy: "straight-line".into(),
        inner: Allocation::Exact,
        profile: Profile::ArduCopter,
        real_time_factor: RealTimeFactor::Factor(SPEED),
        seed: 1,
        symbols_per_slot: 1,
        ignores_errors: false,
        events: Events::default(),
    };
    let mut person = Person {
        vehicle,
        in_slot_3,
        when_waiting,
        waited_armed: false,
        said: Vec::new(),
    };
    let computer = InProcess::new(&scenario, policy, &settings, client, &peer);
    let flown = fly_with(
        &scenario,
        &mut computer.unwrap(),
        &settings,
        peer,
        &mut person,
    );
    (flown, person.said, person.waited_armed)
}

fn count(said: &[String], part: &str) -> usize {
    said.iter().filter(|words| words.contains(part)).count()
}

/// The pilot flies on for any time: no parameter is changed until the motors have stopped.
#[test]
fn after_a_takeover_parameters_wait_for_the_pilot_to_land() {
    let scenario = Scenario::shipped("separated").unwrap();
    let vehicle = Shared::new(&scenario);
    let folder = tempfile::tempdir().unwrap();
    let (flown, said, waited_armed) = flown(
        &vehicle,
        folder.path(),
        |vehicle| {
            vehicle.pilot_sets(FlightMode::Loiter);
        },
        // From 100 m a landing takes longer than the 30 s after which an earlier client gave up.
        |vehicle| vehicle.pilot_sets(FlightMode::Land),
    );
    let failed = flown.unwrap_err();
    assert!(waited_armed, "{said:#?}");
    assert_eq!(count(&said, " restored to "), 4, "{said:#?}");
    let position = |part: &str| said.iter().position(|words| words.contains(part));
    assert!(position("disarmed").unwrap() < position(" restored to ").unwrap());
    assert!(!folder.path().join(FILE_NAME).exists());
    let ended = failed.record.unwrap().ended;
    assert!(
        ended.starts_with("control taken by the pilot or the autopilot: LOITER"),
        "{ended}"
    );
}

/// The link is permanently dead: the run ends soon, and the next run restores the parameters that
/// this one left changed.
#[test]
fn what_a_dead_link_left_changed_is_put_back_by_the_next_run() {
    let scenario = Scenario::shipped("separated").unwrap();
    let vehicle = Shared::new(&scenario);
    let folder = tempfile::tempdir().unwrap();
    let cut = |vehicle: &Shared| vehicle.0.lock().unwrap().cut = true;
    let (first, said, _) = flown(&vehicle, folder.path(), cut, |_| {});
    let record = first.unwrap_err().record.unwrap();
    assert!(!record.completed && record.ended.contains("nothing heard for 25 s"));
    let slots = record.slots.len();
    assert!((3..=8).contains(&slots), "{slots}");
    assert_eq!(count(&said, " was NOT restored"), 4, "{said:#?}");
    assert!(folder.path().join(FILE_NAME).exists());

    // The vehicle was retrieved and kept its parameters; its link works again.
    {
        let mut aloft = vehicle.0.lock().unwrap();
        let mut fetched = vehicle_settings(&scenario, Profile::ArduCopter);
        fetched.parameters = vec![
            ("WPNAV_SPEED".into(), 3500.0),
            ("WPNAV_ACCEL".into(), 1000.0),
            ("ANGLE_MAX".into(), 4500.0),
            ("PSC_JERK_XY".into(), 20.0),
        ];
        aloft.vehicle = Vehicle::new(fetched);
        aloft.begin = std::time::Instant::now();
        aloft.now = Instant::ZERO;
        aloft.cut = false;
    }
    let (second, said, _) = flown(&vehicle, folder.path(), |_| {}, |_| {});
    assert!(second.is_ok(), "{said:#?}");
    assert_eq!(count(&said, "which an earlier run left changed"), 1);
    // The parameters were restored, set for the flight, and restored after it.
    assert_eq!(count(&said, " restored to "), 8, "{said:#?}");
    assert_eq!(count(&said, " set from "), 4, "{said:#?}");
    assert!(!folder.path().join(FILE_NAME).exists());
}

//! Mission upload to each built-in vehicle, over good and impaired links, in simulated time.

mod flight;

use firmware_core::Position;
use firmware_core::autopilot::frames::MapFrame;
use firmware_core::autopilot::mission::{
    Ending, Left, MissionPlan, MissionUpload, PlanError, UploadError, UploadOutcome,
};
use firmware_core::autopilot::wire::{Address, Decoder, Encoder, MAX_FRAME};
use firmware_core::time::{Duration, Instant};
use flight::{origin, zigzag};
use link::lossy::{Channel, Faults};
use mavlink::dialects::common::{
    MISSION_COUNT_DATA, MISSION_ITEM_INT_DATA, MavCmd, MavFrame, MavMessage, MavMissionResult,
};
use vehicle::{FlightMode, Profile, Vehicle};

const OWN: Address = Address {
    system: 255,
    component: 191,
};
const VEHICLE: Address = Address {
    system: 1,
    component: 1,
};

fn plan(profile: Profile, waypoints: &[Position<f64>]) -> MissionPlan<'_, f64> {
    MissionPlan {
        firmware: profile.firmware(),
        map: MapFrame::new(origin()),
        waypoints,
        altitude_m: 100.0,
        speed_mps: 10.0,
        ending: Ending::Land,
    }
}

struct Transfer {
    now: Instant,
    vehicle: Vehicle,
    up: Channel,
    down: Channel,
    encoder: Encoder,
}

impl Transfer {
    fn new(profile: Profile, faults: &Faults, seed: u64) -> Self {
        let mut settings = flight::vehicle(profile);
        settings.ready_after = Duration::from_millis(100);
        Self {
            now: BEGIN,
            vehicle: Vehicle::new(settings),
            up: Channel::new(faults.clone(), seed),
            down: Channel::new(faults.clone(), !seed),
            encoder: Encoder::new(OWN),
        }
    }

    fn run(
        &mut self,
        upload: &mut MissionUpload<'_, f64>,
        mut watch: impl FnMut(Instant, &mut MissionUpload<'_, f64>),
    ) -> UploadOutcome {
        let end = self.now + Duration::from_secs(300);
        while self.now < end {
            let mut buffer = [0; MAX_FRAME];
            while let Some(message) = upload.poll(self.now) {
                self.up
                    .push(self.now, self.encoder.encode(&message, &mut buffer));
            }
            while let Some(frame) = self.up.pop(self.now) {
                self.vehicle.receive(self.now, &frame);
                self.vehicle.end_of_datagram(self.now);
            }
            self.vehicle.step(self.now);
            while let Some(frame) = self.vehicle.next_frame() {
                self.down.push(self.now, &frame);
            }
            while let Some(frame) = self.down.pop(self.now) {
                let mut decoder = Decoder::new();
                let mut bytes = &frame[..];
                while let Some(frame) = decoder.next_frame(&mut bytes) {
                    upload.receive(self.now, frame.sender(), &frame.message().unwrap());
                }
            }
            watch(self.now, upload);
            if let Some(outcome) = upload.outcome() {
                return outcome;
            }
            self.now += Duration::from_millis(10);
        }
        panic!("no outcome");
    }
}

/// The time at which transfers begin: an ArduCopter has space for a mission by then.
const BEGIN: Instant = Instant::from_micros(20_000_000);

const HABITS: [Profile; 3] = [Profile::Multirotor, Profile::ArduCopter, Profile::Px4];

#[test]
fn a_mission_is_uploaded_read_back_started_and_flown() {
    for (profile, ending) in HABITS
        .into_iter()
        .flat_map(|profile| [(profile, Ending::Land), (profile, Ending::Return)])
    {
        let waypoints = zigzag();
        let plan = MissionPlan {
            ending,
            ..plan(profile, &waypoints)
        };
        let mut upload = MissionUpload::new(plan, VEHICLE, OWN, true).unwrap();
        let mut transfer = Transfer::new(profile, &Faults::default(), 0);
        transfer.run(&mut upload, |_, _| {}).unwrap();
        assert_eq!(transfer.vehicle.mission_items(), usize::from(plan.count()));
        assert_eq!(transfer.vehicle.mode(), FlightMode::Auto, "{profile}");
        let (mut nearest, mut highest) = (vec![f64::INFINITY; waypoints.len()], 0.0f64);
        for _ in 0..60_000 {
            transfer.now += Duration::from_millis(10);
            transfer.vehicle.step(transfer.now);
            while transfer.vehicle.next_frame().is_some() {}
            highest = highest.max(transfer.vehicle.altitude_m());
            for (nearest, waypoint) in nearest.iter_mut().zip(&waypoints) {
                *nearest = nearest.min((transfer.vehicle.true_position() - waypoint).norm());
            }
        }
        assert!(nearest.iter().all(|&d| d < 2.0), "{profile}: {nearest:.1?}");
        assert!((highest - 100.0).abs() < 1.5, "{profile}: {highest}");
        assert!(!transfer.vehicle.armed(), "{profile} landed at the end");
        assert_eq!(transfer.vehicle.altitude_m(), 0.0);
    }
}

/// Returns the reason with which the vehicle refuses an item, before it is asked for anything else.
fn refusal(profile: Profile, change: fn(&mut MISSION_ITEM_INT_DATA)) -> Option<MavMissionResult> {
    let waypoints = zigzag();
    let plan = MissionPlan {
        ending: Ending::Return,
        ..plan(profile, &waypoints)
    };
    let mut transfer = Transfer::new(profile, &Faults::default(), 0);
    let mut buffer = [0; MAX_FRAME];
    let mut say = |transfer: &mut Transfer, message: &MavMessage| {
        let frame = transfer.encoder.encode(message, &mut buffer).to_vec();
        transfer.vehicle.receive(BEGIN, &frame);
        let mut answers = vec![];
        while let Some(frame) = transfer.vehicle.next_frame() {
            let mut decoder = Decoder::new();
            let mut bytes = &frame[..];
            answers.push(decoder.next_frame(&mut bytes).unwrap().message().unwrap());
        }
        answers
    };
    let mut answers = say(
        &mut transfer,
        &MavMessage::MISSION_COUNT(MISSION_COUNT_DATA {
            count: plan.count(),
            target_system: 1,
            target_component: 1,
            ..MISSION_COUNT_DATA::DEFAULT
        }),
    );
    for sequence in 0..plan.count() {
        if let Some(MavMessage::MISSION_ACK(ack)) = answers.last() {
            return Some(ack.mavtype);
        }
        let mut item = plan.item(sequence, VEHICLE).unwrap();
        change(&mut item);
        answers = say(&mut transfer, &MavMessage::MISSION_ITEM_INT(item));
    }
    answers.iter().find_map(|answer| match answer {
        MavMessage::MISSION_ACK(ack) => Some(ack.mavtype),
        _ => None,
    })
}

/// PX4 accepts a command without a position only in the frame MISSION, and a position in any other
/// frame.
#[test]
fn items_are_sent_in_the_frames_that_px4_takes() {
    for profile in HABITS {
        let accepted = Some(MavMissionResult::MAV_MISSION_ACCEPTED);
        assert_eq!(refusal(profile, |_| {}), accepted, "{profile}");
    }
    let everywhere = |item: &mut MISSION_ITEM_INT_DATA| {
        item.frame = MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT;
    };
    let unsupported = Some(MavMissionResult::MAV_MISSION_UNSUPPORTED);
    assert_eq!(refusal(Profile::Px4, everywhere), unsupported);
    let waypoints = zigzag();
    let plan = MissionPlan {
        ending: Ending::Return,
        ..plan(Profile::Px4, &waypoints)
    };
    for sequence in 0..plan.count() {
        let item = plan.item(sequence, VEHICLE).unwrap();
        let placeless = matches!(
            item.command,
            MavCmd::MAV_CMD_DO_CHANGE_SPEED | MavCmd::MAV_CMD_NAV_RETURN_TO_LAUNCH
        );
        let frame = if placeless {
            assert_eq!((item.x, item.y, item.z), (0, 0, 0.0));
            MavFrame::MAV_FRAME_MISSION
        } else {
            MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT
        };
        assert_eq!(item.frame, frame, "item {sequence}");
    }
}

/// Like an ArduCopter that has just booted: the client asks again until it has space.
#[test]
fn an_autopilot_without_space_after_boot_is_waited_for() {
    let waypoints = zigzag();
    let profile = Profile::ArduCopter;
    let mut upload = MissionUpload::new(plan(profile, &waypoints), VEHICLE, OWN, false).unwrap();
    let mut transfer = Transfer::new(profile, &Faults::default(), 0);
    transfer.now = Instant::from_micros(1_000_000);
    let mut waited = false;
    let outcome = transfer.run(&mut upload, |_, upload| waited |= upload.waits_for_space());
    assert_eq!(outcome, Ok(()));
    assert!(waited && !upload.waits_for_space());
    assert!(transfer.now > Instant::from_micros(2_400_000));
}

/// PX4 rejects the start of a mission that it has just stored, and accepts it half a second later.
#[test]
fn a_mission_that_is_not_taken_yet_is_started_again() {
    let waypoints = zigzag();
    let plan = plan(Profile::Px4, &waypoints);
    let mut upload = MissionUpload::new(plan, VEHICLE, OWN, true).unwrap();
    let mut transfer = Transfer::new(Profile::Px4, &Faults::default(), 0);
    let begin = transfer.now;
    let outcome = transfer.run(&mut upload, |_, _| {});
    assert_eq!(outcome, Ok(()));
    assert!(transfer.now - begin > Duration::from_millis(500));
    assert_eq!(transfer.vehicle.mode(), FlightMode::Auto);
}

#[test]
fn bad_links_lead_to_a_whole_mission_or_none() {
    let faults = Faults {
        loss: 0.2,
        duplication: 0.05,
        reordering: 0.05,
        reordering_delay: Duration::from_millis(200),
        corruption: 0.02,
        ..Faults::default()
    };
    let waypoints = zigzag();
    let mut whole = 0;
    for seed in 0..200 {
        let profile = HABITS[seed as usize % HABITS.len()];
        let plan = plan(profile, &waypoints);
        let mut upload = MissionUpload::new(plan, VEHICLE, OWN, false).unwrap();
        let mut transfer = Transfer::new(profile, &faults, seed);
        let outcome = transfer.run(&mut upload, |_, _| {});
        match outcome {
            Ok(()) => {
                whole += 1;
                assert_eq!(transfer.vehicle.mission_items(), usize::from(plan.count()));
            }
            Err((_, Left::Nothing | Left::Old)) => {
                assert_eq!(transfer.vehicle.mission_items(), 0, "seed {seed}");
            }
            Err(other) => panic!("seed {seed}: {other:?}"),
        }
    }
    assert!(whole >= 190, "{whole} of 200");
}

#[test]
fn a_cut_in_the_middle_never_leaves_half_a_mission() {
    for profile in HABITS {
        let waypoints = zigzag();
        let mut upload =
            MissionUpload::new(plan(profile, &waypoints), VEHICLE, OWN, false).unwrap();
        let faults = Faults {
            // Each frame takes 30 ms: after half a second about eight items are transferred.
            delay: Duration::from_millis(30),
            cut: Some((
                BEGIN + Duration::from_millis(500),
                BEGIN + Duration::from_secs(11),
            )),
            ..Faults::default()
        };
        let mut transfer = Transfer::new(profile, &faults, 0);
        let outcome = transfer.run(&mut upload, |_, _| {});
        assert_eq!(
            outcome,
            Err((UploadError::Unanswered, Left::Nothing)),
            "{profile}"
        );
        assert_eq!(transfer.vehicle.mission_items(), 0, "{profile}");
    }
}

#[test]
fn a_cancelled_upload_is_cleared() {
    let waypoints = zigzag();
    let profile = Profile::ArduCopter;
    let mut upload = MissionUpload::new(plan(profile, &waypoints), VEHICLE, OWN, false).unwrap();
    let faults = Faults {
        delay: Duration::from_millis(30),
        ..Faults::default()
    };
    let mut transfer = Transfer::new(profile, &faults, 0);
    let outcome = transfer.run(&mut upload, |now, upload| {
        if upload.progress().0 == 5 {
            upload.cancel(now);
        }
    });
    assert_eq!(outcome, Err((UploadError::Cancelled, Left::Nothing)));
    assert_eq!(transfer.vehicle.mission_items(), 0);
}

#[test]
fn what_does_not_fit_is_refused_and_the_old_mission_stays() {
    let (short, long) = (zigzag(), vec![Position::new(1.0, 2.0); 800]);
    let profile = Profile::ArduCopter;
    let mut transfer = Transfer::new(profile, &Faults::default(), 0);
    let mut first = MissionUpload::new(plan(profile, &short), VEHICLE, OWN, false).unwrap();
    transfer.run(&mut first, |_, _| {}).unwrap();
    let mut second = MissionUpload::new(plan(profile, &long), VEHICLE, OWN, false).unwrap();
    let refused = UploadError::Refused(MavMissionResult::MAV_MISSION_NO_SPACE);
    let outcome = transfer.run(&mut second, |_, _| {});
    assert_eq!(outcome, Err((refused, Left::Old)));
    assert_eq!(transfer.vehicle.mission_items(), 14);
}

#[test]
fn plans_that_mean_nothing_are_refused_before_a_byte_is_sent() {
    let new = |waypoints: &[Position<f64>]| {
        MissionUpload::new(plan(Profile::Ideal, waypoints), VEHICLE, OWN, false).map(|_| ())
    };
    assert_eq!(new(&[]), Err(PlanError::Empty));
    let nan = Position::new(0.0, f64::NAN);
    assert_eq!(
        new(&[Position::origin(), nan]),
        Err(PlanError::NotFinite(1))
    );
    let places = [Position::origin()];
    for value in [-50.0, 0.0, f64::INFINITY] {
        let sound = plan(Profile::Ideal, &places);
        let (mut low, mut slow) = (sound, sound);
        (low.altitude_m, slow.speed_mps) = (value, value);
        for (plan, name) in [(low, "altitude_m"), (slow, "speed_mps")] {
            let refused = MissionUpload::new(plan, VEHICLE, OWN, false).map(|_| ());
            assert_eq!(refused, Err(PlanError::NotPositive { name, value }));
        }
    }
}

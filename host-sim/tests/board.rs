//! A mission with the board's computer, in single precision and stepped from outside like the board
//! in QEMU.

use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    process::Command,
    sync::Arc,
    thread,
};

use environment::Allocation;
use firmware_core::{
    USERS_MAX,
    console::{self, BoardReport, Call, Calls, MissionOrder, PolicyKind, REPORT_FRAME_MAX},
    policy::{StraightLine, mlp::Mlp},
};
use host_sim::{
    flight::{
        self, FlightSettings, Peer, RealTimeFactor,
        computer::{Image, OnboardComputer, Twin, order},
    },
    policy::for_any_mission,
    record::FlightRecord,
};
use scenario::{Events, Scenario, ScenarioChoice};
use vehicle::{Profile, Vehicle};

fn flown(scenario: &Scenario, policy_kind: PolicyKind) -> FlightRecord {
    flown_with(scenario, (policy_kind, None), Events::default())
}

/// Flies by a policy, or by that of a file in flash, with changes of the mission.
fn flown_with(
    scenario: &Scenario,
    (policy_kind, file): (PolicyKind, Option<&[u8]>),
    events: Events,
) -> FlightRecord {
    let settings = FlightSettings {
        ground_link: None,
        policy: "of the board".into(),
        inner: Allocation::Exact,
        profile: Profile::Ideal,
        real_time_factor: RealTimeFactor::Max,
        seed: 1,
        symbols_per_slot: 10,
        ignores_errors: false,
        events,
    };
    let order = order(scenario, settings.profile, policy_kind);
    let mut twin = Twin::new(&order, file.map(Arc::from)).expect("an order that can be flown");
    let vehicle = flight::vehicle_settings(scenario, settings.profile);
    let peer = Peer::built_in(Vehicle::new(vehicle));
    flight::fly_with(scenario, &mut twin, &settings, peer, &mut ()).expect("flown")
}

#[test]
fn a_mission_in_single_precision_arrives_and_is_the_same_each_time() {
    let scenario = Scenario::shipped("separated").expect("shipped");
    let record = flown(&scenario, PolicyKind::StraightLine);
    let summary = record.summary();
    assert!(summary.arrived && summary.fair, "{summary:?}");
    assert_eq!(
        (summary.mse_violations, summary.constraint_violations),
        (0, 0)
    );
    assert_eq!(record.slots.len(), 60);
    assert!(record.slots.iter().all(|slot| slot.age_slots == 0));
    let again = flown(&scenario, PolicyKind::StraightLine).slots;
    assert_eq!(again.len(), record.slots.len());
    for (one, other) in record.slots.iter().zip(&again) {
        assert_eq!(
            (one.planned, one.served_user),
            (other.planned, other.served_user)
        );
        assert_eq!(one.rate.to_bits(), other.rate.to_bits());
    }
}

#[test]
fn an_order_without_its_policy_is_refused() {
    let scenario = Scenario::shipped("separated").expect("shipped");
    let order = order(&scenario, Profile::Ideal, PolicyKind::Trained);
    let refusal = Twin::new(&order, None).expect_err("no policy");
    assert_eq!(refusal, "the board has no trained policy");
    let refusal = Twin::new(&order, Some((*b"ONNX").into())).expect_err("no policy");
    assert!(refusal.contains("UAVP"), "{refusal}");
}

/// The first plan is made before take-off, within the operations that the board allows for it.
#[test]
fn a_board_flies_its_own_plan() {
    /// The certified bound (models/bounds.csv), bit/s/Hz.
    const BOUND: f64 = 62.1043;
    let scenario = Scenario::shipped("separated").expect("shipped");
    let summary = flown(&scenario, PolicyKind::Plan).summary();
    assert!(summary.arrived && summary.fair, "{summary:?}");
    assert_eq!(
        (summary.mse_violations, summary.constraint_violations),
        (0, 0)
    );
    let fraction = summary.sum_rate / BOUND;
    assert!((0.98..=1.0).contains(&fraction), "{fraction}");
}

#[test]
fn an_order_beyond_the_planners_capacity_is_refused() {
    let scenario = Scenario::shipped("separated").expect("shipped");
    let mut order = order(&scenario, Profile::Ideal, PolicyKind::Plan);
    order.mission.slots = 150;
    assert!(Twin::new(&order, None).is_ok());
    order.mission.slots = 151;
    let refusal = Twin::new(&order, None).expect_err("too many slots");
    assert_eq!(
        refusal,
        "planner: the mission has 151 slots, but the planner holds at most 150"
    );
    order.policy_kind = PolicyKind::StraightLine;
    assert!(Twin::new(&order, None).is_ok());
}

/// With the policy for any mission in flash, a board flies missions with different users.
#[test]
fn a_board_flies_any_mission_by_one_policy() {
    let policy = (PolicyKind::Trained, Some(for_any_mission()));
    let random = ScenarioChoice::unchanged("../benchmarks/random-0001.toml".into());
    let scenarios = [
        Scenario::shipped("separated").expect("shipped"),
        Scenario::shipped("slow").expect("shipped"),
        random.load().expect("a mission"),
    ];
    for scenario in scenarios {
        let summary = flown_with(&scenario, policy, Events::default()).summary();
        assert!(summary.arrived && summary.fair, "{summary:?}");
        assert_eq!(
            (summary.mse_violations, summary.constraint_violations),
            (0, 0)
        );
        // The straight line has less.
        let straight = flown(&scenario, PolicyKind::StraightLine).summary();
        assert!(summary.sum_rate > 1.05 * straight.sum_rate, "{summary:?}");
    }
}

/// The policy for any mission observes changes in flight: a user that joins where the vehicle would be
/// in slot 40 is served before it must be. (A policy for one mission has no score for it: the user is
/// served when fairness leaves no other choice, in slots 58 to 60.)
#[test]
fn a_board_with_a_policy_for_any_mission_observes_changes() {
    let scenario = Scenario::shipped("separated").expect("shipped");
    let policy = (PolicyKind::Trained, Some(for_any_mission()));
    let unchanged = flown_with(&scenario, policy, Events::default());
    let there = unchanged.slots[39].planned;
    let changes = format!(
        "[[event]]\nslot = 9\nuser = 15\nposition_m = [{:?}, {:?}]\n\
         [[event]]\nslot = 12\nuser = 1\nleaves = true\n\
         [[event]]\nslot = 15\nsensor = 2\nleaves = true\n",
        there.x, there.y
    );
    let events = Events::parse(&changes, &scenario.mission).expect("changes that can be made");
    let record = flown_with(&scenario, policy, events);
    let summary = record.summary();
    assert!(summary.arrived && summary.fair, "{summary:?}");
    assert_eq!(
        (summary.mse_violations, summary.constraint_violations),
        (0, 0)
    );
    let first = record
        .slots
        .iter()
        .find(|slot| slot.served_user == Some(15));
    let first = first.expect("it has a quota").slot;
    assert!((10..58).contains(&first), "{first}");
    let after = record.slots.iter().skip(11);
    assert!(after.clone().all(|slot| slot.served_user != Some(1)));
}

/// A damaged policy for any mission is refused, and the order names no mission.
#[test]
fn a_damaged_policy_for_any_mission_is_refused() {
    let scenario = Scenario::shipped("separated").expect("shipped");
    let order = order(&scenario, Profile::Ideal, PolicyKind::Trained);
    let mut file = for_any_mission().to_vec();
    let twin = Twin::new(&order, Some(file.as_slice().into())).expect("sound");
    assert_eq!(twin.scenario_digest(), None);
    let middle = file.len() / 2;
    file[middle] ^= 4;
    let refusal = Twin::new(&order, Some(file.as_slice().into())).expect_err("damaged");
    assert!(refusal.contains("checksum"), "{refusal}");
}

/// Returns listeners at three successive ports.
fn three_ports() -> [TcpListener; 3] {
    let at = |port: u16| TcpListener::bind(("127.0.0.1", port));
    for _ in 0..100 {
        let first = at(0).expect("a free port");
        let port = first.local_addr().expect("bound").port();
        if port < u16::MAX - 2
            && let (Ok(second), Ok(third)) = (at(port + 1), at(port + 2))
        {
            return [first, second, third];
        }
    }
    panic!("no three free ports in a row");
}

/// Starts a board that accepts one order, with the digest of the mission that its policy was trained
/// for. Returns the address, and the thread that returns the order.
fn accepting_board(digest: Option<&str>) -> (String, thread::JoinHandle<MissionOrder>) {
    let lines = three_ports();
    let to = format!("127.0.0.1:{}", lines[0].local_addr().expect("bound").port());
    let answer = BoardReport::Ready {
        scenario_digest: digest.map(|text| text.try_into().expect("64 digits")),
    };
    let board = thread::spawn(move || {
        let mut lines = lines.map(|line| line.accept().expect("a host").0);
        let console: &mut TcpStream = &mut lines[2];
        let (mut calls, mut byte) = (Calls::default(), [0]);
        let order = loop {
            console.read_exact(&mut byte).expect("an order");
            if let Some(Ok(Call::Order(order))) = calls.push(byte[0]) {
                break order;
            }
        };
        let mut frame = [0; REPORT_FRAME_MAX];
        let frame = console::encode_report(&answer, &mut frame).expect("fits");
        console.write_all(frame).expect("sent");
        order
    });
    (to, board)
}

/// A board whose policy is for one mission does not fly where one for any mission is asked for.
#[test]
fn a_board_without_a_policy_for_any_mission_is_refused() {
    let (to, board) = accepting_board(Some(&"0123456789abcdef".repeat(4)));
    let to = format!("tcp:{to}");
    let mut run = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    run.args(["run", "--controller", &to, "--policy", "any"]);
    let output = run.output().expect("it starts");
    let refused = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{refused}");
    assert!(refused.contains("is for one mission"), "{refused}");
    let order = board.join().expect("no panic");
    assert_eq!(order.policy_kind, PolicyKind::Trained);
}

/// A board accepts an order with the digest of the mission that its policy was trained for, from
/// which the host knows whether that is the mission of the order.
#[test]
fn a_board_says_which_mission_its_policy_was_trained_for() {
    let scenario = Scenario::shipped("separated").expect("shipped");
    for digest in [Some("0123456789abcdef".repeat(4)), None] {
        let (to, board) = accepting_board(digest.as_deref());
        let sent = order(&scenario, Profile::Ideal, PolicyKind::Trained);
        let image = Image::connect(&to.parse().expect("an address"), &sent).expect("accepted");
        assert_eq!(board.join().expect("no panic"), sent);
        assert_eq!(image.scenario_digest(), digest.as_deref());
    }
}

/// The computer of a board reports it by itself.
#[test]
fn an_order_of_a_rule_names_no_mission() {
    let scenario = Scenario::shipped("separated").expect("shipped");
    let order = order(&scenario, Profile::Ideal, PolicyKind::StraightLine);
    let computer = order
        .build::<Mlp<&[u8]>, StraightLine<f32, USERS_MAX>>(None, None)
        .expect("an order that can be flown");
    let expected = BoardReport::Ready {
        scenario_digest: None,
    };
    assert_eq!(console::ready(&computer), expected);
}

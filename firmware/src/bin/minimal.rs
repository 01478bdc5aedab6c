//! The smallest image that flies: a mission that is compiled in, a rule as its policy, no console.
//! It is an example for boards of one's own; `controller` is the image that takes orders.
#![no_std]
#![no_main]

use core::{convert::Infallible, mem::MaybeUninit};

use firmware::board::{Board, Line, mps2::Mps2};
use firmware_core::{
    Mission, Position,
    autopilot::{AutopilotSettings, frames::Geodetic, wire::MAX_FRAME},
    inner::ExactSolver,
    link::secure_frame_max,
    mission::MissionParameters,
    onboard::{Onboard, OnboardSettings},
    policy::StraightLine,
};

/// The capacities for users and sensors.
const USERS: usize = 4;
const SENSORS: usize = 8;

/// The longest frame of the ground link.
const FRAME: usize = secure_frame_max::<f32>(USERS, SENSORS);

type Computer = Onboard<f32, StraightLine<f32, USERS>, USERS, SENSORS, ExactSolver, FRAME>;

/// The size of the computer is known: most of it is the MAVLink client.
const _: () = assert!(size_of::<Computer>() <= 8_700);

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(mut board) = Mps2::take() else {
        // Nobody else runs before this.
        unreachable!("the board is taken once");
    };
    // The computer is built in static memory: the stack need not hold it.
    let place = cortex_m::singleton!(COMPUTER: MaybeUninit<Computer> = MaybeUninit::uninit());
    let place = place.ok_or("the memory is taken once");
    let problem = match place.and_then(computer) {
        Ok(computer) => match fly(&mut board, computer) {},
        Err(problem) => problem,
    };
    board.halt(&problem)
}

/// Creates the onboard computer for the mission of this image.
fn computer(place: &mut MaybeUninit<Computer>) -> Result<&mut Computer, &'static str> {
    let point = Position::new;
    let mission = Mission::new(MissionParameters {
        users: [point(200.0, 700.0), point(400.0, 800.0)]
            .into_iter()
            .collect(),
        sensors: [
            point(600.0, 100.0),
            point(700.0, 200.0),
            point(800.0, 300.0),
        ]
        .into_iter()
        .collect(),
        ..MissionParameters::table_one()
    });
    let mission = mission.map_err(|_| "the mission is invalid")?;
    let origin = Geodetic {
        latitude_e7: -353_632_621,
        longitude_e7: 1_491_652_374,
    };
    let p = mission.parameters();
    let settings = AutopilotSettings::new(origin, p.start, p.altitude_m, p.max_speed_mps);
    let policy = StraightLine::new(&mission);
    let parts = (policy, ExactSolver);
    Onboard::new_in(place, OnboardSettings::default(), mission, parts, settings)
        .map_err(|_| "the settings are invalid")
}

/// The main loop: what came on both lines, one step, what is to be sent, then a rest of 10 ms at
/// most.
fn fly(board: &mut impl Board, computer: &mut Computer) -> Infallible {
    let now = board.now();
    computer.launch(now);
    let mut piece = [0; 64];
    let (mut frame, mut ground_frame) = ([0; MAX_FRAME], [0; FRAME]);
    loop {
        let now = board.now();
        while let length @ 1.. = board.receive(Line::Mavlink, &mut piece) {
            let bytes = piece.get(..length).unwrap_or_default();
            computer.receive_mavlink(now, bytes, false);
        }
        while let length @ 1.. = board.receive(Line::Ground, &mut piece) {
            let bytes = piece.get(..length).unwrap_or_default();
            computer.receive_ground(now, bytes);
        }
        computer.poll(now, &mut ());
        // A frame for which there is no memory is dropped and counted by the board.
        while let Some(frame) = computer.take_mavlink_frame(now, &mut frame) {
            board.send(Line::Mavlink, frame);
        }
        while let Some(frame) = computer.take_ground_frame(&mut ground_frame) {
            board.send(Line::Ground, frame);
        }
        board.rest(true);
    }
}

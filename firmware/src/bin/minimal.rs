//! The smallest image that flies: a mission that is compiled in, a rule as its policy, no console.
//! It is an example for boards of one's own; `controller` is the image that takes orders.
#![no_std]
#![no_main]

use core::convert::Infallible;

use firmware::board::{Board, Line, mps2::Mps2};
use firmware_core::{
    Mission, Position,
    autopilot::{Autopilot, AutopilotSettings, frames::Geodetic, wire::MAX_FRAME},
    controller::Controller,
    link::FRAME_MAX,
    mission::MissionParameters,
    onboard::{Onboard, OnboardSettings},
    policy::StraightLine,
};

/// The capacities for users and sensors.
const USERS: usize = 4;
const SENSORS: usize = 8;

type Computer = Onboard<f32, StraightLine<f32, USERS>, USERS, SENSORS>;

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(mut board) = Mps2::take() else {
        // Nobody else runs before this.
        unreachable!("the board is taken once");
    };
    let problem = match computer() {
        Ok(mut computer) => match fly(&mut board, &mut computer) {},
        Err(problem) => problem,
    };
    board.halt(&problem)
}

/// The onboard computer for the mission of this image.
fn computer() -> Result<Computer, &'static str> {
    let place = Position::new;
    let mission = Mission::new(MissionParameters {
        users: [place(200.0, 700.0), place(400.0, 800.0)]
            .into_iter()
            .collect(),
        sensors: [
            place(600.0, 100.0),
            place(700.0, 200.0),
            place(800.0, 300.0),
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
    let autopilot = Autopilot::new(settings).map_err(|_| "the settings are invalid")?;
    let policy = StraightLine::new(&mission);
    let controller = Controller::new(mission, policy);
    Ok(Onboard::new(
        OnboardSettings::default(),
        controller,
        autopilot,
    ))
}

/// The main loop: what came on both lines, one step, what is to be sent, then a rest of 10 ms at
/// most.
fn fly(board: &mut impl Board, computer: &mut Computer) -> Infallible {
    let now = board.now();
    computer.launch(now);
    let mut piece = [0; 64];
    let (mut frame, mut ground_frame) = ([0; MAX_FRAME], [0; FRAME_MAX]);
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

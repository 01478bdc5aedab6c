// SPDX-License-Identifier: MIT OR Apache-2.0
//! A minimal main loop on an operating system: the onboard computer between an autopilot and the
//! ground, each at a UDP port.
//!
//! ```text
//! cargo run -p firmware-core --example main_loop -- 127.0.0.1:14550 127.0.0.1:14600 60
//! ```
//!
//! The arguments are the addresses of the autopilot and of the ground, and the longest time, s. The
//! program ends when the vehicle has landed.

use std::{env, error::Error, io, net::UdpSocket, time};

use firmware_core::{
    Mission, Position,
    autopilot::{Autopilot, AutopilotSettings, frames::Geodetic, wire::MAX_FRAME},
    controller::Controller,
    link::FRAME_MAX,
    mission::MissionParameters,
    onboard::{Onboard, OnboardSettings, Stage},
    policy::StraightLine,
    time::{Duration, Instant},
};

/// The capacities for users and sensors.
const USERS: usize = 4;
const SENSORS: usize = 8;

fn onboard_computer()
-> Result<Onboard<f64, StraightLine<f64, USERS>, USERS, SENSORS>, Box<dyn Error>> {
    let place = Position::new;
    let mission = Mission::new(MissionParameters::<f64, USERS, SENSORS> {
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
    })?;
    // The origin of the map, where both coordinates are 0.
    let origin = Geodetic {
        latitude_e7: -353_632_621,
        longitude_e7: 1_491_652_374,
    };
    let p = mission.parameters();
    let settings = AutopilotSettings::new(origin, p.start, p.altitude_m, p.max_speed_mps);
    let autopilot = Autopilot::new(settings)?;
    let policy = StraightLine::new(&mission);
    let controller = Controller::new(mission, policy);
    Ok(Onboard::new(
        OnboardSettings::default(),
        controller,
        autopilot,
    ))
}

/// Opens a socket that waits at most 5 ms for a datagram.
fn connect(to: &str) -> io::Result<UdpSocket> {
    let socket = UdpSocket::bind("0.0.0.0:0")?;
    socket.connect(to)?;
    socket.set_read_timeout(Some(time::Duration::from_millis(5)))?;
    Ok(socket)
}

/// Returns the datagram that was received; a peer that is not there (yet) sends nothing.
fn receive<'b>(from: &UdpSocket, buffer: &'b mut [u8]) -> &'b [u8] {
    let length = from.recv(buffer).unwrap_or(0);
    buffer.get(..length).unwrap_or_default()
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [autopilot, ground, longest_s] = arguments.as_slice() else {
        return Err("usage: main_loop AUTOPILOT GROUND SECONDS".into());
    };
    let (autopilot, ground) = (connect(autopilot)?, connect(ground)?);
    let longest = Duration::from_secs(longest_s.parse()?);
    let mut computer = onboard_computer()?;

    let begun = time::Instant::now();
    let clock = || Instant::from_micros(begun.elapsed().as_micros() as u64);
    computer.launch(clock());
    let mut buffer = [0; 2048];
    let (mut frame, mut ground_frame) = ([0; MAX_FRAME], [0; FRAME_MAX]);
    let mut stage = computer.stage();
    while !matches!(stage, Stage::Completed | Stage::Aborted) {
        let datagram = receive(&autopilot, &mut buffer);
        computer.receive_mavlink(clock(), datagram, true);
        let datagram = receive(&ground, &mut buffer);
        computer.receive_ground(clock(), datagram);

        let now = clock();
        computer.poll(now, &mut ());

        // A frame that cannot be sent is lost, as on a radio; the failsafes handle it.
        while let Some(frame) = computer.take_mavlink_frame(now, &mut frame) {
            let _ = autopilot.send(frame);
        }
        while let Some(frame) = computer.take_ground_frame(&mut ground_frame) {
            let _ = ground.send(frame);
        }
        while let Some(event) = computer.autopilot_mut().take_next_event() {
            println!("{event}");
        }
        stage = computer.stage();
        if now.duration_since(Instant::ZERO) > longest {
            return Err(format!("{stage:?} after {longest_s} s").into());
        }
    }
    println!("{stage:?}");
    Ok(())
}

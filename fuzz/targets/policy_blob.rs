//! A policy file: arbitrary bytes, arbitrary bytes after a preamble of either version with a valid
//! checksum, and a file of version 2 with arbitrary weights. A policy that loads returns one score
//! per user and a displacement within its reach.
#![no_main]

use firmware_core::{
    USERS_MAX,
    policy::{
        Observation, Policy,
        mlp::{self, Mlp},
        output_len,
        sets::{
            self, Architecture, MISSION_COLUMNS, Precision, SENSOR_COLUMNS, SetsHeader, SetsNetwork,
            SetsObservation, SetsProvenance, SetsWork, USER_COLUMNS,
        },
        state_len,
    },
    shield::Agility,
};
use libfuzzer_sys::fuzz_target;

const VEHICLE: Agility<f64> = Agility {
    step_m: 30.0,
    reach_m: 30.0,
    velocity_change_m: f64::INFINITY,
    drift_m: [0.0; 2],
};

fuzz_target!(|data: &[u8]| {
    let Some((&first, rest)) = data.split_first() else {
        return;
    };
    match first % 5 {
        0 => {
            for_one_mission(rest.to_vec());
            for_any_mission(rest.to_vec());
        }
        1 => for_one_mission(sealed(mlp::FORMAT_VERSION, rest)),
        3 => for_one_mission(sealed(mlp::FORMAT_VERSION_FUNCTIONS, rest)),
        2 => for_any_mission(sealed(sets::FORMAT_VERSION, rest)),
        _ => with_weights(rest),
    }
});

/// Returns a file with a valid preamble.
fn sealed(version: u16, body: &[u8]) -> Vec<u8> {
    let checksum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(body);
    let mut file = b"UAVP".to_vec();
    file.extend_from_slice(&version.to_le_bytes());
    file.extend_from_slice(&checksum.to_le_bytes());
    file.extend_from_slice(body);
    file
}

fn for_one_mission(file: Vec<u8>) {
    let Ok(mut policy) = Mlp::load(file) else {
        return;
    };
    let users = policy.provenance().users as usize;
    let sizes = &policy.header().sizes;
    let ends = [state_len(users), output_len(users)];
    assert_eq!([sizes[0], sizes[sizes.len() - 1]].map(usize::from), ends);
    if users > USERS_MAX {
        return;
    }
    let action = Policy::<f64, USERS_MAX>::decide(
        &mut policy,
        &Observation {
            slot: 1,
            counts: &vec![0; users],
            rate: 0.0,
            mse: 0.0,
            position: [100.0, 100.0].into(),
            agility: VEHICLE,
        },
    );
    // A sum of finite weights can overflow to NaN, which the shield handles. Any other displacement
    // is `tanh` times the reach.
    assert_eq!(action.user_scores.len(), users);
    let reach_m = f64::from(policy.header().reach_m);
    for displacement in action.displacement.iter() {
        assert!(displacement.is_nan() || displacement.abs() <= reach_m);
    }
}

fn for_any_mission(file: Vec<u8>) {
    let mut work = Box::<SetsWork>::default();
    let Ok(network) = SetsNetwork::load(file, &mut work) else {
        return;
    };
    // Twice: nothing of the first evaluation stays in the memory.
    let observation = observation(3, 5);
    let [output, again] = [(); 2].map(|()| {
        let output = network.evaluate(&observation, &mut work);
        output.expect("a network that was loaded can be evaluated")
    });
    let reach_m = observation.mission[7];
    for (x, again) in output.displacement_m.iter().zip(&again.displacement_m) {
        assert!(x.is_nan() || (x.abs() <= reach_m * 1.001 && x == again), "{x} {again}");
    }
    assert!(output.user_scores[3..].iter().all(|&score| score == 0.0));
}

/// A small network whose weights are these bytes.
fn with_weights(bytes: &[u8]) {
    let architecture = Architecture {
        width: 4,
        hidden: 2,
        layers: 1,
    };
    let provenance = SetsProvenance {
        algorithm: "fuzz".try_into().expect("short"),
        missions: "fuzz".try_into().expect("short"),
        episodes: 0,
        seed: 0,
    };
    let test = observation(2, 1);
    let header = SetsHeader::new(provenance, architecture, Precision::Half, &test);
    let byte = |index: usize| f32::from(bytes.get(index).copied().unwrap_or(0).cast_signed());
    let weights = (0..architecture.weight_count()).map(|index| byte(index) / 16.0);
    let mut file = vec![0; 16 * 1024];
    let mut work = Box::<SetsWork>::default();
    if let Ok(length) = sets::write(&header, weights, &test, &mut work, &mut file) {
        file.truncate(length);
        for_any_mission(file);
    }
}

/// An observation with as many users and sensors, and a reach of 30 m.
fn observation(users: usize, sensors: usize) -> SetsObservation {
    let count = MISSION_COLUMNS + users * USER_COLUMNS + sensors * SENSOR_COLUMNS;
    let columns = (0..count).map(|column| match column {
        7 => 30.0,
        _ => (column % 11) as f32,
    });
    SetsObservation::of_columns([users, sensors], columns)
}

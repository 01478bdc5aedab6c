//! A policy file: arbitrary bytes, and arbitrary bytes after a preamble with a valid checksum. A
//! policy that loads returns one score per user and a displacement within its reach.
#![no_main]

use firmware_core::{
    USERS_MAX,
    policy::{
        Observation, Policy,
        mlp::{FORMAT_VERSION, Mlp},
        output_len, state_len,
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
    let mut file = rest.to_vec();
    if first % 2 == 1 {
        let checksum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(rest);
        file = b"UAVP".to_vec();
        file.extend_from_slice(&FORMAT_VERSION.to_le_bytes());
        file.extend_from_slice(&checksum.to_le_bytes());
        file.extend_from_slice(rest);
    }
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
});

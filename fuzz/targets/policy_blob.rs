//! A policy file: bytes as they come, and bytes behind a preamble whose checksum is right. What
//! loads decides something that is a number.
#![no_main]

use firmware_core::policy::{
    Observation, Policy,
    mlp::{FORMAT_VERSION, Mlp},
};
use libfuzzer_sys::fuzz_target;

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
    let users = usize::from(policy.header().sizes[0]) - 4;
    if users > 16 {
        return;
    }
    let action = Policy::<f64, 16>::decide(
        &mut policy,
        &Observation {
            slot: 1,
            counts: &vec![0; users],
            rate: 0.0,
            mse: 0.0,
            position: [100.0, 100.0].into(),
        },
    );
    // Finite weights can overflow in a sum; the shield takes care of that. A displacement is
    // `tanh` times a reach and cannot.
    assert_eq!(action.user_scores.len(), users);
    let reach_m = f64::from(policy.header().reach_m);
    for displacement in action.displacement.iter() {
        assert!(displacement.is_nan() || displacement.abs() <= reach_m);
    }
});

//! Solves a slot and sends an autopilot its first heartbeat, signed, without std and without an allocator. See Cargo.toml.
#![no_std]
#![no_main]

use core::panic::PanicInfo;

use firmware_core::{
    Position, PowerGain, Watt,
    autopilot::{
        Autopilot, AutopilotSettings,
        frames::Geodetic,
        wire::{
            Decoder, Encoder, MAX_FRAME,
            signing::{self, LinkSigning, SigningKey, SigningState},
        },
    },
    inner::{SlotLimits, Workspace},
    time::Instant,
};

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}

/// The prebuilt `core` names this; with `panic = "abort"` nothing calls it.
#[unsafe(no_mangle)]
pub extern "C" fn rust_eh_personality() {}

/// The C start-up calls this; 0 says that the slot came out feasible.
#[unsafe(no_mangle)]
pub extern "C" fn main() -> i32 {
    let limits = SlotLimits {
        sensor_power_max: Watt(0.05_f32),
        user_power_max: Watt(0.2),
        noise_power: Watt(3.162_277_6e-13),
        mse_threshold: 0.015,
    };
    let gains = [PowerGain(4e-12_f32); 36];
    let mut workspace = Workspace::<f32, 64>::default();
    let solved = workspace
        .sensors(&limits, &gains)
        .and_then(|field| field.solve(Some(PowerGain(2e-12))));
    match solved {
        Ok(solution) if solution.status.is_feasible() && solution.rate > 0.0 => heartbeat(),
        _ => 1,
    }
}

/// 0 if the client's first message is a frame that a decoder with the same key takes.
fn heartbeat() -> i32 {
    let start = Position::new(50.0_f32, 80.0);
    let settings = AutopilotSettings::new(Geodetic::default(), start, 100.0, 30.0);
    let Ok(mut client) = Autopilot::new(settings) else {
        return 2;
    };
    let mut encoder = Encoder::new(client.own());
    let mut decoder = Decoder::in_order();
    let link = LinkSigning {
        key: SigningKey::new([1; 32]),
        link: 0,
        state: SigningState::default(),
    };
    signing::start(&mut decoder, &mut encoder, link);
    let mut buffer = [0; MAX_FRAME];
    let Some(message) = client.poll(Instant::ZERO) else {
        return 3;
    };
    let mut bytes = encoder.encode(&message, &mut buffer);
    let frame = decoder.next_frame(&mut bytes).map(|frame| frame.message());
    if let Some(Ok(message)) = frame {
        client.receive(Instant::ZERO, encoder.own(), &message);
        0
    } else {
        4
    }
}

//! Where the linker finds the memory map, and which policies go into flash.

use std::{env, fs, path::Path, process::exit};

fn main() {
    println!("cargo::rerun-if-changed=memory.x");
    let variable = |name| env::var(name).unwrap_or_else(|_| fail(&format!("{name} is not set")));
    println!(
        "cargo::rustc-link-search={}",
        variable("CARGO_MANIFEST_DIR")
    );
    let out = variable("OUT_DIR");
    let write = |name: &str, bytes: &[u8]| {
        if let Err(error) = fs::write(Path::new(&out).join(name), bytes) {
            fail(&format!("{name}: {error}"));
        }
    };
    let named = |name, what| {
        println!("cargo::rerun-if-env-changed={name}");
        let file = env::var(name).unwrap_or_else(|_| {
            fail(&format!(
                "{name} must name {what}: `cargo xtask firmware build` writes it and sets it"
            ))
        });
        println!("cargo::rerun-if-changed={file}");
        fs::read(&file).unwrap_or_else(|error| fail(&format!("{file}: {error}")))
    };
    for (name, kind) in [
        ("FIRMWARE_ONE_MISSION_POLICY", "one_mission"),
        ("FIRMWARE_ANY_MISSION_POLICY", "any_mission"),
    ] {
        let file = named(name, "a .policy file");
        // The numbers are the file's end: its length says how they lie to the boundaries of words.
        let shift = (4 - file.len() % 4) % 4;
        write(&format!("{kind}.shift"), shift.to_string().as_bytes());
        write(&format!("{kind}.policy"), &file);
    }
    let order = named("FIRMWARE_ORDER", "the order whose mission the bench plans");
    write("planned.order", &order);
}

fn fail(problem: &str) -> ! {
    println!("cargo::error={problem}");
    exit(1)
}

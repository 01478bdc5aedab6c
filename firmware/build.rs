//! Where the linker finds the memory map, and which policy goes into flash.

use std::{env, fs, path::Path, process::exit};

fn main() {
    println!("cargo::rerun-if-changed=memory.x");
    println!("cargo::rerun-if-env-changed=FIRMWARE_POLICY");
    let variable = |name| env::var(name).unwrap_or_else(|_| fail(&format!("{name} is not set")));
    println!(
        "cargo::rustc-link-search={}",
        variable("CARGO_MANIFEST_DIR")
    );
    let policy = env::var("FIRMWARE_POLICY").unwrap_or_else(|_| {
        fail(
            "FIRMWARE_POLICY must name a .policy file: `cargo xtask firmware build` converts the \
             shipped policy and sets it",
        )
    });
    println!("cargo::rerun-if-changed={policy}");
    let out = variable("OUT_DIR");
    let write = |name, bytes: &[u8]| {
        if let Err(error) = fs::write(Path::new(&out).join(name), bytes) {
            fail(&format!("{name}: {error}"));
        }
    };
    let order = env::var("FIRMWARE_ORDER").unwrap_or_else(|_| {
        fail(
            "FIRMWARE_ORDER must name the order whose mission the bench plans: `cargo xtask \
             firmware build` writes it and sets it",
        )
    });
    println!("cargo::rerun-if-env-changed=FIRMWARE_ORDER");
    println!("cargo::rerun-if-changed={order}");
    match fs::read(&order) {
        Ok(frame) => write("planned.order", &frame),
        Err(error) => fail(&format!("{order}: {error}")),
    }
    match fs::read(&policy) {
        // The numbers are the file's end: its length says how they lie to the boundaries of words.
        Ok(file) => {
            write(
                "shift.rs",
                ((4 - file.len() % 4) % 4).to_string().as_bytes(),
            );
            write("trained.policy", &file);
        }
        Err(error) => fail(&format!("{policy}: {error}")),
    }
}

fn fail(problem: &str) -> ! {
    println!("cargo::error={problem}");
    exit(1)
}

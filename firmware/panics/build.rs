//! Where the linker finds the probes' `link.x`.

use std::env;

fn main() {
    println!("cargo::rerun-if-changed=link.x");
    if let Ok(folder) = env::var("CARGO_MANIFEST_DIR") {
        println!("cargo::rustc-link-search={folder}");
    }
}

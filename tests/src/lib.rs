//! What the end-to-end tests share: the real binaries, and folders to run them in.

use std::{
    collections::BTreeSet,
    net::UdpSocket,
    path::{Path, PathBuf},
    process::Command,
    sync::{Mutex, PoisonError},
};

/// The root of the repository.
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// A command that runs one of the workspace's programs, built from the tree as it is now.
///
/// # Panics
/// The program cannot be built.
pub fn program(name: &'static str) -> Command {
    static BUILT: Mutex<BTreeSet<&'static str>> = Mutex::new(BTreeSet::new());
    let mut built = BUILT.lock().unwrap_or_else(PoisonError::into_inner);
    if !built.contains(name) {
        // Cargo gives a test only the binaries of its own package, and these belong to others.
        let cargo = option_env!("CARGO").unwrap_or("cargo");
        let status = Command::new(cargo)
            .args([
                "build",
                "--quiet",
                "--locked",
                "--package",
                name,
                "--bin",
                name,
            ])
            .current_dir(repository())
            .status();
        assert!(
            status.is_ok_and(|status| status.success()),
            "{name} does not build"
        );
        built.insert(name);
    }
    drop(built);
    let mut command = Command::new(folder_of_programs().join(name));
    command.current_dir(repository());
    command
}

/// A port that nobody listened on a moment ago.
///
/// # Panics
/// No port is left on this machine.
pub fn free_port() -> u16 {
    let socket = UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.local_addr());
    socket.map_or_else(|error| panic!("no free port: {error}"), |at| at.port())
}

/// `target/debug`, wherever the target directory is: tests run from its `deps`.
fn folder_of_programs() -> PathBuf {
    let test = std::env::current_exe().unwrap_or_default();
    test.ancestors().nth(2).unwrap_or(Path::new("")).to_owned()
}

//! Capacities of `firmware-core` that do not fit together are refused when a program is compiled, in
//! words that say what to change.

use std::{fs, process::Command};

use end_to_end::repository;

/// The programs in `tests/no-std-link/refused`, and what the compiler says about each.
const REFUSED: [(&str, &str); 7] = [
    ("decoder", "N must be at least `link::frame_max::<T>(M, J)`"),
    (
        "endpoint",
        "the frames of this `link::Endpoint<N>` are too short for M users and J sensors",
    ),
    ("frame_length", "together more than 65,535"),
    ("gain_count", "together more than 65,535"),
    (
        "ground_buffer",
        "it must have at least `link::secure_frame_max::<T>(M, J)` bytes",
    ),
    (
        "handshake_buffer",
        "it must have at least `link::HANDSHAKE_FRAME_MAX` bytes",
    ),
    (
        "onboard",
        "the frames of this `Onboard` are too short for M users and J sensors",
    ),
];

#[test]
fn capacities_that_do_not_fit_together_are_refused_in_words() {
    let package = repository().join("tests/no-std-link");
    let mut listed: Vec<_> = fs::read_dir(package.join("refused"))
        .expect("a directory")
        .map(|entry| entry.expect("an entry").path())
        .filter_map(|path| Some(path.file_stem()?.to_str()?.to_owned()))
        .collect();
    listed.sort();
    assert_eq!(listed, REFUSED.map(|(program, _)| program));
    for (program, words) in REFUSED {
        let output = Command::new(option_env!("CARGO").unwrap_or("cargo"))
            .args(["build", "--locked", "--bin", program])
            // That of `.ci/no-std-link`, where the dependencies are built already.
            .args(["--target-dir", "../../target/no-std-link"])
            .current_dir(&package)
            .output()
            .expect("cargo starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success(), "{program} compiles");
        assert!(said.contains(words), "{program}: {said}");
    }
}

//! The policies that were trained for one mission: those that are shipped, and those of a directory.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::LazyLock,
};

use files::{input, named};
use scenario::Scenario;

/// Embeds policies of `models/cells`: names and contents.
macro_rules! cells {
    ($($name:literal,)*) => {
        [$((
            concat!($name, ".onnx"),
            include_bytes!(concat!("../../../../models/cells/", $name, ".onnx")),
        ),)*]
    };
}

/// The shipped policies: SAC with Table I's settings, each trained for one mission.
static SHIPPED: LazyLock<Vec<(&str, &[u8])>> = LazyLock::new(|| {
    let default: [(&str, &[u8]); 2] = [
        (
            "separated-sac.onnx",
            include_bytes!("../../../../models/separated-sac.onnx"),
        ),
        (
            "mixed-sac.onnx",
            include_bytes!("../../../../models/mixed-sac.onnx"),
        ),
    ];
    let cells: [(&str, &[u8]); CELLS] = cells![
        "mixed-t60-n85-g0.010-sac-paper-s1",
        "mixed-t60-n85-g0.015-sac-paper-s1",
        "mixed-t60-n85-g0.020-sac-paper-s1",
        "mixed-t60-n85-g0.025-sac-paper-s1",
        "mixed-t60-n95-g0.010-sac-paper-s1",
        "mixed-t60-n95-g0.015-sac-paper-s1",
        "mixed-t60-n95-g0.020-sac-paper-s1",
        "mixed-t60-n95-g0.025-sac-paper-s1",
        "separated-t60-n85-g0.010-sac-paper-s1",
        "separated-t60-n85-g0.015-sac-paper-s1",
        "separated-t60-n85-g0.020-sac-paper-s1",
        "separated-t60-n85-g0.025-sac-paper-s1",
        "separated-t60-n95-g0.010-sac-paper-s1",
        "separated-t60-n95-g0.015-sac-paper-s1",
        "separated-t60-n95-g0.020-sac-paper-s1",
        "separated-t60-n95-g0.025-sac-paper-s1",
    ];
    default.into_iter().chain(cells).collect()
});
/// The shipped policy for any mission, as `trainer convert` makes it from `models/any.onnx`: its
/// file's name and content. It flies in builds without tract as well, and loads at once.
pub(super) const FOR_ANY_MISSION: (&str, &[u8]) = (
    "any.policy",
    include_bytes!("../../../../models/any.policy"),
);

/// Returns the `.policy` file of the shipped policy for any mission.
pub fn for_any_mission() -> &'static [u8] {
    FOR_ANY_MISSION.1
}

/// The number of policies for the missions of the paper's figures.
const CELLS: usize = 16;

/// Returns the policy that was trained for the mission of a scenario, if one is shipped: its file's
/// name and content.
pub(super) fn shipped(scenario: &Scenario) -> Option<(&'static str, &'static [u8])> {
    let digest = scenario.digest();
    let found = SHIPPED
        .iter()
        .find(|(_, file)| contains_digest(file, &digest));
    found.copied()
}

/// Returns whether an ONNX file may be a policy for the mission with this digest. The file contains
/// the digest as text. Parsing all files as networks would take a second.
fn contains_digest(file: &[u8], digest: &str) -> bool {
    let mut parts = file.windows(digest.len());
    parts.any(|part| part == digest.as_bytes())
}

/// Returns the policy of a directory that was trained for the mission of a scenario: its file and
/// its content. Among several, the first in the order of the names is taken.
///
/// # Errors
/// Returns a message of one line if the directory or one of its files cannot be read, or if none of
/// them was trained for the mission.
pub(super) fn trained_for(
    folder: &Path,
    scenario: &Scenario,
) -> Result<(PathBuf, Vec<u8>), String> {
    let digest = scenario.digest();
    let entries = fs::read_dir(folder).map_err(|error| named(folder, error))?;
    let mut paths = Vec::new();
    for entry in entries {
        paths.push(entry.map_err(|error| named(folder, error))?.path());
    }
    paths.sort();
    for path in paths {
        if path.extension().is_some_and(|kind| kind == "onnx") {
            let file = input::read(&path).map_err(|error| named(&path, error))?;
            if contains_digest(&file, &digest) {
                return Ok((path, file));
            }
        }
    }
    let problem = format!(
        "no .onnx file in it was trained for the mission {}",
        scenario.name
    );
    Err(named(folder, problem))
}

//! The certified bound that a flight is compared with.

use std::path::Path;

use host_sim::{
    benchmark::{BOUNDS_FILE, Bounds},
    record::CertifiedBound,
};
use planning::bound::BoundSettings;
use scenario::Scenario;

use crate::command::bound::certify_watched;

/// Returns the certified bound of the mission of a scenario file: from the `bounds.csv` beside the
/// scenario file, which is looked up by the digest of the mission, or else computed now.
pub(super) fn certified_bound(scenario: &Scenario, file: &Path) -> Option<CertifiedBound> {
    let folder = file.parent()?;
    let folder = match folder.as_os_str().is_empty() {
        true => Path::new("."),
        false => folder,
    };
    let known = Bounds::read(folder).unwrap_or_else(|problem| {
        eprintln!("warning: {problem}");
        Bounds::default()
    });
    if let Some(record) = known.of(&scenario.digest()) {
        return Some(CertifiedBound {
            upper: record.upper,
            file: Some(folder.join(BOUNDS_FILE).display().to_string()),
        });
    }
    match certify_watched(scenario, &BoundSettings::default(), None) {
        Ok(bound) => Some(CertifiedBound {
            upper: bound.upper,
            file: None,
        }),
        Err(problem) => {
            eprintln!("warning: no certified bound: {problem}");
            None
        }
    }
}

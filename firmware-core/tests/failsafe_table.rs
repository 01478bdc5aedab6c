// SPDX-License-Identifier: MIT OR Apache-2.0
//! The table in `docs/failsafes.md` is that of the code.

use firmware_core::autopilot::failsafe::TABLE;

#[test]
fn the_documented_table_is_the_one_that_flies() {
    let document = include_str!("../../docs/failsafes.md");
    let documented: Vec<&str> = document
        .lines()
        .filter(|line| line.contains("`FAILSAFE "))
        .collect();
    let flown: Vec<String> = TABLE
        .iter()
        .map(|row| {
            let (cause, reaction) = (row.cause, row.reaction);
            format!(
                "| {cause} | {} | {reaction} | {} | `FAILSAFE {cause}: {reaction}` |",
                row.detected, row.ends
            )
        })
        .collect();
    assert_eq!(documented, flown);
}

//! The programs that the trainer's speed is compared with (`trainer/compare/burn`,
//! `.ci/interop/sb3_steps.py`) and the contract of foreign policies (`.ci/interop/contract.py`) have
//! sizes written into them, because they do not use our crates. This test compares these sizes with
//! the interface and with Table I's settings.

use std::{fs, path::Path};

use firmware_core::policy::{OUTPUT_EXTRA, STATE_EXTRA};
use scenario::Scenario;
use trainer::settings::{Algorithm, Preset, TrainingSettings};

/// Returns the value of each constant `name`, as it is written in a file of the repository:
/// `const NAME: TYPE = VALUE;` in Rust, `NAME = VALUE` in Python.
fn constants<const N: usize>(file: &str, names: [&str; N]) -> [String; N] {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(file);
    let text = fs::read_to_string(&path).expect("readable");
    names.map(|name| {
        let value = text.lines().find_map(|line| {
            let (left, right) = line.split_once(" = ")?;
            let left = left.trim_start_matches("const ");
            let defined = left.split(':').next() == Some(name);
            defined.then(|| right.trim_end_matches(';').to_owned())
        });
        value.unwrap_or_else(|| panic!("{file} has no {name}"))
    })
}

fn users() -> usize {
    let scenario = Scenario::shipped("separated").expect("shipped");
    scenario.mission.parameters().users.len()
}

fn table_one() -> TrainingSettings {
    TrainingSettings::preset(Preset::Paper, Algorithm::Sac, 1)
}

#[test]
fn the_gradient_step_of_burn_has_our_sizes() {
    let s = table_one();
    let constants = constants(
        "trainer/compare/burn/src/main.rs",
        [
            "USERS",
            "STATES",
            "HIDDEN",
            "BATCH",
            "RATE",
            "DISCOUNT",
            "TAU",
            "DISPLACEMENT_ENTROPY",
            "USER_ENTROPY_FRACTION",
        ],
    );
    assert_eq!(constants[0], users().to_string());
    assert_eq!(constants[1], format!("USERS + {STATE_EXTRA}"));
    assert_eq!(constants[2], s.hidden.to_string());
    assert_eq!(constants[3], s.batch.to_string());
    let numbers = constants[4..].iter().map(|text| text.parse::<f32>());
    let numbers: Vec<f32> = numbers.map(|number| number.expect("a number")).collect();
    assert_eq!(
        numbers,
        [
            s.policy_learning_rate,
            s.discount,
            s.tau,
            s.displacement_entropy,
            s.user_entropy_fraction
        ]
    );
    assert_eq!(s.critic_learning_rate, s.policy_learning_rate);
    assert_eq!(s.temperature_learning_rate, s.policy_learning_rate);
}

#[test]
fn the_gradient_step_of_stable_baselines_has_our_sizes() {
    let s = table_one();
    let names = ["USERS", "STATES", "ACTION", "HIDDEN", "BATCH"];
    assert_eq!(
        constants(".ci/interop/sb3_steps.py", names),
        [
            users().to_string(),
            format!("USERS + {STATE_EXTRA}"),
            format!("USERS + {OUTPUT_EXTRA}"),
            s.hidden.to_string(),
            s.batch.to_string()
        ]
    );
}

#[test]
fn the_contract_of_foreign_policies_is_for_our_users() {
    let file = ".ci/interop/contract.py";
    let [first] = constants(file, ["USERS, WIDTH, REACH_M"]);
    assert_eq!(first.split(", ").next(), Some(&*users().to_string()));
    let [full_scale] = constants(file, ["FULL_SCALE"]);
    let extra = full_scale
        .split_once("] * USERS + [")
        .map(|(_, rest)| rest.split(',').count());
    assert_eq!(extra, Some(STATE_EXTRA), "{full_scale}");
}

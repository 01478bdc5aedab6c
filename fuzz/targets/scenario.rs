//! The text of a scenario. What is accepted survives being written and read again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use scenario::Scenario;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    match Scenario::parse("fuzzed", text) {
        Ok(scenario) => {
            let again = Scenario::parse("fuzzed", &scenario.to_toml()).expect("our own text");
            assert_eq!(again.digest(), scenario.digest());
        }
        // One line, that says something.
        Err(problem) => assert!(
            !problem.is_empty() && !problem.contains('\n'),
            "{problem:?}"
        ),
    }
});

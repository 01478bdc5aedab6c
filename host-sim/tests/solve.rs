//! Compares `solve` with reference rates from an independent conic solver, and tests lines that are
//! not slot problems.

use std::{
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use firmware_core::{PowerGain, Watt, aircomp};
use reference::solve::{Answer, Method, Precision, Problem, run};
use serde::Deserialize;

/// The known solution of a reference slot.
#[derive(Deserialize)]
struct Known {
    feasible: bool,
    rate: Option<f64>,
}

fn answers(method: Method, precision: Precision, lines: &str) -> Vec<Answer> {
    let mut output = Vec::new();
    let tally = run(method, precision, lines.as_bytes(), &mut output).expect("memory");
    assert_eq!(
        (tally.lines, tally.errors),
        (lines.lines().count() as u64, 0)
    );
    let output = String::from_utf8(output).expect("JSON is UTF-8");
    let parsed = output.lines().map(serde_json::from_str);
    let parsed: Vec<Answer> = parsed.collect::<Result<_, _>>().expect("answers");
    // Callers pair answers with lines: a missing answer must not shorten the comparison.
    assert_eq!(parsed.len(), lines.lines().count());
    parsed
}

/// Returns the MSE and the rate of an answer by the printed formulas, in double precision.
fn recomputed(problem: &Problem, answer: &Answer) -> (f64, f64) {
    let gains: Vec<_> = problem.sensor_gain.iter().copied().map(PowerGain).collect();
    let slot = aircomp::Slot {
        sensor_gains: &gains,
        sensor_coefficients: &answer.sensor_coefficients,
        user_gain: PowerGain(problem.user_gain.unwrap_or(0.0)),
        user_power: Watt(answer.user_power),
        noise_power: Watt(problem.noise_power),
    };
    (slot.mse(answer.eta), slot.rate())
}

/// Checks the product's guarantees on reference slots. The MSE that a single-precision answer
/// contains is rounded; recomputed in double precision, the answer meets the threshold.
fn check_reference(lines: &str) {
    for (precision, rate_tolerance, mse_rounding) in
        [(Precision::F64, 1e-6, 1e-12), (Precision::F32, 2e-4, 4e-6)]
    {
        let answers = answers(Method::Exact, precision, lines);
        let mut worst = (0.0_f64, 0.0_f64);
        for (line, answer) in lines.lines().zip(&answers) {
            let problem: Problem = serde_json::from_str(line).expect("a problem");
            let known: Known = serde_json::from_str(line).expect("a result");
            assert_eq!(answer.feasible, known.feasible, "{line}");
            let (mse, rate) = recomputed(&problem, answer);
            assert!(
                (answer.mse - mse).abs() <= mse_rounding * mse,
                "{answer:?} {line}"
            );

            let power_max = problem.sensor_power_max;
            assert!(
                answer
                    .sensor_coefficients
                    .iter()
                    .all(|b| b * b <= power_max),
                "{line}"
            );
            assert!(answer.user_power <= problem.user_power_max, "{line}");
            match known.rate {
                Some(reference) => {
                    let error = (answer.rate - reference).abs() / reference.max(1e-12);
                    assert!(
                        error <= rate_tolerance,
                        "{} {reference} {line}",
                        answer.rate
                    );
                    assert!(
                        (answer.rate - rate).abs() <= rate_tolerance * rate,
                        "{line}"
                    );
                    let excess = (answer.mse.max(mse)) / problem.mse_threshold - 1.0;
                    assert!(excess <= 1e-9, "{excess} {line}");
                    worst = (worst.0.max(error), worst.1.max(excess));
                }
                None => assert!(answer.least_mse > problem.mse_threshold, "{line}"),
            }
        }
        println!(
            "{precision:?}: rate off by {:e}, MSE over by {:e}",
            worst.0, worst.1
        );
    }
}

#[test]
fn own_reference_slots() {
    check_reference(include_str!("data/slots.jsonl"));
}

/// Applies every method to the same input: the optimum of Clarabel equals that of the closed form,
/// and Alg. 1 is below it by no more than its stopping rule allows.
#[test]
fn every_method_answers_the_reference_slots() {
    let lines = include_str!("data/slots.jsonl");
    let exact = answers(Method::Exact, Precision::F64, lines);
    for (method, fraction) in [(Method::Conic, 1.0 - 1e-7), (Method::Alternating, 0.99)] {
        for (exact, other) in exact.iter().zip(answers(method, Precision::F64, lines)) {
            assert_eq!(exact.feasible, other.feasible);
            assert!(
                other.rate <= exact.rate * (1.0 + 1e-7),
                "{method:?} {other:?}"
            );
            assert!(
                other.rate >= exact.rate * fraction,
                "{method:?} {other:?} {exact:?}"
            );
            assert!((other.least_mse / exact.least_mse - 1.0).abs() < 1e-6);
        }
    }
    assert!(run(Method::Conic, Precision::F32, &b""[..], Vec::new()).is_err());
}

/// The degenerate cases: no sensor received, one that dominates, a single one, a user that is not
/// received, no user served.
#[test]
fn every_method_answers_the_corners() {
    let slot = |sensors: &str, user: &str, threshold: f64| {
        format!(
            r#"{{"sensor_gain":{sensors},"user_gain":{user},"sensor_power_max":0.05,"user_power_max":0.2,"noise_power":3.162e-13,"mse_threshold":{threshold}}}"#
        )
    };
    let lines = [
        slot("[0,0,0]", "1e-11", 0.2),
        slot("[0,1e-10,1e-10,1e-10]", "1e-11", 0.1),
        slot("[1e-6,1e-12,1e-12]", "1e-11", 0.3),
        slot("[1e-10]", "1e-11", 0.5),
        slot("[1e-10]", "1e-11", 0.01),
        slot("[1e-10,2e-10]", "0", 0.3),
        slot("[1e-10,2e-10]", "null", 0.3),
        slot("[1e-10,2e-10]", "1e-20", 0.3),
    ]
    .join("\n");
    let exact = answers(Method::Exact, Precision::F64, &lines);
    let feasible: Vec<bool> = exact.iter().map(|answer| answer.feasible).collect();
    assert_eq!(feasible, [false, true, true, true, false, true, true, true]);
    for method in [Method::Alternating, Method::Conic, Method::ConicAlternating] {
        for (exact, other) in exact.iter().zip(answers(method, Precision::F64, &lines)) {
            assert_eq!(exact.feasible, other.feasible, "{method:?} {other:?}");
            let fraction = if method == Method::Conic { 1e-6 } else { 0.01 };
            let short = exact.rate - other.rate;
            assert!(
                short <= fraction * exact.rate,
                "{method:?} {other:?} {exact:?}"
            );
            assert!(
                -short <= 1e-7 * exact.rate,
                "{method:?} {other:?} {exact:?}"
            );
            assert!(
                (other.least_mse / exact.least_mse - 1.0).abs() < 1e-6,
                "{method:?}"
            );
            if exact.rate == 0.0 {
                assert_eq!(other.user_power, 0.0);
            }
        }
    }
}

/// Returns a file of the reference: it is in a directory next to the repository, or in the directory
/// that `SLOT_REFERENCE` names. `None` if neither exists.
fn reference(name: &str) -> Option<String> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/reference");
    let named = std::env::var_os("SLOT_REFERENCE").map(PathBuf::from);
    let path = named.clone().unwrap_or(beside).join(name);
    match fs::read_to_string(&path) {
        Ok(lines) => Some(lines),
        // Written past the test harness, which would hide it.
        Err(error) if named.is_none() => {
            let _ = writeln!(io::stderr(), "SKIPPED {name}: {}: {error}", path.display());
            None
        }
        Err(error) => panic!("SLOT_REFERENCE: {}: {error}", path.display()),
    }
}

#[test]
fn whole_reference_where_present() {
    if let Some(lines) = reference("inner_cases.jsonl") {
        check_reference(&lines);
    }
}

/// Slots whose channels are known up to errors, solved by somebody else's program.
#[test]
fn whole_reference_with_errors_where_present() {
    let Some(lines) = reference("error_cases.jsonl") else {
        return;
    };
    for (precision, tolerance) in [(Precision::F64, 1e-9), (Precision::F32, 2e-4)] {
        let answers = answers(Method::Exact, precision, &lines);
        assert_eq!(answers.len(), lines.lines().count());
        for (line, answer) in lines.lines().zip(&answers) {
            let known: Known = serde_json::from_str(line).expect("a result");
            assert_eq!(answer.feasible, known.feasible, "{line}");
            if let Some(rate) = known.rate.filter(|_| known.feasible) {
                let error = (answer.rate - rate).abs() / rate;
                assert!(error <= tolerance, "{} {rate} {line}", answer.rate);
            }
        }
    }
}

/// Each input line has one output line; the message contains the name of the field, its value and
/// the valid values.
#[test]
fn bad_lines_are_answered_and_the_rest_go_on() {
    let good = r#"{"sensor_gain":[1e-11,2e-11],"user_gain":1e-11,"sensor_power_max":0.05,"user_power_max":0.2,"noise_power":3e-13,"mse_threshold":0.3}"#;
    let cases: [(&str, String, &[&str]); 23] = [
        (
            "NaN",
            good.replace("2e-11", "NaN"),
            &["line 2, column 23: sensor_gain[1]: expected value"],
        ),
        (
            "infinite",
            good.replace(r#"n":1e-11"#, r#"n":-Infinity"#),
            &["line 2, column", "user_gain: invalid number"],
        ),
        (
            "too large",
            good.replace("2e-11", "1e999"),
            &["sensor_gain[1]: number out of range"],
        ),
        (
            "negative",
            good.replace("2e-11", "-2e-11"),
            &["sensor_gain[1] is -", "at least 0"],
        ),
        (
            "negative user",
            good.replace(r#"n":1e-11"#, r#"n":-1"#),
            &["user_gain is -1,", "at least 0"],
        ),
        (
            "empty",
            good.replace("1e-11,2e-11", ""),
            &["sensor_gain is empty", "at least one"],
        ),
        (
            "text",
            good.replace("0.05", "\"much\""),
            &["sensor_power_max: invalid type: string \"much\", expected f64"],
        ),
        (
            "no array",
            good.replace("[1e-11,2e-11]", "3"),
            &["sensor_gain: invalid type: integer `3`, expected a sequence"],
        ),
        (
            "missing",
            good.replace("noise_power", "noise"),
            &["missing field `noise_power`; a line is a JSON object with"],
        ),
        (
            "no noise",
            good.replace("3e-13", "0"),
            &["noise_power is 0,", "above 0 W"],
        ),
        (
            "loose",
            good.replace(r#""mse_threshold":0.3"#, r#""mse_threshold":0.5"#),
            &["mse_threshold is 0.5,", "below 1/J"],
        ),
        (
            "not JSON",
            "rate = 3".into(),
            &["line 2, column 1: expected value; a line is a JSON object with sensor_gain"],
        ),
        (
            "null",
            good.replace("2e-11", "null"),
            &["sensor_gain[1]: invalid type: null, expected f64"],
        ),
        (
            "a list",
            "[1,2]".into(),
            &["[0]: invalid type: integer `1`"],
        ),
        (
            "twice",
            good.replace("{", r#"{"noise_power":1,"#),
            &["duplicate field `noise_power`"],
        ),
        (
            "two",
            format!("{good} {good}"),
            &[
                "line 2, column",
                "trailing characters; a line holds one object",
            ],
        ),
        (
            "cut",
            good[..40].into(),
            &["line 2, column", "EOF while parsing"],
        ),
        (
            "cut between fields",
            good[..good.len() - 1].into(),
            &["line 2, column", "EOF while parsing"],
        ),
        (
            "comma",
            good.replace("2e-11]", "2e-11,]"),
            &["line 2, column 29: sensor_gain", "trailing comma"],
        ),
        (
            "no comma",
            good.replace("],", "] "),
            &["line 2, column 30: expected `,` or `}`"],
        ),
        (
            "no quotes",
            good.replace("\"user_gain\"", "user_gain"),
            &["line 2, column 30: key must be a string"],
        ),
        (
            "no bracket",
            good.replace("2e-11]", "2e-11"),
            &[
                "line 2, column",
                "sensor_gain[2]: invalid type: string \"user_gain\"",
            ],
        ),
        ("blank", "  ".into(), &["the line is empty", "sensor_gain"]),
    ];
    for precision in [Precision::F64, Precision::F32] {
        for (name, bad, expected) in &cases {
            let input = format!("{good}\n{bad}\n{good}\n");
            let mut output = Vec::new();
            let tally =
                run(Method::Exact, precision, input.as_bytes(), &mut output).expect("memory");
            assert_eq!((tally.lines, tally.errors), (3, 1), "{name}");
            let output = String::from_utf8(output).expect("UTF-8");
            let lines: Vec<serde_json::Value> = output
                .lines()
                .map(|line| serde_json::from_str(line).expect("JSON"))
                .collect();
            assert_eq!(lines.len(), 3, "{name}");
            assert_eq!(lines[0], lines[2]);
            assert_eq!(lines[0]["feasible"], true);
            let error = lines[1]["error"]
                .as_str()
                .unwrap_or_else(|| panic!("{name}: {output}"));
            for part in *expected {
                assert!(error.contains(part), "{name}: {error}");
            }
            // A text of one line has no line number.
            assert!(!error.contains("at line"), "{name}: {error}");
            assert!(error.starts_with("line 2"), "{name}: {error}");
        }
    }
}

const SLOT: &str = r#"{"sensor_gain":[1e-11,2e-11,3e-11],"user_gain":1e-11,"sensor_power_max":0.05,"user_power_max":0.2,"noise_power":3e-13,"mse_threshold":0.2}"#;

/// Returns [`SLOT`] with more fields.
fn slot_with(fields: &str) -> String {
    SLOT.replace("{", &format!("{{{fields},"))
}

fn output(method: Method, precision: Precision, lines: &str) -> String {
    let mut output = Vec::new();
    run(method, precision, lines.as_bytes(), &mut output).expect("memory");
    String::from_utf8(output).expect("UTF-8")
}

/// Statistics that are absent or zero give the same bytes.
#[test]
fn without_errors_the_bytes_are_the_same() {
    let zero =
        r#""sensor_error_variance":0,"sensor_phase_error_rad":[0,0.0,0],"user_error_variance":0"#;
    let reference = include_str!("data/slots.jsonl");
    let with_zeros = reference.replace(
        "{",
        r#"{"sensor_error_variance":0,"user_error_variance":0.0,"#,
    );
    for precision in [Precision::F64, Precision::F32] {
        let known = output(Method::Exact, precision, reference);
        assert_eq!(output(Method::Exact, precision, &with_zeros), known);
    }
    for method in [
        Method::Exact,
        Method::Alternating,
        Method::Conic,
        Method::ConicAlternating,
    ] {
        let known = output(method, Precision::F64, SLOT);
        assert_eq!(
            output(method, Precision::F64, &slot_with(zero)),
            known,
            "{method:?}"
        );
    }
}

/// A number stands for a list of equal numbers, errors cost rate, and every method knows them.
#[test]
fn errors_are_taken_into_account_by_every_method() {
    let number = slot_with(r#""sensor_error_variance":0.05,"sensor_phase_error_rad":0.3"#);
    let list = slot_with(
        r#""sensor_error_variance":[0.05,0.05,0.05],"sensor_phase_error_rad":[0.3,0.3,0.3]"#,
    );
    let user = slot_with(r#""user_error_variance":0.1"#);
    let hopeless = slot_with(r#""sensor_phase_error_rad":1.5"#);
    let lines = [SLOT, &number, &list, &user, &hopeless].join("\n");
    let exact = answers(Method::Exact, Precision::F64, &lines);
    assert_eq!(exact[1], exact[2]);
    assert!(exact[1].rate < exact[0].rate && exact[3].rate < exact[0].rate);
    assert!(exact[1].rate > 0.0 && exact[3].rate > 0.0);
    assert_eq!(exact[4].status, reference::solve::Finding::ErrorFloor);
    assert!(!exact[4].feasible && exact[4].rate == 0.0 && exact[4].least_mse > 0.2);
    assert!((exact[1].mse / 0.2 - 1.0).abs() < 1e-9, "{}", exact[1].mse);
    for method in [Method::Alternating, Method::Conic, Method::ConicAlternating] {
        for (exact, other) in exact.iter().zip(answers(method, Precision::F64, &lines)) {
            assert_eq!(exact.feasible, other.feasible, "{method:?} {other:?}");
            assert!(
                (other.least_mse / exact.least_mse - 1.0).abs() < 1e-6,
                "{method:?} {other:?}"
            );
            let short = exact.rate - other.rate;
            assert!(
                (-1e-7..=0.01).contains(&short),
                "{method:?} {other:?} {exact:?}"
            );
            if !exact.feasible {
                assert_eq!(exact.status, other.status, "{method:?}");
            }
        }
    }
}

/// Statistics that are invalid are named with line, field and value.
#[test]
fn bad_statistics_are_named() {
    let cases: [(&str, &str); 17] = [
        (
            r#""sensor_error_variance":-0.1"#,
            ": sensor_error_variance is -0.1, but must be a finite variance of at least 0",
        ),
        (
            r#""sensor_error_variance":[0,-1e-300,0]"#,
            "sensor_error_variance[1] is -0.000",
        ),
        (
            r#""sensor_error_variance":NaN"#,
            "sensor_error_variance: expected value",
        ),
        (
            r#""sensor_error_variance":[0,NaN,0]"#,
            "sensor_error_variance[1]: expected value",
        ),
        (
            r#""sensor_error_variance":1e999"#,
            "sensor_error_variance: number out of range",
        ),
        (
            r#""sensor_error_variance":[0.1,0.1]"#,
            "sensor_error_variance has 2 numbers, but must be one number or a list of 3",
        ),
        (
            r#""sensor_error_variance":"small""#,
            "sensor_error_variance: invalid type: string \"small\", expected a number or a list",
        ),
        (
            r#""sensor_error_variance":null"#,
            "sensor_error_variance: invalid type: null, expected a number or a list",
        ),
        (
            r#""sensor_error_variance":[0,null,0]"#,
            "sensor_error_variance[1]: invalid type: null",
        ),
        (
            r#""sensor_phase_error_rad":3.2"#,
            ": sensor_phase_error_rad is 3.2, but must be a standard deviation from 0 to pi",
        ),
        (
            r#""sensor_phase_error_rad":[0.1,0.1,-0.1]"#,
            "sensor_phase_error_rad[2] is -0.1,",
        ),
        (
            r#""sensor_phase_error_rad":[]"#,
            "sensor_phase_error_rad has 0 numbers",
        ),
        (
            r#""sensor_phase_error_rad":Infinity"#,
            "sensor_phase_error_rad",
        ),
        (
            r#""user_error_variance":-1"#,
            ": user_error_variance is -1, but must be a finite variance of at least 0",
        ),
        (
            r#""user_error_variance":[0.1]"#,
            "user_error_variance: invalid type: sequence, expected f64",
        ),
        (
            r#""user_error_variance":null"#,
            "user_error_variance: invalid type: null, expected f64",
        ),
        (
            r#""user_error_variance":NaN"#,
            "user_error_variance: expected value",
        ),
    ];
    for precision in [Precision::F64, Precision::F32] {
        for (fields, expected) in cases {
            let input = format!("{SLOT}\n{}\n{SLOT}\n", slot_with(fields));
            let mut written = Vec::new();
            let tally = run(Method::Exact, precision, input.as_bytes(), &mut written);
            let tally = tally.expect("memory");
            assert_eq!((tally.lines, tally.errors), (3, 1), "{fields}");
            let written = String::from_utf8(written).expect("UTF-8");
            let lines: Vec<serde_json::Value> = (written.lines())
                .map(|line| serde_json::from_str(line).expect("JSON"))
                .collect();
            let error = lines[1]["error"].as_str().expect("an error");
            assert!(
                error.starts_with("line 2") && error.contains(expected),
                "{fields}: {error}"
            );
            assert_eq!(lines[0], lines[2]);
        }
    }
}

#[test]
fn bytes_that_are_no_text_cost_one_line() {
    let mut output = Vec::new();
    let tally = run(
        Method::Exact,
        Precision::F64,
        &b"\xff\xfe\n\n{}"[..],
        &mut output,
    )
    .expect("memory");
    assert_eq!((tally.lines, tally.errors), (3, 3));
    let output = String::from_utf8(output).expect("UTF-8");
    assert_eq!(output.lines().count(), 3);
    assert!(output.contains("not UTF-8"), "{output}");
}

/// The byte order mark that some editors write is not part of the first line.
#[test]
fn a_byte_order_mark_is_no_error() {
    let line = r#"{"sensor_gain":[1e-11],"user_gain":null,"sensor_power_max":0.05,"user_power_max":0.2,"noise_power":3e-13,"mse_threshold":0.9}"#;
    let marked = format!("\u{feff}{line}");
    let answer = |line| answers(Method::Exact, Precision::F64, line);
    assert_eq!(answer(&marked), answer(line));
}

/// A value that single precision cannot represent is reported as such, and solved in double
/// precision.
#[test]
fn single_precision_names_what_it_cannot_hold() {
    let line = r#"{"sensor_gain":[1e-11,1e40],"user_gain":1e-11,"sensor_power_max":0.05,"user_power_max":0.2,"noise_power":3e-13,"mse_threshold":0.3}"#;
    let mut output = Vec::new();
    let tally = run(Method::Exact, Precision::F32, line.as_bytes(), &mut output).expect("memory");
    assert_eq!(tally.errors, 1);
    let output = String::from_utf8(output).expect("UTF-8");
    assert!(output.contains("sensor_gain[1] is 1e40"), "{output}");
    let double = answers(Method::Exact, Precision::F64, line);
    assert!(double[0].feasible);
}

/// More sensors than the onboard limit, and no user served.
#[test]
fn the_host_has_no_capacity_limit() {
    let problem = Problem {
        sensor_gain: (1..=5000).map(|j| 1e-12 * f64::from(j)).collect(),
        user_gain: None,
        sensor_power_max: 0.05,
        user_power_max: 0.2,
        noise_power: 3e-13,
        mse_threshold: 0.5 / 5000.0,
        ..Problem::default()
    };
    let mut line = serde_json::to_string(&problem).expect("JSON");
    line.push('\n');
    let silent = answers(Method::Exact, Precision::F64, &line);
    assert!(silent[0].feasible && silent[0].rate == 0.0 && silent[0].user_power == 0.0);
    assert!((silent[0].mse / silent[0].least_mse - 1.0).abs() < 1e-9);
    let served = line.replace("\"user_gain\":null", "\"user_gain\":1e-11");
    let served = answers(Method::Exact, Precision::F64, &served);
    assert_eq!(served[0].sensor_coefficients.len(), 5000);
    assert!(served[0].rate > 0.0);
}

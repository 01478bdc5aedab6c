//! Slot problems as JSON lines: the implementation of `host-sim solve`.
//!
//! An input line contains `sensor_gain` (array, `|h_j|^2`), `user_gain` (`|g|^2`, or `null` if no
//! user is served), `sensor_power_max`, `user_power_max`, `noise_power` (watts) and
//! `mse_threshold`. Where channels are not known exactly it also has `sensor_error_variance`,
//! `sensor_phase_error_rad` and `user_error_variance`: the gains are then estimates, and rate and MSE
//! are the achievable rate and the expected MSE (`docs/mathematics.md`, section 10). Other keys are
//! ignored, so that a line with known results can be replayed. An output line contains the answer,
//! or `{"error": ".."}` with the line's number, the field, its value and what is allowed. There is
//! always exactly one output line per input line. The number of sensors is limited only by the
//! memory.

use std::{
    fmt,
    io::{self, BufRead, Read, Write},
};

use clap::ValueEnum;
use firmware_core::{
    PowerGain, Scalar, Watt, aircomp,
    inner::{
        self, LimitedBy, PrefixSum, SensorField, SlotAllocation, SlotLimits, Status,
        WeightedAmplitude, alternating::AlternatingSettings,
    },
    uncertainty::{SensorUncertainty, SlotUncertainty},
};
use serde::{Deserialize, Serialize};

use files::{PerNode, input::LONGEST_BYTES};

use crate::{
    conic,
    uncertainty::{given, sensor_statistics},
};

/// The method that solves a problem.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Method {
    /// The closed form: the global optimum
    #[default]
    Exact,
    /// The paper's Alg. 1 at its xi = 0.001
    Alternating,
    /// The global optimum by a general convex solver (Clarabel), to check the closed form
    Conic,
    /// Alg. 1 with its subproblem left to the convex solver, as the paper does it
    ConicAlternating,
}

impl Method {
    /// Returns whether the method supports arithmetic of that precision. Clarabel supports only
    /// double precision.
    pub fn supports(self, precision: Precision) -> bool {
        precision == Precision::F64 || matches!(self, Method::Exact | Method::Alternating)
    }
}

/// The arithmetic of the solver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Precision {
    /// Double precision, as on the host
    #[default]
    F64,
    /// Single precision, as on the microcontroller
    F32,
}

/// A slot problem as written in a line.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Problem {
    /// The gain `|h_j|^2` of every sensor.
    pub sensor_gain: Vec<f64>,
    /// The gain `|g|^2` of the served user, or `None` if no user is served.
    pub user_gain: Option<f64>,
    /// The largest power of a sensor, `p_b^max`, watts.
    pub sensor_power_max: f64,
    /// The largest power of the user, `p^max`, watts.
    pub user_power_max: f64,
    /// The noise power `sigma^2`, watts.
    pub noise_power: f64,
    /// The MSE threshold `Gamma`.
    pub mse_threshold: f64,
    /// The variance of each sensor's channel error, relative to its gain; 0 if absent.
    #[serde(
        default,
        deserialize_with = "given",
        skip_serializing_if = "Option::is_none"
    )]
    pub sensor_error_variance: Option<PerNode>,
    /// The standard deviation of the Gaussian phase error of each sensor's signal, rad; 0 if absent.
    #[serde(
        default,
        deserialize_with = "given",
        skip_serializing_if = "Option::is_none"
    )]
    pub sensor_phase_error_rad: Option<PerNode>,
    /// The variance of the user's channel error, relative to its gain; 0 if absent.
    #[serde(
        default,
        deserialize_with = "given",
        skip_serializing_if = "Option::is_none"
    )]
    pub user_error_variance: Option<f64>,
}

/// The answer to a [`Problem`], as written in a line. Numbers of single precision are written to
/// the last digit, so that bounds can be checked exactly.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Whether `Gamma` can be met.
    pub feasible: bool,
    /// The rate `R`, bit/s/Hz, or 0 if infeasible.
    pub rate: f64,
    /// The MSE with the powers, coefficients and `eta` below; where channels are not known exactly, its
    /// expectation.
    pub mse: f64,
    /// The constraint that limits the rate, or `none` if there is no rate.
    pub limited_by: LimitedBy,
    /// The user's power `p`, watts.
    pub user_power: f64,
    /// The coefficients `|b_j|`, square root of watts, in the order of `sensor_gain`.
    pub sensor_coefficients: Vec<f64>,
    /// The normalizing factor `eta`, one over square root of watts.
    pub eta: f64,
    /// The least MSE that the channels allow.
    pub least_mse: f64,
    /// The status of the answer.
    pub status: Finding,
}

/// The status of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Finding {
    /// The answer is the global optimum; for `conic`, to the accuracy of its solver.
    Optimal,
    /// The iteration converged.
    Converged,
    /// The iteration reached its limit.
    IterationLimit,
    /// The gains were known only within bounds.
    Guaranteed,
    /// `Gamma` cannot be met.
    Infeasible,
    /// `Gamma` cannot be met with any power, because the channels are not known well enough.
    ErrorFloor,
    /// The convex solver gave up. The answer is the best point that it had reached, with verified
    /// constraints.
    SolverFailed,
}

/// The number of lines that were processed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// The number of lines read.
    pub lines: u64,
    /// The number of lines that were answered with an error.
    pub errors: u64,
}

/// Answers every line of `input` with a line in `output`.
///
/// # Errors
/// Returns an error if reading or writing fails, or if the method does not support this
/// [precision](Method::supports). An invalid line is not an error: it is answered and counted.
pub fn run(
    method: Method,
    precision: Precision,
    mut input: impl BufRead,
    mut output: impl Write,
) -> anyhow::Result<Tally> {
    anyhow::ensure!(
        method.supports(precision),
        "{method:?} does not support precision {precision:?}"
    );
    let mut tally = Tally::default();
    let mut line = Vec::new();
    while (&mut input)
        .take(LONGEST_BYTES)
        .read_until(b'\n', &mut line)?
        > 0
    {
        tally.lines += 1;
        // A line that is too long ends the input: the rest of it is not read.
        let endless = line.len() as u64 >= LONGEST_BYTES && !line.ends_with(b"\n");
        let problem = if endless {
            let problem = format!("the line is longer than {} MiB", LONGEST_BYTES >> 20);
            Err(LineError::Input(problem))
        } else {
            Problem::parse(&line)
        };
        let answered = problem.and_then(|problem| match precision {
            Precision::F64 => problem.answer::<f64>(method)?.write(&mut output),
            Precision::F32 => problem.answer::<f32>(method)?.write(&mut output),
        });
        match answered {
            Ok(()) => {}
            Err(LineError::Output(error)) => return Err(error.into()),
            Err(error) => {
                tally.errors += 1;
                let error = format!("line {}{error}", tally.lines);
                serde_json::to_writer(&mut output, &serde_json::json!({ "error": error }))?;
            }
        }
        output.write_all(b"\n")?;
        if endless {
            break;
        }
        line.clear();
    }
    output.flush()?;
    Ok(tally)
}

/// The reason why a line has no answer. Its text continues "line 7".
#[derive(Debug, thiserror::Error)]
enum LineError {
    /// The content is wrong.
    #[error(": {0}")]
    Input(String),
    /// The text is not valid JSON or not a [`Problem`] at this column, counted from 1.
    #[error(", column {column}: {problem}")]
    Json { column: usize, problem: String },
    /// The answer could not be written.
    #[error(": {0}")]
    Output(io::Error),
}

impl LineError {
    fn input(problem: impl fmt::Display) -> Self {
        Self::Input(problem.to_string())
    }
}

impl Problem {
    fn parse(line: &[u8]) -> Result<Self, LineError> {
        let text = str::from_utf8(line)
            .map_err(|error| LineError::Input(format!("the line is not UTF-8: {error}")))?
            .trim_start_matches(BYTE_ORDER_MARK)
            .trim_end();
        if text.trim().is_empty() {
            return Err(LineError::Input(format!(
                "the line is empty, but must be {A_PROBLEM}"
            )));
        }
        let mut json = serde_json::Deserializer::from_str(text);
        let problem: Self =
            serde_path_to_error::deserialize(&mut json).map_err(|error| explain(&error))?;
        json.end().map_err(|error| LineError::Json {
            column: error.column(),
            problem: "trailing characters; a line holds one object".into(),
        })?;
        Ok(problem)
    }

    /// Solves the problem in the arithmetic `T`.
    fn answer<T: Scalar>(&self, method: Method) -> Result<Answer, LineError> {
        let rounded = |field: &dyn fmt::Display, value: f64| {
            let number = T::of(value);
            if value.is_finite() && !number.finite() {
                let limit = T::max_value().map_or(f64::MAX, Scalar::to_f64);
                return Err(LineError::Input(format!(
                    "{field} is {value:e}, but the largest number of this precision is {limit:e}"
                )));
            }
            Ok(number)
        };
        // A bound in double precision must hold for the single-precision solution.
        let bound = |field, value| {
            let number: T = rounded(&field, value)?;
            let over = number.finite() && number.to_f64() > value && value > 0.0;
            Ok(Watt(if over { number.next_below() } else { number }))
        };
        let limits = SlotLimits {
            sensor_power_max: bound("sensor_power_max", self.sensor_power_max)?,
            user_power_max: bound("user_power_max", self.user_power_max)?,
            noise_power: Watt(rounded(&"noise_power", self.noise_power)?),
            mse_threshold: rounded(&"mse_threshold", self.mse_threshold)?,
        };
        let sensor_gains = (self.sensor_gain.iter().enumerate())
            .map(|(index, &gain)| {
                rounded(&format_args!("sensor_gain[{index}]"), gain).map(PowerGain)
            })
            .collect::<Result<Vec<_>, _>>()?;
        let user_gain = match self.user_gain {
            Some(gain) => Some(PowerGain(rounded(&"user_gain", gain)?)),
            None => None,
        };
        let statistics = Statistics::of(self)?;
        let uncertainty = match &statistics {
            Some(statistics) => Some(statistics.of_slot()?),
            None => None,
        };
        let (mut amplitude, mut weighted) = (Vec::new(), Vec::new());
        let mut sums = vec![PrefixSum::default(); sensor_gains.len()];
        let field = match &uncertainty {
            None => {
                amplitude.resize(sensor_gains.len(), T::zero());
                SensorField::new(&limits, &sensor_gains, &mut amplitude, &mut sums)
            }
            Some(uncertainty) => {
                weighted.resize(sensor_gains.len(), WeightedAmplitude::default());
                let memory = (&mut weighted[..], &mut sums[..]);
                SensorField::with_uncertainty(&limits, &sensor_gains, uncertainty, memory)
            }
        }
        .map_err(LineError::input)?;
        let amplitude_gains: Vec<T> = sensor_gains.iter().map(|gain| gain.amplitude()).collect();
        let allocation = match method {
            Method::Alternating => inner::Method::Alternating(AlternatingSettings::default()),
            // For the other solvers, too: this checks the user's gain.
            _ => inner::Method::Exact,
        };
        let mut coefficients = vec![T::zero(); amplitude_gains.len()];
        let allocation = field
            .allocate(&allocation, &amplitude_gains, user_gain, &mut coefficients)
            .map_err(LineError::input)?;
        match method {
            Method::Exact | Method::Alternating => {
                Ok(Answer::new(&field, &allocation, coefficients))
            }
            Method::Conic | Method::ConicAlternating => self.answer_by_clarabel(method),
        }
    }

    /// Solves the problem, which has been checked, with Clarabel.
    fn answer_by_clarabel(&self, method: Method) -> Result<Answer, LineError> {
        let limits = SlotLimits {
            sensor_power_max: Watt(self.sensor_power_max),
            user_power_max: Watt(self.user_power_max),
            noise_power: Watt(self.noise_power),
            mse_threshold: self.mse_threshold,
        };
        let gains: Vec<_> = self.sensor_gain.iter().copied().map(PowerGain).collect();
        let user = self.user_gain.map(PowerGain);
        let statistics = Statistics::of(self)?;
        let uncertainty = match &statistics {
            Some(statistics) => Some(statistics.of_slot()?),
            None => None,
        };
        let uncertainty = uncertainty.as_ref();
        let (solution, rested) = if method == Method::Conic {
            let solution = conic::bisect(&limits, &gains, user, uncertainty);
            (solution, Finding::Optimal)
        } else {
            let settings = AlternatingSettings::default();
            (
                conic::alternate(&limits, &gains, user, uncertainty, &settings),
                Finding::Converged,
            )
        };
        let status = match solution.status {
            conic::ConicStatus::Solved => rested,
            conic::ConicStatus::IterationLimit => Finding::IterationLimit,
            conic::ConicStatus::ErrorFloor => Finding::ErrorFloor,
            conic::ConicStatus::Infeasible => Finding::Infeasible,
            conic::ConicStatus::SolverFailed(_) => Finding::SolverFailed,
        };
        let slot = aircomp::Slot {
            sensor_gains: &gains,
            sensor_coefficients: &solution.sensor_coefficients,
            user_gain: user.unwrap_or_default(),
            user_power: Watt(solution.user_power_w),
            noise_power: limits.noise_power,
        };
        let mse = match uncertainty {
            None => slot.mse(solution.normalizing_factor),
            Some(statistics) => slot.expected_mse(statistics, solution.normalizing_factor),
        };
        let feasible = match status {
            Finding::Infeasible | Finding::ErrorFloor => false,
            Finding::SolverFailed => mse <= limits.mse_threshold,
            _ => true,
        };
        Ok(Answer {
            feasible,
            rate: solution.rate,
            mse,
            limited_by: solution.limited_by,
            user_power: solution.user_power_w,
            sensor_coefficients: solution.sensor_coefficients,
            eta: solution.normalizing_factor,
            least_mse: solution.least_mse,
            status,
        })
    }
}

/// The error statistics of a problem in the arithmetic `T`.
#[derive(Clone, Debug)]
struct Statistics<T> {
    sensors: Vec<SensorUncertainty<T>>,
    user_error_variance: T,
}

impl<T: Scalar> Statistics<T> {
    /// Returns the statistics of a problem, or `None` if its channels are known exactly.
    fn of(problem: &Problem) -> Result<Option<Self>, LineError> {
        let variance = problem.sensor_error_variance.as_ref();
        let phase = problem.sensor_phase_error_rad.as_ref();
        if variance.is_none() && phase.is_none() && problem.user_error_variance.is_none() {
            return Ok(None);
        }
        let sensors = problem.sensor_gain.len();
        let user_error_variance = problem.user_error_variance.unwrap_or(0.0);
        // As written: rounded to single precision, a bad value might be a valid one.
        SlotUncertainty::new(&[], user_error_variance).map_err(LineError::input)?;
        Ok(Some(Self {
            sensors: sensor_statistics(sensors, variance, phase).map_err(LineError::Input)?,
            user_error_variance: T::of(user_error_variance),
        }))
    }

    fn of_slot(&self) -> Result<SlotUncertainty<'_, T>, LineError> {
        SlotUncertainty::new(&self.sensors, self.user_error_variance).map_err(LineError::input)
    }
}

impl Answer {
    fn new<T: Scalar>(
        field: &SensorField<'_, T>,
        &SlotAllocation { solution, mse }: &SlotAllocation<T>,
        coefficients: Vec<T>,
    ) -> Self {
        Self {
            feasible: solution.status.is_feasible(),
            rate: solution.rate.to_f64(),
            mse: mse.to_f64(),
            limited_by: solution.status.limited_by(),
            user_power: solution.user_power.0.to_f64(),
            sensor_coefficients: coefficients.into_iter().map(Scalar::to_f64).collect(),
            eta: solution.normalizing_factor.to_f64(),
            least_mse: field.least_mse().to_f64(),
            status: match solution.status {
                Status::Optimal { .. } => Finding::Optimal,
                Status::Converged { .. } => Finding::Converged,
                Status::IterationLimit { .. } => Finding::IterationLimit,
                Status::Guaranteed { .. } => Finding::Guaranteed,
                Status::Infeasible { .. } => Finding::Infeasible,
                Status::ErrorFloor { .. } => Finding::ErrorFloor,
            },
        }
    }

    fn write(&self, output: &mut impl Write) -> Result<(), LineError> {
        serde_json::to_writer(output, self).map_err(|error| LineError::Output(error.into()))
    }
}

/// The byte order mark that some editors write at the beginning of a file.
const BYTE_ORDER_MARK: char = '\u{feff}';
const A_PROBLEM: &str = "a JSON object with sensor_gain, user_gain, sensor_power_max, \
                         user_power_max, noise_power and mse_threshold";

/// Describes why a line is not a [`Problem`]: the field, and the message of serde_json.
fn explain(error: &serde_path_to_error::Error<serde_json::Error>) -> LineError {
    let cause = error.inner();
    let words = cause.to_string();
    // The line number in the message is dropped: serde_json sees a single line, and the caller adds
    // the number within the input.
    let words = words.split(" at line ").next().unwrap_or(&words);
    let path = error.path().to_string();
    // The path ends in `?` if the name of a field was being read.
    let problem = if path == "." || path.contains('?') {
        format!("{words}; a line is {A_PROBLEM}")
    } else {
        format!("{path}: {words}")
    };
    LineError::Json {
        column: cause.column(),
        problem,
    }
}

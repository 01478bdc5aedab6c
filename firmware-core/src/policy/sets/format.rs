// SPDX-License-Identifier: MIT OR Apache-2.0
//! The file of a policy for any mission: format version 2 of `.policy`.

use heapless::String;
use serde::{Deserialize, Serialize};

use super::{
    architecture::Architecture,
    columns::{MISSION_COLUMNS, SENSOR_COLUMNS, SENSORS, USER_COLUMNS, USERS},
    error::{SetsLoadError, SetsWriteError},
    half,
    network::{SetsOutput, SetsWork},
    observation::SetsObservation,
    panel::Weight,
};
use crate::policy::container::{self, PREAMBLE};

/// The format version that this module reads and writes.
pub const FORMAT_VERSION: u16 = 2;

/// How weights are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Precision {
    /// IEEE 754 binary16, two bytes per weight.
    Half,
    /// IEEE 754 binary32, four bytes per weight.
    Single,
}

impl Precision {
    /// Returns the number of bytes per weight.
    pub const fn bytes(self) -> usize {
        match self {
            Self::Half => 2,
            Self::Single => 4,
        }
    }
}

/// The origin of a policy for any mission.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetsProvenance {
    /// The training algorithm.
    pub algorithm: String<16>,
    /// The distribution of the missions that it was trained on, for example `random`.
    pub missions: String<64>,
    /// Episodes of training until this policy.
    pub episodes: u32,
    /// The seed of the training run.
    pub seed: u64,
}

/// The header of a policy file, before the weights.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetsHeader {
    /// The origin of the policy.
    pub provenance: SetsProvenance,
    /// The sizes of the network.
    pub architecture: Architecture,
    /// How weights are stored.
    pub precision: Precision,
    /// The number of columns of mission, user and sensor that the policy observes.
    columns: [u16; 3],
    /// The number of users and of sensors in the test vector.
    test_counts: [u16; 2],
}

impl SetsHeader {
    /// Creates the header of a file with `test` as test vector.
    pub fn new(
        provenance: SetsProvenance,
        architecture: Architecture,
        precision: Precision,
        test: &SetsObservation,
    ) -> Self {
        let count = |count: usize| u16::try_from(count).unwrap_or(u16::MAX);
        Self {
            provenance,
            architecture,
            precision,
            columns: [MISSION_COLUMNS, USER_COLUMNS, SENSOR_COLUMNS].map(count),
            test_counts: [test.user_rows().len(), test.sensor_rows().len()].map(count),
        }
    }

    /// Returns the number of users and sensors in the test vector.
    fn test_counts(&self) -> [usize; 2] {
        self.test_counts.map(usize::from)
    }

    /// Returns the number of bytes of the weights.
    pub(super) fn weight_bytes(&self) -> usize {
        self.architecture.weight_count() * self.precision.bytes()
    }

    /// Returns the number of bytes of the test vector.
    fn test_bytes(&self) -> usize {
        let [users, sensors] = self.test_counts();
        4 * (MISSION_COLUMNS + (USER_COLUMNS + 1) * users + SENSOR_COLUMNS * sensors + 2)
    }

    fn check(&self) -> Result<(), SetsLoadError> {
        let expected = [MISSION_COLUMNS, USER_COLUMNS, SENSOR_COLUMNS];
        let whats = ["mission", "user", "sensor"];
        for ((what, got), expected) in whats.into_iter().zip(self.columns).zip(expected) {
            if usize::from(got) != expected {
                return Err(SetsLoadError::Columns {
                    what,
                    got,
                    expected,
                });
            }
        }
        self.architecture.check()?;
        let most = [("users", USERS), ("sensors", SENSORS)];
        for ((what, most), got) in most.into_iter().zip(self.test_counts) {
            if got == 0 || usize::from(got) > most {
                return Err(SetsLoadError::TestVector { what, got, most });
            }
        }
        Ok(())
    }

    /// Evaluates the network with the weights of a file. `None` means that they do not fit the
    /// header.
    pub(super) fn evaluate(
        &self,
        weights: &[u8],
        observation: &SetsObservation,
        work: &mut SetsWork,
    ) -> Option<SetsOutput> {
        let architecture = &self.architecture;
        match self.precision {
            Precision::Half => work.evaluate(architecture, weights.as_chunks::<2>().0, observation),
            Precision::Single => {
                work.evaluate(architecture, weights.as_chunks::<4>().0, observation)
            }
        }
    }

    /// Checks that all weights are finite.
    fn check_weights(&self, weights: &[u8]) -> Result<(), SetsLoadError> {
        fn first_invalid<W: Weight>(weights: &[W]) -> Option<usize> {
            weights.iter().position(|weight| !weight.is_finite())
        }
        let invalid = match self.precision {
            Precision::Half => first_invalid(weights.as_chunks::<2>().0),
            Precision::Single => first_invalid(weights.as_chunks::<4>().0),
        };
        let what = "weight";
        invalid.map_or(Ok(()), |index| {
            Err(SetsLoadError::NotFinite { what, index })
        })
    }

    /// Reads the test vector: the observation, and the bytes of the outputs that it must give.
    fn test_vector<'a>(
        &self,
        test: &'a [u8],
    ) -> Result<(SetsObservation, &'a [u8]), SetsLoadError> {
        let mut numbers = container::floats(test);
        if let Some(index) = numbers.clone().position(|x| !x.is_finite()) {
            let what = "test number";
            return Err(SetsLoadError::NotFinite { what, index });
        }
        let [user_count, sensor_count] = self.test_counts();
        let observation = SetsObservation::of_columns([user_count, sensor_count], &mut numbers);
        let outputs = 4 * (2 + user_count);
        let expected = test
            .len()
            .checked_sub(outputs)
            .and_then(|at| test.get(at..));
        let value = observation.reach_m();
        if value > 0.0 {
            Ok((observation, expected.unwrap_or(&[])))
        } else {
            Err(SetsLoadError::Reach { value })
        }
    }
}

/// Checks a file, including its test vector, and returns its header and where the weights begin.
pub(super) fn read(file: &[u8], work: &mut SetsWork) -> Result<(SetsHeader, usize), SetsLoadError> {
    let body = container::open(file, FORMAT_VERSION)?;
    let (header, numbers): (SetsHeader, &[u8]) =
        postcard::take_from_bytes(body).map_err(|_| SetsLoadError::Header)?;
    header.check()?;
    let (got, expected) = (numbers.len(), header.weight_bytes() + header.test_bytes());
    let length = SetsLoadError::Length { got, expected };
    if got != expected {
        return Err(length);
    }
    let (weights, test) = numbers
        .split_at_checked(header.weight_bytes())
        .ok_or(length)?;
    header.check_weights(weights)?;
    let (observation, expected) = header.test_vector(test)?;
    let output = header.evaluate(weights, &observation, work).ok_or(length)?;
    output.check(&observation, container::floats(expected))?;
    Ok((header, file.len() - numbers.len()))
}

/// Writes a policy file into `file` and returns its length. The weights are in the order of the
/// [module's](super) table; they are rounded to the header's precision, and the outputs for the test
/// vector `test` are those of the rounded weights.
///
/// # Errors
/// Returns an error if the header is invalid or not for this test vector, if the number of weights is
/// wrong or one is not finite in this precision, or if the buffer is too small.
pub fn write(
    header: &SetsHeader,
    weights: impl ExactSizeIterator<Item = f32>,
    test: &SetsObservation,
    work: &mut SetsWork,
    file: &mut [u8],
) -> Result<usize, SetsWriteError> {
    header.check()?;
    let (got, expected) = (
        weights.len() * header.precision.bytes(),
        header.weight_bytes(),
    );
    let length = SetsLoadError::Length { got, expected };
    if got != expected {
        return Err(length.into());
    }
    let too_long = SetsWriteError::TooLong {
        capacity: file.len(),
    };
    let (_, body) = file.split_at_mut_checked(PREAMBLE).ok_or(too_long)?;
    let head = postcard::to_slice(header, body)
        .map_err(|_| too_long)?
        .len();
    let numbers = body.get_mut(head..).ok_or(too_long)?;
    let (stored, rest) = numbers.split_at_mut_checked(expected).ok_or(too_long)?;
    match header.precision {
        Precision::Half => {
            for (bytes, weight) in stored.as_chunks_mut::<2>().0.iter_mut().zip(weights) {
                *bytes = half::from_single(weight).to_le_bytes();
            }
        }
        Precision::Single => {
            for (bytes, weight) in stored.as_chunks_mut::<4>().0.iter_mut().zip(weights) {
                *bytes = weight.to_le_bytes();
            }
        }
    }
    header.check_weights(stored)?;
    let output = header.evaluate(stored, test, work).ok_or(length)?;
    let columns = test.mission.iter().chain(test.user_rows().iter().flatten());
    let columns = columns.chain(test.sensor_rows().iter().flatten()).copied();
    let outputs = output.numbers().take(2 + test.user_rows().len());
    let vector = rest.get_mut(..header.test_bytes()).ok_or(too_long)?;
    let (words, _) = vector.as_chunks_mut::<4>();
    for (bytes, number) in words.iter_mut().zip(columns.chain(outputs)) {
        *bytes = number.to_le_bytes();
    }
    // The last check: also that the test vector has the counts of the header.
    let length = PREAMBLE + head + expected + header.test_bytes();
    let file = file.get_mut(..length).ok_or(too_long)?;
    container::seal(file, FORMAT_VERSION).ok_or(too_long)?;
    read(file, work)?;
    Ok(length)
}

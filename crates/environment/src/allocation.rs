//! `--inner`: the method that allocates the powers of a slot in a flight.

use std::{fmt, str::FromStr};

use firmware_core::{
    Mission, Scalar, Watt,
    inner::{Method, alternating},
};

use serde::{Deserialize, Serialize};

use scenario::HostMission;

/// A method as written on the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Allocation {
    /// The global optimum in closed form.
    #[default]
    Exact,
    /// The paper's Alg. 1 at its `xi = 0.001`.
    Alternating,
    /// The paper's comparison scheme: users send with this power, watts, or not at all; with
    /// `None` it is the scenario's largest. The paper gives no value.
    FixedUserPower(Option<f64>),
    /// The paper's comparison scheme: sensors send with this power, watts; with `None` it is the
    /// scenario's largest. The paper gives no value.
    FixedSensorPower(Option<f64>),
}

impl Allocation {
    /// Checks that fixed powers are within the mission's limits.
    ///
    /// # Errors
    /// Returns a message with the power and its limit if the power is above it.
    pub fn check(self, mission: &HostMission) -> Result<(), String> {
        let p = mission.parameters();
        let (power, limit, what) = match self {
            Self::FixedUserPower(Some(power)) => (power, p.user_power_max.0, "users.power_max_w"),
            Self::FixedSensorPower(Some(power)) => {
                (power, p.sensor_power_max.0, "aircomp.sensor_power_max_w")
            }
            _ => return Ok(()),
        };
        if power <= limit {
            return Ok(());
        }
        Err(format!(
            "--inner {self}: {power} W is above {what} = {limit} W"
        ))
    }

    /// Returns the method for a mission.
    pub fn method<T: Scalar, const M: usize, const J: usize>(
        self,
        mission: &Mission<T, M, J>,
    ) -> Method<T> {
        let p = mission.parameters();
        match self {
            Self::Exact => Method::Exact,
            Self::Alternating => Method::Alternating(alternating::AlternatingSettings::default()),
            Self::FixedUserPower(power) => {
                Method::FixedUserPower(power.map_or(p.user_power_max, |watts| Watt(T::of(watts))))
            }
            Self::FixedSensorPower(power) => Method::FixedSensorPower(
                power.map_or(p.sensor_power_max, |watts| Watt(T::of(watts))),
            ),
        }
    }
}

impl FromStr for Allocation {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, power) = match text.split_once(':') {
            Some((name, power)) => match power.parse::<f64>() {
                Ok(watts) if watts.is_finite() && watts > 0.0 => (name, Some(watts)),
                _ => {
                    return Err(format!(
                        "the power is `{power}`, but must be a number of watts above 0"
                    ));
                }
            },
            None => (text, None),
        };
        match (name, power) {
            ("exact", None) => Ok(Self::Exact),
            ("alternating", None) => Ok(Self::Alternating),
            ("fixed-user-power", power) => Ok(Self::FixedUserPower(power)),
            ("fixed-sensor-power", power) => Ok(Self::FixedSensorPower(power)),
            _ => Err("must be exact, alternating, fixed-user-power[:WATTS] or \
                      fixed-sensor-power[:WATTS]"
                .into()),
        }
    }
}

impl TryFrom<String> for Allocation {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Allocation> for String {
    fn from(allocation: Allocation) -> Self {
        allocation.to_string()
    }
}

impl fmt::Display for Allocation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (name, power) = match self {
            Self::Exact => ("exact", None),
            Self::Alternating => ("alternating", None),
            Self::FixedUserPower(power) => ("fixed-user-power", *power),
            Self::FixedSensorPower(power) => ("fixed-sensor-power", *power),
        };
        match power {
            Some(watts) => write!(f, "{name}:{watts}"),
            None => f.write_str(name),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_are_read_as_they_are_written() {
        for text in [
            "exact",
            "alternating",
            "fixed-user-power",
            "fixed-user-power:0.05",
            "fixed-sensor-power:0.01",
        ] {
            assert_eq!(text.parse::<Allocation>().expect(text).to_string(), text);
        }
        for bad in [
            "",
            "conic",
            "exact:1",
            "fixed-user-power:",
            "fixed-user-power:-1",
            "fixed-sensor-power:NaN",
        ] {
            assert!(bad.parse::<Allocation>().is_err(), "{bad}");
        }
    }
}

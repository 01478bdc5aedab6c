//! The choice of a policy on the command line.

use std::{
    fmt, fs, io,
    path::{Path, PathBuf},
    str::FromStr,
    time::Duration,
};

/// A policy as selected on the command line.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum PolicyChoice {
    /// The trained policy that is shipped for the mission (SAC with Table I's settings), or the
    /// onboard planner for other missions and in builds without the feature `onnx`.
    #[default]
    Shipped,
    /// Flies straight to the destination and serves the nearest user.
    StraightLine,
    /// Hovers over the centre of all nodes and serves the nearest user.
    Fixed,
    /// The near-optimal mission that `host-sim bound` finds, computed before take-off.
    Search,
    /// The onboard planner, which plans before take-off and re-plans in flight.
    Plan,
    /// The plan that [`PolicyChoice::Plan`] has before take-off, after at most this time, flown as it
    /// is: nothing is re-planned or improved in flight.
    PlanOnce(Option<Duration>),
    /// The trained policy that is shipped for any mission.
    Any,
    /// A trained policy.
    File(PathBuf),
    /// A directory with `.onnx` files: the policy among them that was trained for the mission.
    Trained(PathBuf),
    /// A file with planned waypoints: see [`planning::waypoint_file`].
    Waypoints(PathBuf),
}

impl FromStr for PolicyChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "shipped" => Ok(Self::Shipped),
            "straight-line" => Ok(Self::StraightLine),
            "fixed" => Ok(Self::Fixed),
            "search" => Ok(Self::Search),
            "plan" => Ok(Self::Plan),
            "any" => Ok(Self::Any),
            "plan-once" => Ok(Self::PlanOnce(None)),
            _ => {
                if let Some(seconds) = text.strip_prefix("plan-once:") {
                    return planning_time(seconds).map(|time| Self::PlanOnce(Some(time)));
                }
                let path = PathBuf::from(text);
                match path.extension().and_then(|extension| extension.to_str()) {
                    Some("onnx" | "policy") => Ok(Self::File(path)),
                    Some("csv" | "plan") => Ok(Self::Waypoints(path)),
                    _ if path.is_dir() => Ok(Self::Trained(path)),
                    _ => Err(
                        "must be shipped, plan, plan-once, plan-once:SECONDS, any, straight-line, fixed, \
                         search, a file that ends in .onnx, .policy, .csv or .plan, or a directory of .onnx files"
                            .into(),
                    ),
                }
            }
        }
    }
}

/// Reads the time that planning may take.
fn planning_time(text: &str) -> Result<Duration, String> {
    let seconds: Option<f64> = text.parse().ok();
    let seconds = seconds.filter(|seconds| (0.0..=3600.0).contains(seconds));
    let time = seconds.map(Duration::from_secs_f64);
    time.ok_or_else(|| format!("the time of planning is {text}, but must be 0 to 3600 seconds"))
}

impl fmt::Display for PolicyChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Shipped => f.write_str("shipped"),
            Self::StraightLine => f.write_str("straight-line"),
            Self::Fixed => f.write_str("fixed"),
            Self::Search => f.write_str("search"),
            Self::Plan => f.write_str("plan"),
            Self::Any => f.write_str("any"),
            Self::PlanOnce(None) => f.write_str("plan-once"),
            Self::PlanOnce(Some(time)) => write!(f, "plan-once:{}", time.as_secs_f64()),
            // Records contain only the file's name, because its directory does not affect its decisions.
            Self::File(path) | Self::Waypoints(path) | Self::Trained(path) => {
                match path.file_name() {
                    Some(name) => name.to_string_lossy().fmt(f),
                    None => path.display().fmt(f),
                }
            }
        }
    }
}

impl PolicyChoice {
    /// Checks that the file or directory of the policy exists. A benchmark does so before it flies:
    /// otherwise each mission would count as one that the policy does not fit.
    ///
    /// # Errors
    /// Returns the path, and why it cannot be opened.
    pub fn check_path(&self) -> Result<(), (&Path, io::Error)> {
        match self {
            Self::File(path) | Self::Trained(path) | Self::Waypoints(path) => {
                fs::metadata(path).map_err(|error| (path.as_path(), error))?;
                Ok(())
            }
            _ => Ok(()),
        }
    }
}

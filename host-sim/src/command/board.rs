//! Which controller flies: ours, a board's, or a board's twin in this process.

use std::{path::Path, str::FromStr, sync::Arc};

use clap::{Args, ValueEnum};
use files::input;
use firmware_core::console::{Footprint, PolicyKind};
use host_sim::{
    flight::computer::{Image, Twin, order},
    policy::PolicyChoice,
};
use link::HostPort;
use scenario::Scenario;
use vehicle::Profile;

use super::Failure;

/// Where the controller is.
#[derive(Clone, Debug, PartialEq, Eq)]
enum ControllerChoice {
    InProcess,
    Tcp(HostPort),
}

impl FromStr for ControllerChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "in-process" {
            return Ok(Self::InProcess);
        }
        let to = text
            .strip_prefix("tcp:")
            .ok_or("must be in-process or tcp:HOST:PORT")?;
        Ok(Self::Tcp(to.parse()?))
    }
}

/// The controller's number type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Precision {
    /// Double, as on a host.
    F64,
    /// Single, as on a board.
    F32,
}

/// Which controller flies.
#[derive(Clone, Debug, Args)]
pub(crate) struct BoardChoice {
    /// Where the controller is: in-process, or tcp:HOST:PORT for a board (docs/target.md) whose
    /// ground link is at PORT, MAVLink at PORT + 1 and console at PORT + 2. It flies the policy in
    /// its flash, or --policy straight-line
    #[arg(long, default_value = "in-process", value_name = "WHERE")]
    controller: ControllerChoice,
    /// The controller's numbers: f64, or f32 as a board's are (with --policy F.policy or
    /// straight-line); a board's own are always f32
    #[arg(long, default_value = "f64")]
    precision: Precision,
}

/// A board that has its order.
pub(super) enum OpenBoard {
    /// At the other end of three connections.
    Image(Box<Image>),
    /// In this process.
    Twin(Box<Twin>),
}

impl BoardChoice {
    /// Whether it is not the ordinary controller.
    pub(super) fn is_asked_for(&self) -> bool {
        self.controller != ControllerChoice::InProcess || self.precision == Precision::F32
    }

    /// Gives the order.
    pub(super) fn open(
        &self,
        scenario: &Scenario,
        (policy, profile): (&PolicyChoice, Profile),
    ) -> Result<OpenBoard, Failure> {
        let ordered = |policy_kind| order(scenario, profile, policy_kind);
        match (&self.controller, policy) {
            (ControllerChoice::Tcp(to), PolicyChoice::Shipped | PolicyChoice::StraightLine) => {
                let policy_kind = match policy {
                    PolicyChoice::Shipped => PolicyKind::Trained,
                    _ => PolicyKind::StraightLine,
                };
                let image = Image::connect(to, &ordered(policy_kind)).map_err(Failure::failed)?;
                Ok(OpenBoard::Image(Box::new(image)))
            }
            (ControllerChoice::Tcp(_), other) => Err(Failure::bad_input(format!(
                "--policy {other}: a board flies the policy in its flash (leave --policy out) or \
                 straight-line"
            ))),
            (ControllerChoice::InProcess, PolicyChoice::StraightLine) => {
                twin(&ordered(PolicyKind::StraightLine), None)
            }
            (ControllerChoice::InProcess, PolicyChoice::File(path)) if is_policy(path) => {
                let named = |error| Failure::bad_input(format!("{}: {error}", path.display()));
                twin(
                    &ordered(PolicyKind::Trained),
                    Some(input::read(path).map_err(named)?.into()),
                )
            }
            (ControllerChoice::InProcess, other) => Err(Failure::bad_input(format!(
                "--policy {other}: --precision f32 flies straight-line or a .policy file \
                 (`trainer convert F.onnx F.policy`)"
            ))),
        }
    }
}

fn is_policy(path: &Path) -> bool {
    path.extension().is_some_and(|kind| kind == "policy")
}

fn twin(
    order: &firmware_core::console::MissionOrder,
    policy: Option<Arc<[u8]>>,
) -> Result<OpenBoard, Failure> {
    let twin = Twin::new(order, policy).map_err(Failure::bad_input)?;
    Ok(OpenBoard::Twin(Box::new(twin)))
}

/// A board's memory, in one line for people and scripts.
pub(super) fn footprint_in_words(footprint: &Footprint) -> String {
    format!(
        "board: {} B of stack at most, of them {} B the controller; {} bytes lost, {} frames unsent",
        footprint.stack_bytes,
        footprint.computer_bytes,
        footprint.lost_bytes,
        footprint.unsent_frames
    )
}

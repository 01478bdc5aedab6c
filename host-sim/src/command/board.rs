//! The choice of the controller: in this process, on a board, or the board's controller (f32) in this
//! process; and the key of its ground link.

use std::{path::Path, str::FromStr, sync::Arc};

use clap::{Args, ValueEnum};
use files::input;
use firmware_core::{
    autopilot::wire::signing::LinkSigning,
    console::{Footprint, MavlinkKey, MissionOrder, PolicyKind},
    link::Credentials,
};
use host_sim::{
    flight::computer::{Image, OnboardComputer, Twin, check_order, order},
    policy::{PolicyChoice, for_any_mission},
};
use link::{HostPort, key};
use scenario::Scenario;
use vehicle::Profile;

use super::Failure;

/// The place where the controller runs.
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

/// The scalar type of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Precision {
    /// Double precision
    F64,
    /// Single precision, as on a board
    F32,
}

/// The options that select the controller.
#[derive(Clone, Debug, Args)]
pub(crate) struct BoardChoice {
    /// Where the controller runs: in-process, or tcp:HOST:PORT for a board (docs/target.md) that has
    /// its ground link at PORT, MAVLink at PORT + 1 and its console at PORT + 2. A board flies the
    /// policy in its flash memory (with --policy any it must be for any mission), or plan or
    /// straight-line if --policy says so
    #[arg(long, default_value = "in-process", value_name = "WHERE")]
    controller: ControllerChoice,
    /// Floating-point precision of the in-process controller: f64, or f32 as on a board (only with
    /// --policy F.policy, any, plan or straight-line). A board always computes in f32
    #[arg(long, default_value = "f64")]
    precision: Precision,
}

/// The credentials of both ends of the ground link, which start now; `None` leaves it open.
#[derive(Clone, Debug, Default)]
pub(super) struct GroundLink {
    pub(super) vehicle: Option<Credentials>,
    pub(super) ground: Option<Credentials>,
}

impl GroundLink {
    /// Reads the key file of `--ground-key`.
    pub(super) fn of(file: Option<&Path>) -> Result<Self, Failure> {
        let Some(file) = file else {
            return Ok(Self::default());
        };
        let key = key::read_ground(file).map_err(Failure::bad_input)?;
        let credentials = || key::credentials(&key).map_err(Failure::failed);
        Ok(Self {
            vehicle: Some(credentials()?),
            ground: Some(credentials()?),
        })
    }
}

/// The keys of a board's links.
#[derive(Clone, Copy, Debug)]
pub(super) struct BoardKeys<'a> {
    pub(super) ground_link: Option<&'a Credentials>,
    pub(super) mavlink: Option<&'a LinkSigning>,
}

/// A controller that has received its mission order.
pub(super) enum OpenBoard {
    /// A board, connected by three TCP connections.
    Image(Box<Image>),
    /// The board's controller in this process.
    Twin(Box<Twin>),
}

impl BoardChoice {
    /// Returns whether anything but the default controller (in-process, f64) is selected.
    pub(super) fn is_selected(&self) -> bool {
        self.controller != ControllerChoice::InProcess || self.precision == Precision::F32
    }

    /// Connects to the board, or starts its controller in this process, and gives it the mission order.
    pub(super) fn open(
        &self,
        scenario: &Scenario,
        (policy, profile): (&PolicyChoice, Profile),
        keys: BoardKeys<'_>,
    ) -> Result<OpenBoard, Failure> {
        check_order(scenario).map_err(Failure::bad_input)?;
        let ordered = |policy_kind| MissionOrder {
            ground_link: keys.ground_link.cloned(),
            mavlink_key: keys.mavlink.cloned().map(MavlinkKey::from),
            ..order(scenario, profile, policy_kind)
        };
        match (&self.controller, policy) {
            (
                ControllerChoice::Tcp(to),
                PolicyChoice::Shipped
                | PolicyChoice::Any
                | PolicyChoice::StraightLine
                | PolicyChoice::Plan,
            ) => {
                let policy_kind = match policy {
                    PolicyChoice::Shipped | PolicyChoice::Any => PolicyKind::Trained,
                    PolicyChoice::Plan => PolicyKind::Plan,
                    _ => PolicyKind::StraightLine,
                };
                let image = Image::connect(to, &ordered(policy_kind)).map_err(Failure::failed)?;
                if *policy == PolicyChoice::Any && image.scenario_digest().is_some() {
                    return Err(Failure::bad_input(
                        "--policy any: the policy in the board's flash memory is for one mission; \
                         `cargo xtask firmware build` also builds an image with the policy for any",
                    ));
                }
                Ok(OpenBoard::Image(Box::new(image)))
            }
            (ControllerChoice::Tcp(_), other) => Err(Failure::bad_input(format!(
                "--policy {other} cannot be used with a board: omit --policy to fly the policy in its \
                 flash memory, or use --policy plan or --policy straight-line"
            ))),
            (ControllerChoice::InProcess, PolicyChoice::StraightLine) => {
                twin(&ordered(PolicyKind::StraightLine), None)
            }
            (ControllerChoice::InProcess, PolicyChoice::Plan) => {
                twin(&ordered(PolicyKind::Plan), None)
            }
            (ControllerChoice::InProcess, PolicyChoice::Any) => {
                let policy = Arc::from(for_any_mission());
                twin(&ordered(PolicyKind::Trained), Some(policy))
            }
            (ControllerChoice::InProcess, PolicyChoice::File(path)) if is_policy(path) => {
                let named = |error| Failure::bad_input(format!("{}: {error}", path.display()));
                twin(
                    &ordered(PolicyKind::Trained),
                    Some(input::read(path).map_err(named)?.into()),
                )
            }
            (ControllerChoice::InProcess, other) => Err(Failure::bad_input(format!(
                "--policy {other} cannot be used with --precision f32: use any, plan, straight-line \
                 or a .policy file (`trainer convert F.onnx F.policy` writes one)"
            ))),
        }
    }
}

fn is_policy(path: &Path) -> bool {
    path.extension().is_some_and(|kind| kind == "policy")
}

fn twin(order: &MissionOrder, policy: Option<Arc<[u8]>>) -> Result<OpenBoard, Failure> {
    let twin = Twin::new(order, policy).map_err(Failure::bad_input)?;
    Ok(OpenBoard::Twin(Box::new(twin)))
}

/// Formats the memory use and the counters of a board as one line.
pub(super) fn footprint_line(footprint: &Footprint) -> String {
    format!(
        "board: at most {} B of stack used, {} B of it by the controller; {} bytes lost, {} frames \
         unsent",
        footprint.stack_bytes,
        footprint.computer_bytes,
        footprint.lost_bytes,
        footprint.unsent_frames
    )
}

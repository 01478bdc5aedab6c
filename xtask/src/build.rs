//! Builds the images around trained policies.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use firmware_core::policy::{format_version, mlp, sets};

use crate::{
    elf, order,
    tools::{Compiler, TARGET},
};

/// The shipped policy for one mission that is built into an image by default.
const FOR_ONE_MISSION: &str = "models/separated-sac.onnx";
/// The shipped policy for any mission.
const FOR_ANY_MISSION: &str = "models/any.policy";

/// The options of the build.
#[derive(Clone, Debug, Args)]
pub(crate) struct BuildArguments {
    /// The policy: any (the shipped policy for any mission), an .onnx file, or a .policy file from
    /// `trainer convert`. The other of the two images that are built, one with a policy for one
    /// mission and one with a policy for any, has the shipped policy
    #[arg(long, default_value = FOR_ONE_MISSION, value_name = "POLICY")]
    pub(crate) policy: PathBuf,
    /// Path of a host-sim program [default: it is built as by `cargo build --release`]
    #[arg(long, value_name = "FILE")]
    pub(crate) host_sim: Option<PathBuf>,
}

/// An image that flies.
#[derive(Debug)]
pub(crate) struct Controller {
    /// The file of the image.
    pub(crate) image: PathBuf,
    /// The policy in it.
    pub(crate) policy: PathBuf,
}

/// The result of a build.
#[derive(Debug)]
pub(crate) struct Images {
    /// The image with a policy for one mission.
    pub(crate) one_mission: Controller,
    /// The image with a policy for any mission.
    pub(crate) any_mission: Controller,
    /// Whether `--policy` is in the latter.
    is_for_any: bool,
    /// The image that measures the parts of a slot.
    pub(crate) bench: PathBuf,
    /// The image that measures received bytes.
    pub(crate) bench_bytes: PathBuf,
    /// The image that measures the planner.
    pub(crate) bench_planner: PathBuf,
    /// The image that measures the policy for any mission.
    pub(crate) bench_sets: PathBuf,
}

impl Images {
    /// Returns the image with the policy that `--policy` names.
    pub(crate) fn chosen(&self) -> &Controller {
        if self.is_for_any {
            &self.any_mission
        } else {
            &self.one_mission
        }
    }
}

/// Returns the output directory.
pub(crate) fn folder(root: &Path) -> PathBuf {
    root.join("target/firmware")
}

/// Builds the images.
pub(crate) fn run(root: &Path, arguments: &BuildArguments) -> Result<Images> {
    let compiler = Compiler::find(root)?;
    let folder = folder(root);
    fs::create_dir_all(&folder)?;
    let policy = converted(root, &arguments.policy, "chosen.policy")?;
    let is_for_any = is_for_any_mission(&policy)?;
    let [one_mission, any_mission] = if is_for_any {
        [
            converted(root, Path::new(FOR_ONE_MISSION), "shipped.policy")?,
            policy,
        ]
    } else {
        [policy, root.join(FOR_ANY_MISSION)]
    };
    let planned = folder.join("planned.order");
    order::write(&planned)?;
    let mut cargo = cargo();
    cargo
        .args(["build", "--release", "--locked"])
        .current_dir(root.join("firmware"))
        .env("CARGO_TARGET_DIR", &folder)
        .env("FIRMWARE_ONE_MISSION_POLICY", &one_mission)
        .env("FIRMWARE_ANY_MISSION_POLICY", &any_mission)
        .env("FIRMWARE_ORDER", &planned);
    compiler.prepare(&mut cargo);
    complete(&mut cargo)?;
    let built = folder.join(TARGET).join("release");
    let images = Images {
        one_mission: Controller {
            image: built.join("controller"),
            policy: one_mission,
        },
        any_mission: Controller {
            image: built.join("controller_any"),
            policy: any_mission,
        },
        is_for_any,
        bench: built.join("bench"),
        bench_bytes: built.join("bench_bytes"),
        bench_planner: built.join("bench_planner"),
        bench_sets: built.join("bench_sets"),
    };
    for (controller, what) in [
        (&images.one_mission, "for one mission"),
        (&images.any_mission, "for any mission"),
    ] {
        let sizes = elf::Sizes::read(&controller.image)?;
        println!(
            "{}, with a policy {what}: {} B code, {} B constants, {} B of statics, {} B of them the \
             planner's",
            controller.image.display(),
            sizes.text,
            sizes.rodata,
            sizes.data + sizes.bss,
            sizes.planner
        );
    }
    Ok(images)
}

/// Returns whether a `.policy` file is for any mission.
fn is_for_any_mission(policy: &Path) -> Result<bool> {
    let name = || policy.display().to_string();
    let file = fs::read(policy).with_context(name)?;
    match format_version(&file).with_context(name)? {
        mlp::FORMAT_VERSION | mlp::FORMAT_VERSION_FUNCTIONS => Ok(false),
        sets::FORMAT_VERSION => Ok(true),
        other => bail!("{}: format version {other} is not known", name()),
    }
}

/// Converts the policy to the format of the microcontroller, in the file `to` of the output directory
/// unless it has this format. Returns the file's path.
fn converted(root: &Path, policy: &Path, to: &str) -> Result<PathBuf> {
    if policy == Path::new("any") {
        return Ok(root.join(FOR_ANY_MISSION));
    }
    let policy = root.join(policy);
    ensure!(
        policy.is_file(),
        "--policy {}: no such file",
        policy.display()
    );
    if policy.extension().is_some_and(|kind| kind == "policy") {
        return Ok(policy);
    }
    let to = folder(root).join(to);
    let mut cargo = cargo();
    cargo
        .current_dir(root)
        .args([
            "run",
            "--release",
            "--quiet",
            "--package",
            "trainer",
            "--",
            "convert",
        ])
        .arg(&policy)
        .arg(&to);
    complete(&mut cargo)?;
    Ok(to)
}

/// Returns a command for the cargo that runs this program.
pub(crate) fn cargo() -> Command {
    Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// Runs a command to its end, and returns an error if it fails.
pub(crate) fn complete(command: &mut Command) -> Result<()> {
    let program = command.get_program().display().to_string();
    let status = command
        .status()
        .with_context(|| format!("{program} could not be started"))?;
    ensure!(status.success(), "{command:?}: {status}");
    Ok(())
}

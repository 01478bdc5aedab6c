//! Builds the image around a trained policy.

use std::{
    env,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, ensure};
use clap::Args;

use crate::{
    elf, order,
    tools::{Compiler, TARGET},
};

/// The options of the build.
#[derive(Clone, Debug, Args)]
pub(crate) struct BuildArguments {
    /// The policy: an .onnx file, or a .policy file from `trainer convert`
    #[arg(long, default_value = "models/separated-sac.onnx", value_name = "FILE")]
    pub(crate) policy: PathBuf,
    /// Path of a host-sim program [default: it is built as by `cargo build --release`]
    #[arg(long, value_name = "FILE")]
    pub(crate) host_sim: Option<PathBuf>,
}

/// The result of a build.
#[derive(Debug)]
pub(crate) struct Images {
    /// The image that flies.
    pub(crate) controller: PathBuf,
    /// The image that measures the parts of a slot.
    pub(crate) bench: PathBuf,
    /// The image that measures received bytes.
    pub(crate) bench_bytes: PathBuf,
    /// The image that measures the planner.
    pub(crate) bench_planner: PathBuf,
    /// The policy in the images.
    pub(crate) policy: PathBuf,
}

/// Returns the output directory.
pub(crate) fn folder(root: &Path) -> PathBuf {
    root.join("target/firmware")
}

/// Builds the images.
pub(crate) fn run(root: &Path, arguments: &BuildArguments) -> Result<Images> {
    let compiler = Compiler::find(root)?;
    let folder = folder(root);
    std::fs::create_dir_all(&folder)?;
    let policy = converted(root, &arguments.policy)?;
    let planned = folder.join("planned.order");
    order::write(&planned)?;
    let mut cargo = cargo();
    cargo
        .args(["build", "--release", "--locked"])
        .current_dir(root.join("firmware"))
        .env("CARGO_TARGET_DIR", &folder)
        .env("FIRMWARE_POLICY", &policy)
        .env("FIRMWARE_ORDER", &planned);
    compiler.prepare(&mut cargo);
    complete(&mut cargo)?;
    let built = folder.join(TARGET).join("release");
    let images = Images {
        controller: built.join("controller"),
        bench: built.join("bench"),
        bench_bytes: built.join("bench_bytes"),
        bench_planner: built.join("bench_planner"),
        policy,
    };
    let sizes = elf::Sizes::read(&images.controller)?;
    println!(
        "{}: {} B code, {} B constants, {} B of statics, {} B of them the planner's",
        images.controller.display(),
        sizes.text,
        sizes.rodata,
        sizes.data + sizes.bss,
        sizes.planner
    );
    Ok(images)
}

/// Converts the policy to the format of the microcontroller.
fn converted(root: &Path, policy: &Path) -> Result<PathBuf> {
    let policy = root.join(policy);
    ensure!(
        policy.is_file(),
        "--policy {}: no such file",
        policy.display()
    );
    if policy.extension().is_some_and(|kind| kind == "policy") {
        return Ok(policy);
    }
    let to = folder(root).join("trained.policy");
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

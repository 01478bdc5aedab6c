//! Finds a compiler for the target, its linker, and QEMU, and reports what is missing.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, bail};

/// The target of the image.
pub(crate) const TARGET: &str = "thumbv7em-none-eabihf";

/// A compiler that can build for the target.
#[derive(Debug)]
pub(crate) enum Compiler {
    /// A compiler of rustup, with the `core` of the target.
    Installed,
    /// Builds `core` from source with this compiler; `None` is cargo's own.
    FromSource {
        rustc: Option<PathBuf>,
        linker: PathBuf,
    },
}

impl Compiler {
    /// Finds a compiler: rustup's target, the tools that `.ci/firmware-tools` unpacks, or rustup's
    /// library source.
    pub(crate) fn find(root: &Path) -> Result<Self> {
        let libraries = ask_rustc(root, &["--print", "target-libdir", "--target", TARGET]);
        let has_core = |folder: PathBuf| {
            let files = fs::read_dir(folder).into_iter().flatten().flatten();
            files.into_iter().any(|file| {
                let name = file.file_name();
                name.to_str()
                    .is_some_and(|name| name.starts_with("libcore-"))
            })
        };
        if libraries.is_ok_and(|folder| has_core(folder.into())) {
            return Ok(Self::Installed);
        }
        let unpacked = unpacked(root, "rustc");
        let sysroot = PathBuf::from(ask_rustc(root, &["--print", "sysroot"])?);
        let has_source = sysroot.join("lib/rustlib/src/rust/library/core").is_dir();
        if unpacked.is_none() && !has_source {
            bail!(
                "no compiler for {TARGET}: run `rustup target add {TARGET}`, or `rustup component \
                 add rust-src`; on Debian without rustup's targets, .ci/firmware-tools unpacks \
                 what is needed into target/firmware-tools"
            );
        }
        Ok(Self::FromSource {
            rustc: unpacked,
            linker: linker(root, &sysroot)?,
        })
    }

    /// Configures a cargo command to use this compiler.
    pub(crate) fn prepare(&self, cargo: &mut Command) {
        if let Self::FromSource { rustc, linker } = self {
            if let Some(rustc) = rustc {
                cargo.env("RUSTC", rustc);
            }
            cargo
                .env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", linker)
                // Building `core` is not stable yet.
                .env("RUSTC_BOOTSTRAP", "1")
                .arg("-Zbuild-std=core");
        }
    }

    /// Returns the version in one line.
    pub(crate) fn version(&self, root: &Path) -> Result<String> {
        match self {
            Self::FromSource {
                rustc: Some(rustc), ..
            } => ask(Command::new(rustc).arg("--version")),
            _ => ask_rustc(root, &["--version"]),
        }
    }
}

/// Returns LLVM's linker: rustup's compilers include it, but look for it only for known targets.
fn linker(root: &Path, sysroot: &Path) -> Result<PathBuf> {
    let about = ask_rustc(root, &["-vV"])?;
    let host = about.lines().find_map(|line| line.strip_prefix("host: "));
    let host = host.context("rustc -vV names no host")?;
    let own = sysroot.join("lib/rustlib").join(host).join("bin/rust-lld");
    if own.is_file() {
        return Ok(own);
    }
    on_path("rust-lld")
        .or_else(|| on_path("ld.lld"))
        .context("no linker: rust-lld comes with rustup's toolchains, ld.lld with the package lld")
}

/// Returns QEMU for the board.
pub(crate) fn qemu(root: &Path) -> Result<PathBuf> {
    const NAME: &str = "qemu-system-arm";
    unpacked(root, NAME)
        .or_else(|| on_path(NAME))
        .with_context(|| {
            format!(
                "no {NAME}: install the package {NAME} (Debian) or qemu (Homebrew), or run \
             .ci/firmware-tools, which unpacks it into target/firmware-tools"
            )
        })
}

/// Returns a program that `.ci/firmware-tools` has unpacked.
fn unpacked(root: &Path, name: &str) -> Option<PathBuf> {
    let tools = root.join("target/firmware-tools");
    let program = tools.join("bin").join(name);
    (tools.join("complete").is_file() && program.is_file()).then_some(program)
}

fn on_path(name: &str) -> Option<PathBuf> {
    let folders = env::var_os("PATH")?;
    env::split_paths(&folders)
        .map(|folder| folder.join(name))
        .find(|program| program.is_file())
}

fn ask_rustc(root: &Path, arguments: &[&str]) -> Result<String> {
    let rustc = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    ask(Command::new(rustc).current_dir(root).args(arguments))
}

fn ask(command: &mut Command) -> Result<String> {
    let output = command
        .output()
        .with_context(|| format!("{} could not be started", command.get_program().display()))?;
    if !output.status.success() {
        bail!("{}", String::from_utf8_lossy(&output.stderr).trim());
    }
    Ok(String::from_utf8(output.stdout)?.trim().to_owned())
}

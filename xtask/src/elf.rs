//! Reads the sizes of the sections of an image, and the places from which a program can panic.

use std::{fs, path::Path};

use anyhow::{Context, Result, ensure};
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

/// The sizes of the sections in bytes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sizes {
    /// The code and the vector table.
    pub(crate) text: u32,
    /// The constants, including the policy.
    pub(crate) rodata: u32,
    /// The statics with a value, in flash and in RAM.
    pub(crate) data: u32,
    /// The statics that are initially zero.
    pub(crate) bss: u32,
    /// The part of `data` and `bss` that is the planner's memory.
    pub(crate) planner: u32,
    /// The part of `bss` in which the network for any mission is evaluated.
    pub(crate) sets_work: u32,
}

impl Sizes {
    /// Reads the sizes of the image in this file.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let file = fs::read(path).with_context(|| path.display().to_string())?;
        Self::parse(&file).with_context(|| format!("{}: not an image", path.display()))
    }

    fn parse(file: &[u8]) -> Result<Self> {
        let image = object::File::parse(file)?;
        let mut sizes = Self::default();
        for section in image.sections() {
            let size = u32::try_from(section.size())?;
            match section.name()? {
                ".text" | ".vector_table" => sizes.text += size,
                ".rodata" => sizes.rodata += size,
                ".data" => sizes.data += size,
                ".bss" | ".uninit" => sizes.bss += size,
                _ => {}
            }
        }
        ensure!(sizes.text > 0, "no code");
        for symbol in image.symbols() {
            if symbol.kind() != SymbolKind::Data {
                continue;
            }
            // The statics of firmware/src/planner.rs and trained.rs; the names are mangled.
            let (name, size) = (symbol.name()?, u32::try_from(symbol.size())?);
            if name.contains("PLANNER") {
                sizes.planner += size;
            } else if name.contains("SETS_WORK") {
                sizes.sets_work += size;
            }
        }
        Ok(sizes)
    }
}

/// Returns whether a program calculates in double precision. It must be built for a processor without a
/// unit for that: the compiler then calls functions of the run-time ABI instead.
pub(crate) fn has_double_precision(path: &Path) -> Result<bool> {
    let file = fs::read(path).with_context(|| path.display().to_string())?;
    let image = object::File::parse(&*file).with_context(|| path.display().to_string())?;
    let mut names = image.symbols().filter_map(|symbol| symbol.name().ok());
    Ok(names.any(is_double_precision))
}

/// Returns whether a function of the run-time ABI takes or returns a number in double precision.
fn is_double_precision(function: &str) -> bool {
    const INTO_DOUBLE: [&str; 5] = ["f2d", "i2d", "ui2d", "l2d", "ul2d"];
    let name = function.strip_prefix("__aeabi_");
    name.is_some_and(|name| name.starts_with('d') || INTO_DOUBLE.contains(&name))
}

/// Returns the places `file:line` that a program names in panics; files of the workspace relative to
/// `root`.
pub(crate) fn panic_locations(path: &Path, root: &Path) -> Result<Vec<String>> {
    let file = fs::read(path).with_context(|| path.display().to_string())?;
    let image = object::File::parse(&*file).with_context(|| path.display().to_string())?;
    let constants = image.section_by_name(".rodata").context("no .rodata")?;
    let (base, bytes) = (constants.address(), constants.data()?);
    // A `core::panic::Location`: address and length of the file's name, line and column.
    let (words, _) = bytes.as_chunks::<4>();
    let words: Vec<u32> = words.iter().map(|&word| u32::from_le_bytes(word)).collect();
    let mut places: Vec<(&str, u32)> = words
        .windows(4)
        .filter_map(|words| {
            let &[address, length, line, _] = words else {
                return None;
            };
            let start = usize::try_from(u64::from(address).checked_sub(base)?).ok()?;
            let name = bytes.get(start..start.checked_add(length as usize)?)?;
            let name = str::from_utf8(name).ok()?;
            name.ends_with(".rs").then_some((name, line))
        })
        .collect();
    places.sort_unstable();
    places.dedup();
    Ok(places
        .into_iter()
        .map(|(name, line)| format!("{}:{line}", shown(name, root)))
        .collect())
}

/// Returns the name of a source file without the place of the workspace, the library or the registry.
fn shown<'n>(name: &'n str, root: &Path) -> &'n str {
    // First, because an unpacked compiler is below the workspace.
    if let Some((_, file)) = name.split_once("/rust/library/") {
        return file;
    }
    if let Some(file) = Path::new(name)
        .strip_prefix(root)
        .ok()
        .and_then(Path::to_str)
    {
        return file;
    }
    let registry = name.split_once("/registry/src/");
    let file = registry.and_then(|(_, file)| file.split_once('/'));
    file.map_or(name, |(_, file)| file)
}

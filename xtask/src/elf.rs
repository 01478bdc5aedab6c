//! Reads the sizes of the sections of an image.

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
            // The statics of firmware/src/planner.rs; the names are mangled.
            if symbol.kind() == SymbolKind::Data && symbol.name()?.contains("PLANNER") {
                sizes.planner += u32::try_from(symbol.size())?;
            }
        }
        Ok(sizes)
    }
}

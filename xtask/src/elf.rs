//! Sizes of the sections of an image: 32-bit little-endian ELF.

use std::{fs, path::Path};

use anyhow::{Context, Result, ensure};

/// Bytes by section.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sizes {
    /// Code and the vector table.
    pub(crate) text: u32,
    /// Constants, the policy among them.
    pub(crate) rodata: u32,
    /// Statics with a value, in flash and in RAM.
    pub(crate) data: u32,
    /// Statics that begin as zero.
    pub(crate) bss: u32,
}

impl Sizes {
    /// Of the image in this file.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let file = fs::read(path).with_context(|| path.display().to_string())?;
        Self::parse(&file).with_context(|| format!("{}: not an image", path.display()))
    }

    fn parse(file: &[u8]) -> Result<Self> {
        ensure!(
            file.starts_with(b"\x7fELF\x01\x01"),
            "no 32-bit little-endian ELF"
        );
        let half = |at: usize| -> Result<usize> {
            let bytes = file.get(at..at + 2).context("cut short")?;
            Ok(usize::from(u16::from_le_bytes([bytes[0], bytes[1]])))
        };
        let word = |at: usize| -> Result<u32> {
            let bytes = file.get(at..at + 4).context("cut short")?;
            Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
        };
        let (table, entry, count, names) =
            (word(0x20)? as usize, half(0x2E)?, half(0x30)?, half(0x32)?);
        let names = word(table + names * entry + 0x10)? as usize;
        let mut sizes = Self::default();
        for section in (0..count).map(|index| table + index * entry) {
            let name = file
                .get(names + word(section)? as usize..)
                .context("cut short")?;
            let size = word(section + 0x14)?;
            let is = |wanted: &str| {
                name.starts_with(wanted.as_bytes()) && name.get(wanted.len()) == Some(&0)
            };
            if is(".text") || is(".vector_table") {
                sizes.text += size;
            } else if is(".rodata") {
                sizes.rodata += size;
            } else if is(".data") {
                sizes.data += size;
            } else if is(".bss") || is(".uninit") {
                sizes.bss += size;
            }
        }
        ensure!(sizes.text > 0, "no code");
        Ok(sizes)
    }
}

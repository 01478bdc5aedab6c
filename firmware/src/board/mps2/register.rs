//! A register of a peripheral.
#![allow(unsafe_code)]

use core::ptr::{
    read_volatile, with_exposed_provenance, with_exposed_provenance_mut, write_volatile,
};

/// At a fixed address. This module's callers name addresses of the board's peripherals alone.
#[derive(Clone, Copy, Debug)]
pub(super) struct Register(usize);

impl Register {
    pub(super) const fn new(address: usize) -> Self {
        Self(address)
    }

    pub(super) fn read(self) -> u32 {
        // SAFETY: a peripheral's register: aligned, always there, and no Rust object.
        unsafe { read_volatile(with_exposed_provenance(self.0)) }
    }

    pub(super) fn write(self, value: u32) {
        // SAFETY: as above; what a write sets off is no access to our memory.
        unsafe { write_volatile(with_exposed_provenance_mut(self.0), value) };
    }
}

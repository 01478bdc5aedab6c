// SPDX-License-Identifier: MIT OR Apache-2.0
//! The most bytes that postcard needs for a value, and that a frame has around them. The lengths of
//! the longest frames are computed from these.
//!
//! postcard writes integers in groups of 7 bits, enumerations and lengths as integers, and
//! floating-point numbers as they are.

/// A byte, a flag, or the variant of an enumeration with at most 128 of them.
pub(crate) const U8: usize = 1;
/// A `u16`.
pub(crate) const U16: usize = 3;
/// A `u32` or `i32`.
pub(crate) const U32: usize = 5;
/// A `u64`.
pub(crate) const U64: usize = 10;
/// The length of a vector with fewer than 2^21 entries.
pub(crate) const LENGTH: usize = 3;
/// The version and the CRC of a frame.
const VERSION_AND_CRC: usize = 1 + 4;

/// Returns the length of a frame around a message of so many bytes, at most.
pub(crate) const fn framed(message: usize) -> usize {
    1 + cobs::max_encoding_length(message + VERSION_AND_CRC) + 1
}

/// Returns the larger length.
pub(crate) const fn longer(a: usize, b: usize) -> usize {
    if a > b { a } else { b }
}

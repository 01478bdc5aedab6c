// SPDX-License-Identifier: MIT OR Apache-2.0
//! Consistent overhead byte stuffing (COBS), decoded in place.
//!
//! The crate `cobs` encodes; its decoders contain panics.

use core::cell::Cell;

/// Decodes the bytes between two delimiters in place. Returns `None` if a block is longer than what
/// follows.
pub(super) fn unstuff(frame: &mut [u8]) -> Option<&[u8]> {
    let cells = Cell::from_mut(&mut *frame).as_slice_of_cells();
    // What is written never overtakes what is read: a block is one byte shorter without its length.
    let (mut encoded, mut decoded) = (cells.iter(), cells.iter());
    while let Some(length) = encoded.next() {
        let length = length.get();
        let block = encoded
            .as_slice()
            .get(..usize::from(length).checked_sub(1)?)?;
        for (byte, place) in block.iter().zip(decoded.by_ref()) {
            place.set(byte.get());
        }
        encoded = encoded.as_slice().get(block.len()..)?.iter();
        if length < u8::MAX && !encoded.as_slice().is_empty() {
            decoded.next()?.set(0);
        }
    }
    let length = cells.len() - decoded.as_slice().len();
    frame.get(..length)
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    fn agrees(frame: &[u8]) {
        let (mut ours, mut theirs) = (frame.to_vec(), frame.to_vec());
        let expected = cobs::decode_in_place(&mut theirs).ok();
        let expected = expected.and_then(|length| theirs.get(..length));
        assert_eq!(unstuff(&mut ours), expected, "{frame:?}");
    }

    /// All frames of up to six bytes that are decoded differently, and long blocks of every length,
    /// whole and cut off: the result is that of the crate `cobs`.
    #[test]
    fn the_result_is_that_of_the_crate_cobs() {
        let mut frame = Vec::new();
        for length in 1..=6_u32 {
            for number in 0..7_u32.pow(length) {
                let digit = |place| number / 7_u32.pow(place) % 7;
                frame.clear();
                frame.extend(
                    (0..length).map(|place| [1, 2, 3, 4, 5, 6, 0xFF][digit(place) as usize]),
                );
                agrees(&frame);
            }
        }
        for length in 1..=u8::MAX {
            for present in [0, 1, length - 1, length, u8::MAX] {
                frame.clear();
                frame.push(length);
                frame.extend((0..present).map(|byte| byte | 1));
                agrees(&frame);
            }
        }
    }
}

// SPDX-License-Identifier: MIT OR Apache-2.0
//! Consistent overhead byte stuffing (COBS), encoded and decoded in place.
//!
//! The crate `cobs` encodes from one buffer into another, and its decoders contain panics.

use core::cell::Cell;

/// The most bytes in a block.
const BLOCK: usize = 254;

/// Returns the most bytes that can be encoded in `capacity` bytes, whatever they are: the largest
/// `n` with `cobs::max_encoding_length(n) <= capacity`.
pub(super) const fn most_encodable(capacity: usize) -> usize {
    capacity - capacity.div_ceil(BLOCK + 1)
}

/// Encodes the last `length` of the first `end` bytes in place. The result begins at the first
/// byte; its length is returned. Returns `None` if there are not that many bytes, or if those before
/// them are fewer than the encoding may add (`cobs::max_encoding_overhead(length)`).
pub(super) fn stuff(buffer: &mut [u8], end: usize, length: usize) -> Option<usize> {
    let cells = Cell::from_mut(buffer).as_slice_of_cells();
    let begin = end.checked_sub(length)?;
    if begin < length.div_ceil(BLOCK) {
        return None;
    }
    let mut encoded = cells.iter();
    // What is written never overtakes what is read: of the bytes before the plain ones, each block
    // that ends without a zero takes one.
    let mut length_of_block = encoded.next()?;
    let mut run = 0;
    for byte in cells.get(begin..end)? {
        if run == BLOCK {
            // A full block stands for no zero.
            length_of_block.set(u8::MAX);
            length_of_block = encoded.next()?;
            run = 0;
        }
        if byte.get() == 0 {
            length_of_block.set((run + 1) as u8);
            length_of_block = encoded.next()?;
            run = 0;
        } else {
            encoded.next()?.set(byte.get());
            run += 1;
        }
    }
    length_of_block.set((run + 1) as u8);
    Some(cells.len() - encoded.as_slice().len())
}

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

    /// Encodes in place, with as little before the bytes as is needed, and a byte behind them.
    fn encoded_in_place(plain: &[u8]) -> Vec<u8> {
        let overhead = cobs::max_encoding_overhead(plain.len());
        let mut buffer = std::vec![0xAA; overhead];
        buffer.extend(plain);
        buffer.push(0xBB);
        let end = buffer.len() - 1;
        let length = stuff(&mut buffer, end, plain.len()).expect("there is space");
        assert_eq!(
            buffer.last(),
            Some(&0xBB),
            "nothing is written behind the bytes"
        );
        assert!(length <= end);
        buffer.truncate(length);
        // With less space before them the bytes are refused.
        let mut tight = plain.to_vec();
        assert_eq!(stuff(&mut tight, plain.len(), plain.len()), None);
        buffer
    }

    /// All short sequences of zeros and others, and runs of every length that matters, with and
    /// without zeros around them: the result is that of the crate `cobs`, which also says how much
    /// can be encoded.
    #[test]
    fn the_encoding_is_that_of_the_crate_cobs() {
        let check = |plain: &[u8]| {
            let mut theirs = std::vec![0; cobs::max_encoding_length(plain.len())];
            let length = cobs::encode(plain, &mut theirs);
            assert_eq!(encoded_in_place(plain), theirs[..length], "{plain:?}");
        };
        for length in 1..=10_u32 {
            for bits in 0..1_u32 << length {
                let plain: Vec<u8> = (0..length).map(|at| (bits >> at & 1) as u8 * 7).collect();
                check(&plain);
            }
        }
        for run in [
            1, 2, 252, 253, 254, 255, 256, 507, 508, 509, 510, 762, 763, 1016, 1017,
        ] {
            for (zeros_before, zeros_behind, more) in [
                (0, 0, 0),
                (1, 0, 0),
                (0, 1, 0),
                (2, 1, 1),
                (0, 1, 254),
                (1, 2, 255),
                (3, 0, 9),
            ] {
                let mut plain = std::vec![0; zeros_before];
                plain.extend((0..run).map(|at| at as u8 | 1));
                plain.extend(std::vec![0; zeros_behind]);
                plain.extend(std::vec![9; more]);
                check(&plain);
            }
        }
        for capacity in 0..2000 {
            let most = most_encodable(capacity);
            assert!(cobs::max_encoding_length(most) <= capacity, "{capacity}");
            assert!(cobs::max_encoding_length(most + 1) > capacity, "{capacity}");
        }
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

// SPDX-License-Identifier: MIT OR Apache-2.0
//! Half precision (IEEE 754 binary16), in which weights are stored.

/// The bits of the exponent: all of them are set in infinities and NaN.
const EXPONENT: u16 = 0x7c00;

/// `2^112`, the ratio of the biases of both exponents.
const REBIAS: f32 = f32::from_bits((127 + 112) << 23);

/// Returns whether the bits are those of a finite number.
pub fn is_finite(bits: u16) -> bool {
    bits & EXPONENT != EXPONENT
}

/// Returns a number, which must be [finite](is_finite), in single precision. This is exact.
pub fn to_single(bits: u16) -> f32 {
    // Sign and magnitude at their places in single precision, where the exponent has another bias.
    let wide = i32::from(bits.cast_signed()).cast_unsigned() << 13;
    f32::from_bits(wide & 0x8fff_e000) * REBIAS
}

/// Returns the nearest number in half precision, of two equally near ones the even one. From 65520
/// on this is infinite.
pub fn from_single(x: f32) -> u16 {
    let sign = ((x.to_bits() >> 16) & 0x8000) as u16;
    let magnitude = x.abs();
    let bits = magnitude.to_bits();
    let rounded = if x.is_nan() {
        u32::from(EXPONENT) | 0x200
    } else if magnitude >= 65520.0 {
        u32::from(EXPONENT)
    } else if magnitude < f32::from_bits((127 - 14) << 23) {
        // Below 2^-14 the spacing is 2^-24, which is that of single precision from 0.5 on.
        (magnitude + 0.5).to_bits() - 0.5_f32.to_bits()
    } else {
        let rebiased = bits - (112 << 23);
        (rebiased + 0xfff + ((bits >> 13) & 1)) >> 13
    };
    sign | rounded as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The value of a finite half, from the definition.
    fn value(bits: u16) -> f64 {
        let sign = if bits & 0x8000 == 0 { 1.0 } else { -1.0 };
        let exponent = i32::from((bits & EXPONENT) >> 10);
        let fraction = f64::from(bits & 0x3ff) / 1024.0;
        let magnitude = match exponent {
            0 => fraction * 2.0_f64.powi(-14),
            _ => (1.0 + fraction) * 2.0_f64.powi(exponent - 15),
        };
        sign * magnitude
    }

    /// All finite halves are exact in single precision, and come back.
    #[test]
    fn halves_come_back() {
        let mut count = 0;
        for bits in (0..=u16::MAX).filter(|&bits| is_finite(bits)) {
            assert_eq!(f64::from(to_single(bits)), value(bits), "{bits:#06x}");
            assert_eq!(from_single(to_single(bits)), bits, "{bits:#06x}");
            count += 1;
        }
        assert_eq!(count, 65_536 - 2 * 1024);
    }

    /// Between two neighbours the nearer one is taken, half-way the even one.
    #[test]
    fn rounding_is_to_the_nearest() {
        for bits in (0..0x7bff_u16).chain(0x8000..0xfbff) {
            let (here, next) = (to_single(bits), to_single(bits + 1));
            let middle = (here + next) / 2.0;
            let even = bits + (bits & 1);
            assert_eq!(from_single(middle), even, "{bits:#06x}");
            assert_eq!(
                from_single(here + (next - here) * 0.499),
                bits,
                "{bits:#06x}"
            );
            assert_eq!(
                from_single(here + (next - here) * 0.501),
                bits + 1,
                "{bits:#06x}"
            );
        }
        assert_eq!(from_single(65519.0), 0x7bff);
        for (x, bits) in [
            (65520.0, 0x7c00),
            (-65520.0, 0xfc00),
            (f32::INFINITY, 0x7c00),
            (f32::MAX, 0x7c00),
            (-1e-9, 0x8000),
        ] {
            assert_eq!(from_single(x), bits, "{x}");
            assert_eq!(is_finite(bits), bits == 0x8000);
        }
        assert!(!is_finite(from_single(f32::NAN)));
    }
}

//! Elementary functions that the compiler can vectorize, with the same bits on every machine.

use pulp::{Arch, Simd, WithSimd};

/// Runs `loops` with the machine's vector instructions. `loops` must be an `#[inline(always)]`
/// closure, and so must be what it calls: code that is not inlined is compiled without them.
#[inline(always)]
pub fn vectorize<F: FnMut()>(arch: Arch, loops: F) {
    arch.dispatch(Loops(loops));
}

/// A closure as it is: called through `FnOnce`, as pulp does, it would not be inlined.
struct Loops<F>(F);

impl<F: FnMut()> WithSimd for Loops<F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) {
        (self.0)();
    }
}

/// Returns `e^x` with a relative error below 2e-7 for x from -87 to 88; beyond, the value at the
/// nearer end. NaN passes through.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    // The sum with 1.5 * 2^23 has no fractional part, so its last bits are the nearest integer.
    const TO_INTEGER: f32 = 12_582_912.0;
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;
    let x = x.clamp(-87.0, 88.0);
    let shifted = x.mul_add(std::f32::consts::LOG2_E, TO_INTEGER);
    let n = shifted - TO_INTEGER;
    let r = n.mul_add(-LN_2_LOW, n.mul_add(-LN_2_HIGH, x));
    // The polynomial of Cephes' expf.
    let p = r.mul_add(1.987_569_2e-4, 1.398_2e-3);
    let p = r.mul_add(p, 8.333_452e-3);
    let p = r.mul_add(p, 4.166_579_6e-2);
    let p = r.mul_add(p, 1.666_666_5e-1);
    let p = r.mul_add(p, 5.000_000_3e-1);
    let p = (r * r).mul_add(p, r) + 1.0;
    let exponent = shifted.to_bits().wrapping_sub(TO_INTEGER.to_bits());
    p * f32::from_bits(exponent.wrapping_add(127) << 23)
}

/// Returns `1 / (1 + e^-x)`.
#[inline(always)]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// Replaces each `x` of `values` by `x sigmoid(x)`, and writes the derivative.
pub fn silu(arch: Arch, values: &mut [f32], derivatives: &mut [f32]) {
    let n = values.len().min(derivatives.len());
    let (values, derivatives) = (&mut values[..n], &mut derivatives[..n]);
    vectorize(
        arch,
        #[inline(always)]
        || {
            for i in 0..n {
                let x = values[i];
                let s = sigmoid(x);
                values[i] = x * s;
                derivatives[i] = s * (1.0 - s).mul_add(x, 1.0);
            }
        },
    );
}

/// Multiplies `gradient` by `derivatives`, element by element.
pub fn multiply(arch: Arch, gradient: &mut [f32], derivatives: &[f32]) {
    vectorize(
        arch,
        #[inline(always)]
        || {
            for (gradient, derivative) in gradient.iter_mut().zip(derivatives) {
                *gradient *= derivative;
            }
        },
    );
}

/// Adds `other` to `values`, element by element.
pub fn add(arch: Arch, values: &mut [f32], other: &[f32]) {
    vectorize(
        arch,
        #[inline(always)]
        || {
            for (value, other) in values.iter_mut().zip(other) {
                *value += other;
            }
        },
    );
}

/// Returns the sum of 16 numbers in a fixed order, which vectors can follow.
#[inline(always)]
pub fn sum_of_lanes(lanes: [f32; 16]) -> f32 {
    let mut s = lanes;
    for half in [8, 4, 2, 1] {
        for i in 0..half {
            s[i] += s[i + half];
        }
    }
    s[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::arch::every_arch;

    #[test]
    fn exp_is_accurate_and_passes_nan() {
        for i in -870_000..=880_000 {
            let x = i as f32 * 1e-4;
            let exact = f64::from(x).exp();
            let error = (f64::from(exp(x)) / exact - 1.0).abs();
            assert!(error < 2e-7, "{x}: {error:e}");
        }
        assert!(exp(f32::NAN).is_nan());
        assert_eq!(exp(f32::NEG_INFINITY), exp(-87.0));
        assert!(exp(f32::INFINITY) > 1e38);
    }

    #[test]
    fn silu_has_the_same_bits_on_every_machine_and_the_right_derivative() {
        let inputs: Vec<f32> = (-400..400).map(|i| i as f32 * 0.05).collect();
        let of = |arch| {
            let (mut values, mut derivatives) = (inputs.clone(), inputs.clone());
            silu(arch, &mut values, &mut derivatives);
            (values, derivatives)
        };
        let expected = of(Arch::Scalar);
        for arch in every_arch() {
            assert_eq!(of(arch), expected, "{arch:?}");
        }
        let exact = |x: f64| x / (1.0 + (-x).exp());
        for (i, &x) in inputs.iter().enumerate() {
            let x = f64::from(x);
            let error = (f64::from(expected.0[i]) - exact(x)).abs();
            assert!(error < 1e-6 * x.abs().max(1.0), "{x}: {error:e}");
            let slope = (exact(x + 1e-6) - exact(x - 1e-6)) / 2e-6;
            assert!((f64::from(expected.1[i]) - slope).abs() < 1e-6, "{x}");
        }
    }
}

//! An independent network in double precision, which tests differentiate numerically.

use super::{mlp::Mlp, product::LANES};

/// Returns the output for one sample; `parameters` replaces the network's own.
pub(crate) fn forward(network: &Mlp, parameters: &[f64], input: &[f64]) -> Vec<f64> {
    let mut x = input.to_vec();
    let mut start = 0;
    for (index, layer) in network.layers().iter().enumerate() {
        let stride = layer.inputs.div_ceil(LANES) * LANES;
        let bias = start + layer.outputs * stride;
        x = (0..layer.outputs)
            .map(|o| {
                let row = &parameters[start + o * stride..];
                let z: f64 = x.iter().zip(row).map(|(x, w)| x * w).sum();
                z + parameters[bias + o]
            })
            .collect();
        if index + 1 < network.layers().len() {
            x.iter_mut().for_each(|x| *x = x.max(0.0));
        }
        start = bias + layer.outputs.div_ceil(LANES) * LANES;
    }
    x
}

/// Compares a gradient with central differences of `loss` at `n` of the parameters, relative to the
/// size of the gradient.
pub(crate) fn check_gradient(
    parameters: &[f32],
    gradient: &[f32],
    n: usize,
    mut loss: impl FnMut(&[f64]) -> f64,
) {
    let mut at: Vec<f64> = parameters.iter().map(|&x| f64::from(x)).collect();
    let largest = gradient.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
    assert!(largest > 0.0, "the gradient is zero everywhere");
    let step = (parameters.len() / n).max(1);
    let mut nonzero = 0;
    for i in (0..parameters.len()).step_by(step) {
        const H: f64 = 1e-6;
        let x = at[i];
        at[i] = x + H;
        let above = loss(&at);
        at[i] = x - H;
        let below = loss(&at);
        at[i] = x;
        let numeric = (above - below) / (2.0 * H);
        let error = (numeric - f64::from(gradient[i])).abs();
        let scale = f64::from(gradient[i].abs()).max(0.05 * f64::from(largest));
        assert!(
            error <= 1e-3 * scale,
            "parameter {i}: numeric {numeric}, back-propagated {}",
            gradient[i]
        );
        nonzero += usize::from(numeric != 0.0);
    }
    assert!(
        nonzero * 4 >= n.min(parameters.len()),
        "hardly anything was compared"
    );
}

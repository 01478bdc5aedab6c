//! Linear layers `y = W x + b` over the rows of a matrix.

use pulp::Arch;

use super::{
    super::product::{Epilogue, Left, product},
    functions::add,
    layout::Linear,
    network::SetNetwork,
};

/// Computes one row of `y` ([`Linear::columns`] long) for each of the `rows` rows of `x`
/// ([`Linear::stride`] apart).
pub fn forward(
    arch: Arch,
    network: &SetNetwork,
    linear: &Linear,
    rows: usize,
    x: &[f32],
    y: &mut [f32],
) {
    let (_, bias) = network.linear(linear);
    let columns = linear.columns();
    product(
        arch,
        Left::rows(x, rows, linear.stride()),
        network.transposed(linear),
        y,
        linear.inputs,
        columns,
        Epilogue::ColumnBias(bias),
    );
}

/// Adds the gradient of weights and biases to `gradient`, where `dy` is the gradient of the outputs
/// of the `rows` rows `x`.
pub fn backward_parameters(
    arch: Arch,
    linear: &Linear,
    rows: usize,
    x: &[f32],
    dy: &[f32],
    gradient: &mut [f32],
) {
    let columns = linear.columns();
    let left = Left {
        data: dy,
        rows: linear.outputs,
        row_stride: 1,
        k_stride: columns,
    };
    let weights = &mut gradient[linear.weights()];
    product(
        arch,
        left,
        x,
        weights,
        rows,
        linear.stride(),
        Epilogue::Accumulate,
    );
    let bias = &mut gradient[linear.bias()];
    for row in dy[..rows * columns].chunks_exact(columns) {
        add(arch, bias, row);
    }
}

/// Computes the gradient `dx` of the inputs, one row of [`Linear::stride`] each; adds it if
/// `accumulate`.
pub fn backward_inputs(
    arch: Arch,
    network: &SetNetwork,
    linear: &Linear,
    rows: usize,
    dy: &[f32],
    dx: &mut [f32],
    accumulate: bool,
) {
    let (weights, _) = network.linear(linear);
    let epilogue = match accumulate {
        true => Epilogue::Accumulate,
        false => Epilogue::None,
    };
    product(
        arch,
        Left::rows(dy, rows, linear.columns()),
        weights,
        dx,
        linear.outputs,
        linear.stride(),
        epilogue,
    );
}

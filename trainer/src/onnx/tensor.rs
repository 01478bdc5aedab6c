//! Constant tensors as numbers.

use anyhow::{bail, ensure};

use super::proto::{FLOAT, INT64, TensorProto};
use crate::actor::Dense;

/// Returns the elements of a tensor of 32-bit floats; `index` is the input that holds it.
pub(super) fn floats(tensor: &TensorProto, index: usize) -> anyhow::Result<Vec<f32>> {
    ensure!(
        tensor.data_type == FLOAT,
        "input {index} must be of 32-bit floats"
    );
    if !tensor.float_data.is_empty() {
        return Ok(tensor.float_data.clone());
    }
    let (words, _) = tensor.raw_data.as_chunks::<4>();
    Ok(words.iter().map(|&word| f32::from_le_bytes(word)).collect())
}

/// Returns the only element of a tensor of 64-bit integers, one bound of a `Slice` over one axis.
pub(super) fn integer(tensor: &TensorProto, index: usize) -> anyhow::Result<i64> {
    ensure!(
        tensor.data_type == INT64,
        "input {index} must be a 64-bit integer"
    );
    let (words, _) = tensor.raw_data.as_chunks::<8>();
    let raw = words.iter().map(|&word| i64::from_le_bytes(word));
    let values: Vec<i64> = tensor.int64_data.iter().copied().chain(raw).collect();
    match values[..] {
        [] => bail!("an empty range"),
        [value] => Ok(value),
        _ => bail!("only one axis can be sliced"),
    }
}

/// Returns a matrix as a layer without bias. A `transposed` matrix has one row per output, another
/// one has one column per output.
pub(super) fn layer(tensor: &TensorProto, index: usize, transposed: bool) -> anyhow::Result<Dense> {
    let values = floats(tensor, index)?;
    let &[rows, columns] = &tensor.dims[..] else {
        bail!("input {index} must be a matrix");
    };
    let (rows, columns) = (usize::try_from(rows)?, usize::try_from(columns)?);
    ensure!(
        rows.checked_mul(columns) == Some(values.len()),
        "input {index} is cut: {rows} x {columns}, but {} numbers",
        values.len()
    );
    ensure!(rows > 0 && columns > 0, "input {index} is empty");
    let (inputs, outputs, weights) = if transposed {
        (columns, rows, values)
    } else {
        let column = |o: usize| values.iter().skip(o).step_by(columns).copied();
        (rows, columns, (0..columns).flat_map(column).collect())
    };
    Ok(Dense {
        inputs,
        outputs,
        weights,
        bias: vec![0.0; outputs],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(dims: [i64; 2], values: &[f32]) -> TensorProto {
        TensorProto {
            dims: dims.to_vec(),
            data_type: FLOAT,
            float_data: values.to_vec(),
            ..TensorProto::default()
        }
    }

    #[test]
    fn both_orientations_of_a_matrix_give_the_same_layer() {
        let one_row_per_output = matrix([2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let one_column_per_output = matrix([3, 2], &[1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
        let expected = layer(&one_row_per_output, 1, true).expect("a matrix");
        assert_eq!((expected.inputs, expected.outputs), (3, 2));
        assert_eq!(expected.weights, one_row_per_output.float_data);
        let found = layer(&one_column_per_output, 1, false).expect("a matrix");
        assert_eq!(found, expected);
    }

    #[test]
    fn a_bound_is_one_integer() {
        let bound = |values: &[i64]| {
            let tensor = TensorProto {
                data_type: INT64,
                int64_data: values.to_vec(),
                ..TensorProto::default()
            };
            integer(&tensor, 1).map_err(|error| error.to_string())
        };
        assert_eq!(bound(&[7]), Ok(7));
        assert_eq!(bound(&[]), Err("an empty range".to_owned()));
        assert_eq!(
            bound(&[1, 2]),
            Err("only one axis can be sliced".to_owned())
        );
    }
}

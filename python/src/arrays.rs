//! NumPy arrays as slices. Shapes and layouts are checked here, so that a wrong array is a
//! `ValueError` that names it.

use numpy::{
    Element, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyReadwriteArrayDyn,
    PyUntypedArrayMethods,
};
use pyo3::{exceptions::PyValueError, prelude::*};

/// A dimension that may have any length.
pub(crate) const ANY: usize = usize::MAX;

fn check<T: Element>(
    name: &str,
    array: &Bound<'_, PyArrayDyn<T>>,
    shape: &[usize],
) -> PyResult<()> {
    let got = array.shape();
    let fits = got.len() == shape.len()
        && got
            .iter()
            .zip(shape)
            .all(|(&got, &expected)| expected == ANY || got == expected);
    if !fits {
        let expected: Vec<String> = shape
            .iter()
            .map(|&length| match length {
                ANY => "any".to_owned(),
                length => length.to_string(),
            })
            .collect();
        return Err(PyValueError::new_err(format!(
            "{name} has the shape {got:?}, but must have [{}]",
            expected.join(", ")
        )));
    }
    if !array.is_c_contiguous() {
        return Err(PyValueError::new_err(format!(
            "{name} must be contiguous, in C order"
        )));
    }
    Ok(())
}

/// Returns an array of this shape for reading.
pub(crate) fn readable<'py, T: Element>(
    name: &str,
    array: &Bound<'py, PyArrayDyn<T>>,
    shape: &[usize],
) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    check(name, array, shape)?;
    array
        .try_readonly()
        .map_err(|error| PyValueError::new_err(format!("{name}: {error}")))
}

/// Returns an array of this shape for writing.
pub(crate) fn writable<'py, T: Element>(
    name: &str,
    array: &Bound<'py, PyArrayDyn<T>>,
    shape: &[usize],
) -> PyResult<PyReadwriteArrayDyn<'py, T>> {
    check(name, array, shape)?;
    array
        .try_readwrite()
        .map_err(|error| PyValueError::new_err(format!("{name}: {error}")))
}

/// Takes the first `count` entries.
pub(crate) fn split_off<'a, T>(slice: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    slice.split_off_mut(..count).unwrap_or_default()
}

/// Returns the rows of a matrix with `count` columns.
pub(crate) fn rows<T, const N: usize>(mut matrix: &mut [T], count: usize) -> [&mut [T]; N] {
    std::array::from_fn(|_| split_off(&mut matrix, count))
}

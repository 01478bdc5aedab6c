//! The native part of the Python package `aircomp_uav`. What users import is in `aircomp_uav/`; the
//! stubs in `aircomp_uav/_native.pyi` describe this module.
//!
//! | module | content |
//! |---|---|
//! | `mission` | `Mission`: scenarios, their gains and rates |
//! | `batch` | `Batch`: many episodes that are stepped together |
//! | `slots` | `solve_slots`: the exact allocation of many slots |
//! | `bound` | `certified_bound` |
//! | `benchmark` | policies on many missions, as fractions of certified bounds |
//! | `planner` | `Planner` |
//! | `policy`, `flight` | `Policy`, and `fly`: a policy on the ideal vehicle |
//! | `export` | networks as `.onnx` files |
//! | `arrays` | NumPy arrays as slices |
//! | `interrupt` | long calls that Ctrl-C ends |
//! | `threads` | the threads of parallel calls |
//!
//! Every wrong argument is a Python exception. A call that takes long releases the interpreter.

mod arrays;
mod batch;
mod benchmark;
mod bound;
mod export;
mod flight;
mod interrupt;
mod mission;
mod planner;
mod policy;
mod slots;
mod threads;

use pyo3::prelude::*;

#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("USERS_MAX", firmware_core::USERS_MAX)?;
    module.add("SENSORS_MAX", firmware_core::SENSORS_MAX)?;
    module.add("SHIPPED", mission::SHIPPED)?;
    module.add_class::<mission::Mission>()?;
    module.add_class::<batch::Batch>()?;
    module.add_class::<planner::Planner>()?;
    module.add_class::<policy::Policy>()?;
    module.add_class::<benchmark::BenchmarkBounds>()?;
    module.add_class::<benchmark::BenchmarkFlights>()?;
    module.add("HAS_TRACT", cfg!(feature = "onnx"))?;
    module.add_function(wrap_pyfunction!(benchmark::benchmark_missions, module)?)?;
    module.add_function(wrap_pyfunction!(benchmark::benchmark_fly, module)?)?;
    module.add_function(wrap_pyfunction!(export::write_onnx, module)?)?;
    module.add_function(wrap_pyfunction!(slots::solve_slots, module)?)?;
    module.add_function(wrap_pyfunction!(bound::certified_bound, module)?)?;
    module.add_function(wrap_pyfunction!(policy::load_policy, module)?)?;
    module.add_function(wrap_pyfunction!(flight::fly, module)?)?;
    Ok(())
}

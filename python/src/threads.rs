//! The threads of parallel calls: pools that are shared by all that ask for as many threads. A
//! process that was forked has none of its parent's threads and makes pools of its own.

use std::{
    collections::HashMap,
    num::NonZero,
    process,
    sync::{Arc, Mutex, PoisonError},
    thread,
};

use pyo3::{exceptions::PyOSError, prelude::*};
use rayon::{ThreadPool, ThreadPoolBuilder};

/// The largest number of threads.
pub(crate) const THREADS_MAX: usize = 256;

/// Pools by process and number of threads.
type Pools = HashMap<(u32, usize), Arc<ThreadPool>>;

static POOLS: Mutex<Option<Pools>> = Mutex::new(None);

/// Returns the number of threads for what the user asked for: all of the machine for `None`.
pub(crate) fn count(threads: Option<usize>) -> usize {
    let available = || thread::available_parallelism().map_or(1, NonZero::get);
    threads.unwrap_or_else(available).clamp(1, THREADS_MAX)
}

/// Returns the pool with this number of threads.
pub(crate) fn pool(threads: usize) -> PyResult<Arc<ThreadPool>> {
    let mut pools = POOLS.lock().unwrap_or_else(PoisonError::into_inner);
    let pools = pools.get_or_insert_with(HashMap::new);
    let key = (process::id(), threads);
    if let Some(pool) = pools.get(&key) {
        return Ok(Arc::clone(pool));
    }
    let pool = ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|error| PyOSError::new_err(error.to_string()))?;
    let pool = Arc::new(pool);
    pools.insert(key, Arc::clone(&pool));
    Ok(pool)
}

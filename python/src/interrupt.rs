//! Long calls: they release the interpreter, and Ctrl-C ends them.

use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc::{self, RecvTimeoutError},
    },
    thread,
    time::Duration,
};

use pyo3::{exceptions::PyRuntimeError, prelude::*};

/// The time between two looks at the signals.
const INTERVAL: Duration = Duration::from_millis(50);

/// Runs `work` on another thread and returns its result. `work` receives a flag that asks it to
/// stop; it is set if a signal arrives whose Python handler raises, and that exception is the error.
pub(crate) fn run<R: Send>(
    py: Python<'_>,
    work: impl FnOnce(&AtomicBool) -> R + Send,
) -> PyResult<R> {
    py.detach(|| {
        let stop = AtomicBool::new(false);
        let (sender, receiver) = mpsc::channel();
        thread::scope(|scope| {
            let worker = scope.spawn(|| {
                // The receiver waits as long as there is a sender.
                let _ = sender.send(work(&stop));
                drop(sender);
            });
            let mut interrupted = None;
            let result = loop {
                match receiver.recv_timeout(INTERVAL) {
                    Ok(result) => break Some(result),
                    Err(RecvTimeoutError::Disconnected) => break None,
                    Err(RecvTimeoutError::Timeout) if interrupted.is_none() => {
                        if let Err(error) = Python::attach(|py| py.check_signals()) {
                            stop.store(true, Ordering::Relaxed);
                            interrupted = Some(error);
                        }
                    }
                    Err(RecvTimeoutError::Timeout) => {}
                }
            };
            let ended = worker.join();
            match (interrupted, result, ended) {
                (Some(error), ..) => Err(error),
                (None, Some(result), Ok(())) => Ok(result),
                _ => Err(PyRuntimeError::new_err(
                    "internal error: the calculation panicked",
                )),
            }
        })
    })
}

//! Counts ctrl-C (and SIGTERM) for the whole process.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, OnceLock};

/// The number of times the process was asked to end.
static PRESSES: AtomicU32 = AtomicU32::new(0);
/// The number of the press that ends the process at once.
static LAST: AtomicU32 = AtomicU32::new(2);
/// The exit code of a process that was ended by ctrl-C.
pub const EXIT_CODE: u8 = 130;

/// Returns a flag that is set at the first ctrl-C (or SIGTERM). A second one ends the process at
/// once.
pub fn flag() -> Arc<AtomicBool> {
    static FLAG: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    let flag = FLAG.get_or_init(|| {
        let flag = Arc::new(AtomicBool::new(false));
        let inner = Arc::clone(&flag);
        // This fails only if a handler exists already; then that handler acts.
        let _ = ctrlc::set_handler(move || {
            inner.store(true, Ordering::Relaxed);
            let press = PRESSES.fetch_add(1, Ordering::Relaxed) + 1;
            if press >= LAST.load(Ordering::Relaxed) {
                std::process::exit(EXIT_CODE.into());
            }
        });
        flag
    });
    Arc::clone(flag)
}

/// The number of times ctrl-C was pressed. Only the third press ends the process at once: the
/// caller handles the first and the second.
#[derive(Debug)]
pub struct Presses(());

impl Presses {
    /// Starts counting.
    pub fn watch() -> Self {
        LAST.store(3, Ordering::Relaxed);
        let _ = flag();
        Self(())
    }

    /// Returns the number of presses so far.
    pub fn count(&self) -> u32 {
        PRESSES.load(Ordering::Relaxed)
    }
}

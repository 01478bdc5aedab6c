//! Ctrl-C (and SIGTERM), counted in one place.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, OnceLock};

/// How often the process was asked to end.
static PRESSES: AtomicU32 = AtomicU32::new(0);
/// The press that ends the process at once.
static LAST: AtomicU32 = AtomicU32::new(2);
/// The exit code of a process that was ended by ctrl-C.
pub const EXIT_CODE: u8 = 130;

/// A flag that is set at the first ctrl-C (or SIGTERM). A second one ends the process at once.
pub fn flag() -> Arc<AtomicBool> {
    static FLAG: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    let flag = FLAG.get_or_init(|| {
        let flag = Arc::new(AtomicBool::new(false));
        let inner = Arc::clone(&flag);
        // Fails only where a handler exists already; then ctrl-C does what that one says.
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

/// How often ctrl-C was pressed. Only the third press ends the process at once: the caller sees to
/// the first and the second.
#[derive(Debug)]
pub struct Presses(());

impl Presses {
    /// Counts from the start of the process.
    pub fn watch() -> Self {
        LAST.store(3, Ordering::Relaxed);
        let _ = flag();
        Self(())
    }

    /// Presses so far.
    pub fn count(&self) -> u32 {
        PRESSES.load(Ordering::Relaxed)
    }
}

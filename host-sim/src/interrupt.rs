//! Ctrl-C, asked for in one place.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

/// A flag that is set at the first ctrl-C (or SIGTERM). A second one ends the process at once.
pub fn flag() -> Arc<AtomicBool> {
    static FLAG: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    let flag = FLAG.get_or_init(|| {
        let flag = Arc::new(AtomicBool::new(false));
        let inner = Arc::clone(&flag);
        // Fails only where a handler exists already; then ctrl-C does what that one says.
        let _ = ctrlc::set_handler(move || {
            if inner.swap(true, Ordering::Relaxed) {
                std::process::exit(130);
            }
        });
        flag
    });
    Arc::clone(flag)
}

//! An advisory lock that excludes other processes from a run.
//!
//! The operating system releases the lock when the process ends, however it ends, so a killed process
//! leaves nothing behind. The file itself stays: deleting it would let two processes lock two files of
//! one name.

use std::{
    fs::{File, TryLockError},
    io,
    path::Path,
};

use anyhow::{Context, Error};

/// The name of the lock file in the directory of a run.
pub const LOCK: &str = "run.lock";

/// A lock on a run, which is released when it is dropped.
#[derive(Debug)]
pub struct RunLock(#[expect(dead_code, reason = "it is held, not used")] File);

impl RunLock {
    /// Locks the run in this directory; returns `None` if another process has locked it. On a file
    /// system without locks this only prints a warning.
    ///
    /// # Errors
    /// Fails if the file cannot be created or locked.
    pub fn try_exclusive(directory: &Path) -> anyhow::Result<Option<Self>> {
        let path = directory.join(LOCK);
        let file = File::options().create(true).append(true).open(&path);
        let file = file.with_context(|| path.display().to_string())?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Self(file))),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) if error.kind() == io::ErrorKind::Unsupported => {
                eprintln!(
                    "warning: {}: the file system has no locks: nothing keeps two processes from \
                     executing this run at the same time",
                    path.display()
                );
                Ok(Some(Self(file)))
            }
            Err(TryLockError::Error(error)) => {
                Err(Error::new(error).context(format!("{}: cannot be locked", path.display())))
            }
        }
    }

    /// Returns whether another process has locked the run in this directory.
    pub fn is_taken(directory: &Path) -> bool {
        // A shared lock, so that two processes that only look do not see each other.
        let file = File::open(directory.join(LOCK));
        file.is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_lock_waits_for_the_first() {
        let folder = tempfile::tempdir().unwrap();
        assert!(!RunLock::is_taken(folder.path()));
        let first = RunLock::try_exclusive(folder.path()).unwrap();
        assert!(first.is_some());
        assert!(RunLock::is_taken(folder.path()));
        assert!(RunLock::try_exclusive(folder.path()).unwrap().is_none());
        drop(first);
        assert!(!RunLock::is_taken(folder.path()));
        assert!(RunLock::try_exclusive(folder.path()).unwrap().is_some());
    }

    #[test]
    fn a_folder_that_does_not_exist_is_an_error() {
        let problem = RunLock::try_exclusive(Path::new("no/such")).unwrap_err();
        assert!(problem.to_string().contains("run.lock"), "{problem}");
    }
}

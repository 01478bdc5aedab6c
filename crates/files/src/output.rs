//! Writes files that appear completely or not at all.

use std::{
    fs::File,
    io::{self, Write},
    path::{Path, PathBuf},
};

use tempfile::{Builder, NamedTempFile, TempPath};

/// Writes a file so that a reader, also after a crash, sees either the old or the new content.
///
/// # Errors
/// Returns an error if the file cannot be written. The old content is then unchanged.
pub fn write(path: &Path, content: &[u8]) -> io::Result<()> {
    Draft::write(path, content)?.publish()
}

/// A file that is complete on the disk but does not have its final name yet. It is deleted when it
/// is dropped.
#[derive(Debug)]
pub struct Draft {
    content: TempPath,
    path: PathBuf,
}

impl Draft {
    /// Writes the content to a temporary file in the folder of `path`.
    ///
    /// # Errors
    /// Returns an error if the folder is not writable or the disk is full.
    pub fn write(path: &Path, content: &[u8]) -> io::Result<Self> {
        let mut file = hidden(folder(path))?;
        file.write_all(content)?;
        file.as_file().sync_all()?;
        Ok(Self {
            content: file.into_temp_path(),
            path: path.to_owned(),
        })
    }

    /// Gives the file its final name. An older file of that name is replaced.
    ///
    /// # Errors
    /// Returns an error if the name cannot be used, for example because a folder has it.
    pub fn publish(self) -> io::Result<()> {
        self.content
            .persist(&self.path)
            .map_err(|failed| failed.error)?;
        // The new name itself must reach the disk as well. Not every file system supports such a
        // request.
        let _ = File::open(folder(&self.path)).and_then(|folder| folder.sync_all());
        Ok(())
    }
}

/// Checks that a file can be written into a folder.
///
/// # Errors
/// Returns the error of the attempt.
pub fn probe(folder: &Path) -> io::Result<()> {
    hidden(folder).map(drop)
}

/// Returns the folder of a file.
pub fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}

/// Creates a temporary file with the permissions of an ordinary file.
fn hidden(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = Builder::new();
    builder.prefix(".").suffix(".partial");
    #[cfg(unix)]
    {
        use std::{fs::Permissions, os::unix::fs::PermissionsExt};
        // These are the permissions before the umask is applied.
        builder.permissions(Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name());
        names.map(|name| name.into_string().unwrap()).collect()
    }

    #[test]
    fn the_old_file_stays_until_the_new_one_is_published() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write(&path, b"old").unwrap();
        let draft = Draft::write(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        draft.publish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        drop(Draft::write(&path, b"never").unwrap());
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["a.txt"]);
    }

    #[test]
    fn what_cannot_be_written_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("taken");
        fs::create_dir(&taken).unwrap();
        assert!(write(&taken, b"x").is_err());
        assert!(write(&folder.path().join("no/such/folder"), b"x").is_err());
        assert!(probe(&folder.path().join("no")).is_err());
        probe(folder.path()).unwrap();
        assert_eq!(names(folder.path()), ["taken"]);
    }

    #[cfg(unix)]
    #[test]
    fn a_file_has_the_permissions_of_any_other() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let [ours, other] = ["ours", "other"].map(|name| folder.path().join(name));
        write(&ours, b"x").unwrap();
        fs::write(&other, b"x").unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&other));
    }
}

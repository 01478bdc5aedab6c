//! Files that appear whole or not at all.

use std::{
    fs::File,
    io::{self, Write},
    path::{Path, PathBuf},
};

use tempfile::{Builder, NamedTempFile, TempPath};

/// Writes a file so that a reader, or a crash, sees the old one or the new one.
///
/// # Errors
/// The file cannot be written; what was there stays.
pub fn write(path: &Path, content: &[u8]) -> io::Result<()> {
    Draft::write(path, content)?.publish()
}

/// A file that is complete on the disk and does not have its name yet. Dropping it deletes it.
#[derive(Debug)]
pub struct Draft {
    content: TempPath,
    path: PathBuf,
}

impl Draft {
    /// Writes the content beside the place where the file is to be.
    ///
    /// # Errors
    /// The folder cannot be written, or the disk is full.
    pub fn write(path: &Path, content: &[u8]) -> io::Result<Self> {
        let mut file = hidden(folder(path))?;
        file.write_all(content)?;
        file.as_file().sync_all()?;
        Ok(Self {
            content: file.into_temp_path(),
            path: path.to_owned(),
        })
    }

    /// Gives the file its name, in place of an older file of that name.
    ///
    /// # Errors
    /// The name cannot be taken, by a folder that has it, for one.
    pub fn publish(self) -> io::Result<()> {
        self.content
            .persist(&self.path)
            .map_err(|failed| failed.error)?;
        // The new name itself has to reach the disk; not every file system lets one ask.
        let _ = File::open(folder(&self.path)).and_then(|folder| folder.sync_all());
        Ok(())
    }
}

/// Fails if no file can be written into a folder.
///
/// # Errors
/// That of the attempt.
pub fn probe(folder: &Path) -> io::Result<()> {
    hidden(folder).map(drop)
}

fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}

/// A temporary file with the permissions of any other file.
fn hidden(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = Builder::new();
    builder.prefix(".").suffix(".partial");
    #[cfg(unix)]
    {
        use std::{fs::Permissions, os::unix::fs::PermissionsExt};
        // As far as the umask allows.
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

//! One process at a time reads a file, changes it and writes it.

use std::fs::{self, File, Metadata, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use same_file::Handle;

/// A file that this process will replace by a changed one, or a directory in which it works.
///
/// The lock is on the file itself and not on one beside it. A file that was replaced while this process waited
/// is another file, which is locked in its turn. The operating system takes the lock away with the process,
/// however that ends, so that nothing remains which could block.
#[derive(Debug)]
pub struct Claim {
    path: PathBuf,
    held: Handle,
    stamp: Stamp,
    exclusion: Exclusion,
}

/// How others are kept away.
#[derive(Debug)]
pub enum Exclusion {
    /// By a lock.
    Locked,
    /// By nothing, as the file system has no locks; it says so. [`Claim::is_current`] notices what they did.
    Watched(io::Error),
}

/// What differs after another has written the file in its place.
#[derive(Debug, PartialEq)]
struct Stamp {
    size: u64,
    modified: Option<SystemTime>,
}

impl Stamp {
    fn of(metadata: &Metadata) -> Stamp {
        Stamp { size: metadata.len(), modified: metadata.modified().ok() }
    }
}

impl Claim {
    /// Claims what is at `path`; `wait` is called before this process waits for another one.
    ///
    /// # Errors
    /// A file cannot be opened for reading and writing, a directory not for reading.
    pub fn take(path: &Path, wait: impl FnOnce()) -> io::Result<Claim> {
        let mut wait = Some(wait);
        let wait = &mut || wait.take().map_or((), |wait| wait());
        Claim::take_by(path, &mut |file| lock(file, wait))
    }

    fn take_by(path: &Path, lock: &mut dyn FnMut(&File) -> Exclusion) -> io::Result<Claim> {
        loop {
            // Some network file systems lock only what is open for writing.
            let file = File::options().read(true).write(!path.is_dir()).open(path)?;
            let held = Handle::from_file(file)?;
            let exclusion = lock(held.as_file());
            let stamp = Stamp::of(&held.as_file().metadata()?);
            let claim = Claim { path: path.to_owned(), held, stamp, exclusion };
            if claim.is_current()? {
                return Ok(claim);
            }
        }
    }

    /// Whether the path still leads to the file as it was when it was claimed.
    ///
    /// # Errors
    /// What the file system says.
    pub fn is_current(&self) -> io::Result<bool> {
        let found = Handle::from_path(&self.path)?;
        Ok(found == self.held && Stamp::of(&fs::metadata(&self.path)?) == self.stamp)
    }

    /// How others are kept away.
    #[must_use]
    pub fn exclusion(&self) -> &Exclusion {
        &self.exclusion
    }
}

fn lock(file: &File, wait: &mut dyn FnMut()) -> Exclusion {
    let locked = match file.try_lock() {
        Err(TryLockError::WouldBlock) => {
            wait();
            file.lock()
        }
        Err(TryLockError::Error(error)) => Err(error),
        Ok(()) => Ok(()),
    };
    locked.map_or_else(Exclusion::Watched, |()| Exclusion::Locked)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::write_whole;

    const THREADS: usize = 8;
    const ROUNDS: usize = 20;

    /// Adds a byte to a file.
    fn lengthen(path: &Path) {
        let claim = Claim::take(path, || ()).unwrap();
        assert!(matches!(claim.exclusion(), Exclusion::Locked));
        let mut bytes = fs::read(path).unwrap();
        bytes.push(b'x');
        assert!(claim.is_current().unwrap());
        write_whole(path, &bytes).unwrap();
        assert!(!claim.is_current().unwrap());
    }

    #[test]
    fn no_change_of_many_at_once_is_lost() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(&path, "").unwrap();
        std::thread::scope(|scope| {
            for _ in 0..THREADS {
                scope.spawn(|| (0..ROUNDS).for_each(|_| lengthen(&path)));
            }
        });
        assert_eq!(fs::metadata(&path).unwrap().len(), (THREADS * ROUNDS) as u64);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "a lock leaves no file");
    }

    #[test]
    fn what_another_did_without_a_lock_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        for change in [b"longer".as_slice(), b"other"] {
            fs::write(&path, "first").unwrap();
            let refuses = |_: &File| Exclusion::Watched(io::ErrorKind::Unsupported.into());
            let claim = Claim::take_by(&path, &mut { refuses }).unwrap();
            assert!(claim.is_current().unwrap() && matches!(claim.exclusion(), Exclusion::Watched(_)));
            write_whole(&path, change).unwrap();
            assert!(!claim.is_current().unwrap());
        }
        fs::remove_file(&path).unwrap();
        assert!(Claim::take(&path, || ()).is_err());
        let directory = Claim::take(folder.path(), || ()).unwrap();
        assert!(matches!(directory.exclusion(), Exclusion::Locked));
    }
}

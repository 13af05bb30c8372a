//! Writing a file whole or not at all.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

/// The name under which the standard output can be written.
pub const STANDARD_OUTPUT: &str = "/dev/stdout";

/// Its other names.
const STANDARD_OUTPUTS: [&str; 3] = [STANDARD_OUTPUT, "/dev/fd/1", "/proc/self/fd/1"];

/// As many symbolic links are followed as Linux follows.
const MAX_LINKS: usize = 40;

/// What is written under a path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// A file, there already or not; the path leads to it through no symbolic link of its own.
    File(PathBuf),
    /// The standard output of this process, whatever it leads to.
    StandardOutput,
    /// A pipe or a device.
    Stream(PathBuf),
}

impl Place {
    /// Where `path` leads.
    ///
    /// # Errors
    /// It is a directory, or what the file system says.
    pub fn of(path: &Path) -> io::Result<Place> {
        if STANDARD_OUTPUTS.iter().any(|name| path == Path::new(name)) {
            return Ok(Place::StandardOutput);
        }
        match fs::metadata(path) {
            Ok(found) if found.is_dir() => Err(is_directory()),
            Ok(found) if found.is_file() => Ok(Place::File(path.canonicalize()?)),
            Ok(_) => Ok(Place::Stream(path.to_owned())),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(Place::File(end_of_links(path)?)),
            Err(error) => Err(error),
        }
    }
}

fn is_directory() -> io::Error {
    io::Error::new(ErrorKind::IsADirectory, "it is a directory")
}

/// What a path to nothing would be the file of: a symbolic link may come before its target.
fn end_of_links(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..MAX_LINKS {
        let is_directory_name = path.as_os_str().as_encoded_bytes().ends_with(b"/");
        if path.file_name().is_none() || is_directory_name {
            return Err(is_directory());
        }
        match fs::read_link(&path) {
            Ok(target) => path = directory_of(&path).join(target),
            Err(_) => return Ok(path),
        }
    }
    Err(io::Error::other("its symbolic links have no end"))
}

/// Writes `bytes` to `path`: whole, or not at all.
///
/// They go to a temporary file beside the target, to the disk, and only then to the target's place, so that a
/// full disk, an end of the process or a power cut leaves the old file or the new one. Symbolic links are
/// followed; mode and owner of an old file stay, the owner where that is permitted. Pipes, devices and the
/// standard output are written straight.
///
/// # Errors
/// Whatever the file system says; that `path` is a directory, or a file that must not be written.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    match Place::of(path)? {
        Place::File(file) => replace(&file, bytes),
        Place::StandardOutput => {
            let mut output = io::stdout().lock();
            output.write_all(bytes).and_then(|()| output.flush())
        }
        // A reader of a pipe may have asked for some of it only: nothing is cut off.
        Place::Stream(stream) => OpenOptions::new().append(true).open(stream)?.write_all(bytes),
    }
}

/// Finds out whether [`write_whole`] could write `path`, and leaves all as it is.
///
/// # Errors
/// Those of [`write_whole`] that can be foreseen.
pub fn probe(path: &Path) -> io::Result<Place> {
    let place = Place::of(path)?;
    if let Place::File(file) = &place {
        old(file)?;
        temporary(directory_of(file))?.close()?;
    }
    Ok(place)
}

fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let old = old(path)?;
    let directory = directory_of(path);
    let mut part = temporary(directory)?;
    part.write_all(bytes)?;
    if let Some(old) = old {
        keep_owner_and_mode(part.as_file(), &old)?;
    }
    part.as_file().sync_all()?;
    part.persist(path)?;
    sync_directory(directory)
}

/// The file that is replaced, if there is one. One that must not be written must not be replaced either.
fn old(path: &Path) -> io::Result<Option<Metadata>> {
    match OpenOptions::new().write(true).open(path) {
        Ok(file) => file.metadata().map(Some),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// A file that is removed unless it gets a name. Its own begins with a dot and ends like that of no format, so
/// that no search for inputs finds what a crash has left.
fn temporary(directory: &Path) -> io::Result<NamedTempFile> {
    // The error of a directory that is not there needs no name of a temporary file.
    fs::metadata(directory)?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(".glimt-").suffix(".part");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // As any new file: the umask takes away what the user does not want.
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(directory)
}

fn directory_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

fn keep_owner_and_mode(file: &File, old: &Metadata) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, fchown};
        // Only root gives files away; a member of the group may keep the group. A change of owner drops bits
        // of the mode, which therefore comes after it.
        let group = Some(old.gid());
        let _ = fchown(file, Some(old.uid()), group).or_else(|_| fchown(file, None, group));
    }
    file.set_permissions(old.permissions())
}

/// A name is on the disk once its directory is.
fn sync_directory(directory: &Path) -> io::Result<()> {
    if cfg!(not(unix)) {
        return Ok(());
    }
    match File::open(directory).and_then(|directory| directory.sync_all()) {
        // Some network file systems have no such call, and a directory may be one that is written and not read.
        Err(error)
            if matches!(
                error.kind(),
                ErrorKind::InvalidInput | ErrorKind::Unsupported | ErrorKind::PermissionDenied
            ) =>
        {
            Ok(())
        }
        synced => synced,
    }
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};

    use super::*;

    fn names(directory: &Path) -> Vec<String> {
        let name = |item: io::Result<fs::DirEntry>| item.unwrap().file_name().into_string().unwrap();
        let mut names: Vec<String> = fs::read_dir(directory).unwrap().map(name).collect();
        names.sort();
        names
    }

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).unwrap().mode() & 0o7777
    }

    #[test]
    fn a_new_file_has_the_mode_of_any_new_file() {
        let folder = tempfile::tempdir().unwrap();
        let [ours, plain] = ["ours", "plain"].map(|name| folder.path().join(name));
        write_whole(&ours, b"bytes").unwrap();
        fs::write(&plain, b"bytes").unwrap();
        assert_eq!(fs::read(&ours).unwrap(), b"bytes");
        assert_eq!(mode(&ours), mode(&plain));
        assert_eq!(names(folder.path()), ["ours", "plain"]);
    }

    #[test]
    fn mode_and_owner_of_the_old_file_stay() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(&path, b"old").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
        // Only root can make the case; for others the owner is their own.
        let _ = std::os::unix::fs::chown(&path, Some(12345), Some(12346));
        let owner = |path: &Path| fs::metadata(path).map(|found| (found.uid(), found.gid())).unwrap();
        let before = owner(&path);
        write_whole(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(mode(&path), 0o640);
        assert_eq!(owner(&path), before);
    }

    #[test]
    fn symbolic_links_are_followed_to_a_file_that_is_there_or_not() {
        let folder = tempfile::tempdir().unwrap();
        let other = folder.path().join("other");
        fs::create_dir(&other).unwrap();
        let link = folder.path().join("link");
        symlink("other/second", &link).unwrap();
        symlink("target", other.join("second")).unwrap();
        for bytes in [b"first", b"again"] {
            write_whole(&link, bytes).unwrap();
            assert_eq!(fs::read(other.join("target")).unwrap(), bytes);
        }
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(names(&other), ["second", "target"]);
        let ring = folder.path().join("ring");
        symlink("ring", &ring).unwrap();
        assert!(write_whole(&ring, b"bytes").is_err());
    }

    #[test]
    fn what_cannot_be_written_stays_and_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let message = write_whole(folder.path(), b"bytes").unwrap_err().to_string();
        assert!(message.contains("it is a directory"), "{message}");
        assert!(write_whole(&folder.path().join("new/"), b"bytes").is_err());
        assert!(write_whole(&folder.path().join("missing/file"), b"bytes").is_err());
        assert!(probe(&folder.path().join("missing/file")).is_err());
        assert!(names(folder.path()).is_empty());
        let path = folder.path().join("file");
        assert_eq!(probe(&path).unwrap(), Place::File(path));
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn devices_are_written_straight() {
        assert_eq!(Place::of(Path::new("/dev/null")).unwrap(), Place::Stream("/dev/null".into()));
        write_whole(Path::new("/dev/null"), b"bytes").unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
        assert_eq!(Place::of(Path::new("/dev/stdout")).unwrap(), Place::StandardOutput);
        if Path::new("/dev/full").exists() {
            assert_eq!(
                write_whole(Path::new("/dev/full"), b"bytes").unwrap_err().kind(),
                ErrorKind::StorageFull
            );
        }
    }
}

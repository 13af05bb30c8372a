//! Whole files in and out, with errors that name them.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

use glimt_disk::write_whole;

use crate::error::Error;

/// Opens a file, which a pipe or a device is not: those may have no end.
///
/// # Errors
/// Whatever the file system says, and that `path` is no regular file.
pub fn open_regular(path: &Path) -> io::Result<File> {
    // Before it is opened: that waits for whoever writes to a pipe.
    let kind = fs::metadata(path)?.file_type();
    if !kind.is_file() && !kind.is_dir() {
        return Err(io::Error::other("it is not a regular file"));
    }
    File::open(path)
}

/// Reads a whole file.
///
/// # Errors
/// Those of [`open_regular`].
pub fn read_regular(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open_regular(path)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// [`read_regular`], with an error that names the file.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>, Error> {
    read_regular(path).map_err(|source| Error::Read { path: path.to_owned(), source })
}

/// Reads the first `size` bytes of a file, and says how many follow; a shorter file is an error.
pub(crate) fn read_first(path: &Path, size: usize, what: &str) -> Result<(Vec<u8>, usize), Error> {
    let (found, bytes) = read_start(path, size as u64)?;
    if bytes.len() < size {
        return Err(Error::size(path, bytes.len(), size, what));
    }
    Ok((bytes, found.saturating_sub(size as u64) as usize))
}

/// The length of a file and its first bytes, at most `count`.
pub(crate) fn read_start(path: &Path, count: u64) -> Result<(u64, Vec<u8>), Error> {
    let read = || {
        let file = open_regular(path)?;
        let size = file.metadata()?.len();
        let mut start = Vec::new();
        file.take(count).read_to_end(&mut start)?;
        Ok((size, start))
    };
    read().map_err(|source| Error::Read { path: path.to_owned(), source })
}

/// Writes a file: whole, or not at all.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    write_whole(path, bytes).map_err(|source| Error::Write { path: path.to_owned(), source })
}

/// The file's name without directory and extension.
pub(crate) fn stem(path: &Path) -> String {
    path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Little-endian doubles; the first that is not finite is an error that names the `table`.
pub(crate) fn doubles<'a>(
    path: &'a Path,
    bytes: &'a [u8],
    table: &'a str,
) -> impl Iterator<Item = Result<f64, Error>> + 'a {
    bytes.chunks_exact(8).enumerate().map(move |(index, b)| {
        let value = f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]);
        if value.is_finite() {
            Ok(value)
        } else {
            let found = format!("{value} at index {index}");
            Err(Error::invalid(path, table, found, "finite numbers"))
        }
    })
}

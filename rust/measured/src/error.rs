//! What can go wrong with a measured file. Every message names the file, what was found and what was expected.

use std::io;
use std::path::{Path, PathBuf};

/// Why a measured file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system would not let the file be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// The operating system would not let the file be written.
    #[error("{}: cannot be written: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// Neither content nor file name fits a format that is known here.
    #[error(
        "{}: not a measured BRDF: found {found}, expected an RGL tensor file (.bsdf), \
         a MERL table (.binary) or a UTIA table (.bin)",
        path.display()
    )]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// Its size and first bytes.
        found: String,
    },
    /// The file has another length than its format or its own header says.
    #[error("{}: {found} bytes, expected {expected} ({what})", path.display())]
    Size {
        /// The file.
        path: PathBuf,
        /// Length of the file in bytes.
        found: u64,
        /// Length that it should have.
        expected: u64,
        /// What the expected length follows from.
        what: String,
    },
    /// A header, a field or a value is not what the format allows.
    #[error("{}: {what}: found {found}, expected {expected}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// The part of the file in question.
        what: String,
        /// What stands there.
        found: String,
        /// What should stand there.
        expected: String,
    },
}

impl Error {
    pub(crate) fn invalid(
        path: &Path,
        what: impl Into<String>,
        found: impl ToString,
        expected: impl Into<String>,
    ) -> Error {
        Error::Invalid {
            path: path.to_owned(),
            what: what.into(),
            found: found.to_string(),
            expected: expected.into(),
        }
    }

    pub(crate) fn size(path: &Path, found: usize, expected: usize, what: &str) -> Error {
        Error::Size {
            path: path.to_owned(),
            found: found as u64,
            expected: expected as u64,
            what: what.to_owned(),
        }
    }
}

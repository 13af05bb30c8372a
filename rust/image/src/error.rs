//! What can go wrong with image files.

use std::path::PathBuf;

/// An error of an image file; every message names the file.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file is no OpenEXR image, or not one that can be used.
    #[error("cannot read {} as OpenEXR: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What was found and what was expected.
        reason: String,
    },
    /// The file cannot be written.
    #[error("cannot write {}: {reason}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
}

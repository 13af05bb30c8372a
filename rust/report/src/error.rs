//! What can go wrong with images.

use std::path::PathBuf;

/// An error of image files and of comparing them; every message names the file or the images' sizes.
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
    /// Images that are compared have different sizes.
    #[error("the images have {} × {} and {} × {} pixels; only images of one size can be compared", .0[0], .0[1], .1[0], .1[1])]
    Sizes([usize; 2], [usize; 2]),
}

//! What can go wrong with a fit.

use std::path::PathBuf;

/// An error of a fit.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The options make no sense together, or with the materials.
    #[error("{0}")]
    Options(String),
    /// A loss or a number became infinite or NaN.
    #[error("the fit diverged at step {step}: a number is no longer finite; a lower --rate helps")]
    Diverged {
        /// The step.
        step: u64,
    },
    /// Nothing can be fitted to a material.
    #[error("nothing can be fitted to the material \"{name}\": {reason}")]
    Material {
        /// The material.
        name: String,
        /// What was found.
        reason: String,
    },
    /// A material of a library cannot be read.
    #[error(transparent)]
    Library(#[from] glimt_core::Error),
    /// The checkpoint cannot be read or written.
    #[error("checkpoint {}: {reason}", path.display())]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// What was found and what was expected.
        reason: String,
    },
}

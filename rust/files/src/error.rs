//! What can go wrong with a file. Every message names it.

use std::io;
use std::path::{Path, PathBuf};

/// Why a file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An error of a model library.
    #[error(transparent)]
    Library(#[from] glimt_core::Error),
    /// An error of a measured file.
    #[error(transparent)]
    Measured(#[from] glimt_measured::Error),
    /// The operating system would not let the file be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// The operating system would not let the file be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// The file is broken, or it holds something else than what was asked for.
    #[error("{} is not {format}: {reason}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What it should have been, with an article.
        format: &'static str,
        /// What was found and what was expected.
        reason: String,
    },
    /// Scattered samples, asked for what only a BRDF can answer.
    #[error(
        "{} holds scattered samples, which say nothing between them; fit a model to them with glimt fit",
        path.display()
    )]
    OnlySamples {
        /// The file.
        path: PathBuf,
    },
    /// Neither content nor file name fits a format that is known here.
    #[error(
        "{}: {found}; expected a model library (.safetensors), an RGL (.bsdf), MERL (.binary) or UTIA (.bin) \
         measurement, scattered samples (.csv, .npy), NBRDF weights (.h5, .npz, or .npy files named *_fc1.npy …), \
         or analytic fits (.fit)",
        path.display()
    )]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// What stands there.
        found: String,
    },
}

impl Error {
    /// An error of reading `path`, for `map_err`.
    pub(crate) fn read(path: &Path) -> impl FnOnce(io::Error) -> Error + '_ {
        |source| Error::Read { path: path.to_owned(), source }
    }
}

/// The beginning of a text of a file, for a message: a file may hold a line of any length.
pub(crate) fn excerpt(text: &str) -> String {
    const MOST: usize = 80;
    match text.char_indices().nth(MOST) {
        Some((end, _)) => format!("{}…", text[..end].escape_debug()),
        None => text.escape_debug().to_string(),
    }
}

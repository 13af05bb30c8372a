//! How libraries and materials travel: into other processes and into files.
//!
//! A model travels as the bytes of a library that holds it, so that whatever a library keeps arrives: edits too. A
//! measurement has megabytes and stays in its file: its absolute path and its digest travel, and the file is read
//! again where they arrive. A material travels as the only one of a library.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::SystemTime;

use glimt_files::{Source, sha256};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyBytes, PyString};

use crate::error;
use crate::library::Library;
use crate::material::parse_sampler;

/// The file that something was read from, as it was then.
pub struct SourceFile {
    path: PathBuf,
    /// Time of the last change, and length.
    state: Option<(SystemTime, u64)>,
    sha256: OnceLock<String>,
}

impl SourceFile {
    /// The file at `path`, before it is read.
    pub fn new(path: &Path) -> Arc<SourceFile> {
        // The process that reads it again may be in another directory.
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        Arc::new(SourceFile { state: state(&path), path, sha256: OnceLock::new() })
    }

    /// Where it is, absolute.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// SHA-256 of what was read.
    ///
    /// # Errors
    /// `glimt.Error` if the file has changed since, or is gone.
    fn sha256(&self) -> PyResult<&str> {
        if let Some(known) = self.sha256.get() {
            return Ok(known);
        }
        let found = sha256(&self.path).map_err(error)?;
        if state(&self.path) != self.state {
            return Err(error(format!(
                "{} has changed since it was loaded, and a pickled measurement stays in its file; load it again",
                self.path.display()
            )));
        }
        Ok(self.sha256.get_or_init(|| found))
    }
}

fn state(path: &Path) -> Option<(SystemTime, u64)> {
    fs::metadata(path).ok().and_then(|file| Some((file.modified().ok()?, file.len())))
}

/// What restores a library: where it was read from, its bytes or else the digest of the file, and its sampler.
pub type State<'py> = (PathBuf, Bound<'py, PyAny>, Option<String>);

/// What pickle is told: the function that restores a library, and its arguments.
///
/// # Errors
/// Those of [`SourceFile::sha256`].
pub fn reduce<'py>(py: Python<'py>, library: &Library) -> PyResult<(Bound<'py, PyAny>, State<'py>)> {
    let held = library.source.library().ok();
    let bytes = held.map(|held| held.to_bytes()).transpose().map_err(error)?;
    let (path, content) = match bytes.flatten() {
        Some(bytes) => (library.source.path(), PyBytes::new(py, &bytes).into_any()),
        None => (library.file.path(), PyString::new(py, library.file.sha256()?).into_any()),
    };
    let sampler = library.sampler.map(|choice| choice.to_string());
    // By its name in the module pickle finds it again.
    let restore = py.import("glimt._native")?.getattr("_restore_library")?;
    Ok((restore, (path.to_owned(), content, sampler)))
}

/// The second part of a [`State`].
#[derive(FromPyObject)]
pub enum Content {
    /// SHA-256 of the file.
    File(String),
    /// A library's bytes.
    Library(PyBackedBytes),
}

impl Content {
    /// # Errors
    /// `glimt.Error` if the file is not the one that was pickled, and all of [`Source::open`].
    fn source(&self, path: &Path) -> PyResult<(Source, Arc<SourceFile>)> {
        let file = SourceFile::new(path);
        let source = match self {
            Content::Library(bytes) => {
                Source::Library(glimt_core::Library::from_bytes(path, bytes).map_err(error)?)
            }
            Content::File(expected) => {
                let source = Source::open(path).map_err(error)?;
                let found = file.sha256()?;
                if found != expected {
                    return Err(error(format!(
                        "{} is not the file that was pickled: its SHA-256 is {found}, expected {expected}",
                        path.display()
                    )));
                }
                source
            }
        };
        Ok((source, file))
    }
}

/// The library that [`reduce`] described.
#[pyfunction]
pub fn _restore_library(
    py: Python,
    path: PathBuf,
    content: Content,
    sampler: Option<&str>,
) -> PyResult<Library> {
    let sampler = sampler.map(parse_sampler).transpose()?;
    let (source, file) = py.detach(|| content.source(&path))?;
    Ok(Library { source, file, sampler })
}

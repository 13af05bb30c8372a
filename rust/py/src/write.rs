//! Files that Python code writes: whole or not at all, as all of glimt's.

use std::io;
use std::path::{Path, PathBuf};

use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;

/// Raises OSError if `path` cannot be written; leaves all as it is.
#[pyfunction]
pub fn probe(path: PathBuf) -> PyResult<()> {
    glimt_disk::probe(&path).map(drop).map_err(failed(&path))
}

/// Writes a text as UTF-8; the file is whole or as it was.
#[pyfunction]
pub fn write_whole(path: PathBuf, text: &str) -> PyResult<()> {
    glimt_disk::write_whole(&path, text.as_bytes()).map_err(failed(&path))
}

fn failed(path: &Path) -> impl Fn(io::Error) -> PyErr + '_ {
    |error| PyOSError::new_err(format!("cannot write {}: {error}", path.display()))
}

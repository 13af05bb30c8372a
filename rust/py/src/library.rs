//! `glimt.load` and `glimt.Library`.

use std::path::PathBuf;
use std::sync::Arc;

use glimt_core::sampling::SamplerChoice;
use glimt_files::Source;
use pyo3::prelude::*;

use crate::error;
use crate::material::{Material, parse_sampler};
use crate::pickle::{self, Content, SourceFile, State};

/// Opens a model library, a measurement (RGL .bsdf, MERL .binary, UTIA .bin) or NBRDF weights.
///
/// `sampler` gives all materials another sampler, see `Material.with_sampler`.
#[pyfunction]
#[pyo3(signature = (path, *, sampler=None))]
pub fn load(py: Python, path: PathBuf, sampler: Option<&str>) -> PyResult<Library> {
    let sampler = sampler.map(parse_sampler).transpose()?;
    let file = SourceFile::new(&path);
    let source = py.detach(|| Source::open(path)).map_err(error)?;
    Ok(Library { source, file, sampler })
}

/// The materials of a file. Immutable.
#[pyclass(frozen, module = "glimt")]
pub struct Library {
    pub source: Source,
    pub file: Arc<SourceFile>,
    pub sampler: Option<SamplerChoice>,
}

#[pymethods]
impl Library {
    /// Names of the materials in the file's order.
    #[getter]
    fn materials(&self) -> Vec<String> {
        self.source.names()
    }

    /// Model ("hybrid") or measured format ("merl"), as commands spell it.
    #[getter]
    fn kind(&self) -> &'static str {
        self.source.kind()
    }

    /// The file that it was read from.
    #[getter]
    fn path(&self) -> PathBuf {
        self.source.path().to_owned()
    }

    /// The material of that name; the only one if no name is given.
    #[pyo3(signature = (name=None))]
    fn material(&self, py: Python, name: Option<&str>) -> PyResult<Material> {
        py.detach(|| Material::new(&self.source, &self.file, name, self.sampler)).map_err(error)
    }

    /// A material between the two of those names, with a share `weight` in [0, 1] of the second.
    fn mix(&self, py: Python, a: &str, b: &str, weight: f32) -> PyResult<Material> {
        py.detach(|| Material::mixed(&self.source, &self.file, [a, b], weight, self.sampler)).map_err(error)
    }

    fn __getitem__(&self, py: Python, name: &str) -> PyResult<Material> {
        self.material(py, Some(name))
    }

    fn __contains__(&self, name: &str) -> bool {
        self.source.names().iter().any(|other| other == name)
    }

    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Ok(self.materials().into_pyobject(py)?.try_iter()?.into_any())
    }

    fn __len__(&self) -> usize {
        self.source.names().len()
    }

    fn __copy__(slf: Bound<Self>) -> Bound<Self> {
        slf
    }

    fn __deepcopy__<'py>(slf: Bound<'py, Self>, _memo: &Bound<'py, PyAny>) -> Bound<'py, Self> {
        slf
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, State<'py>)> {
        let state = pickle::state_of(py, &self.source, &self.file, self.sampler)?;
        Ok((pickle::restoring(py, "_restore_library")?, state))
    }

    fn __repr__(&self) -> String {
        format!("<glimt.Library {:?}: {} {:?}>", self.source.path(), self.kind(), self.materials())
    }
}

/// The library of a [`State`].
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

/// The material of a [`State`] of a library that holds it alone.
#[pyfunction]
pub fn _restore_material(
    py: Python,
    path: PathBuf,
    content: Content,
    sampler: Option<&str>,
) -> PyResult<Material> {
    _restore_library(py, path, content, sampler)?.material(py, None)
}

//! The Python module `glimt._native`: libraries and materials over NumPy arrays.
//!
//! What users see is described in `plugin/glimt/_native.pyi`.

mod arrays;
mod check;
mod library;
mod material;
mod parallel;
mod pickle;
mod write;

use glimt_disk::printable;
use pyo3::prelude::*;

pyo3::create_exception!(
    glimt,
    Error,
    pyo3::exceptions::PyException,
    "A file that cannot be used, a material that is not there, or a parameter out of its range."
);

/// An error of the libraries as Python's.
fn error(message: impl ToString) -> PyErr {
    Error::new_err(printable(&message.to_string()).into_owned())
}

/// Native part of glimt.
#[pymodule]
fn _native(module: &Bound<PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("Error", module.py().get_type::<Error>())?;
    module.add_class::<library::Library>()?;
    module.add_class::<material::Material>()?;
    module.add_class::<check::CheckReport>()?;
    module.add_function(wrap_pyfunction!(check::check, module)?)?;
    module.add_function(wrap_pyfunction!(write::probe, module)?)?;
    module.add_function(wrap_pyfunction!(write::write_whole, module)?)?;
    module.add_function(wrap_pyfunction!(library::_restore_library, module)?)?;
    module.add_function(wrap_pyfunction!(library::_restore_material, module)?)?;
    module.add_function(wrap_pyfunction!(library::load, module)?)
}

//! NumPy arrays in and out: one direction (3,) or many (n, 3).

use glimt_core::Vec3;
use numpy::{PyArray1, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::IntoPyDict;

/// The rows of an argument, copied: Python may change its array while we compute.
pub struct Directions {
    name: &'static str,
    rows: Vec<Vec3>,
    /// Whether the argument has the shape (3,).
    single: bool,
}

impl Directions {
    /// The rows of `argument`, an array or what NumPy makes one of.
    ///
    /// # Errors
    /// `ValueError` for another shape, and NumPy's own for what is no array of numbers.
    pub fn new(name: &'static str, argument: &Bound<PyAny>) -> PyResult<Directions> {
        let py = argument.py();
        let options = [("dtype", "float32"), ("order", "C")].into_py_dict(py)?;
        let array = py.import("numpy")?.call_method("asarray", (argument,), Some(&options))?;
        let array = array.cast_into::<PyArrayDyn<f32>>()?;
        let single = array.shape() == [3];
        if !single && (array.ndim() != 2 || array.shape()[1] != 3) {
            let shape = array.getattr("shape")?;
            return Err(PyValueError::new_err(format!(
                "{name} has the shape {shape}, expected (3,) or (n, 3)"
            )));
        }
        let array = array.try_readonly()?;
        let rows = array.as_slice()?.chunks_exact(3).map(Vec3::from_slice).collect();
        Ok(Directions { name, rows, single })
    }

    /// Row `index`; a single direction is every row.
    pub fn get(&self, index: usize) -> Vec3 {
        if self.rows.len() == 1 { self.rows[0] } else { self.rows[index] }
    }

    /// All rows.
    pub fn into_rows(self) -> Vec<Vec3> {
        self.rows
    }

    /// `count` rows from `first` on.
    pub fn range(&self, first: usize, count: usize) -> std::borrow::Cow<'_, [Vec3]> {
        if self.rows.len() == 1 {
            vec![self.rows[0]; count].into()
        } else {
            self.rows[first..first + count].into()
        }
    }
}

/// Number of rows of the result for two arguments; `None` if both are single directions.
///
/// # Errors
/// `ValueError` if the arguments have different numbers of rows, and neither has one.
pub fn aligned(a: &Directions, b: &Directions) -> PyResult<Option<usize>> {
    if a.single && b.single {
        return Ok(None);
    }
    match (a.rows.len(), b.rows.len()) {
        (n, m) if n == m => Ok(Some(n)),
        (1, n) | (n, 1) => Ok(Some(n)),
        (n, m) => Err(PyValueError::new_err(format!(
            "{} has {n} rows and {} has {m}; expected as many, or one",
            a.name, b.name
        ))),
    }
}

/// Three numbers for every row of a result.
pub struct Triples {
    shape: Option<usize>,
    values: Vec<f32>,
}

impl Triples {
    /// Zeros in the shape (n, 3), or (3,) for `None`.
    pub fn new(shape: Option<usize>) -> Triples {
        Triples { shape, values: vec![0.0; 3 * shape.unwrap_or(1)] }
    }

    /// The rows.
    pub fn as_mut(&mut self) -> &mut [Vec3] {
        bytemuck::cast_slice_mut(&mut self.values)
    }

    /// The array for Python.
    pub fn into_numpy(self, py: Python) -> PyResult<Bound<PyAny>> {
        let array = PyArray1::from_vec(py, self.values);
        match self.shape {
            Some(rows) => Ok(array.reshape([rows, 3])?.into_any()),
            None => Ok(array.into_any()),
        }
    }
}

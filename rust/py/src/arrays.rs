//! NumPy arrays in and out: one row, such as a direction (3,), or many, (n, 3).

use std::borrow::Cow;

use glimt_core::Vec3;
use glimt_core::surface::{Footprint, Place};
use numpy::{PyArray1, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::IntoPyDict;

/// The rows of an argument, copied: Python may change its array while we compute.
pub struct Rows<T> {
    name: &'static str,
    rows: Vec<T>,
    /// Whether the argument is one row and not an array of rows.
    single: bool,
}

/// One direction (3,) or many (n, 3).
pub type Directions = Rows<Vec3>;

/// One place of a texture (2,) or many (n, 2).
type Uvs = Rows<[f32; 2]>;

/// One footprint or many: deviations () and (n,), or axes (2, 2) and (n, 2, 2).
type Footprints = Rows<Footprint>;

impl<T: Copy> Rows<T> {
    /// Row `index`; a single row is every row.
    pub fn get(&self, index: usize) -> T {
        if self.rows.len() == 1 { self.rows[0] } else { self.rows[index] }
    }

    /// All rows.
    pub fn into_rows(self) -> Vec<T> {
        self.rows
    }

    /// `count` rows from `first` on.
    pub fn range(&self, first: usize, count: usize) -> Cow<'_, [T]> {
        if self.rows.len() == 1 {
            vec![self.rows[0]; count].into()
        } else {
            self.rows[first..first + count].into()
        }
    }

    fn extent(&self) -> Extent {
        Extent { name: self.name, rows: self.rows.len(), single: self.single }
    }
}

impl Directions {
    /// The rows of `argument`, an array or what NumPy makes one of.
    ///
    /// # Errors
    /// `ValueError` for another shape, and NumPy's own for what is no array of numbers.
    pub fn new(name: &'static str, argument: &Bound<PyAny>) -> PyResult<Directions> {
        let array = Array::new(argument)?;
        let single = match array.shape()[..] {
            [3] => true,
            [_, 3] => false,
            _ => return Err(array.refused(name, "(3,) or (n, 3)")),
        };
        let rows = array.read(|numbers| numbers.chunks_exact(3).map(Vec3::from_slice).collect())?;
        Ok(Rows { name, rows, single })
    }
}

impl Uvs {
    /// The rows of `argument`, as [`Directions::new`].
    ///
    /// # Errors
    /// Those of [`Directions::new`].
    fn new(argument: &Bound<PyAny>) -> PyResult<Uvs> {
        let array = Array::new(argument)?;
        let single = match array.shape()[..] {
            [2] => true,
            [_, 2] => false,
            _ => return Err(array.refused("uv", "(2,) or (n, 2)")),
        };
        let rows = array.read(|numbers| numbers.as_chunks::<2>().0.to_vec())?;
        Ok(Rows { name: "uv", rows, single })
    }
}

impl Footprints {
    /// The rows of `argument`, as [`Directions::new`]; points without one.
    ///
    /// # Errors
    /// Those of [`Directions::new`].
    fn new(argument: Option<&Bound<PyAny>>) -> PyResult<Footprints> {
        let Some(argument) = argument else {
            return Ok(Rows { name: "footprint", rows: vec![Footprint::Point], single: true });
        };
        let array = Array::new(argument)?;
        let (single, is_axes) = match array.shape()[..] {
            [] => (true, false),
            [_] => (false, false),
            [2, 2] => (true, true),
            [_, 2, 2] => (false, true),
            _ => return Err(array.refused("footprint", "a number, (n,), (2, 2) or (n, 2, 2)")),
        };
        let axes = |&[a, b, c, d]: &[f32; 4]| Footprint::Axes([[a, b], [c, d]]);
        let rows = if is_axes {
            array.read(|numbers| numbers.as_chunks::<4>().0.iter().map(axes).collect())?
        } else {
            array.read(|numbers| numbers.iter().copied().map(Footprint::Isotropic).collect())?
        };
        Ok(Rows { name: "footprint", rows, single })
    }
}

/// Where questions are asked: a place each, or none.
pub struct Places(Option<(Uvs, Footprints)>);

impl Places {
    /// The places of two arguments.
    ///
    /// # Errors
    /// `ValueError` for a footprint that is around no place, and those of [`Directions::new`].
    pub fn new(uv: Option<&Bound<PyAny>>, footprint: Option<&Bound<PyAny>>) -> PyResult<Places> {
        match (uv, footprint) {
            (Some(uv), footprint) => Ok(Places(Some((Uvs::new(uv)?, Footprints::new(footprint)?)))),
            (None, Some(_)) => Err(PyValueError::new_err("footprint is given without uv, expected both")),
            (None, None) => Ok(Places(None)),
        }
    }

    /// The place of row `index`.
    pub fn get(&self, index: usize) -> Option<Place> {
        let (uv, footprint) = self.0.as_ref()?;
        Some(Place { uv: uv.get(index), footprint: footprint.get(index) })
    }

    /// `count` places from row `first` on.
    pub fn range(&self, first: usize, count: usize) -> Option<impl ExactSizeIterator<Item = Place>> {
        let (uv, footprint) = self.0.as_ref()?;
        let place = move |i| Place { uv: uv.get(first + i), footprint: footprint.get(first + i) };
        Some((0..count).map(place))
    }
}

/// Numbers from Python, in float32 and row by row.
struct Array<'py>(Bound<'py, PyArrayDyn<f32>>);

impl<'py> Array<'py> {
    fn new(argument: &Bound<'py, PyAny>) -> PyResult<Array<'py>> {
        let py = argument.py();
        let options = [("dtype", "float32"), ("order", "C")].into_py_dict(py)?;
        let array = py.import("numpy")?.call_method("asarray", (argument,), Some(&options))?;
        Ok(Array(array.cast_into()?))
    }

    fn shape(&self) -> Vec<usize> {
        self.0.shape().to_vec()
    }

    /// What `read` makes of the numbers.
    fn read<T>(&self, read: impl FnOnce(&[f32]) -> Vec<T>) -> PyResult<Vec<T>> {
        Ok(read(self.0.try_readonly()?.as_slice()?))
    }

    /// The error for a shape that `name` cannot have.
    fn refused(&self, name: &str, expected: &str) -> PyErr {
        let refused =
            |shape| PyValueError::new_err(format!("{name} has the shape {shape}, expected {expected}"));
        self.0.getattr("shape").map_or_else(|error| error, refused)
    }
}

/// How many rows an argument has.
struct Extent {
    name: &'static str,
    rows: usize,
    single: bool,
}

/// Number of rows of the result for two arguments and places; `None` if each is a single row.
///
/// # Errors
/// `ValueError` if two arguments have different numbers of rows, and neither has one.
pub fn aligned(a: &Directions, b: &Directions, places: &Places) -> PyResult<Option<usize>> {
    let places = places.0.iter().flat_map(|(uv, footprint)| [uv.extent(), footprint.extent()]);
    let arguments: Vec<Extent> = [a.extent(), b.extent()].into_iter().chain(places).collect();
    if arguments.iter().all(|argument| argument.single) {
        return Ok(None);
    }
    let mut many = arguments.iter().filter(|argument| argument.rows != 1);
    let Some(first) = many.next() else { return Ok(Some(1)) };
    match many.find(|other| other.rows != first.rows) {
        None => Ok(Some(first.rows)),
        Some(other) => Err(PyValueError::new_err(format!(
            "{} has {} rows and {} has {}; expected as many, or one",
            first.name, first.rows, other.name, other.rows
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

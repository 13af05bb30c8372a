//! `glimt._native.check`: the conformance tests over Python objects.
//!
//! An object that can be checked has the attributes `name`, `claims` (a dict of booleans: reciprocal,
//! isotropic, conserving, transmits, two_sided), `components` (a list of (name, is_delta)) and `is_slow` (fewer
//! questions are asked), and the methods
//!
//! - `response(component, light, view)`: f·|cosθ_light|, (n, 3);
//! - `pdf(component, light, view)`: (n,);
//! - `response_and_pdf(component, light, view)`: both;
//! - `sample(component, view, u)`: light (n, 3), pdf (n,), weight (n, 3), is_delta (n,), eta (n,);
//!
//! where `component` is `None` for the whole or an index, and all others are float32 (n, 3).

use glimt_check::{Answer, Claims, Component, Draw, Options, Part, Report, Subject, Unanswered};
use glimt_core::Vec3;
use numpy::{PyArray1, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{IntoPyDict, PyDict, PyTuple};

use crate::arrays::{Directions, Triples};
use crate::parallel;

/// The result of `check`.
#[pyclass(frozen, module = "glimt")]
pub struct CheckReport(Report);

#[pymethods]
impl CheckReport {
    /// Whether no subject failed.
    #[getter]
    fn passed(&self) -> bool {
        self.0.passed()
    }

    /// Names of the subjects that failed.
    #[getter]
    fn failed(&self) -> Vec<&str> {
        self.0.failed()
    }

    /// A table for people.
    fn text(&self) -> String {
        self.0.text()
    }

    /// The same for machines.
    fn json(&self) -> String {
        self.0.json()
    }

    /// A self-contained page.
    fn html(&self) -> String {
        glimt_check::page::html(&self.0)
    }
}

/// Puts objects through the conformance tests; what they must have is in `glimt.check.MitsubaSubject`.
///
/// An exception of a subject ends the run.
///
/// # Errors
/// `glimt.Error` in a fork of a process that used threads.
#[pyfunction]
#[pyo3(signature = (subjects, *, samples=None, seed=1))]
pub fn check(
    py: Python,
    subjects: Vec<Bound<PyAny>>,
    samples: Option<usize>,
    seed: u64,
) -> PyResult<CheckReport> {
    if parallel::is_forked() {
        let reason = "check() does not run in a fork of a process that computed with several threads; start the \
                      process with multiprocessing's \"spawn\"";
        return Err(crate::error(reason));
    }
    let mut checked = Vec::new();
    for object in subjects {
        let is_slow: bool = object.getattr("is_slow")?.extract()?;
        let budget = if is_slow { Options::SMALL } else { Options::FULL };
        let options = Options { samples: samples.unwrap_or(budget.samples), seed, ..budget };
        let subject = PythonSubject::new(&object)?;
        checked.push(glimt_check::check(&subject, &options).map_err(|error| exception(py, error))?);
    }
    Ok(CheckReport(Report::new(checked)))
}

/// The exception that a subject raised.
fn exception(py: Python, error: Unanswered) -> PyErr {
    match error.downcast::<PyErr>() {
        Ok(raised) => raised.clone_ref(py),
        Err(other) => crate::error(other),
    }
}

struct PythonSubject {
    object: Py<PyAny>,
    name: String,
    claims: Claims,
    components: Vec<Component>,
}

impl PythonSubject {
    fn new(object: &Bound<PyAny>) -> PyResult<PythonSubject> {
        let claims = object.getattr("claims")?;
        let claim = |name: &str| claims.get_item(name)?.extract::<bool>();
        let components: Vec<(String, bool)> = object.getattr("components")?.extract()?;
        Ok(PythonSubject {
            object: object.clone().unbind(),
            name: object.getattr("name")?.extract()?,
            claims: Claims {
                reciprocal: claim("reciprocal")?,
                isotropic: claim("isotropic")?,
                conserving: claim("conserving")?,
                transmits: claim("transmits")?,
                two_sided: claim("two_sided")?,
                tilted: false,
                measured: false,
            },
            components: components.into_iter().map(|(name, delta)| Component { name, delta }).collect(),
        })
    }

    /// Calls a method with two arrays, and hands its result to `read`.
    fn call<T>(
        &self,
        method: &str,
        part: Part,
        arrays: [&[Vec3]; 2],
        read: impl Fn(&Bound<PyAny>) -> PyResult<T>,
    ) -> Answer<T> {
        let answer = Python::attach(|py| {
            py.check_signals()?;
            let component = match part {
                Part::Whole => None,
                Part::Component(index) => Some(index),
            };
            let [a, b] = arrays.map(|rows| {
                let mut triples = Triples::new(Some(rows.len()));
                triples.as_mut().copy_from_slice(rows);
                triples.into_numpy(py)
            });
            read(self.object.bind(py).call_method1(method, (component, a?, b?))?.as_any())
        });
        answer.map_err(|error: PyErr| Unanswered::from(error))
    }
}

/// An array (n, 3) for n questions.
fn triples(value: &Bound<PyAny>, n: usize) -> PyResult<Vec<Vec3>> {
    answered(Directions::new("an answer", value)?.into_rows(), n)
}

/// An array (n,) for n questions.
fn numbers(value: &Bound<PyAny>, n: usize) -> PyResult<Vec<f32>> {
    let py = value.py();
    let options: Bound<PyDict> = [("dtype", "float32"), ("order", "C")].into_py_dict(py)?;
    let array = py.import("numpy")?.call_method("asarray", (value,), Some(&options))?;
    answered(array.cast_into::<PyArray1<f32>>()?.to_vec()?, n)
}

fn answered<T>(answers: Vec<T>, n: usize) -> PyResult<Vec<T>> {
    if answers.len() == n {
        return Ok(answers);
    }
    Err(PyValueError::new_err(format!("{n} questions got {} answers", answers.len())))
}

impl Subject for PythonSubject {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn claims(&self) -> Claims {
        self.claims
    }

    fn components(&self) -> Vec<Component> {
        self.components.clone()
    }

    fn response(&self, part: Part, light: &[Vec3], view: &[Vec3]) -> Answer<Vec<Vec3>> {
        self.call("response", part, [light, view], |answer| triples(answer, light.len()))
    }

    fn pdf(&self, part: Part, light: &[Vec3], view: &[Vec3]) -> Answer<Vec<f32>> {
        self.call("pdf", part, [light, view], |answer| numbers(answer, light.len()))
    }

    fn response_and_pdf(&self, part: Part, light: &[Vec3], view: &[Vec3]) -> Answer<(Vec<Vec3>, Vec<f32>)> {
        self.call("response_and_pdf", part, [light, view], |both| {
            let both = both.cast::<PyTuple>()?;
            let n = light.len();
            Ok((triples(&both.get_item(0)?, n)?, numbers(&both.get_item(1)?, n)?))
        })
    }

    fn sample(&self, part: Part, view: &[Vec3], u: &[Vec3]) -> Answer<Vec<Draw>> {
        self.call("sample", part, [view, u], |answer| {
            let answer = answer.cast::<PyTuple>()?;
            let n = view.len();
            let light = triples(&answer.get_item(0)?, n)?;
            let pdf = numbers(&answer.get_item(1)?, n)?;
            let weight = triples(&answer.get_item(2)?, n)?;
            let delta = numbers(&answer.get_item(3)?, n)?;
            let eta = numbers(&answer.get_item(4)?, n)?;
            let draw = |i: usize| Draw {
                light: light[i],
                pdf: pdf[i],
                weight: weight[i],
                delta: delta[i] != 0.0,
                eta: eta[i],
            };
            Ok((0..n).map(draw).collect())
        })
    }
}

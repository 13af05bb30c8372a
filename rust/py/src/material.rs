//! `glimt.Material`.

use std::sync::Arc;

use glimt_core::library::{Entry, Origin};
use glimt_core::material::At;
use glimt_core::sampling::{Sampler, SamplerChoice};
use glimt_core::surface::Place;
use glimt_core::{Brdf, Invalid, SampleBrdf, Vec3};
use glimt_files::Source;
use numpy::{PyArray1, ToPyArray};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

use crate::arrays::{Directions, Places, Triples, aligned};
use crate::error;
use crate::parallel;
use crate::pickle::{self, SourceFile, State};

/// A material: a fitted model, or a measured table as it is. Immutable.
#[pyclass(frozen, module = "glimt")]
pub struct Material {
    name: String,
    kind: &'static str,
    material: glimt_core::Material,
    file: Arc<SourceFile>,
}

/// One number for all components, or one for each.
struct Numbers<const N: usize>([f32; N]);

impl<'py, const N: usize> FromPyObject<'_, 'py> for Numbers<N> {
    type Error = PyErr;

    fn extract(given: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let one = given.extract::<f32>().map(|number| [number; N]);
        let each = || given.extract::<[f32; N]>();
        one.or_else(|_| each()).map(Numbers).map_err(|_| {
            PyTypeError::new_err(format!("{given:?} is neither a number nor a list of {N} numbers"))
        })
    }
}

impl Material {
    /// The material of that name; the only one if `name` is `None`. `file` is what `source` was read from.
    pub fn new(
        source: &Source,
        file: &Arc<SourceFile>,
        name: Option<&str>,
        sampler: Option<SamplerChoice>,
    ) -> Result<Material, glimt_files::Error> {
        let Entry { name, material, .. } = source.library()?.entry(name)?;
        let other = sampler.filter(|choice| material.plan().choice() != Some(*choice));
        let material = other.map_or_else(|| material.clone(), |choice| material.with_sampler(choice));
        Ok(Material { name: name.clone(), kind: source.kind(), material, file: file.clone() })
    }

    /// Between the materials of two names, with a share `weight` of the second.
    pub fn mixed(
        source: &Source,
        file: &Arc<SourceFile>,
        [a, b]: [&str; 2],
        weight: f32,
        sampler: Option<SamplerChoice>,
    ) -> Result<Material, glimt_files::Error> {
        let material = source.library()?.mix(a, b, weight)?;
        let material = sampler.map_or_else(|| material.clone(), |choice| material.with_sampler(choice));
        let name = glimt_core::library::mix_name(a, b, weight);
        Ok(Material { name, kind: source.kind(), material, file: file.clone() })
    }

    /// The same material after a change.
    fn changed(&self, material: glimt_core::Material) -> Material {
        Material { name: self.name.clone(), kind: self.kind, material, file: self.file.clone() }
    }

    /// The material at a place; without one, the material itself.
    fn at(&self, place: Option<Place>) -> At<'_> {
        place.map_or(At::Everywhere(&self.material), |place| self.material.at(&place))
    }
}

#[pymethods]
impl Material {
    /// The name.
    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// Model or measured format, as in `Library.kind`.
    #[getter]
    fn kind(&self) -> &'static str {
        self.kind
    }

    /// Whether the material is another at every place of a surface. Without a place it is what it is from afar.
    #[getter]
    fn is_surface(&self) -> bool {
        self.material.is_surface()
    }

    /// What is odd about the file that a measurement was read from, and what was made of it, in words.
    #[getter]
    fn oddities(&self) -> Vec<String> {
        self.material.oddities().iter().map(ToString::to_string).collect()
    }

    /// Diffuse albedo, linear RGB; None where the model has no analytic part.
    #[getter]
    fn kd(&self) -> Option<(f32, f32, f32)> {
        self.material.microfacet().map(|m| m.kd.into())
    }

    /// Relative index of refraction per channel; None where the model has no analytic part.
    #[getter]
    fn eta(&self) -> Option<(f32, f32, f32)> {
        self.material.microfacet().map(|m| m.eta.into())
    }

    /// GGX roughness along x and y; None where the model has no analytic part.
    #[getter]
    fn alpha(&self) -> Option<(f32, f32)> {
        self.material.microfacet().map(|m| m.alpha.into())
    }

    /// The latent code, float32; empty where the model has none.
    #[getter]
    fn latent<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        self.material.latent().to_pyarray(py)
    }

    /// A copy with other parameters of its analytic part, and a sampler that follows them.
    ///
    /// kd and eta take three numbers, alpha two, and each also one number for all.
    #[pyo3(signature = (*, kd=None, eta=None, alpha=None))]
    fn edit(
        &self,
        kd: Option<Numbers<3>>,
        eta: Option<Numbers<3>>,
        alpha: Option<Numbers<2>>,
    ) -> PyResult<Material> {
        let refused = |reason: Invalid| error(format!("material \"{}\": {reason}", self.name));
        let Some(mut microfacet) = self.material.microfacet().copied() else {
            let reason = format!("{} materials have no kd, eta or alpha to edit", self.kind);
            return Err(refused(reason.into()));
        };
        microfacet.kd = kd.map_or(microfacet.kd, |kd| kd.0);
        microfacet.eta = eta.map_or(microfacet.eta, |eta| eta.0);
        microfacet.alpha = alpha.map_or(microfacet.alpha, |alpha| alpha.0);
        Ok(self.changed(self.material.with_microfacet(microfacet).map_err(refused)?))
    }

    /// Name of the sampler: "lobes", "table" or "warp".
    #[getter]
    fn sampler(&self) -> &'static str {
        self.material.plan().name()
    }

    /// Bytes of the sampler's tables; 0 for lobes and for a measurement's own warp.
    #[getter]
    fn sampler_bytes(&self, py: Python) -> usize {
        py.detach(|| if let Sampler::Table(table) = self.material.sampler() { table.bytes() } else { 0 })
    }

    /// A copy with another sampler: "lobes", "table", "table:paper" or "table:VIEWSxRINGSxSECTORS". It is
    /// made when it is first asked for.
    fn with_sampler(&self, sampler: &str) -> PyResult<Material> {
        let choice = parse_sampler(sampler)?;
        Ok(self.changed(self.material.with_sampler(choice)))
    }

    /// f_r(light, view) in 1/sr, linear RGB, without the cosine.
    ///
    /// Unit vectors (n, 3) or (3,) in the local frame with the normal +z, pointing away from the
    /// surface; one direction goes with many. Below the horizon, and for NaN, f is 0.
    ///
    /// `uv` (n, 2) or (2,) are places on a surface, and `footprint` is how much is seen around them: a standard
    /// deviation in uv, (n,) of them, or two axes (2, 2), (n, 2, 2). A material that is no surface ignores both.
    #[pyo3(signature = (light, view, uv=None, footprint=None))]
    fn eval<'py>(
        &self,
        light: &Bound<'py, PyAny>,
        view: &Bound<'py, PyAny>,
        uv: Option<&Bound<'py, PyAny>>,
        footprint: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let py = light.py();
        let (light, view) = (Directions::new("light", light)?, Directions::new("view", view)?);
        let places = Places::new(uv, footprint)?;
        let mut f = Triples::new(aligned(&light, &view, &places)?);
        py.detach(|| {
            parallel::chunks(f.as_mut(), |first, f| {
                let n = f.len();
                let (light, view) = (light.range(first, n), view.range(first, n));
                match places.range(first, n) {
                    Some(places) => self.material.eval_batch_at(places, &light, &view, f),
                    None => self.material.eval_batch(&light, &view, f),
                }
            });
        });
        f.into_numpy(py)
    }

    /// Density in 1/sr with which `sample` chooses `light` for `view`. Shapes and places as for `eval`.
    #[pyo3(signature = (light, view, uv=None, footprint=None))]
    fn pdf<'py>(
        &self,
        light: &Bound<'py, PyAny>,
        view: &Bound<'py, PyAny>,
        uv: Option<&Bound<'py, PyAny>>,
        footprint: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let py = light.py();
        let (light, view) = (Directions::new("light", light)?, Directions::new("view", view)?);
        let places = Places::new(uv, footprint)?;
        let shape = aligned(&light, &view, &places)?;
        let mut pdf = vec![0.0; shape.unwrap_or(1)];
        py.detach(|| {
            parallel::chunks(&mut pdf, |first, pdf| {
                for (i, pdf) in (first..).zip(pdf) {
                    *pdf = self.at(places.get(i)).pdf(light.get(i), view.get(i));
                }
            });
        });
        numbers(py, shape, &pdf)
    }

    /// Light directions for `view` from random numbers `u` in [0, 1), both (n, 3) or (3,). Places as for `eval`.
    ///
    /// Returns (light, pdf, weight), where weight = f cos(theta_light) / pdf. A sample that failed
    /// has pdf 0 and weight 0.
    #[pyo3(signature = (view, u, uv=None, footprint=None))]
    fn sample<'py>(
        &self,
        view: &Bound<'py, PyAny>,
        u: &Bound<'py, PyAny>,
        uv: Option<&Bound<'py, PyAny>>,
        footprint: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let py = view.py();
        let (view, u) = (Directions::new("view", view)?, Directions::new("u", u)?);
        let places = Places::new(uv, footprint)?;
        let shape = aligned(&view, &u, &places)?;
        let mut samples = vec![glimt_core::Sample::FAILED; shape.unwrap_or(1)];
        py.detach(|| {
            parallel::chunks(&mut samples, |first, samples| {
                for (i, sample) in (first..).zip(samples) {
                    *sample = self.at(places.get(i)).sample(view.get(i), u.get(i));
                }
            });
        });
        let triples = |part: fn(&glimt_core::Sample) -> Vec3| {
            let mut triples = Triples::new(shape);
            for (triple, sample) in triples.as_mut().iter_mut().zip(&samples) {
                *triple = part(sample);
            }
            triples.into_numpy(py)
        };
        let pdf: Vec<f32> = samples.iter().map(|sample| sample.pdf).collect();
        Ok((triples(|s| s.light)?, numbers(py, shape, &pdf)?, triples(|s| s.weight)?))
    }

    fn __copy__(slf: Bound<Self>) -> Bound<Self> {
        slf
    }

    fn __deepcopy__<'py>(slf: Bound<'py, Self>, _memo: &Bound<'py, PyAny>) -> Bound<'py, Self> {
        slf
    }

    /// As a library that holds this alone.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, State<'py>)> {
        let material = self.material.clone();
        let entry = Entry { name: self.name.clone(), material, origin: Origin::default() };
        let alone = glimt_core::Library::new(self.file.path(), vec![entry]).map_err(error)?;
        let sampler = self.material.plan().choice();
        let state = pickle::state_of(py, &Source::Library(alone), &self.file, sampler)?;
        Ok((pickle::restoring(py, "_restore_material")?, state))
    }

    fn __repr__(&self) -> String {
        format!("<glimt.Material {:?}: {}>", self.name, self.kind)
    }
}

/// What the name of a sampler asks for.
///
/// # Errors
/// `ValueError` for a name that is none.
pub fn parse_sampler(name: &str) -> PyResult<SamplerChoice> {
    name.parse().map_err(PyValueError::new_err)
}

/// An array (n,), or one float.
fn numbers<'py>(py: Python<'py>, shape: Option<usize>, values: &[f32]) -> PyResult<Bound<'py, PyAny>> {
    match shape {
        Some(_) => Ok(values.to_pyarray(py).into_any()),
        None => Ok(values[0].into_pyobject(py)?.into_any()),
    }
}

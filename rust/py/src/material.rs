//! `glimt.Material`.

use std::sync::Arc;

use glimt_core::{SampleBrdf, Vec3};
use glimt_files::Source;
use numpy::{PyArray1, ToPyArray};
use pyo3::prelude::*;

use crate::arrays::{Directions, Triples, aligned};
use crate::error;
use crate::parallel;

/// A material: a fitted model, or a measured table as it is. Immutable.
#[pyclass(frozen, module = "glimt")]
pub struct Material {
    name: String,
    kind: &'static str,
    content: Content,
}

enum Content {
    Model(Box<glimt_core::Material>),
    /// The only material of a measured file.
    Table(Arc<Source>),
}

/// One number for all components, or one for each.
#[derive(FromPyObject)]
enum Numbers<const N: usize> {
    #[pyo3(transparent)]
    One(f32),
    #[pyo3(transparent)]
    Each([f32; N]),
}

impl<const N: usize> Numbers<N> {
    fn each(&self) -> [f32; N] {
        match *self {
            Numbers::One(number) => [number; N],
            Numbers::Each(numbers) => numbers,
        }
    }
}

impl Material {
    /// The material of that name; the only one if `name` is `None`.
    pub fn new(source: &Arc<Source>, name: Option<&str>) -> Result<Material, glimt_files::Error> {
        let kind = source.kind();
        match &**source {
            Source::Library(library) => {
                let entry = library.entry(name)?;
                let content = Content::Model(Box::new(entry.material.clone()));
                Ok(Material { name: entry.name.clone(), kind, content })
            }
            Source::Table { table, .. } => {
                source.brdf(name)?;
                let name = table.measured().name().to_owned();
                Ok(Material { name, kind, content: Content::Table(Arc::clone(source)) })
            }
            Source::Samples { path, .. } => Err(glimt_files::Error::OnlySamples { path: path.clone() }),
        }
    }

    fn model(&self) -> Option<&glimt_core::Material> {
        match &self.content {
            Content::Model(material) => Some(material),
            Content::Table(_) => None,
        }
    }

    fn brdf(&self) -> &dyn SampleBrdf {
        match &self.content {
            Content::Model(material) => &**material,
            Content::Table(source) => match &**source {
                Source::Table { table, .. } => &**table,
                Source::Library(_) | Source::Samples { .. } => unreachable!("made of a table"),
            },
        }
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

    /// Diffuse albedo, linear RGB; None where the model has no analytic part.
    #[getter]
    fn kd(&self) -> Option<(f32, f32, f32)> {
        self.model()?.microfacet().map(|m| m.kd.into())
    }

    /// Relative index of refraction per channel; None where the model has no analytic part.
    #[getter]
    fn eta(&self) -> Option<(f32, f32, f32)> {
        self.model()?.microfacet().map(|m| m.eta.into())
    }

    /// GGX roughness along x and y; None where the model has no analytic part.
    #[getter]
    fn alpha(&self) -> Option<(f32, f32)> {
        self.model()?.microfacet().map(|m| m.alpha.into())
    }

    /// The latent code, float32; empty where the model has none.
    #[getter]
    fn latent<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        self.model().map_or(&[][..], |material| material.latent()).to_pyarray(py)
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
        let refused = |reason: String| error(format!("material \"{}\": {reason}", self.name));
        let editable = self.model().and_then(|material| Some((material, *material.microfacet()?)));
        let Some((material, mut microfacet)) = editable else {
            return Err(refused(format!("{} materials have no kd, eta or alpha to edit", self.kind)));
        };
        microfacet.kd = kd.map_or(microfacet.kd, |kd| kd.each());
        microfacet.eta = eta.map_or(microfacet.eta, |eta| eta.each());
        microfacet.alpha = alpha.map_or(microfacet.alpha, |alpha| alpha.each());
        let material = material.with_microfacet(microfacet).map_err(refused)?;
        Ok(Material { name: self.name.clone(), kind: self.kind, content: Content::Model(Box::new(material)) })
    }

    /// f_r(light, view) in 1/sr, linear RGB, without the cosine.
    ///
    /// Unit vectors (n, 3) or (3,) in the local frame with the normal +z, pointing away from the
    /// surface; one direction goes with many. Below the horizon, and for NaN, f is 0.
    fn eval<'py>(&self, light: &Bound<'py, PyAny>, view: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let py = light.py();
        let (light, view) = (Directions::new("light", light)?, Directions::new("view", view)?);
        let mut f = Triples::new(aligned(&light, &view)?);
        py.detach(|| {
            parallel::chunks(f.as_mut(), |first, f| {
                let n = f.len();
                self.brdf().eval_batch(&light.range(first, n), &view.range(first, n), f);
            });
        });
        f.into_numpy(py)
    }

    /// Density in 1/sr with which `sample` chooses `light` for `view`. Shapes as for `eval`.
    fn pdf<'py>(&self, light: &Bound<'py, PyAny>, view: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let py = light.py();
        let (light, view) = (Directions::new("light", light)?, Directions::new("view", view)?);
        let shape = aligned(&light, &view)?;
        let mut pdf = vec![0.0; shape.unwrap_or(1)];
        py.detach(|| {
            parallel::chunks(&mut pdf, |first, pdf| {
                for (i, pdf) in pdf.iter_mut().enumerate() {
                    *pdf = self.brdf().pdf(light.get(first + i), view.get(first + i));
                }
            });
        });
        numbers(py, shape, &pdf)
    }

    /// Light directions for `view` from random numbers `u` in [0, 1), both (n, 3) or (3,).
    ///
    /// Returns (light, pdf, weight), where weight = f cos(theta_light) / pdf. A sample that failed
    /// has pdf 0 and weight 0.
    fn sample<'py>(
        &self,
        view: &Bound<'py, PyAny>,
        u: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let py = view.py();
        let (view, u) = (Directions::new("view", view)?, Directions::new("u", u)?);
        let shape = aligned(&view, &u)?;
        let mut samples = vec![glimt_core::Sample::FAILED; shape.unwrap_or(1)];
        py.detach(|| {
            parallel::chunks(&mut samples, |first, samples| {
                for (i, sample) in samples.iter_mut().enumerate() {
                    *sample = self.brdf().sample(view.get(first + i), u.get(first + i));
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

    fn __repr__(&self) -> String {
        format!("<glimt.Material {:?}: {}>", self.name, self.kind)
    }
}

/// An array (n,), or one float.
fn numbers<'py>(py: Python<'py>, shape: Option<usize>, values: &[f32]) -> PyResult<Bound<'py, PyAny>> {
    match shape {
        Some(_) => Ok(values.to_pyarray(py).into_any()),
        None => Ok(values[0].into_pyobject(py)?.into_any()),
    }
}

//! What a renderer holds: a model, and a sampler for it.
//!
//! A model is listed here in three places: the enum, `with_model!`, and `variants!`.

use std::sync::{Arc, OnceLock};

use glam::Vec3;

use crate::analytic::Analytic;
use crate::brdf::{Brdf, Sample, SampleBrdf};
use crate::factor::Factor;
use crate::ggx::Ggx;
use crate::hybrid::Hybrid;
use crate::microfacet::Microfacet;
use crate::model::Model;
use crate::nbrdf::Nbrdf;
use crate::network::Network;
use crate::neural::Neural;
use crate::sampler::{Plan, Sampler, SamplerChoice};
use crate::simd::Lane3;
use crate::spherical::Spherical;
use crate::tabulated::Tabulated;

/// The closed set of models.
#[derive(Clone, Debug)]
pub enum AnyModel {
    /// See [`crate::ggx`].
    Ggx(Ggx),
    /// See [`crate::hybrid`].
    Hybrid(Hybrid),
    /// See [`crate::neural`].
    Neural(Neural),
    /// See [`crate::nbrdf`].
    Nbrdf(Nbrdf),
    /// See [`crate::factor`].
    Factor(Factor),
    /// See [`crate::tabulated`].
    Tabulated(Tabulated),
    /// See [`crate::analytic`].
    Analytic(Analytic),
    /// See [`crate::spherical`].
    Spherical(Spherical),
}

/// A material: a model, and a sampler that is made when it is first asked for. Copies share it.
#[derive(Clone, Debug)]
pub struct Material {
    model: AnyModel,
    plan: Plan,
    sampler: Arc<OnceLock<Sampler>>,
}

/// `$body` with `$model` bound to the [`Model`] that `$any` holds.
macro_rules! with_model {
    ($any:expr, $model:pat => $body:expr) => {
        match $any {
            $crate::material::AnyModel::Ggx($model) => $body,
            $crate::material::AnyModel::Hybrid($model) => $body,
            $crate::material::AnyModel::Neural($model) => $body,
            $crate::material::AnyModel::Nbrdf($model) => $body,
            $crate::material::AnyModel::Factor($model) => $body,
            $crate::material::AnyModel::Tabulated($model) => $body,
            $crate::material::AnyModel::Analytic($model) => $body,
            $crate::material::AnyModel::Spherical($model) => $body,
        }
    };
}
pub(crate) use with_model;

/// Ways between [`Material`] and each model.
macro_rules! variants {
    ($($model:ident),+) => {$(
        impl From<$model> for AnyModel {
            fn from(model: $model) -> Self {
                AnyModel::$model(model)
            }
        }

        impl From<$model> for Material {
            fn from(model: $model) -> Self {
                let plan = model.plan();
                Material::planned(model.into(), plan)
            }
        }

        impl<'a> TryFrom<&'a Material> for &'a $model {
            type Error = ();

            fn try_from(material: &'a Material) -> Result<Self, ()> {
                if let AnyModel::$model(model) = material.model() { Ok(model) } else { Err(()) }
            }
        }
    )+};
}
variants!(Ggx, Hybrid, Neural, Nbrdf, Factor, Tabulated, Analytic, Spherical);

impl Material {
    fn planned(model: AnyModel, plan: Plan) -> Material {
        Material { model, plan, sampler: Arc::default() }
    }

    /// The model.
    #[must_use]
    pub fn model(&self) -> &AnyModel {
        &self.model
    }

    /// See [`Model::KIND`].
    #[must_use]
    pub fn kind(&self) -> &'static str {
        fn kind<M: Model>(_: &M) -> &'static str {
            M::KIND
        }
        with_model!(&self.model, model => kind(model))
    }

    /// See [`Model::microfacet`].
    #[must_use]
    pub fn microfacet(&self) -> Option<&Microfacet> {
        with_model!(&self.model, model => Model::microfacet(model))
    }

    /// See [`Model::latent`].
    #[must_use]
    pub fn latent(&self) -> &[f32] {
        with_model!(&self.model, model => Model::latent(model))
    }

    /// See [`Model::network`].
    #[must_use]
    pub fn network(&self) -> Option<&Network> {
        with_model!(&self.model, model => Model::network(model))
    }

    /// The sampler, which the first call makes.
    #[must_use]
    pub fn sampler(&self) -> &Sampler {
        self.sampler.get_or_init(|| with_model!(&self.model, model => self.plan.make(model)))
    }

    /// What the sampler is or will be.
    #[must_use]
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// The same material with another sampler.
    #[must_use]
    pub fn with_sampler(&self, choice: SamplerChoice) -> Material {
        match (choice, &self.plan) {
            (SamplerChoice::Lobes, Plan::Lobes) => self.clone(),
            _ => Material::planned(self.model.clone(), choice.into()),
        }
    }

    /// See [`Model::is_isotropic`].
    #[must_use]
    pub fn is_isotropic(&self) -> bool {
        with_model!(&self.model, model => model.is_isotropic())
    }

    /// See [`Model::is_reciprocal`].
    #[must_use]
    pub fn is_reciprocal(&self) -> bool {
        with_model!(&self.model, model => model.is_reciprocal())
    }

    /// See [`Model::with_microfacet`]. The copy has a sampler of the same kind.
    ///
    /// # Errors
    /// See [`Model::with_microfacet`].
    pub fn with_microfacet(&self, microfacet: Microfacet) -> Result<Material, String> {
        let edited =
            with_model!(&self.model, model => model.with_microfacet(microfacet).map(AnyModel::from))?;
        Ok(Material::planned(edited, self.plan.clone()))
    }

    /// See [`Model::with_latent`]. The copy has a sampler of the same kind.
    ///
    /// # Errors
    /// See [`Model::with_latent`].
    pub fn with_latent(&self, latent: Vec<f32>) -> Result<Material, String> {
        let edited = with_model!(&self.model, model => model.with_latent(latent).map(AnyModel::from))?;
        Ok(Material::planned(edited, self.plan.clone()))
    }
}

impl Brdf for Material {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        with_model!(&self.model, model => model.eval(light, view))
    }

    fn eval_tile(&self, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        with_model!(&self.model, model => model.eval_tile(light, view, out));
    }

    fn eval_packet(&self, light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]) {
        with_model!(&self.model, model => model.eval_packet(light, view, out));
    }

    fn eval_batch(&self, light: &[Vec3], view: &[Vec3], out: &mut [Vec3]) {
        with_model!(&self.model, model => model.eval_batch(light, view, out));
    }
}

impl SampleBrdf for Material {
    fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        self.sampler().pdf(light, view)
    }

    fn sample(&self, view: Vec3, u: Vec3) -> Sample {
        self.sampler().sample(self, view, u)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Library;

    fn is_made(material: &Material) -> bool {
        material.sampler.get().is_some()
    }

    /// Lobes take milliseconds, and whoever opens a library of a thousand materials samples a few.
    #[test]
    fn a_sampler_is_made_once_and_only_when_it_is_asked_for() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/models/rgl.safetensors");
        let library = Library::open(path).unwrap();
        let material = library.material(Some("chm_orange")).unwrap();
        let microfacet = Microfacet { alpha: [0.3; 2], ..*material.microfacet().unwrap() };
        let edited = material.with_microfacet(microfacet).unwrap();
        let edited = edited.with_latent(vec![0.1; edited.latent().len()]).unwrap();
        let tabulated = material.with_sampler("table:4x4x4".parse().unwrap());
        let _ = (material.eval(Vec3::Z, Vec3::Z), edited.eval(Vec3::Z, Vec3::Z), tabulated.plan().name());
        assert!(!library.entries().iter().any(|entry| is_made(&entry.material)));
        assert!(!is_made(&edited) && !is_made(&tabulated));

        let copy = material.clone();
        assert!(copy.pdf(Vec3::Z, Vec3::Z) > 0.0);
        assert!(std::ptr::eq(copy.sampler(), material.sampler()));
        assert_eq!(library.entries().iter().filter(|entry| is_made(&entry.material)).count(), 1);
        assert!(matches!(tabulated.with_microfacet(microfacet).unwrap().sampler(), Sampler::Table(_)));
    }
}

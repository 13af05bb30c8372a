//! The closed set of models, as one type that a renderer holds.
//!
//! A model is listed here in three places: the enum, `with_model!`, and `variants!`.

use std::sync::Arc;

use glam::Vec3;

use crate::analytic::Analytic;
use crate::brdf::{Brdf, Sample, SampleBrdf};
use crate::factor::Factor;
use crate::ggx::Ggx;
use crate::hybrid::Hybrid;
use crate::lobes::{Lobes, PROXY_ALPHAS};
use crate::microfacet::Microfacet;
use crate::model::Model;
use crate::nbrdf::Nbrdf;
use crate::network::Network;
use crate::neural::Neural;
use crate::oddity::Oddity;
use crate::sampler::{Sampler, SamplerChoice};
use crate::simd::Lane3;
use crate::spherical::Spherical;
use crate::table_sampler::TableSampler;
use crate::tabulated::Tabulated;

/// A material of any model.
#[derive(Clone, Debug)]
pub enum Material {
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

/// `$body` with `$model` bound to the [`Model`] that `$material` holds.
macro_rules! with_model {
    ($material:expr, $model:pat => $body:expr) => {
        match $material {
            Material::Ggx($model) => $body,
            Material::Hybrid($model) => $body,
            Material::Neural($model) => $body,
            Material::Nbrdf($model) => $body,
            Material::Factor($model) => $body,
            Material::Tabulated($model) => $body,
            Material::Analytic($model) => $body,
            Material::Spherical($model) => $body,
        }
    };
}
pub(crate) use with_model;

/// Ways between [`Material`] and each model.
macro_rules! variants {
    ($($model:ident),+) => {$(
        impl From<$model> for Material {
            fn from(model: $model) -> Self {
                Material::$model(model)
            }
        }

        impl<'a> TryFrom<&'a Material> for &'a $model {
            type Error = ();

            fn try_from(material: &'a Material) -> Result<Self, ()> {
                if let Material::$model(model) = material { Ok(model) } else { Err(()) }
            }
        }
    )+};
}
variants!(Ggx, Hybrid, Neural, Nbrdf, Factor, Tabulated, Analytic, Spherical);

impl Material {
    /// See [`Model::KIND`].
    #[must_use]
    pub fn kind(&self) -> &'static str {
        fn kind<M: Model>(_: &M) -> &'static str {
            M::KIND
        }
        with_model!(self, model => kind(model))
    }

    /// See [`Model::microfacet`].
    #[must_use]
    pub fn microfacet(&self) -> Option<&Microfacet> {
        with_model!(self, model => Model::microfacet(model))
    }

    /// See [`Model::latent`].
    #[must_use]
    pub fn latent(&self) -> &[f32] {
        with_model!(self, model => Model::latent(model))
    }

    /// See [`Model::network`].
    #[must_use]
    pub fn network(&self) -> Option<&Network> {
        with_model!(self, model => Model::network(model))
    }

    /// See [`Model::sampler`].
    #[must_use]
    pub fn sampler(&self) -> &Sampler {
        with_model!(self, model => model.sampler())
    }

    /// The same material with another sampler, made for it here.
    #[must_use]
    pub fn with_sampler(&self, choice: SamplerChoice) -> Material {
        let sampler = match (choice, self.sampler()) {
            (SamplerChoice::Lobes, Sampler::Lobes(_)) => return self.clone(),
            (SamplerChoice::Lobes, _) => Lobes::fit(self, &PROXY_ALPHAS).into(),
            (SamplerChoice::Table(resolution), _) => {
                Sampler::Table(Arc::new(TableSampler::new(self, self.is_isotropic(), resolution)))
            }
        };
        let mut material = self.clone();
        with_model!(&mut material, model => model.set_sampler(sampler));
        material
    }

    /// An edited copy of this material, with a sampler of the same kind.
    fn sampled_alike(&self, edited: Material) -> Material {
        match self.sampler() {
            Sampler::Table(table) => edited.with_sampler(SamplerChoice::Table(table.resolution())),
            Sampler::Lobes(_) | Sampler::Warp(_) => edited,
        }
    }

    /// See [`Model::is_isotropic`].
    #[must_use]
    pub fn is_isotropic(&self) -> bool {
        with_model!(self, model => model.is_isotropic())
    }

    /// See [`Model::is_reciprocal`].
    #[must_use]
    pub fn is_reciprocal(&self) -> bool {
        with_model!(self, model => model.is_reciprocal())
    }

    /// What is odd about the file that a measurement was read from; empty for models.
    #[must_use]
    pub fn oddities(&self) -> &[Oddity] {
        if let Material::Tabulated(measured) = self { measured.table().oddities() } else { &[] }
    }

    /// See [`Model::with_microfacet`].
    ///
    /// # Errors
    /// See [`Model::with_microfacet`].
    pub fn with_microfacet(&self, microfacet: Microfacet) -> Result<Material, String> {
        let edited = with_model!(self, model => model.with_microfacet(microfacet).map(Material::from))?;
        Ok(self.sampled_alike(edited))
    }

    /// See [`Model::with_latent`].
    ///
    /// # Errors
    /// See [`Model::with_latent`].
    pub fn with_latent(&self, latent: Vec<f32>) -> Result<Material, String> {
        let edited = with_model!(self, model => model.with_latent(latent).map(Material::from))?;
        Ok(self.sampled_alike(edited))
    }
}

impl Brdf for Material {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        with_model!(self, model => model.eval(light, view))
    }

    fn eval_tile(&self, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        with_model!(self, model => model.eval_tile(light, view, out));
    }

    fn eval_packet(&self, light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]) {
        with_model!(self, model => model.eval_packet(light, view, out));
    }

    fn eval_batch(&self, light: &[Vec3], view: &[Vec3], out: &mut [Vec3]) {
        with_model!(self, model => model.eval_batch(light, view, out));
    }

    fn has_data(&self, light: Vec3, view: Vec3) -> bool {
        with_model!(self, model => model.has_data(light, view))
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

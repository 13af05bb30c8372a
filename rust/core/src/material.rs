//! The closed set of models, as one type that a renderer holds.
//!
//! Models are listed once, in [`models!`](Kind). [`Kind`], [`Material`], the conversions, and the macros
//! `with_model!` and `with_kind!` are made from the list. What is particular to a model is a `match` over [`Kind`]
//! without a wildcard, here and in other crates, so that a model which is missing somewhere does not compile.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use glam::Vec3;

use crate::brdf::{Brdf, Sample, SampleBrdf};
use crate::lobes::{Lobes, PROXY_ALPHAS};
use crate::microfacet::Microfacet;
use crate::model::Model;
use crate::network::Network;
use crate::oddity::Oddity;
use crate::sampler::{Sampler, SamplerChoice};
use crate::simd::Lane3;
use crate::table_sampler::TableSampler;

/// Makes what goes over all models from the list of their modules and types. `$d` is a dollar sign, for the
/// macros that are made.
macro_rules! models {
    ($d:tt $($module:ident::$model:ident,)+) => {
        $(use crate::$module::$model;)+

        /// Which model a material is of.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Kind {$(
            #[doc = concat!("See [`crate::", stringify!($module), "`].")]
            $model,
        )+}

        impl Kind {
            /// Every kind, in the order of the list.
            pub const ALL: [Kind; [$(Kind::$model),+].len()] = [$(Kind::$model),+];

            /// The model's name as files and commands spell it.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self {$(Kind::$model => <$model as Model>::KIND,)+}
            }
        }

        /// A material of any model.
        #[derive(Clone, Debug)]
        pub enum Material {$(
            #[doc = concat!("See [`crate::", stringify!($module), "`].")]
            $model($model),
        )+}

        impl Material {
            /// The model.
            #[must_use]
            pub const fn kind(&self) -> Kind {
                match self {$(Material::$model(_) => Kind::$model,)+}
            }
        }

        $(
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
        )+

        /// `$body` with `$model` bound to the [`Model`] that `$material` holds.
        macro_rules! with_model {
            ($d material:expr, $d model:pat => $d body:expr) => {
                match $d material {$(Material::$model($d model) => $d body,)+}
            };
        }
        pub(crate) use with_model;

        /// `$body` with `$Type` standing for the [`Model`] of `$kind`.
        macro_rules! with_kind {
            ($d kind:expr, $d Type:ident => $d body:expr) => {
                match $d kind {$(
                    $crate::material::Kind::$model => {
                        type $d Type = $crate::$module::$model;
                        $d body
                    }
                )+}
            };
        }
        pub(crate) use with_kind;
    };
}

models! {$
    ggx::Ggx,
    hybrid::Hybrid,
    neural::Neural,
    nbrdf::Nbrdf,
    factor::Factor,
    tabulated::Tabulated,
    analytic::Analytic,
    spherical::Spherical,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A name that no model has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no model has this name")]
pub struct UnknownKind;

impl FromStr for Kind {
    type Err = UnknownKind;

    fn from_str(name: &str) -> Result<Kind, UnknownKind> {
        Kind::ALL.into_iter().find(|kind| kind.name() == name).ok_or(UnknownKind)
    }
}

impl Material {
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

    /// See [`Model::mix`]. At the ends it is one of the two.
    ///
    /// # Errors
    /// See [`Model::mix`]; also for materials of two models and a share outside [0, 1].
    pub fn mix(&self, other: &Material, t: f32) -> Result<Material, String> {
        fn mix<'a, M: Model + 'a>(a: &M, b: &'a Material, t: f32) -> Result<Material, String>
        where
            &'a M: TryFrom<&'a Material>,
            Material: From<M>,
        {
            let same = b.try_into().map_err(|_| "are of two models, and only one model's mix".to_owned());
            a.mix(same?, t).map(Material::from)
        }
        match t {
            0.0 => Ok(self.clone()),
            1.0 => Ok(other.clone()),
            _ if t > 0.0 && t < 1.0 => {
                Ok(self.sampled_alike(with_model!(self, model => mix(model, other, t))?))
            }
            _ => Err(format!("are mixed with a weight of {t}, expected one in [0, 1]")),
        }
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

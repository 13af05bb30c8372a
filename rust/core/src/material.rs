//! What a renderer holds: a model, and a sampler for it.
//!
//! Models are listed once, in [`crate::models`]. [`Kind`], [`AnyModel`], the conversions, and the macros
//! `with_model!` and `with_kind!` are made from the list. What is particular to a model is a `match` over [`Kind`]
//! without a wildcard, here and in other crates, so that a model which is missing somewhere does not compile.

use std::fmt;
use std::str::FromStr;
use std::sync::{Arc, OnceLock};

use glam::Vec3;

use crate::brdf::{Brdf, Sample, SampleBrdf, check_lengths, lane_of};
use crate::error::{Invalid, Unmixable};
use crate::kernels::network::Network;
use crate::microfacet::Microfacet;
use crate::models::{Local, Model, for_models};
use crate::oddity::Oddity;
use crate::sampling::{Plan, Sampler, SamplerChoice};
use crate::simd::{LANES, Lane3};
use crate::surface::Place;

/// Makes what goes over all models from the list of their modules and types. `$d` is a dollar sign, for the
/// macros that are made.
macro_rules! models {
    ($d:tt $($module:ident::$model:ident,)+) => {
        $(use crate::models::$module::$model;)+

        /// Which model a material is of.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Kind {$(
            #[doc = concat!("See [`crate::models::", stringify!($module), "`].")]
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

        /// Any model.
        #[derive(Clone, Debug)]
        pub enum AnyModel {$(
            #[doc = concat!("See [`crate::models::", stringify!($module), "`].")]
            $model($model),
        )+}

        impl AnyModel {
            /// Which model it is.
            #[must_use]
            pub const fn kind(&self) -> Kind {
                match self {$(AnyModel::$model(_) => Kind::$model,)+}
            }
        }

        $(
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
        )+

        /// `$body` with `$model` bound to the [`Model`] that `$any` is.
        #[macro_export]
        macro_rules! with_model {
            ($d any:expr, $d model:pat => $d body:expr) => {
                match $d any {$($crate::material::AnyModel::$model($d model) => $d body,)+}
            };
        }
        pub use with_model;

        /// `$body` with `$Type` standing for the [`Model`] of `$kind`.
        #[macro_export]
        macro_rules! with_kind {
            ($d kind:expr, $d Type:ident => $d body:expr) => {
                match $d kind {$(
                    $crate::material::Kind::$model => {
                        type $d Type = $crate::models::$module::$model;
                        $d body
                    }
                )+}
            };
        }
        pub use with_kind;
    };
}

for_models!(models $);

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

/// A material: a model, and a sampler that is made when it is first asked for. Copies share it.
///
/// ```
/// use glimt_core::{Brdf, Kind, Library, SampleBrdf, Vec3};
///
/// let library = Library::open("../../scenes/models/rgl.safetensors")?;
/// let orange = library.material(Some("chm_orange"))?;
/// assert_eq!(orange.kind(), Kind::Hybrid);
///
/// // The edit is a material of its own, with a sampler of its own.
/// let mut microfacet = *orange.microfacet().unwrap();
/// microfacet.alpha = [0.3; 2];
/// let rough = orange.with_microfacet(microfacet).unwrap();
/// assert!(rough.eval(Vec3::Z, Vec3::Z).x < orange.eval(Vec3::Z, Vec3::Z).x);
///
/// let tables = orange.with_sampler("table:8x16x8".parse().unwrap());
/// assert_eq!(tables.eval(Vec3::Z, Vec3::Z), orange.eval(Vec3::Z, Vec3::Z));
/// assert!(tables.pdf(Vec3::Z, Vec3::Z) > 0.0);
/// # Ok::<(), glimt_core::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Material {
    model: AnyModel,
    plan: Plan,
    sampler: Arc<OnceLock<Sampler>>,
}

impl Material {
    fn planned(model: AnyModel, plan: Plan) -> Material {
        Material { model, plan, sampler: Arc::default() }
    }

    /// The model.
    #[must_use]
    pub fn model(&self) -> &AnyModel {
        &self.model
    }

    /// Which model it is.
    #[must_use]
    pub fn kind(&self) -> Kind {
        self.model.kind()
    }

    /// Whether lanes of this material and lanes of `other` can be in one tile.
    #[must_use]
    pub fn shares_tiles_with(&self, other: &Material) -> bool {
        std::ptr::eq(self, other)
            || with_model!(&self.model, model => {
                of_model_of(model, other).is_some_and(|other| model.shares_tiles_with(other))
            })
    }

    /// f_r in every lane, of that lane's material: [`Brdf::eval_tile`] for materials with each of which the first
    /// [shares tiles](Material::shares_tiles_with). Every lane gets the very value that its material gives alone.
    pub fn eval_mixed_tile(materials: &[&Material; LANES], light: &Lane3, view: &Lane3, out: &mut Lane3) {
        let first = materials[0];
        if materials.iter().all(|material| std::ptr::eq(*material, first)) {
            first.eval_tile(light, view, out);
            return;
        }
        with_model!(&first.model, model => {
            let models = materials.map(|material| of_model_of(model, material).unwrap_or(model));
            Model::eval_mixed_tile(&models, light, view, out);
        });
    }

    /// What the material reflects at a place: a surface what it is there, any other material itself.
    #[must_use]
    pub fn at(&self, place: &Place) -> At<'_> {
        with_model!(&self.model, model => Model::at(model, place)).map_or(At::Everywhere(self), At::Place)
    }

    /// Whether it is not the same everywhere. Without a place such a surface is what it is from afar.
    #[must_use]
    pub fn is_surface(&self) -> bool {
        matches!(self.at(&Place::far()), At::Place(_))
    }

    /// [`Brdf::eval_packet`] with a place for every pair.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn eval_packet_at(
        &self,
        places: &[Place],
        light: [&[f32]; 3],
        view: [&[f32]; 3],
        out: [&mut [f32]; 3],
    ) {
        check_lengths(&light, &view, &out);
        assert!(places.len() == out[0].len(), "as many places as results");
        with_model!(&self.model, model => Model::eval_packet_at(model, places, light, view, out));
    }

    /// [`Brdf::eval_batch`] with a place for every pair. What is the same everywhere asks for none.
    ///
    /// # Panics
    /// If the lengths differ.
    pub fn eval_batch_at(
        &self,
        mut places: impl ExactSizeIterator<Item = Place>,
        light: &[Vec3],
        view: &[Vec3],
        out: &mut [Vec3],
    ) {
        assert!(places.len() == out.len(), "as many places as results");
        if !self.is_surface() {
            return self.eval_batch(light, view, out);
        }
        assert!(light.len() == out.len() && view.len() == out.len(), "as many lights as views and results");
        for ((light, view), out) in light.chunks(LANES).zip(view.chunks(LANES)).zip(out.chunks_mut(LANES)) {
            let n = out.len();
            let there: [Place; LANES] = std::array::from_fn(|_| places.next().unwrap_or(Place::far()));
            let of = |side: &[Vec3]| -> Lane3 {
                std::array::from_fn(|c| std::array::from_fn(|lane| side.get(lane).map_or(0.0, |w| w[c])))
            };
            let (light, view, mut f) = (of(light), of(view), [[0.0; LANES]; 3]);
            let [light, view] = [&light, &view].map(|side| side.each_ref().map(|x| &x[..n]));
            self.eval_packet_at(&there[..n], light, view, f.each_mut().map(|x| &mut x[..n]));
            out.iter_mut().enumerate().for_each(|(lane, out)| *out = lane_of(&f, lane));
        }
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
        let alpha = self.microfacet().map(|microfacet| microfacet.alpha);
        let make =
            || with_model!(&self.model, model => self.plan.make(model, Model::is_isotropic(model), alpha));
        self.sampler.get_or_init(make)
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

    /// See [`Model::describe`].
    #[must_use]
    pub fn describe(&self) -> String {
        with_model!(&self.model, model => model.describe())
    }

    /// See [`Model::is_reciprocal`].
    #[must_use]
    pub fn is_reciprocal(&self) -> bool {
        with_model!(&self.model, model => model.is_reciprocal())
    }

    /// What is odd about the file that a measurement was read from; empty for models.
    #[must_use]
    pub fn oddities(&self) -> &[Oddity] {
        if let AnyModel::Tabulated(measured) = &self.model { measured.table().oddities() } else { &[] }
    }

    /// See [`Model::with_microfacet`]. The copy has a sampler of the same kind.
    ///
    /// # Errors
    /// See [`Model::with_microfacet`].
    pub fn with_microfacet(&self, microfacet: Microfacet) -> Result<Material, Invalid> {
        let edited =
            with_model!(&self.model, model => model.with_microfacet(microfacet).map(AnyModel::from))?;
        Ok(Material::planned(edited, self.plan.clone()))
    }

    /// See [`Model::with_latent`]. The copy has a sampler of the same kind.
    ///
    /// # Errors
    /// See [`Model::with_latent`].
    pub fn with_latent(&self, latent: Vec<f32>) -> Result<Material, Invalid> {
        let edited = with_model!(&self.model, model => model.with_latent(latent).map(AnyModel::from))?;
        Ok(Material::planned(edited, self.plan.clone()))
    }

    /// See [`Model::mix`]. At the ends it is one of the two; the copy has a sampler as this material has.
    ///
    /// # Errors
    /// See [`Model::mix`]; also for materials of two models and a share outside [0, 1].
    pub fn mix(&self, other: &Material, t: f32) -> Result<Material, Invalid> {
        match t {
            0.0 => Ok(self.clone()),
            1.0 => Ok(other.clone()),
            _ if t > 0.0 && t < 1.0 => {
                let mixed = with_model!(&self.model, model => {
                    let other = of_model_of(model, other).ok_or(Unmixable::Models)?;
                    model.mix(other, t).map(AnyModel::from)
                })?;
                Ok(Material::planned(mixed, self.plan.clone()))
            }
            _ => Err(Unmixable::Weight(t).into()),
        }
    }
}

/// The model of `material`, if it is of the same as `_model`.
fn of_model_of<'a, M>(_model: &M, material: &'a Material) -> Option<&'a M>
where
    &'a M: TryFrom<&'a Material>,
{
    material.try_into().ok()
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

    fn has_data(&self, light: Vec3, view: Vec3) -> bool {
        with_model!(&self.model, model => model.has_data(light, view))
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

/// What a material reflects at a place, see [`Material::at`].
#[derive(Clone, Copy, Debug)]
pub enum At<'a> {
    /// What it reflects at every place.
    Everywhere(&'a Material),
    /// What it reflects there.
    Place(Local<'a>),
}

/// `$body` with `$brdf` bound to what reflects at `$at`.
macro_rules! with_brdf {
    ($at:expr, $brdf:pat => $body:expr) => {
        match $at {
            At::Everywhere($brdf) => $body,
            At::Place(Local::Facet($brdf)) => $body,
            At::Place(Local::Gated($brdf)) => $body,
        }
    };
}

impl At<'_> {
    /// The light of [`SampleBrdf::sample`] and its density, without f there; `None` for a failed sample.
    #[must_use]
    pub fn sample_direction(&self, view: Vec3, u: Vec3) -> Option<(Vec3, f32)> {
        match self {
            At::Everywhere(material) => material.sampler().sample_direction(view, u),
            At::Place(Local::Facet(facet)) => facet.sample_direction(view, u),
            At::Place(Local::Gated(point)) => point.sample_direction(view, u),
        }
    }
}

impl Brdf for At<'_> {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        with_brdf!(self, brdf => brdf.eval(light, view))
    }

    fn eval_tile(&self, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        with_brdf!(self, brdf => brdf.eval_tile(light, view, out));
    }

    fn eval_packet(&self, light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]) {
        with_brdf!(self, brdf => brdf.eval_packet(light, view, out));
    }

    fn eval_batch(&self, light: &[Vec3], view: &[Vec3], out: &mut [Vec3]) {
        with_brdf!(self, brdf => brdf.eval_batch(light, view, out));
    }
}

impl SampleBrdf for At<'_> {
    fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        with_brdf!(self, brdf => brdf.pdf(light, view))
    }

    fn sample(&self, view: Vec3, u: Vec3) -> Sample {
        with_brdf!(self, brdf => brdf.sample(view, u))
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
        assert!(!library.entries().unwrap().iter().any(|entry| is_made(&entry.material)));
        assert!(!is_made(&edited) && !is_made(&tabulated));

        let copy = material.clone();
        assert!(copy.pdf(Vec3::Z, Vec3::Z) > 0.0);
        assert!(std::ptr::eq(copy.sampler(), material.sampler()));
        assert_eq!(library.entries().unwrap().iter().filter(|entry| is_made(&entry.material)).count(), 1);
        assert!(matches!(tabulated.with_microfacet(microfacet).unwrap().sampler(), Sampler::Table(_)));
    }
}

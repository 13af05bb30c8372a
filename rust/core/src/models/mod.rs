//! What the faces and the model library ask of every model, beyond its reflectance.

pub mod analytic;
pub mod edit;
pub mod factor;
pub mod gated;
pub mod ggx;
pub mod hybrid;
pub mod maps;
pub mod nbrdf;
pub mod neural;
pub mod spherical;
pub mod tabulated;

use serde::Serialize;

use crate::brdf::Brdf;
use crate::error::{Invalid, Unmixable};
use crate::kernels::network::Network;
use crate::microfacet::Microfacet;
use crate::sampling::Plan;
use crate::simd::{LANES, Lane3};
use crate::surface::Place;

/// The one list of models: hands the module and the type of each to the macro `$make`. `$d` is a dollar sign, for
/// macros that are made.
macro_rules! for_models {
    ($make:ident $d:tt) => {
        $make! {$d
            ggx::Ggx,
            hybrid::Hybrid,
            neural::Neural,
            nbrdf::Nbrdf,
            factor::Factor,
            tabulated::Tabulated,
            analytic::Analytic,
            spherical::Spherical,
            maps::Maps,
            gated::Gated,
        }
    };
}
pub(crate) use for_models;

/// A model of reflectance: one file of this crate each, listed in [`crate::material`].
pub trait Model: Brdf + Clone {
    /// The model's name as files and commands spell it.
    const KIND: &'static str;

    /// Its form in a few words, for people: what no number of a single material tells.
    fn describe(&self) -> String;

    /// How a material of this model is sampled where nothing else is asked for.
    fn plan(&self) -> Plan {
        Plan::Lobes
    }

    /// Whether f is the same in every azimuth by construction.
    fn is_isotropic(&self) -> bool;

    /// Whether f(l, v) = f(v, l) by construction.
    fn is_reciprocal(&self) -> bool {
        false
    }

    /// k_d, η, α of the models that have an analytic part.
    fn microfacet(&self) -> Option<&Microfacet> {
        None
    }

    /// z; empty for models that have none.
    fn latent(&self) -> &[f32] {
        &[]
    }

    /// The network of the models that have one, before anything is folded into it.
    fn network(&self) -> Option<&Network> {
        None
    }

    /// The same material with other k_d, η and α.
    ///
    /// # Errors
    /// [`Invalid::OutOfRange`], [`Invalid::NoSuchParameter`].
    fn with_microfacet(&self, _: Microfacet) -> Result<Self, Invalid> {
        Err(Invalid::NoSuchParameter { kind: Self::KIND, parameters: "kd, eta or alpha to edit" })
    }

    /// The same material with another latent code.
    ///
    /// # Errors
    /// [`Invalid::LatentLength`], [`Invalid::NoSuchParameter`], and [`Invalid::Parts`] for numbers that are not finite.
    fn with_latent(&self, _: Vec<f32>) -> Result<Self, Invalid> {
        Err(Invalid::NoSuchParameter { kind: Self::KIND, parameters: "latent code" })
    }

    /// Whether lanes of this material and lanes of `other` can be in one tile.
    fn shares_tiles_with(&self, other: &Self) -> bool {
        std::ptr::eq(self, other)
    }

    /// f_r in every lane, of that lane's material; the first [shares tiles with](Model::shares_tiles_with) each.
    fn eval_mixed_tile(materials: &[&Self; LANES], light: &Lane3, view: &Lane3, out: &mut Lane3) {
        materials[0].eval_tile(light, view, out);
    }

    /// What a surface reflects at a place; `None` for a model that is the same everywhere.
    fn at(&self, _place: &Place) -> Option<Local<'_>> {
        None
    }

    /// f_r of every pair at its place; the slices have one length.
    fn eval_packet_at(&self, _places: &[Place], light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]) {
        self.eval_packet(light, view, out);
    }

    /// The material between this one and `other` of the same library, with a share `t` in [0, 1] of `other`.
    ///
    /// # Errors
    /// [`Invalid::Mix`].
    fn mix(&self, _other: &Self, _t: f32) -> Result<Self, Invalid> {
        Err(Unmixable::Model(Self::KIND).into())
    }
}

/// What a surface reflects at a place: a BRDF.
#[derive(Clone, Copy, Debug)]
pub enum Local<'a> {
    /// Of [`maps`].
    Facet(maps::Facet),
    /// Of [`gated`].
    Gated(gated::Point<'a>),
}

/// A variant as files spell it.
pub(crate) fn spelled(variant: &impl Serialize) -> String {
    match serde_json::to_value(variant) {
        Ok(serde_json::Value::String(name)) => name,
        other => format!("{other:?}"),
    }
}

//! The catalogue of extreme inputs: pairs of directions and materials at the edges of what they can
//! be, by name. Every model and every face is run on all of it.

mod materials;
mod pairs;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DVec3, Vec3};
use glimt_core::library::{Entry, Origin};
use glimt_core::microfacet::{self, ETA_RANGE, MIN_ALPHA, Microfacet};
use glimt_core::models::factor::{self, Interpolation, Variant};
use glimt_core::models::ggx::Ggx;
use glimt_core::models::hybrid::{self, Hybrid};
use glimt_core::models::nbrdf::{self, Nbrdf};
use glimt_core::models::neural::{self, Neural, Shared};
use glimt_core::sampling::SamplerChoice;
use glimt_core::{AnyModel, Kind, Library, Material};

use crate::measurements;
use crate::stability::{nudged_layer, nudged_network};
pub use pairs::families;

/// A light and a view.
pub type Pair = (Vec3, Vec3);

/// Pairs that are extreme in the same way.
pub struct Family {
    /// What is extreme about them.
    pub name: &'static str,
    /// The pairs.
    pub pairs: Vec<Pair>,
}

/// A material that is extreme in some way.
#[derive(Clone)]
pub struct Case {
    /// What is extreme about it.
    pub name: String,
    /// The material.
    pub material: Material,
    /// Its sampler as commands and scenes ask for it; empty for the one that it comes with.
    pub sampler: &'static str,
    /// The file of a measurement; models are saved as libraries.
    pub file: Option<MeasuredFile>,
}

/// A measurement's file.
#[derive(Clone)]
pub struct MeasuredFile {
    /// That of its name, by which the format is told where its content does not.
    pub extension: &'static str,
    /// Its content.
    pub bytes: Vec<u8>,
}

impl Case {
    /// A material with its own sampler.
    #[must_use]
    pub fn new(name: String, material: Material) -> Case {
        Case { name, material, sampler: "", file: None }
    }

    /// The same material with another sampler, see [`SamplerChoice`].
    ///
    /// # Panics
    /// If there is no such sampler.
    #[must_use]
    pub fn sampled(&self, sampler: &'static str) -> Case {
        let choice: SamplerChoice = sampler.parse().expect("the name of a sampler");
        let name = format!("{}, sampled by {sampler}", self.name);
        Case { name, material: self.material.with_sampler(choice), sampler, file: self.file.clone() }
    }

    /// Writes the material to a file of this name and the extension of its format, which it names: a measurement in
    /// its format, a model as a library. Its sampler is not in the file.
    ///
    /// # Errors
    /// [`glimt_core::Error::Write`].
    pub fn save(&self, path: &Path) -> Result<PathBuf, glimt_core::Error> {
        let Some(MeasuredFile { extension, bytes }) = &self.file else {
            let path = path.with_extension("safetensors");
            let (name, material) = (self.name.clone(), self.material.clone());
            Library::new(&path, vec![Entry { name, material, origin: Origin::default() }])?.save()?;
            return Ok(path);
        };
        let path = path.with_extension(extension);
        match std::fs::write(&path, bytes) {
            Ok(()) => Ok(path),
            Err(source) => Err(glimt_core::Error::Write { path, source }),
        }
    }
}

/// What the catalogue has of a model.
pub struct Part {
    /// The model.
    pub kind: Kind,
    /// Its materials.
    pub cases: fn() -> Vec<Case>,
    /// Largest [`blame`](crate::accuracy::Comparison::blame) that it is allowed.
    pub budget: f64,
}

impl Part {
    /// What there is of `kind`.
    #[must_use]
    pub fn of(kind: Kind) -> Part {
        let (cases, budget): (fn() -> Vec<Case>, f64) = match kind {
            Kind::Ggx => (materials::ggx, 4.0),
            Kind::Hybrid => (materials::hybrid, 8.0),
            Kind::Neural => (materials::neural, 4.0),
            Kind::Nbrdf => (materials::nbrdf, 4.0),
            // A place among 90 bins takes 6 of a float's 24 bits.
            Kind::Factor => (materials::factor, 32.0),
            // These have no reference, see [`reference`].
            Kind::Analytic => (materials::analytic, 0.0),
            Kind::Spherical => (materials::spherical, 0.0),
            Kind::Tabulated => (measurements::cases, 0.0),
        };
        Part { kind, cases, budget }
    }
}

/// The catalogue's materials, model by model.
#[must_use]
pub fn parts() -> [Part; Kind::ALL.len()] {
    Kind::ALL.map(Part::of)
}

/// One material of every model, for tests that need all models but no extremes.
///
/// # Panics
/// If the catalogue has none of a model.
#[must_use]
pub fn materials_of_every_kind() -> Vec<Case> {
    parts().iter().map(|part| (part.cases)().swap_remove(0)).collect()
}

/// f of a pair above the horizon by the model's float64 reference; `None` for kinds that have
/// none, and tables that are constant in each bin, whose error at an edge is that of the bin.
#[must_use]
pub fn reference(material: &Material, light: DVec3, view: DVec3) -> Option<[f64; 3]> {
    let f = match material.model() {
        AnyModel::Ggx(m) => microfacet::reference::eval(m.microfacet(), light.into(), view.into()),
        AnyModel::Hybrid(m) => hybrid::reference::eval(m, light, view),
        AnyModel::Neural(m) => neural::reference::eval(m, light, view),
        AnyModel::Nbrdf(m) => nbrdf::reference::eval(m, light, view),
        AnyModel::Factor(m) => {
            let form = m.form();
            if form.variant == Variant::Naive || form.interpolation == Interpolation::Nearest {
                return None;
            }
            factor::reference::eval(m, light, view)
        }
        // The pixel of a direction is found in float32. Beside an edge, where catalogues look, the reference may be
        // in the next one, where f is as good but not the same; away from edges the model's own tests compare them.
        AnyModel::Spherical(_) => return None,
        // A measurement is the table that it is, and these are evaluated in float64 themselves.
        AnyModel::Tabulated(_) | AnyModel::Analytic(_) => return None,
    };
    Some(f)
}

/// The material with each of its numbers put through `nudge`, which moves them by an ULP; `None` for
/// a model whose numbers do not enter sums.
#[must_use]
pub fn nudged(material: &Material, nudge: &mut dyn FnMut(f32) -> f32) -> Option<Material> {
    let nudged_microfacet = |m: &Microfacet, nudge: &mut dyn FnMut(f32) -> f32| Microfacet {
        kd: m.kd.map(&mut *nudge).map(|kd| kd.clamp(0.0, 1.0)),
        eta: m.eta.map(&mut *nudge).map(|eta| eta.clamp(ETA_RANGE[0], ETA_RANGE[1])),
        alpha: m.alpha.map(&mut *nudge).map(|alpha| alpha.clamp(MIN_ALPHA, 1.0)),
    };
    let nudged: Result<Material, String> = match material.model() {
        AnyModel::Ggx(m) => Ggx::new(nudged_microfacet(m.microfacet(), nudge)).map(Material::from),
        AnyModel::Hybrid(m) => {
            let network = Arc::new(nudged_network(m.network(), nudge));
            let microfacet = nudged_microfacet(m.microfacet(), nudge);
            let latent = m.latent().iter().map(|&z| nudge(z)).collect();
            Hybrid::new(m.form(), network, microfacet, latent, m.bound()).map(Material::from)
        }
        AnyModel::Neural(m) => {
            let network = nudged_network(&m.shared().network, nudge);
            let shared = Shared { network, frames: nudged_layer(&m.shared().frames, nudge) };
            let latent = m.latent().iter().map(|&z| nudge(z)).collect();
            Neural::new(Arc::new(shared), latent, m.bound()).map(Material::from)
        }
        AnyModel::Nbrdf(m) => Nbrdf::new(Arc::new(nudged_network(m.network(), nudge))).map(Material::from),
        AnyModel::Factor(_) | AnyModel::Analytic(_) | AnyModel::Tabulated(_) | AnyModel::Spherical(_) => {
            return None;
        }
    };
    Some(nudged.expect("numbers stay in their ranges"))
}

/// Writes every material of the catalogue to `directory` as a file of its own, see [`Case::save`].
///
/// # Errors
/// [`glimt_core::Error::Write`].
pub fn save_files(directory: &Path) -> Result<Vec<(PathBuf, Case)>, glimt_core::Error> {
    let mut saved = Vec::new();
    for Part { kind, cases, .. } in parts() {
        for (i, case) in cases().into_iter().enumerate() {
            saved.push((case.save(&directory.join(format!("{kind}-{i}")))?, case));
        }
    }
    Ok(saved)
}

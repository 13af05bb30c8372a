//! The catalogue of extreme inputs: pairs of directions and materials at the edges of what they can
//! be, by name. Every model and every face is run on all of it.

mod materials;
mod pairs;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DVec3, Vec3};
use glimt_core::analytic::Analytic;
use glimt_core::factor::{self, Factor, Interpolation, Variant};
use glimt_core::ggx::Ggx;
use glimt_core::hybrid::{self, Hybrid};
use glimt_core::library::{Entry, Origin};
use glimt_core::microfacet::{self, ETA_RANGE, MIN_ALPHA, Microfacet};
use glimt_core::nbrdf::{self, Nbrdf};
use glimt_core::neural::{self, Neural, Shared};
use glimt_core::sampler::SamplerChoice;
use glimt_core::spherical::Spherical;
use glimt_core::tabulated::Tabulated;
use glimt_core::{AnyModel, Library, Material, Model};

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
}

/// A kind of model.
pub struct Kind {
    /// As files and commands spell it.
    pub name: &'static str,
    /// Its materials of the catalogue.
    pub cases: fn() -> Vec<Case>,
    /// Largest [`blame`](crate::accuracy::Comparison::blame) that it is allowed.
    pub budget: f64,
}

/// Every kind of model. A new one is covered by a line here and its reference in [`reference`].
pub const KINDS: [Kind; 8] = [
    Kind { name: Ggx::KIND, cases: materials::ggx, budget: 4.0 },
    Kind { name: Hybrid::KIND, cases: materials::hybrid, budget: 8.0 },
    Kind { name: Neural::KIND, cases: materials::neural, budget: 4.0 },
    Kind { name: Nbrdf::KIND, cases: materials::nbrdf, budget: 4.0 },
    // A place among 90 bins takes 6 of a float's 24 bits.
    Kind { name: Factor::KIND, cases: materials::factor, budget: 32.0 },
    Kind { name: Analytic::KIND, cases: materials::analytic, budget: 0.0 },
    Kind { name: Spherical::KIND, cases: materials::spherical, budget: 0.0 },
    Kind { name: Tabulated::KIND, cases: measurements::cases, budget: 0.0 },
];

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

/// Writes every material of the catalogue to `directory` as a file of its own, which it names: a measurement
/// in its format, a model as a library. Its sampler is not in the file.
///
/// # Errors
/// [`glimt_core::Error::Write`].
pub fn save_files(directory: &Path) -> Result<Vec<(PathBuf, Case)>, glimt_core::Error> {
    let mut saved = Vec::new();
    for kind in KINDS {
        for (i, case) in (kind.cases)().into_iter().enumerate() {
            let path = directory.join(format!("{}-{i}", kind.name));
            let path = if let Some(MeasuredFile { extension, bytes }) = &case.file {
                let path = path.with_extension(extension);
                let written = std::fs::write(&path, bytes);
                written.map_err(|source| glimt_core::Error::Write { path: path.clone(), source })?;
                path
            } else {
                let path = path.with_extension("safetensors");
                let (name, material) = (case.name.clone(), case.material.clone());
                Library::new(&path, vec![Entry { name, material, origin: Origin::default() }])?.save()?;
                path
            };
            saved.push((path, case));
        }
    }
    Ok(saved)
}

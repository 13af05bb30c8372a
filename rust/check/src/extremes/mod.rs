//! The catalogue of extreme inputs: pairs of directions and materials at the edges of what they can
//! be, by name. Every model and every face is run on all of it.

mod materials;
mod measurements;
mod pairs;

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use glimt_core::library::{Entry, Origin};
use glimt_core::sampling::SamplerChoice;
use glimt_core::{Kind, Library, Material, Model, with_kind, with_model};

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

/// What the catalogue knows of a model.
pub(crate) trait Extreme: Model {
    /// Largest [`blame`](crate::accuracy::Comparison::blame) that it is allowed.
    const BUDGET: f64;

    /// Its extreme materials, the least extreme of which is the first.
    fn cases() -> Vec<Case>;

    /// f of a pair above the horizon by the model's float64 reference, if it has one that holds for every pair.
    fn reference(&self, _light: DVec3, _view: DVec3) -> Option<[f64; 3]> {
        None
    }

    /// The material with each of its numbers put through `nudge`, which moves them by an ULP; `None` for
    /// a model whose numbers do not enter sums.
    fn nudged(&self, _nudge: &mut dyn FnMut(f32) -> f32) -> Option<Self> {
        None
    }
}

impl Part {
    /// What there is of `kind`.
    #[must_use]
    pub fn of(kind: Kind) -> Part {
        with_kind!(kind, Of => Part { kind, cases: <Of as Extreme>::cases, budget: <Of as Extreme>::BUDGET })
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

/// f of a pair above the horizon by the model's float64 reference, if it has one that holds for every pair.
#[must_use]
pub fn reference(material: &Material, light: DVec3, view: DVec3) -> Option<[f64; 3]> {
    with_model!(material.model(), model => Extreme::reference(model, light, view))
}

/// The material with each of its numbers put through `nudge`, which moves them by an ULP; `None` for
/// a model whose numbers do not enter sums.
#[must_use]
pub fn nudged(material: &Material, nudge: &mut dyn FnMut(f32) -> f32) -> Option<Material> {
    with_model!(material.model(), model => Extreme::nudged(model, nudge).map(Material::from))
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

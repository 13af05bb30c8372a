//! Who is held against whom: measurements, and models of them by name.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use glimt_core::library::Entry;
use glimt_core::{Kind, Library, Material};
use glimt_files::{Source, sha256};

use crate::Usage;

/// A material that models are held against.
pub struct Truth {
    pub name: String,
    pub file: PathBuf,
    pub sha256: String,
    pub format: &'static str,
    pub material: Material,
}

/// A model with its materials.
pub struct Model {
    /// Unique in a report.
    pub name: String,
    pub kind: &'static str,
    /// The file, or the first of several.
    pub file: PathBuf,
    /// Where there are several, the file of every material.
    files: Vec<PathBuf>,
    pub sha256: String,
    pub entries: Vec<Entry>,
    /// Bytes of tensors that a material has of its own, and that all share.
    pub bytes: (usize, usize),
    /// Seconds that its fit took, if it was made here.
    pub fit_seconds: Option<f64>,
}

/// Both sides.
pub struct Opponents {
    pub truths: Vec<Truth>,
    pub models: Vec<Model>,
}

impl Opponents {
    /// Sorts files into measurements and models, by the rule that the command's help states.
    ///
    /// # Errors
    /// Two measurements or two models of one name, scattered samples, or nothing to hold a model against.
    pub fn new(sources: &[Source]) -> Result<Self> {
        let is_measured = |source: &&Source| matches!(source.kind(), "merl" | "rgl" | "utia");
        let has_measurements = sources.iter().any(|source| is_measured(&source));
        let mut opponents = Opponents { truths: Vec::new(), models: Vec::new() };
        // Models that come as a file for each material.
        let mut single: Vec<&Library> = Vec::new();
        for source in sources {
            let library = source.library()?;
            let is_library =
                library.path().extension().is_some_and(|e| e.eq_ignore_ascii_case("safetensors"));
            if is_measured(&source) || (!has_measurements && !is_library) {
                opponents.add_truths(library, source.kind())?;
            } else if is_library {
                opponents.add(Model::of_library(library)?)?;
            } else {
                single.push(library);
            }
        }
        for kind in Kind::ALL {
            let of_kind: Vec<&Library> =
                single.iter().copied().filter(|library| library.kind() == kind).collect();
            if !of_kind.is_empty() {
                opponents.add(Model::of_files(&of_kind)?)?;
            }
        }
        if opponents.truths.is_empty() {
            return Err(Usage("there is no measurement to hold models against".into()).into());
        }
        Ok(opponents)
    }

    fn add_truths(&mut self, library: &Library, format: &'static str) -> Result<()> {
        let hash = sha256(library.path())?;
        for entry in library.entries()? {
            if let Some(other) = self.truths.iter().find(|truth| plain(&truth.name) == plain(&entry.name)) {
                bail!(
                    "{} and {} both hold \"{}\"",
                    other.file.display(),
                    library.path().display(),
                    entry.name
                );
            }
            self.truths.push(Truth {
                name: entry.name.clone(),
                file: library.path().to_owned(),
                sha256: hash.clone(),
                format,
                material: entry.material.clone(),
            });
        }
        Ok(())
    }

    /// Adds a model.
    ///
    /// # Errors
    /// Another has its name.
    pub fn add(&mut self, model: Model) -> Result<()> {
        if let Some(other) = self.models.iter().find(|other| other.name == model.name) {
            bail!(
                "{} and {} are both called \"{}\" after their files; rename one",
                other.file.display(),
                model.file.display(),
                model.name
            );
        }
        self.models.push(model);
        Ok(())
    }

    /// The measurement of a material.
    pub fn truth(&self, name: &str) -> Option<&Truth> {
        self.truths.iter().find(|truth| plain(&truth.name) == plain(name))
    }

    /// The models that have a material of this name.
    pub fn against<'a>(&'a self, truth: &'a Truth) -> impl Iterator<Item = (&'a Model, &'a Entry)> {
        let entry =
            |model: &'a Model| model.entries.iter().find(|entry| plain(&entry.name) == plain(&truth.name));
        self.models.iter().filter_map(move |model| Some((model, entry(model)?)))
    }
}

/// A material's name without the ending that tells RGL's variants apart.
fn plain(name: &str) -> &str {
    name.strip_suffix("_rgb").or_else(|| name.strip_suffix("_spec")).unwrap_or(name)
}

impl Model {
    /// A fitted library, called after its file.
    ///
    /// # Errors
    /// The file cannot be read again.
    pub fn of_library(library: &Library) -> Result<Model> {
        Ok(Model {
            name: stem(library.path()),
            kind: library.kind().name(),
            file: library.path().to_owned(),
            sha256: sha256(library.path())?,
            files: Vec::new(),
            entries: library.entries()?.into_iter().cloned().collect(),
            bytes: library.tensor_bytes()?,
            fit_seconds: None,
        })
    }

    /// The file that holds a material.
    pub fn file_of(&self, material: &str) -> &Path {
        let place = self.entries.iter().position(|entry| entry.name == material);
        place.and_then(|place| self.files.get(place)).unwrap_or(&self.file)
    }

    /// Several files of one kind, called after it.
    fn of_files(libraries: &[&Library]) -> Result<Model> {
        let first = libraries[0];
        let (mut hashes, mut entries) = (String::new(), Vec::new());
        for library in libraries {
            hashes += &sha256(library.path())?;
            entries.extend(library.entries()?.into_iter().cloned());
        }
        let (own, shared) = first.tensor_bytes()?;
        Ok(Model {
            name: first.kind().name().to_owned(),
            kind: first.kind().name(),
            file: first.path().to_owned(),
            sha256: hashes,
            files: libraries.iter().map(|library| library.path().to_owned()).collect(),
            entries,
            bytes: (own + shared, 0),
            fit_seconds: None,
        })
    }
}

fn stem(path: &Path) -> String {
    path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
}

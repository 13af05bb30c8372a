//! A file that holds reflectance, whatever its format.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use glimt_core::library::{Entry, Origin};
use glimt_core::{Library, Material, SampleBrdf};
use glimt_measured::Measured;
use sha2::{Digest, Sha256};

use crate::error::Error;
use crate::keras;
use crate::nbrdf;
use crate::npy;
use crate::samples::Samples;
use crate::table::Table;

/// What a file holds: models, or a measurement as it is.
#[derive(Clone, Debug)]
pub enum Source {
    /// A model library, or NBRDF weights as a library of one material.
    Library(Library),
    /// A measured file.
    Table {
        /// Where it was read from.
        path: PathBuf,
        /// The table.
        table: Box<Table>,
    },
    /// Scattered samples: f at some pairs of directions, and nothing between them.
    Samples {
        /// Where they were read from.
        path: PathBuf,
        /// The samples.
        samples: Samples,
    },
}

impl Source {
    /// Opens a file by its content.
    ///
    /// # Errors
    /// [`Error::Read`], [`Error::UnknownFormat`], and the errors of the format.
    pub fn open(path: impl AsRef<Path>) -> Result<Source, Error> {
        let path = path.as_ref();
        let start = start(path)?;
        let has_extension = |wanted: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(wanted));
        if has_extension("safetensors") || start.get(8) == Some(&b'{') {
            return Ok(Source::Library(Library::open(path)?));
        }
        let is_archive = start.starts_with(nbrdf::NPZ_MAGIC) || start.starts_with(keras::MAGIC);
        if is_archive || has_extension("npz") || has_extension("h5") {
            return open_nbrdf(path);
        }
        if start.starts_with(npy::MAGIC) {
            let is_first = |name: &str| nbrdf::FIRST_NPY.iter().any(|end| name.ends_with(end));
            return if path.file_name().and_then(|name| name.to_str()).is_some_and(is_first) {
                open_nbrdf(path)
            } else {
                open_samples(path)
            };
        }
        if has_extension("csv") {
            return open_samples(path);
        }
        match Measured::open(path) {
            Ok(measured) => {
                Ok(Source::Table { path: path.to_owned(), table: Box::new(Table::new(measured)) })
            }
            Err(glimt_measured::Error::UnknownFormat { found, .. }) => Err(unknown(path, &found)),
            Err(error) => Err(error.into()),
        }
    }

    /// Where it was read from.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Source::Library(library) => library.path(),
            Source::Table { path, .. } | Source::Samples { path, .. } => path,
        }
    }

    /// The model or the measured format: `ggx`, `hybrid`, `neural`, `nbrdf`, `factor`, `merl`, `rgl`, `utia`,
    /// `samples`.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Source::Library(library) => library.kind(),
            Source::Table { table, .. } => match table.measured() {
                Measured::Merl(_) => "merl",
                Measured::Rgl(_) => "rgl",
                Measured::Utia(_) => "utia",
            },
            Source::Samples { .. } => "samples",
        }
    }

    /// Names of the materials in the file's order.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        match self {
            Source::Library(library) => library.names(),
            Source::Table { table, .. } => vec![table.measured().name().to_owned()],
            Source::Samples { path, .. } => {
                vec![path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()]
            }
        }
    }

    /// The material of that name; the only one if `name` is `None` and there is one.
    ///
    /// # Errors
    /// The library's: an unknown name, with the nearest ones, or none where there are several. [`Error::OnlySamples`].
    pub fn brdf(&self, name: Option<&str>) -> Result<&dyn SampleBrdf, Error> {
        match self {
            Source::Library(library) => Ok(library.material(name)?),
            Source::Table { path, table } => match name {
                Some(name) if name != table.measured().name() => {
                    let materials = self.names();
                    let nearest = glimt_core::library::nearest(name, materials.iter().map(String::as_str));
                    let (path, name) = (path.clone(), name.to_owned());
                    Err(glimt_core::Error::UnknownMaterial { path, name, nearest, materials }.into())
                }
                _ => Ok(&**table),
            },
            Source::Samples { path, .. } => Err(Error::OnlySamples { path: path.clone() }),
        }
    }
}

/// A file's first bytes.
fn start(path: &Path) -> Result<Vec<u8>, Error> {
    let read = || {
        let mut start = Vec::new();
        File::open(path)?.take(16).read_to_end(&mut start)?;
        Ok(start)
    };
    read().map_err(Error::read(path))
}

fn open_samples(path: &Path) -> Result<Source, Error> {
    Ok(Source::Samples { path: path.to_owned(), samples: Samples::open(path)? })
}

fn unknown(path: &Path, found: &str) -> Error {
    Error::UnknownFormat { path: path.to_owned(), found: format!("found {found}") }
}

/// NBRDF weights as a library of one material.
fn open_nbrdf(path: &Path) -> Result<Source, Error> {
    let material = Material::Nbrdf(nbrdf::open(path)?);
    let source = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let origin = Origin { source, sha256: sha256(path)?, command: "import".into(), ..Origin::default() };
    let entry = Entry { name: nbrdf::name(path), material, origin };
    Ok(Source::Library(Library::new(path, vec![entry])?))
}

/// SHA-256 of a file in hexadecimal.
///
/// # Errors
/// [`Error::Read`].
pub fn sha256(path: &Path) -> Result<String, Error> {
    let bytes = std::fs::read(path).map_err(Error::read(path))?;
    Ok(Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hash_is_that_of_the_standard() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        // FIPS 180-4, the example of one block.
        assert_eq!(
            sha256(&path).unwrap(),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
    }

    #[test]
    fn what_is_unknown_is_refused_with_what_is_known() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("readme.txt");
        std::fs::write(&path, "hello").unwrap();
        let message = Source::open(&path).unwrap_err().to_string();
        assert!(message.contains("readme.txt: found 5 bytes that begin with \"hello\""), "{message}");
        assert!(message.contains(".safetensors") && message.contains(".npz"), "{message}");
        assert!(matches!(Source::open(folder.path()), Err(Error::Read { .. })));
        assert!(matches!(Source::open(folder.path().join("none.bsdf")), Err(Error::Read { .. })));
    }
}

//! A file that holds reflectance, whatever its format.

use std::io::Read;
use std::path::{Path, PathBuf};

use glimt_core::library::{Entry, Origin};
use glimt_core::{AnyModel, Library, Material};
use glimt_measured::Measured;
use glimt_measured::file::{open_regular, read_regular};
use sha2::{Digest, Sha256};

use crate::error::Error;
use crate::keras;
use crate::merl_fits;
use crate::nbrdf;
use crate::npy;
use crate::samples::Samples;

/// What a file holds: materials, or samples of one.
#[derive(Clone, Debug)]
pub enum Source {
    /// A model library; a measured table, NBRDF weights or published analytic fits as one.
    Library(Library),
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
        if has_extension("fit") {
            return Ok(Source::Library(merl_fits::open(path)?));
        }
        if has_extension("csv") {
            return open_samples(path);
        }
        match Measured::open(path) {
            Ok(measured) => {
                let name = measured.name().to_owned();
                single(path, name, measured.into_material(), Origin::default())
            }
            Err(glimt_measured::Error::UnknownFormat { found, .. }) => Err(unknown(path, &found)),
            Err(error) => Err(error.into()),
        }
    }

    /// The materials.
    ///
    /// # Errors
    /// [`Error::OnlySamples`].
    pub fn library(&self) -> Result<&Library, Error> {
        match self {
            Source::Library(library) => Ok(library),
            Source::Samples { path, .. } => Err(Error::OnlySamples { path: path.clone() }),
        }
    }

    /// Where it was read from.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Source::Library(library) => library.path(),
            Source::Samples { path, .. } => path,
        }
    }

    /// The name of the model ([`Kind::name`](glimt_core::Kind::name)); for a measured table that of its format
    /// (`merl`, `rgl`, `utia`), and `samples` for scattered samples.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Source::Library(library) => match library.first().map(|entry| entry.material.model()) {
                Ok(AnyModel::Tabulated(tabulated)) => tabulated.table().format(),
                _ => library.kind().name(),
            },
            Source::Samples { .. } => "samples",
        }
    }

    /// Names of the materials in the file's order.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        match self {
            Source::Library(library) => library.names(),
            Source::Samples { path, .. } => {
                vec![path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()]
            }
        }
    }

    /// The material of that name; the only one if `name` is `None` and there is one.
    ///
    /// # Errors
    /// The library's: an unknown name, with the nearest ones, or none where there are several. [`Error::OnlySamples`].
    pub fn brdf(&self, name: Option<&str>) -> Result<&Material, Error> {
        Ok(self.library()?.material(name)?)
    }
}

/// A file's first bytes.
fn start(path: &Path) -> Result<Vec<u8>, Error> {
    let read = || {
        let mut start = Vec::new();
        open_regular(path)?.take(16).read_to_end(&mut start)?;
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

/// A file of one material as a library of it.
fn single(path: &Path, name: String, material: Material, origin: Origin) -> Result<Source, Error> {
    Ok(Source::Library(Library::new(path, vec![Entry { name, material, origin }])?))
}

/// NBRDF weights as a library of one material.
fn open_nbrdf(path: &Path) -> Result<Source, Error> {
    let material = Material::from(nbrdf::open(path)?);
    let source = file_name(path);
    let origin = Origin { source, sha256: sha256(path)?, command: "import".into(), ..Origin::default() };
    single(path, nbrdf::name(path), material, origin)
}

pub(crate) fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// SHA-256 of a file in hexadecimal.
///
/// # Errors
/// [`Error::Read`].
pub fn sha256(path: &Path) -> Result<String, Error> {
    Ok(sha256_of(&read_regular(path).map_err(Error::read(path))?))
}

/// SHA-256 of some bytes, in hexadecimal.
#[must_use]
pub fn sha256_of(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
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

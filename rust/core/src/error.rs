//! What can go wrong with a model library.

use std::path::PathBuf;

/// An error of the model library; every message names the file.
///
/// ```
/// use glimt_core::{Error, Library};
///
/// let library = Library::open("../../scenes/models/rgl.safetensors")?;
/// match library.material(Some("chm_orang")) {
///     Err(Error::UnknownMaterial { nearest, .. }) => assert_eq!(nearest[0], "chm_orange"),
///     other => panic!("{other:?}"),
/// }
/// # Ok::<(), Error>(())
/// ```
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not a model library, or not a valid one.
    #[error("{} is not a valid glimt model library: {reason}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What was found and what was expected.
        reason: String,
    },
    /// The library has no material of that name.
    #[error("{} has no material \"{name}\"; {}", path.display(), hint(nearest, materials))]
    UnknownMaterial {
        /// The file.
        path: PathBuf,
        /// The name that was asked for.
        name: String,
        /// Names that resemble it, best first.
        nearest: Vec<String>,
        /// Number of materials in the library.
        materials: Vec<String>,
    },
    /// No material was named, and the library has several.
    #[error("{} holds {} materials, so one must be named: {}", path.display(), materials.len(), list(materials))]
    MaterialNotNamed {
        /// The file.
        path: PathBuf,
        /// The names in the library.
        materials: Vec<String>,
    },
    /// Two materials cannot be mixed.
    #[error("{}: \"{a}\" and \"{b}\" {reason}", path.display())]
    Mix {
        /// The file.
        path: PathBuf,
        /// The first material.
        a: String,
        /// The second.
        b: String,
        /// Why, in words that go on from the names.
        reason: String,
    },
    /// A parameter of a material is out of its range, or the model has no such parameter.
    #[error("material \"{material}\": {reason}")]
    Parameter {
        /// The material.
        material: String,
        /// What was found and what was expected.
        reason: String,
    },
}

/// Most names that a message lists.
const LISTED: usize = 12;

fn list(names: &[String]) -> String {
    let mut text = names.iter().take(LISTED).map(String::as_str).collect::<Vec<_>>().join(", ");
    if names.len() > LISTED {
        text += ", …";
    }
    text
}

fn hint(nearest: &[String], materials: &[String]) -> String {
    if nearest.is_empty() {
        format!("it holds {}", list(materials))
    } else {
        format!("did you mean {}?", nearest.join(" or "))
    }
}

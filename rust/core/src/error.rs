//! What can go wrong with a material and with a model library.

use std::path::PathBuf;

/// Why numbers are no material, or why a material cannot be what was asked for.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Invalid {
    /// A parameter is out of its range.
    #[error("{name} is {value}, expected a value in [{low}, {high}]")]
    OutOfRange {
        /// The parameter.
        name: &'static str,
        /// What it is.
        value: f32,
        /// The least that it may be.
        low: f32,
        /// The most that it may be.
        high: f32,
    },
    /// A latent code is not as long as those of the model.
    #[error("the latent code has {found} numbers, expected {expected}")]
    LatentLength {
        /// Its length.
        found: usize,
        /// That of the others.
        expected: usize,
    },
    /// The model has no such parameters.
    #[error("a {kind} material has no {parameters}")]
    NoSuchParameter {
        /// The model's name.
        kind: &'static str,
        /// The parameters.
        parameters: &'static str,
    },
    /// Two materials cannot be mixed.
    #[error(transparent)]
    Mix(#[from] Unmixable),
    /// Parts that do not fit together, or numbers that no model can have: what was found and what was expected.
    #[error("{0}")]
    Parts(String),
}

impl From<String> for Invalid {
    fn from(reason: String) -> Invalid {
        Invalid::Parts(reason)
    }
}

impl From<&str> for Invalid {
    fn from(reason: &str) -> Invalid {
        Invalid::Parts(reason.to_owned())
    }
}

impl From<Invalid> for String {
    fn from(invalid: Invalid) -> String {
        invalid.to_string()
    }
}

/// Why two materials cannot be mixed, in words that go on from their names.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Unmixable {
    /// They are of two models.
    #[error("are of two models, and only one model's mix")]
    Models,
    /// Each has a network of its own.
    #[error("have no network in common, and what differs between them is no code")]
    Networks,
    /// The model has nothing to go between.
    #[error("cannot be mixed: a {0} material has no parameters between which to go")]
    Model(&'static str),
    /// The weight is not one.
    #[error("are mixed with a weight of {0}, expected one in [0, 1]")]
    Weight(f32),
}

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
        /// Why.
        reason: Invalid,
    },
    /// A parameter of a material is out of its range, or the model has no such parameter.
    #[error("material \"{material}\": {reason}")]
    Parameter {
        /// The material.
        material: String,
        /// What was found and what was expected.
        reason: Invalid,
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

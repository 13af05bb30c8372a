//! What is fitted to: materials by name.

use glimt_core::library::Origin;

use crate::error::Error;
use crate::truth::Truth;

/// A material to fit to.
pub struct Input<'a> {
    /// Its name in the library.
    pub name: String,
    /// Its reflectance: a function, or scattered samples of one.
    pub truth: Truth<'a>,
    /// Whether it is the same in every azimuth.
    pub isotropic: bool,
    /// Where it came from.
    pub origin: Origin,
}

/// Whether all of `inputs` are the same in every azimuth.
pub(crate) fn all_isotropic(inputs: &[Input]) -> bool {
    inputs.iter().all(|input| input.isotropic)
}

/// What a checkpoint knows `inputs` by: names, and hashes of their sources.
pub(crate) fn identities(inputs: &[Input]) -> Vec<(String, String)> {
    inputs.iter().map(|input| (input.name.clone(), input.origin.sha256.clone())).collect()
}

/// Refuses no materials, and those that nothing can be fitted to.
pub(crate) fn check(inputs: &[Input]) -> Result<(), Error> {
    if inputs.is_empty() {
        return Err(Error::Options("there is no material to fit to".into()));
    }
    inputs.iter().try_for_each(|input| {
        input.truth.check().map_err(|reason| Error::Material { name: input.name.clone(), reason })
    })
}

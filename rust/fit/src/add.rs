//! New materials for a finished library, whose shared numbers stay as they are.

use glimt_core::library::{Entry, Library};

use crate::error::Error;
use crate::fittable::{Fit, fit_model};
use crate::hybrid::addition::Addition;
use crate::input::{Input, all_isotropic};
use crate::train::{Schedule, Watch};

/// Steps of [`add`] when the caller has no other wish.
pub const ADD_STEPS: u64 = 1500;

/// The entries for new materials of a hybrid library whose network stays as it is: only z, k_d, η
/// and α are fitted. `None` if it was stopped.
///
/// # Errors
/// [`Error::Options`] if the library is not a hybrid one with a shared network, or if a material is
/// anisotropic and the library is not; [`Error::Library`], [`Error::Material`], [`Error::Diverged`].
pub fn add(
    library: &Library,
    inputs: &[Input],
    steps: u64,
    seed: u64,
    watch: &mut Watch,
) -> Result<Option<Vec<Entry>>, Error> {
    let schedule = Schedule { rate: 0.02, freeze_shared: true, ..Schedule::standard(steps, seed) };
    Ok(match fit_model(&Addition::new(library)?, inputs, &schedule, None, watch)? {
        Fit::Done(entries) => Some(entries),
        Fit::Stopped(_) => None,
    })
}

/// How many numbers [`add`] fits for each of `inputs`.
///
/// # Errors
/// As [`add`], if nothing can be added to the library.
pub fn numbers_each(library: &Library, inputs: &[Input]) -> Result<usize, Error> {
    Ok(Addition::new(library)?.own_len(all_isotropic(inputs)))
}

//! From materials to a model library.

use glimt_core::library::Entry;

use crate::checkpoint::{Checkpoint, CheckpointOf};
use crate::error::Error;
use crate::fittable::Fit;
use crate::input::{Input, identities};
use crate::options::Options;
use crate::train::{MAX_BLOCKS, Schedule, State, Watch};

/// How a fit with options `O` ended.
// A fit has one outcome, whose size does not matter.
#[allow(clippy::large_enum_variant)]
pub enum Outcome<O = Options> {
    /// Every step is done.
    Done(Vec<Entry>),
    /// It was stopped, and can go on from here; `None` if there is nothing yet to go on from.
    Stopped(Option<CheckpointOf<O>>),
}

/// Fits one library to all `inputs`; goes on from `resume` if it is given.
///
/// # Errors
/// [`Error::Options`] for options that make no sense or a checkpoint of another fit,
/// [`Error::Material`], [`Error::Diverged`].
pub fn fit(
    inputs: &[Input],
    options: &Options,
    resume: Option<Checkpoint>,
    watch: &mut Watch,
) -> Result<Outcome, Error> {
    check(&options.schedule)?;
    let resumed = resume.map(|checkpoint| state_of(checkpoint, options, &identities(inputs))).transpose()?;
    Ok(match options.model.fittable().fit(inputs, &options.schedule, resumed, watch)? {
        Fit::Done(entries) => Outcome::Done(entries),
        Fit::Stopped(state) => Outcome::Stopped(state.map(|state| Checkpoint::new(inputs, options, state))),
    })
}

/// Where the fit of a checkpoint is, if it is one with these options of these materials.
///
/// # Errors
/// [`Error::Options`] if it is of another.
pub(crate) fn state_of<O: PartialEq>(
    checkpoint: CheckpointOf<O>,
    options: &O,
    materials: &[(String, String)],
) -> Result<State, Error> {
    let refused = |what: &str| Err(Error::Options(format!("the checkpoint was made with other {what}")));
    if checkpoint.options != *options {
        return refused("options; use the same ones");
    }
    if checkpoint.materials != materials {
        return refused("materials; use the same files");
    }
    Ok(checkpoint.state)
}

fn check(schedule: &Schedule) -> Result<(), Error> {
    let Schedule { blocks, rate, .. } = *schedule;
    if !(1..=MAX_BLOCKS).contains(&blocks) {
        return Err(Error::Options(format!("a step has {blocks} blocks, expected 1 to {MAX_BLOCKS}")));
    }
    if !(rate > 0.0 && rate.is_finite()) {
        return Err(Error::Options(format!("the learning rate is {rate}, expected a positive number")));
    }
    Ok(())
}

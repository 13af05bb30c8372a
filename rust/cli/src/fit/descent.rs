//! Fits by gradients, with a checkpoint now and then.

use std::ops::ControlFlow;

use anyhow::{Result, bail};
use glimt_core::library::Entry;
use glimt_fit::checkpoint::Checkpoint;
use glimt_fit::{Options, Outcome, doubts, fit};

use super::job::Job;
use crate::fitting::{self, Watch};

/// Fits a model; goes on from a checkpoint if there is one.
///
/// # Errors
/// Those of the fit, and an interrupt, after which there is a checkpoint.
pub fn descend(job: &mut Job, options: &Options, resume: Option<Checkpoint>) -> Result<Vec<Entry>> {
    let Job { truths, inputs, keeper, .. } = job;
    let isotropic = inputs.iter().all(|input| input.isotropic);
    let doubts = doubts(inputs, options.numbers_each(inputs.len(), isotropic));
    truths.check_running()?;
    fitting::warn(&doubts);
    let mut watch = Watch::new()?;
    let outcome = fit(inputs, options, resume, &mut |progress, state| {
        if truths.check_running().is_err() {
            return ControlFlow::Break(());
        }
        if let Some(state) = state {
            keeper.keep(|path| Ok(Checkpoint::new(inputs, options, state.clone()).save(path)?));
        }
        watch.report(progress)
    });
    truths.check_running()?;
    match outcome? {
        Outcome::Done(entries) => {
            watch.finish();
            Ok(entries)
        }
        Outcome::Stopped(None) => bail!("stopped before there was anything to save"),
        Outcome::Stopped(Some(checkpoint)) => {
            checkpoint.save(keeper.path())?;
            bail!(super::stopped(checkpoint.state.step, options.schedule.steps, keeper.path()));
        }
    }
}

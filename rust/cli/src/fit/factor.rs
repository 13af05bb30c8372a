//! `glimt fit --model factor`: tables, which take no gradients but turns.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use glimt_core::library::{Entry, Origin};
use glimt_core::models::factor::{self, Interpolation};
use glimt_core::{Kind, Library};
use glimt_fit::{FactorOptions, Input, Truth, doubts, doubts_of_tables, fit_factor};

use super::job::Job;
use super::shared::{self, Between, Resume};
use crate::fitting::{self, Watch};
use crate::{Usage, output};

#[derive(Args)]
pub struct FactorArguments {
    #[command(flatten)]
    pub resume: Resume,
    #[command(flatten)]
    between: Between,
    /// Which factors [default: independent-g]
    #[arg(long, value_enum, value_name = "VARIANT")]
    variant: Option<Variant>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Variant {
    /// D, F, and a G that is fitted as well
    IndependentG,
    /// D, F, and the G that Smith's model derives from D
    GFromD,
    /// D(θ_h) F(θ_d) H(φ_d), no microfacets
    Naive,
    /// One table over θ_h and θ_d
    Bivariate,
}

impl From<Variant> for factor::Variant {
    fn from(variant: Variant) -> factor::Variant {
        match variant {
            Variant::IndependentG => factor::Variant::IndependentG,
            Variant::GFromD => factor::Variant::GFromD,
            Variant::Naive => factor::Variant::Naive,
            Variant::Bivariate => factor::Variant::Bivariate,
        }
    }
}

fn interpolation(asked: shared::Interpolation) -> Option<Interpolation> {
    match asked {
        shared::Interpolation::Nearest => Some(Interpolation::Nearest),
        shared::Interpolation::Linear => Some(Interpolation::Linear),
        shared::Interpolation::Bilinear
        | shared::Interpolation::InverseDistance
        | shared::Interpolation::Constant => None,
    }
}

impl FactorArguments {
    fn options(&self, seed: u64) -> Result<FactorOptions, Usage> {
        Ok(FactorOptions {
            variant: self.variant.unwrap_or(Variant::IndependentG).into(),
            interpolation: self.between.interpolation(interpolation)?,
            seed,
        })
    }

    /// Fits tables, which takes seconds a material: what is kept on the way is the materials that are finished, as
    /// the library that they are.
    ///
    /// # Errors
    /// Inputs that are no functions, a checkpoint of another fit, an interrupt.
    pub fn fit(&self, job: &mut Job) -> Result<Vec<Entry>> {
        let Job { truths, inputs, keeper, seed } = job;
        let options = self.options(*seed)?;
        let doubts = [doubts(inputs, None), doubts_of_tables(inputs)].concat();
        truths.check_running()?;
        fitting::warn(&doubts);
        let mut entries =
            if self.resume.resume { finished(keeper.path(), inputs, &options)? } else { Vec::new() };
        let watch = Watch::new()?;
        let bar = output::progress_bar(inputs.len(), "fit");
        bar.set_position(entries.len() as u64);
        for input in &inputs[entries.len()..] {
            entries.push(fit_one(input, &options)?);
            truths.check_running()?;
            bar.inc(1);
            let save = |path: &Path| Ok(Library::new(path, entries.clone())?.save()?);
            if watch.is_stopped() && entries.len() < inputs.len() {
                save(keeper.path())?;
                bail!(
                    "stopped after {} of {} materials; the same command with --resume goes on from {}",
                    entries.len(),
                    inputs.len(),
                    keeper.path().display()
                );
            }
            keeper.keep(save);
        }
        Ok(entries)
    }
}

fn fit_one(input: &Input, options: &FactorOptions) -> Result<Entry> {
    let Truth::Brdf(brdf) = input.truth else {
        bail!(
            "\"{}\" is scattered samples, to which no tables can be fitted; expected a function",
            input.name
        );
    };
    let fit = fit_factor(brdf, options);
    let mut origin = Origin { seed: Some(options.seed), ..input.origin.clone() };
    for (channel, trace) in ["red", "green", "blue"].into_iter().zip(&fit.traces) {
        origin.metrics.insert(format!("objective_{channel}"), trace[trace.len() - 1]);
    }
    Ok(Entry { name: input.name.clone(), material: fit.factor.into(), origin })
}

/// The materials that an interrupted fit of tables has finished.
///
/// # Errors
/// There is no checkpoint, or it is of other materials or options.
fn finished(checkpoint: &Path, inputs: &[Input], options: &FactorOptions) -> Result<Vec<Entry>> {
    let hint = "no fit of this output was interrupted: leave --resume out to start one";
    if !checkpoint.exists() {
        bail!("the checkpoint {} is not there; {hint}", checkpoint.display());
    }
    let library = Library::open(checkpoint)?;
    let is_of = |entry: &Entry, input: &Input| {
        let asked = Origin { seed: Some(options.seed), ..input.origin.clone() };
        entry.name == input.name
            && Origin { metrics: BTreeMap::new(), ..entry.origin.clone() } == asked
            && library.kind() == Kind::Factor
    };
    let entries = library.entries()?;
    if entries.len() > inputs.len() || !entries.iter().zip(inputs).all(|(entry, input)| is_of(entry, input)) {
        bail!(
            "the checkpoint {} is of a fit of other materials or with other options; expected the same command",
            checkpoint.display()
        );
    }
    Ok(entries.into_iter().cloned().collect())
}

//! The time of a training step.

use std::ops::ControlFlow;

use anyhow::{Result, bail};
use glimt_core::library::Origin;
use glimt_core::microfacet::Microfacet;
use glimt_core::models::ggx::Ggx;
use glimt_fit::checkpoint::Checkpoint;
use glimt_fit::train::Schedule;
use glimt_fit::{HybridOptions, Input, Model, Net, Options, Outcome, Truth, fit};

/// Materials that are fitted together.
const MATERIALS: usize = 12;
/// Pairs of each in a step, as the standard schedule has it.
const PAIRS: usize = 1024;
/// Numbers in the latent code.
const LATENT: usize = 4;
/// Steps in one measurement: a multiple of those after which a fit reports, and enough for the drawing of
/// pairs, which comes before the first, to weigh little.
const STEPS: u64 = 200;

/// A fit of hybrids that goes on from where it was stopped: forward, both losses, backward and AdamW, with
/// the drawing of pairs left in.
pub struct Training {
    net: Net,
    targets: Vec<Ggx>,
    options: Options,
    start: Option<Checkpoint>,
}

impl Training {
    /// Fits the analytic parts, whose time does not count.
    pub fn new(net: Net) -> Result<Self> {
        let target = |i: usize| {
            let alpha = [0.05 * (i + 1) as f32; 2];
            Ggx::new(Microfacet { kd: [0.1; 3], eta: [1.5; 3], alpha })
        };
        let Ok(targets) = (0..MATERIALS).map(target).collect() else {
            bail!("the materials to fit to are out of range");
        };
        let options = Options {
            model: Model::Hybrid(HybridOptions::shared(net, LATENT)),
            // Far more than are measured, so that the fit is stopped before its end.
            schedule: Schedule::standard(1 << 30, 1),
        };
        let mut training = Training { net, targets, options, start: None };
        training.start = training.run()?.1;
        Ok(training)
    }

    /// Multiply-adds of the three products of a step: forward, and backward for inputs and for weights.
    pub fn multiply_adds(&self) -> usize {
        let Net { width, layers } = self.net;
        // Six features and six outputs, as isotropic hybrids have them.
        let network = (6 + LATENT) * width + (layers - 1) * width * width + 6 * width;
        3 * network * MATERIALS * PAIRS
    }

    /// Seconds of one step.
    pub fn seconds(&self) -> Result<f64> {
        Ok(1.0 / self.run()?.0)
    }

    /// Steps per second, and where the fit was stopped.
    fn run(&self) -> Result<(f64, Option<Checkpoint>)> {
        let input = |(i, brdf)| Input {
            name: format!("{i}"),
            truth: Truth::Brdf(brdf),
            isotropic: true,
            origin: Origin::default(),
        };
        let inputs: Vec<Input> = self.targets.iter().map(|t| t as _).enumerate().map(input).collect();
        let first = self.start.as_ref().map_or(0, |checkpoint| checkpoint.state.step);
        let mut rate = 0.0;
        let outcome = fit(&inputs, &self.options, self.start.clone(), &mut |progress, _| {
            rate = progress.rate;
            // The analytic parts have a schedule of their own, of fewer steps.
            let measured = progress.steps == self.options.schedule.steps && progress.step >= first + STEPS;
            if measured { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })?;
        match outcome {
            Outcome::Stopped(checkpoint) => Ok((rate, checkpoint)),
            Outcome::Done(_) => bail!("the fit ended before it was measured"),
        }
    }
}

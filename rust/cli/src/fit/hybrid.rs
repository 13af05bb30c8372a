//! `glimt fit --model hybrid`.

use clap::{Args, ValueEnum};
use glimt_core::models::hybrid;
use glimt_fit::train::Schedule;
use glimt_fit::{HybridOptions, InputChoice, Model, Net, Options};

use super::shared::{Code, Pairs, Paper, Resume, Training};

#[derive(Args)]
pub struct HybridArguments {
    #[command(flatten)]
    pub pairs: Pairs,
    #[command(flatten)]
    paper: Paper,
    #[command(flatten)]
    training: Training,
    #[command(flatten)]
    code: Code,
    #[command(flatten)]
    pub resume: Resume,
    /// Give every material a network of its own: smaller errors, more bytes
    #[arg(long, conflicts_with = "latent")]
    per_material: bool,
    /// What the network sees [default: half-difference; cartesian with --paper]
    #[arg(long, value_enum, value_name = "INPUTS")]
    inputs: Option<Inputs>,
    /// f(light, view) = f(view, light) by construction: the same as --inputs reciprocal
    #[arg(long, conflicts_with = "inputs")]
    reciprocal: bool,
    /// How the network corrects the analytic part [default: gated-residual]
    #[arg(long, value_enum, value_name = "COMPOSITION")]
    composition: Option<Composition>,
    /// Show the analytic value to the network
    #[arg(long)]
    analytic_input: bool,
    /// Leave the loss of the analytic part out
    #[arg(long)]
    no_analytic_loss: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Inputs {
    /// Light and view as vectors, as in the paper
    Cartesian,
    /// Functions of half and difference vector
    HalfDifference,
    /// The same, with f(light, view) = f(view, light) by construction
    Reciprocal,
}

impl From<Inputs> for InputChoice {
    fn from(inputs: Inputs) -> InputChoice {
        match inputs {
            Inputs::Cartesian => InputChoice::Cartesian,
            Inputs::HalfDifference => InputChoice::HalfDifference,
            Inputs::Reciprocal => InputChoice::Reciprocal,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Composition {
    /// exp a + sigmoid b · f_a, as in the paper
    GatedResidual,
    /// max(0, f_a + a)
    Additive,
    /// f_a · exp a
    LogMultiplicative,
}

impl From<Composition> for hybrid::Composition {
    fn from(composition: Composition) -> hybrid::Composition {
        match composition {
            Composition::GatedResidual => hybrid::Composition::GatedResidual,
            Composition::Additive => hybrid::Composition::Additive,
            Composition::LogMultiplicative => hybrid::Composition::LogMultiplicative,
        }
    }
}

impl HybridArguments {
    pub fn options(&self, seed: u64) -> Options {
        let schedule = if self.paper.paper { Schedule::paper } else { Schedule::standard };
        Options { model: Model::Hybrid(self.model()), schedule: self.training.schedule(schedule, seed) }
    }

    fn model(&self) -> HybridOptions {
        let width = if self.per_material { 16 } else { 32 };
        let net = self.training.net.unwrap_or(Net { width, layers: 2 });
        let shared = if self.paper.paper { HybridOptions::paper } else { HybridOptions::shared };
        let mut options = shared(net, self.code.latent.unwrap_or(4));
        if self.per_material {
            let HybridOptions { sharing, latent, .. } = HybridOptions::per_material(net);
            options = HybridOptions { sharing, latent, ..options };
        }
        if self.reciprocal {
            options.inputs = InputChoice::Reciprocal;
        }
        if self.no_analytic_loss {
            options.analytic_loss = None;
            options.joint = true;
        }
        HybridOptions {
            inputs: self.inputs.map_or(options.inputs, InputChoice::from),
            composition: self.composition.map_or(options.composition, Into::into),
            analytic_input: self.analytic_input,
            ..options
        }
    }
}

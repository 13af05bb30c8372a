//! `glimt fit --model neural`.

use clap::Args;
use glimt_fit::loss::Loss;
use glimt_fit::train::Schedule;
use glimt_fit::{HybridOptions, Model, Net, NeuralOptions, Options};

use super::shared::{Code, Pairs, Paper, Resume, Training};

#[derive(Args)]
pub struct NeuralArguments {
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
}

/// Learning rate at which the network-only model ends best on the RGL materials.
const RATE: f32 = 0.02;

impl NeuralArguments {
    pub fn options(&self, seed: u64) -> Options {
        let recipe = HybridOptions::shared(Net { width: 32, layers: 2 }, 12);
        let standard = |steps, seed| Schedule { rate: RATE, ..Schedule::standard(steps, seed) };
        let schedule = if self.paper.paper { Schedule::paper } else { standard };
        let model = NeuralOptions {
            net: self.training.net.unwrap_or(recipe.net),
            latent: self.code.latent.unwrap_or(recipe.latent),
            loss: if self.paper.paper { Loss::PAPER } else { recipe.loss },
        };
        Options { model: Model::Neural(model), schedule: self.training.schedule(schedule, seed) }
    }
}

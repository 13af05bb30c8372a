//! `glimt fit --model ggx`.

use clap::Args;
use glimt_fit::loss::Loss;
use glimt_fit::options::DEFAULT_ANALYTIC_LOSS;
use glimt_fit::train::Schedule;
use glimt_fit::{GgxOptions, Model, Options};

use super::shared::{DEFAULT_STEPS, Pairs, Paper};

#[derive(Args)]
pub struct GgxArguments {
    #[command(flatten)]
    pub pairs: Pairs,
    #[command(flatten)]
    paper: Paper,
}

impl GgxArguments {
    pub fn options(&self, seed: u64) -> Options {
        let (loss, schedule): (_, fn(u64, u64) -> Schedule) = if self.paper.paper {
            (Loss::PAPER, Schedule::paper)
        } else {
            (DEFAULT_ANALYTIC_LOSS, Schedule::standard)
        };
        // The analytic part takes steps of its own, of which nothing can be chosen.
        Options { model: Model::Ggx(GgxOptions { loss }), schedule: schedule(DEFAULT_STEPS, seed) }
    }
}

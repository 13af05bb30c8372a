//! Options that apply to more than one model: each is defined once, and every model takes what it has a use for.

use clap::{Args, ValueEnum};
use glimt_fit::Net;
use glimt_fit::train::Schedule;

use crate::Usage;
use crate::fitting::HoldOut;
use crate::values::parse_net;

/// Steps of a fit if nothing else is asked for.
pub const DEFAULT_STEPS: u64 = 20_000;

/// Models that are fitted to pairs of directions, which may be scattered samples.
#[derive(Args)]
pub struct Pairs {
    #[command(flatten)]
    pub hold_out: HoldOut,
    /// Scattered samples (.csv, .npy) and BSDFs of Mitsuba are of an anisotropic material. Without it, samples
    /// are isotropic, and Mitsuba tells; the other formats do, too
    #[arg(long)]
    pub anisotropic: bool,
}

/// Models that have a network.
#[derive(Args)]
pub struct Training {
    /// Width and number of the network's hidden layers: 16, 32 or 64 times 2 or 3 [default: 32x2; 16x2 with
    /// --per-material and for gated; 64x2 for spherical]
    #[arg(long, value_name = "WxN", value_parser = parse_net)]
    pub net: Option<Net>,
    /// Steps of the optimiser (of each cluster for spherical; the analytic part always takes its own 1,500)
    /// [default: 20000; 6000 for gated, each of which looks at more]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub steps: Option<u64>,
    /// Learning rate at the start [default: 0.01; 0.02 for neural, spherical and gated; 0.005 with --paper]
    #[arg(long, value_name = "RATE")]
    pub rate: Option<f32>,
}

impl Training {
    /// One of the schedules, for so many steps and with the rate that was asked for.
    pub fn schedule(&self, standard: fn(u64, u64) -> Schedule, seed: u64) -> Schedule {
        let schedule = standard(self.steps.unwrap_or(DEFAULT_STEPS), seed);
        Schedule { rate: self.rate.unwrap_or(schedule.rate), ..schedule }
    }
}

/// Models whose materials have a latent code.
#[derive(Args)]
pub struct Code {
    /// Numbers in a material's latent code [default: 4; 12 for neural, as many numbers as a
    /// hybrid material has]
    #[arg(long, value_name = "N")]
    pub latent: Option<usize>,
}

/// Models that one paper describes.
#[derive(Args)]
pub struct Paper {
    /// The inputs, loss and schedule of the model's paper, instead of glimt's own
    #[arg(long)]
    pub paper: bool,
}

/// Models whose fits can be interrupted.
#[derive(Args)]
pub struct Resume {
    /// Continue from the checkpoint of an interrupted fit
    #[arg(long)]
    pub resume: bool,
}

/// Models that look up tables.
#[derive(Args)]
pub struct Between {
    /// How tables answer between their entries [default: linear for factor, bilinear for spherical]
    #[arg(long, value_enum, value_name = "INTERPOLATION")]
    interpolation: Option<Interpolation>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Interpolation {
    /// factor: the value of the bin, as in the paper
    Nearest,
    /// factor: linear between the centres of the bins
    Linear,
    /// spherical: bilinear between the corners of a pixel
    Bilinear,
    /// spherical: by the inverse distance to the corners, as in the paper's training
    InverseDistance,
    /// spherical: a quarter of each corner, as at the paper's run time
    Constant,
}

impl Between {
    /// What was asked for as a model has it, whose own kinds `own` tells.
    ///
    /// # Errors
    /// A kind that the model does not have.
    pub fn interpolation<T: Default>(&self, own: fn(Interpolation) -> Option<T>) -> Result<T, Usage> {
        let Some(asked) = self.interpolation else { return Ok(T::default()) };
        own(asked).ok_or_else(|| {
            let name = |kind: Interpolation| {
                kind.to_possible_value().expect("every kind has a name").get_name().to_owned()
            };
            let kinds = Interpolation::value_variants().iter().copied();
            let expected: Vec<String> = kinds.filter(|&kind| own(kind).is_some()).map(name).collect();
            Usage(format!(
                "--interpolation {} does not apply to this model; expected {}",
                name(asked),
                expected.join(" or ")
            ))
        })
    }
}

//! `glimt bench`: how fast this machine evaluates, samples and fits, against the limit of its
//! multiply-adds.

pub mod cases;
pub mod report;
mod training;
pub mod ways;

use std::hint::black_box;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use glimt_core::Kind;
use glimt_core::simd::multiply_adds;
use glimt_files::Source;
use glimt_fit::Net;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::values::parse_net;
use crate::{inputs, output};
use cases::Case;
use report::{Measurement, Report};
use training::Training;
use ways::{PAIRS, Way, Workspace};

/// Measure speed: ns per evaluation, sample and training step, against the multiply-adds alone
///
/// The limit is a loop in registers of as many fused multiply-adds as the network has, by the same
/// instruction set (GLIMT_ISA chooses another) and in the same rounds. Rounds alternate between all ways, so
/// that what else the machine does meets all of them; medians and quartiles are printed. Figures are those of
/// one core; with --threads N, those of N threads stand beside them.
#[derive(clap::Args)]
pub struct Arguments {
    /// Model libraries, measurements or NBRDF weights, of which the first material is measured; networks of random
    /// weights if not given
    #[arg(value_name = "FILE", conflicts_with_all = ["model", "net"], value_parser = inputs::file())]
    files: Vec<PathBuf>,
    /// Models to measure [default: all]
    #[arg(long, value_name = "MODEL", value_parser = kind_parser())]
    model: Vec<Kind>,
    /// Sizes of the networks [default: 16x3, 32x3 and 64x3]
    #[arg(long, value_name = "WxN", value_parser = parse_net)]
    net: Vec<Net>,
    /// Rounds, of which there is the median
    #[arg(long, value_name = "N", default_value_t = 9, value_parser = clap::value_parser!(u16).range(1..))]
    rounds: u16,
    /// Leave the training step out, which takes most of the time
    #[arg(long)]
    no_training: bool,
    /// One JSON object
    #[arg(long)]
    json: bool,
}

/// The sizes that are measured if none are asked for.
const NETS: [Net; 3] =
    [Net { width: 16, layers: 3 }, Net { width: 32, layers: 3 }, Net { width: 64, layers: 3 }];

fn kind_parser() -> impl TypedValueParser<Value = Kind> {
    PossibleValuesParser::new(Kind::ALL.map(Kind::name)).try_map(|name| name.parse::<Kind>())
}

/// Runs the command; `threads` is what --threads says.
pub fn run(arguments: &Arguments, threads: Option<u16>) -> Result<()> {
    let cases = cases(arguments)?;
    let mut pools = vec![pool(1)?];
    if let Some(threads) = threads.filter(|&n| n > 1) {
        pools.push(pool(threads.into())?);
    }
    let mut report = Report::new();
    for (i, case) in cases.iter().enumerate() {
        report.measurements.extend(measure(arguments, case, &pools)?);
        if !arguments.json {
            output::print(&report.text(i == 0))?;
        }
    }
    if arguments.json {
        output::print_raw(&report.json()?)?;
    }
    Ok(())
}

fn pool(threads: usize) -> Result<ThreadPool> {
    Ok(ThreadPoolBuilder::new().num_threads(threads).build()?)
}

fn cases(arguments: &Arguments) -> Result<Vec<Case>> {
    if !arguments.files.is_empty() {
        return arguments.files.iter().map(from_file).collect();
    }
    let nets = if arguments.net.is_empty() { &NETS[..] } else { &arguments.net };
    let kinds = if arguments.model.is_empty() { &Kind::ALL[..] } else { &arguments.model };
    kinds.iter().flat_map(|&kind| cases::cases(kind, nets)).collect()
}

/// The first material of a file.
fn from_file(path: &PathBuf) -> Result<Case> {
    match Source::open(path)? {
        Source::Library(library) => Ok(Case::new(library.first()?.material.clone())),
        Source::Samples { .. } => bail!("{} holds scattered samples, which answer no pair", path.display()),
    }
}

/// What is timed in every round.
enum Task {
    Ask(Way),
    Step(Box<Training>),
}

/// All ways to ask one material, and the training step of its network.
fn measure(arguments: &Arguments, case: &Case, pools: &[ThreadPool]) -> Result<Vec<Measurement>> {
    let mut workspace = Workspace::new();
    let mut tasks: Vec<Task> = Way::ALL.into_iter().map(Task::Ask).collect();
    if let Some(net) = case.training.filter(|_| !arguments.no_training) {
        tasks.push(Task::Step(Box::new(Training::new(net)?)));
    }
    let timed: Vec<(&Task, &ThreadPool)> = tasks
        .iter()
        .flat_map(|task| pools.iter().map(move |pool| (task, pool)))
        .filter(|(task, pool)| pool.current_num_threads() == 1 || task.is_parallel())
        .collect();
    let mut limits = Vec::new();
    let mut times = vec![Vec::new(); timed.len()];
    // The first round only warms caches and clock.
    for round in 0..=arguments.rounds {
        limits.push(limit(case.multiply_adds * PAIRS) / PAIRS as f64);
        for ((task, pool), times) in timed.iter().zip(&mut times) {
            times.push(pool.install(|| match task {
                Task::Ask(way) => Ok(way.seconds(&case.material, &mut workspace)),
                Task::Step(training) => training.seconds(),
            })?);
        }
        if round == 0 {
            limits.clear();
            times.iter_mut().for_each(Vec::clear);
        }
    }
    let measurement = |((task, pool), times): ((&Task, &ThreadPool), Vec<f64>)| {
        let limits: Option<Vec<f64>> = (task.multiply_adds(case) > 0).then(|| {
            let scale = task.multiply_adds(case) as f64 / case.multiply_adds as f64;
            limits.iter().map(|limit| limit * scale).collect()
        });
        Measurement::new(case, task.name(), pool.current_num_threads(), &times, limits.as_deref())
    };
    Ok(timed.into_iter().zip(times).map(measurement).collect())
}

impl Task {
    fn name(&self) -> &'static str {
        match self {
            Task::Ask(way) => way.name(),
            Task::Step(_) => "step",
        }
    }

    /// Whether it is measured on several threads, too.
    fn is_parallel(&self) -> bool {
        matches!(self, Task::Ask(Way::Batch) | Task::Step(_))
    }

    /// Multiply-adds of the networks in one evaluation or step.
    fn multiply_adds(&self, case: &Case) -> usize {
        match self {
            Task::Ask(Way::Pdf) => 0,
            Task::Ask(_) => case.multiply_adds,
            Task::Step(training) => training.multiply_adds(),
        }
    }
}

/// Seconds of `count` multiply-adds in registers.
fn limit(count: usize) -> f64 {
    let mut sum = 0.0;
    let start = Instant::now();
    multiply_adds(black_box(count), &mut sum);
    black_box(sum);
    start.elapsed().as_secs_f64()
}

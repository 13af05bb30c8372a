//! `glimt`: compact and neural BRDFs, fitted to measured reflectance.
//!
//! Exit code 0: done; 1: failed, with one line on the standard error stream; 2: bad usage.

mod add;
mod bench;
mod check;
mod compare;
mod convert;
mod edit;
mod eval;
mod fit;
mod fitting;
mod info;
mod inputs;
mod output;
mod place;
mod report;
mod sample;
mod simulated;
mod textures;
mod values;

use std::borrow::Cow;
use std::process::ExitCode;

use anyhow::Context;
use clap::{Parser, Subcommand};

/// Compact and neural BRDFs, fitted to measured reflectance.
///
/// FILE is a model library (.safetensors), an RGL (.bsdf), MERL (.binary) or UTIA (.bin) measurement,
/// scattered samples (.csv, or .npy of the shape (n, 9)), or the weights of a neural BRDF as Sztrajman et
/// al. publish them (.h5, .npz, or *_fc1.npy for a set of .npy files). Directions are unit vectors in the local frame with the normal +z, and point away from the
/// surface; f is in 1/sr, linear RGB, without the cosine.
#[derive(Parser)]
#[command(name = "glimt", version, propagate_version = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,

    /// Threads to use; all that the machine has if not given.
    #[arg(long, global = true, display_order = 100, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
}

#[derive(Subcommand)]
enum Command {
    Fit(Box<fit::Arguments>),
    Add(add::Arguments),
    Info(info::Arguments),
    Eval(eval::Arguments),
    Sample(sample::Arguments),
    Bench(bench::Arguments),
    Convert(convert::Arguments),
    Compare(compare::Arguments),
    Check(check::Arguments),
    Report(report::Arguments),
}

/// Arguments that fit the syntax but make no sense together.
#[derive(Debug)]
struct Usage(String);

impl std::fmt::Display for Usage {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Usage {}

fn main() -> ExitCode {
    let done = match Arguments::try_parse() {
        Ok(arguments) => run(arguments),
        Err(answer) if answer.use_stderr() => return refuse(&answer),
        Err(help) => help.print().context("cannot write to the standard output"),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        // Whoever read our output has seen enough, as `head` does.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            output::note(&format!("error: {}", one_line(&error)));
            if error.is::<Usage>() { ExitCode::from(2) } else { ExitCode::FAILURE }
        }
    }
}

/// Says why arguments cannot be parsed; in colours where a terminal has them.
fn refuse(error: &clap::Error) -> ExitCode {
    let text = error.to_string();
    match glimt_disk::printable_lines(&text) {
        // Nobody need be able to read it.
        Cow::Borrowed(_) => drop(error.print()),
        Cow::Owned(escaped) => escaped.lines().for_each(output::note),
    }
    ExitCode::from(2)
}

fn run(arguments: Arguments) -> anyhow::Result<()> {
    if let Some(threads) = arguments.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads.into()).build_global()?;
    }
    match arguments.command {
        Command::Fit(arguments) => fit::run(&arguments),
        Command::Add(arguments) => add::run(&arguments),
        Command::Info(arguments) => info::run(&arguments),
        Command::Eval(arguments) => eval::run(&arguments),
        Command::Sample(arguments) => sample::run(&arguments),
        Command::Bench(bench) => bench::run(&bench, arguments.threads),
        Command::Convert(arguments) => convert::run(&arguments),
        Command::Compare(arguments) => compare::run(&arguments),
        Command::Check(arguments) => check::run(&arguments),
        Command::Report(arguments) => report::run(&arguments),
    }
}

/// The error and its causes. Errors of the libraries say their cause already.
fn one_line(error: &anyhow::Error) -> String {
    let mut line = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if line.is_empty() {
            line = cause;
        } else if !line.contains(&cause) {
            line = format!("{line}: {cause}");
        }
    }
    line
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let is_one = |e: &std::io::Error| e.kind() == std::io::ErrorKind::BrokenPipe;
    error.chain().any(|cause| cause.downcast_ref().is_some_and(is_one))
}

//! `glimt add`: new materials for a finished library.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use glimt_core::Library;
use glimt_disk::is_same;
use glimt_fit::add::{ADD_STEPS, add, numbers_each};
use glimt_fit::{doubts, doubts_of};

use crate::fitting::{self, HoldOut, JsonErrors, Watch};
use crate::output::{Format, Overwrite};
use crate::{inputs, output};

/// Add materials to a hybrid library, whose network stays as it is
///
/// Only the latent code and the parameters of the analytic part are fitted: seconds instead of minutes.
/// The materials that the library holds do not change. Commands that add to one library at the same time wait for
/// each other.
#[derive(clap::Args)]
pub struct Arguments {
    /// Library to add to
    #[arg(value_name = "LIB.safetensors", value_parser = inputs::file())]
    library: PathBuf,
    /// Files, directories or globs to fit to
    #[arg(required = true, value_name = "FILE", value_parser = inputs::file())]
    files: Vec<PathBuf>,
    /// Library to write [default: the library itself]
    #[arg(short, long, value_name = "LIB.safetensors", value_parser = inputs::file())]
    output: Option<PathBuf>,
    /// Steps of the optimiser
    #[arg(long, value_name = "N", default_value_t = ADD_STEPS, value_parser = clap::value_parser!(u64).range(1..))]
    steps: u64,
    /// Seed of all random numbers
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    hold_out: HoldOut,
    #[command(flatten)]
    overwrite: Overwrite,
    #[command(flatten)]
    json: JsonErrors,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let path = arguments.output.as_ref().unwrap_or(&arguments.library);
    arguments.overwrite.check_file(path, Format::Library)?;
    arguments.json.check(arguments.overwrite, path)?;
    let claim = is_same(path, &arguments.library).then(|| output::claim(path)).transpose()?;
    let library = Library::open(&arguments.library)?;
    let outputs: Vec<&Path> = [path.as_path()].into_iter().chain(arguments.json.file()).collect();
    let mut sources = inputs::open(&arguments.files, &outputs)?;
    let held = arguments.hold_out.take(&mut sources, arguments.seed);
    let files = [std::slice::from_ref(&arguments.library), &arguments.files].concat();
    let inputs = fitting::inputs(&sources, &fitting::command(&files), true)?;

    fitting::warn(&doubts(&inputs, Some(numbers_each(&library, &inputs)?)));
    let mut watch = Watch::new()?;
    let mut report = |progress: &_, _: Option<&_>| watch.report(progress);
    let Some(mut added) = add(&library, &inputs, arguments.steps, arguments.seed, &mut report)? else {
        bail!("stopped; {} is as it was", path.display());
    };
    watch.finish();
    fitting::warn(&doubts_of(&added));
    fitting::measure(&mut added, &inputs, &held);
    if let Some(claim) = &claim
        && !claim.is_current()?
    {
        bail!(
            "{} was changed by another process meanwhile and is left so; run the command again",
            path.display()
        );
    }
    let entries = library.entries()?.into_iter().cloned().chain(added.iter().cloned());
    let library = Library::new(path, entries.collect())?;
    library.save()?;
    fitting::print_errors(&library, &added.iter().collect::<Vec<_>>(), &arguments.json)
}

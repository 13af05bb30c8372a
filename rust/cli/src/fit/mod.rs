//! `glimt fit`: from measurements to a model library.
//!
//! [`model`] has the models and tells which options apply to which; each model's options are in a file of its own.

mod descent;
mod factor;
mod gated;
mod ggx;
mod hybrid;
mod job;
mod keeper;
mod model;
mod neural;
mod shared;
mod spherical;
mod up_to_date;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::builder::NonEmptyStringValueParser;
use clap::{ArgMatches, Args, Command, FromArgMatches};
use glimt_core::Library;
use glimt_core::library::Entry;
use glimt_fit::checkpoint::Checkpoint;
use glimt_fit::doubts_of;

use crate::fitting::{self, JsonErrors};
use crate::output::{Format, Overwrite};
use crate::{Usage, inputs, output};
use descent::descend;
use gated::{GatedArguments, SurfaceMaps};
use job::{Job, Truths};
use keeper::Keeper;
use model::{Choice, Chosen};
use shared::Pairs;
use up_to_date::Recipe;

pub use model::ModelName;

/// The command's arguments: those of every fit, and those of the model.
pub struct Arguments {
    common: Common,
    matches: ArgMatches,
}

/// Fit one model library to measurements
///
/// The same files, options and seed give the same library, on any number of threads. An interrupt
/// (Ctrl-C) stops the fit and saves a checkpoint beside the output, and so does every minute of it; the same
/// command with --resume goes on from it, to the same result. Tables (factor) stop after the material that is being
/// fitted. When the fit is done, its errors against the inputs are printed, over a
/// million pairs of cosine-distributed directions, and stored in the library. Scattered samples are fitted to
/// at their own directions, every sample counting the same, but for a tenth of them, over which the errors are
/// the means.
#[derive(Args)]
struct Common {
    /// Files, directories or globs to fit to
    #[arg(required_unless_present = "from_mitsuba", value_name = "FILE", value_parser = inputs::file())]
    files: Vec<PathBuf>,
    /// Fit to a BSDF of Mitsuba, evaluated by Mitsuba: a scene, or a JSON dictionary of a BSDF. Needs Python
    /// with mitsuba
    #[arg(long, value_name = "SCENE.xml|BSDF.json", conflicts_with = "files", value_parser = inputs::file())]
    from_mitsuba: Option<PathBuf>,
    /// The id of the BSDF; not needed where the file has one
    #[arg(long, value_name = "ID", requires = "from_mitsuba", value_parser = NonEmptyStringValueParser::new())]
    bsdf: Option<String>,
    /// Library to write
    #[arg(short, long, value_name = "LIB.safetensors", value_parser = inputs::file())]
    output: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Model to fit
    #[arg(long, value_enum, default_value_t = ModelName::Hybrid)]
    model: ModelName,
    /// Seed of all random numbers
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Do nothing if the output is what this command would write: fitted by the same version to files of the same
    /// names and contents with the same options, and not changed since
    #[arg(long, conflicts_with = "from_mitsuba")]
    if_changed: bool,
    #[command(flatten)]
    json: JsonErrors,
}

/// The arguments that have no influence on the library, or of which more than the value has.
const NOT_IN_RECIPE: [&str; 8] =
    ["files", "from_mitsuba", "bsdf", "output", "force", "if_changed", "json", "resume"];

impl Args for Arguments {
    fn augment_args(command: Command) -> Command {
        model::augment(Common::augment_args(command))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for Arguments {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        Ok(Arguments { common: Common::from_arg_matches(matches)?, matches: matches.clone() })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Arguments {
    /// What a fit to `files` follows from.
    fn recipe(&self, files: &[PathBuf]) -> Result<Recipe> {
        let command = Self::augment_args(Command::new(""));
        let options = command.get_arguments().map(|option| option.get_id().as_str());
        Recipe::new(files, &self.matches, options.filter(|option| !NOT_IN_RECIPE.contains(option)))
    }
}

impl Common {
    /// Refuses an output that cannot be written or must not be, before any work is done.
    fn check_outputs(&self) -> Result<()> {
        self.overwrite.check_file(&self.output, Format::Library)?;
        self.overwrite.check_file(&checkpoint_path(&self.output), Format::Checkpoint)?;
        self.json.check(self.overwrite, &self.output)
    }
}

impl Chosen {
    fn pairs(&self) -> Option<&Pairs> {
        match self {
            Chosen::Ggx(ggx) => Some(&ggx.pairs),
            Chosen::Hybrid(hybrid) => Some(&hybrid.pairs),
            Chosen::Neural(neural) => Some(&neural.pairs),
            Chosen::Spherical(spherical) => Some(&spherical.pairs),
            Chosen::Factor(_) => None,
        }
    }

    fn resumes(&self) -> bool {
        match self {
            Chosen::Ggx(_) => false,
            Chosen::Hybrid(hybrid) => hybrid.resume.resume,
            Chosen::Neural(neural) => neural.resume.resume,
            Chosen::Factor(factor) => factor.resume.resume,
            Chosen::Spherical(spherical) => spherical.resume.resume,
        }
    }

    /// The checkpoint of a fit by gradients, if it is to go on from one. Tables are kept in another way.
    fn checkpoint(&self, path: &Path) -> Result<Option<Checkpoint>> {
        let has_one = self.resumes() && !matches!(self, Chosen::Factor(_));
        Ok(has_one.then(|| Checkpoint::open(path)).transpose()?)
    }

    /// Fits; the materials, and what there is to say besides their errors.
    fn fit(&self, job: &mut Job, resume: Option<Checkpoint>) -> Result<(Vec<Entry>, String)> {
        let seed = job.seed;
        let entries = match self {
            Chosen::Ggx(ggx) => descend(job, &ggx.options(seed), resume)?,
            Chosen::Hybrid(hybrid) => descend(job, &hybrid.options(seed), resume)?,
            Chosen::Neural(neural) => descend(job, &neural.options(seed), resume)?,
            Chosen::Factor(factor) => factor.fit(job)?,
            Chosen::Spherical(spherical) => {
                let (options, why) = spherical.options(seed, &job.inputs)?;
                let entries = descend(job, &options, resume)?;
                let notes = format!("{why}\n{}", spherical::pruned(&entries));
                return Ok((entries, notes));
            }
        };
        Ok((entries, String::new()))
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    let common = &arguments.common;
    let chosen = common.model.read(&arguments.matches)?;
    common.check_outputs()?;
    let checkpoint_path = checkpoint_path(&common.output);
    let outputs: Vec<&Path> =
        [&*common.output, &checkpoint_path].into_iter().chain(common.json.file()).collect();
    let keeper = Keeper::new(&checkpoint_path);
    match chosen {
        Choice::Brdf(chosen) => fit_brdfs(arguments, &chosen, keeper, &outputs),
        Choice::Surface(gated) => fit_surface(arguments, &gated, keeper, &outputs),
    }
}

fn fit_brdfs(arguments: &Arguments, chosen: &Chosen, keeper: Keeper, outputs: &[&Path]) -> Result<()> {
    let common = &arguments.common;
    let files = match &common.from_mitsuba {
        Some(scene) => {
            inputs::keep_apart([scene.as_path()], outputs)?;
            Vec::new()
        }
        None => inputs::expand(&common.files, outputs)?,
    };
    // A scene can read any other file: there, nothing says that nothing has changed.
    let recipe = common.from_mitsuba.is_none().then(|| arguments.recipe(&files)).transpose()?;
    if let Some(library) = common.unchanged(recipe.as_ref()) {
        return skip(common, &library);
    }
    let resume = chosen.checkpoint(keeper.path())?;
    let mut truths = match &common.from_mitsuba {
        Some(scene) => Truths::simulate(scene, common.bsdf.as_deref())?,
        None => Truths::open(&files, &common.files)?,
    };
    let pairs = chosen.pairs();
    let held = pairs.map_or_else(BTreeMap::new, |pairs| truths.hold_out(&pairs.hold_out, common.seed));
    let inputs = truths.inputs(pairs.is_some_and(|pairs| pairs.anisotropic))?;
    let mut job = Job { truths: &truths, inputs, keeper, seed: common.seed };
    let (mut entries, notes) = chosen.fit(&mut job, resume)?;
    // Measuring takes a while: the library is saved before, and again with its errors.
    Library::new(&common.output, entries.clone())?.save()?;
    fitting::warn(&doubts_of(&entries));
    fitting::measure(&mut entries, &job.inputs, &held);
    truths.check_running()?;
    let library = common.save(entries, recipe.as_ref())?;
    job.keeper.forget(chosen.resumes());
    if !common.json.is_printed() {
        output::print(&notes)?;
    }
    fitting::print_errors(&library, &library.entries()?, &common.json)
}

fn fit_surface(
    arguments: &Arguments,
    gated: &GatedArguments,
    mut keeper: Keeper,
    outputs: &[&Path],
) -> Result<()> {
    let common = &arguments.common;
    if common.from_mitsuba.is_some() {
        return Err(
            Usage("--from-mitsuba does not apply to --model gated, which is fitted to maps".into()).into()
        );
    }
    let maps = SurfaceMaps::open(&common.files, gated, outputs)?;
    let recipe = arguments.recipe(&maps.files)?;
    if let Some(library) = common.unchanged(Some(&recipe)) {
        return skip(common, &library);
    }
    maps.check(gated, common.seed)?;
    let resume = gated.checkpoint(keeper.path())?;
    if !common.json.is_printed() {
        output::print(&maps.findings)?;
    }
    let entry = maps.fit(gated, common.seed, resume, &mut keeper)?;
    Library::new(&common.output, vec![entry.clone()])?.save()?;
    let (entry, table) = maps.measure(entry)?;
    let library = common.save(vec![entry], Some(&recipe))?;
    keeper.forget(gated.resume.resume);
    if !common.json.is_printed() {
        output::print(&table)?;
    }
    fitting::give_json(&library, &library.entries()?, &common.json)
}

impl Common {
    /// The output, if it is asked about and follows from this recipe.
    fn unchanged(&self, recipe: Option<&Recipe>) -> Option<Library> {
        recipe.filter(|_| self.if_changed)?.find(&self.output)
    }

    /// Writes the library.
    fn save(&self, entries: Vec<Entry>, recipe: Option<&Recipe>) -> Result<Library> {
        let mut library = Library::new(&self.output, entries)?;
        if let Some(recipe) = recipe {
            library = recipe.stamp(library)?;
        }
        library.save()?;
        Ok(library)
    }
}

/// What is said of a fit that was stopped.
fn stopped(step: u64, steps: u64, checkpoint: &Path) -> String {
    format!(
        "stopped at step {step} of {steps}; the same command with --resume goes on from {}",
        checkpoint.display()
    )
}

/// Says that there is nothing to do, and gives the errors to a program that asks for them.
fn skip(common: &Common, library: &Library) -> Result<()> {
    let line = format!("{} is up to date: nothing it was fitted from has changed", common.output.display());
    if common.json.is_printed() {
        output::note(&line);
    } else {
        output::print(&format!("{line}\n"))?;
    }
    fitting::give_json(library, &library.entries()?, &common.json)
}

/// Where an interrupted fit of this library is kept.
fn checkpoint_path(output: &Path) -> PathBuf {
    let mut path = output.as_os_str().to_owned();
    path.push(".checkpoint");
    path.into()
}

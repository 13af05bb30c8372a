//! `glimt fit`: from measurements to a model library.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use clap::ValueEnum;
use clap::builder::NonEmptyStringValueParser;
use glimt_core::library::{Entry, Origin};
use glimt_core::models::factor::Variant;
use glimt_core::models::hybrid::Composition;
use glimt_core::{Kind, Library};
use glimt_files::{Samples, Source};
use glimt_fit::checkpoint::Checkpoint;
use glimt_fit::loss::Loss;
use glimt_fit::options::DEFAULT_ANALYTIC_LOSS;
use glimt_fit::train::Schedule;
use glimt_fit::{
    FactorOptions, HybridOptions, Input, InputChoice, Model, Net, NeuralOptions, Options, Outcome, Truth,
    doubts, doubts_of, doubts_of_tables, fit, fit_factor,
};
use serde::de::DeserializeOwned;
use serde::de::value::{Error as ValueError, StrDeserializer};

use crate::fitting::{self, HoldOut, Watch};
use crate::output::{Format, Overwrite};
use crate::simulated::Simulated;
use crate::{Usage, inputs, output, spherical};

/// Fit one model library to measurements
///
/// The same files, options and seed give the same library, on any number of threads. An interrupt
/// (Ctrl-C) stops the fit and saves a checkpoint beside the output, and so does every minute of it; the same
/// command with --resume goes on from it, to the same result. Tables (factor) stop after the material at hand. When the fit is done, its errors against the inputs are printed, over a
/// million pairs of cosine-distributed directions, and stored in the library. Scattered samples are fitted to
/// at their own directions, every sample counting the same, but for a tenth of them, over which the errors are
/// the means.
#[derive(clap::Args)]
pub struct Arguments {
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
    /// Width and number of the network's hidden layers: 16, 32 or 64 times 2 or 3 [default: 32x2; 16x2 with
    /// --per-material]
    #[arg(long, value_name = "WxN", value_parser = parse_net)]
    net: Option<Net>,
    /// Numbers in a material's latent code [default: 4; 12 for neural, as many numbers as a
    /// hybrid material has]
    #[arg(long, value_name = "N", conflicts_with = "per_material")]
    latent: Option<usize>,
    /// Give every material a network of its own: smaller errors, more bytes (hybrid)
    #[arg(long)]
    per_material: bool,
    /// The inputs, loss and schedule of the model's paper, instead of glimt's own
    #[arg(long)]
    paper: bool,
    /// What the network sees: cartesian, half-difference or reciprocal (hybrid)
    #[arg(long, value_name = "INPUTS", value_parser = parse_variant::<InputChoice>)]
    inputs: Option<InputChoice>,
    /// f(light, view) = f(view, light) by construction: the same as --inputs reciprocal
    #[arg(long, conflicts_with = "inputs")]
    reciprocal: bool,
    /// How the network corrects the analytic part: gated-residual, additive or log-multiplicative (hybrid)
    #[arg(long, value_name = "COMPOSITION", value_parser = parse_variant::<Composition>)]
    composition: Option<Composition>,
    /// Which factors: independent-g, g-from-d, naive or bivariate (factor) [default: independent-g]
    #[arg(long, value_name = "VARIANT", value_parser = parse_variant::<Variant>)]
    variant: Option<Variant>,
    /// How tables answer between their bins: nearest, as in the paper, or linear (factor) [default: linear]; or how
    /// the corners of a pixel are weighted: bilinear, or as in the paper's training inverse-distance, or as at its run
    /// time constant (spherical) [default: bilinear]
    #[arg(long, value_name = "INTERPOLATION")]
    interpolation: Option<String>,
    /// Show the analytic value to the network (hybrid)
    #[arg(long)]
    analytic_input: bool,
    /// Leave the loss of the analytic part out (hybrid)
    #[arg(long)]
    no_analytic_loss: bool,
    /// Scattered samples (.csv, .npy) and BSDFs of Mitsuba are of an anisotropic material. Without it, samples
    /// are isotropic, and Mitsuba tells; the other formats do, too
    #[arg(long)]
    anisotropic: bool,
    /// Steps of the optimiser (of each cluster for spherical; the analytic part always takes its own 1,500)
    #[arg(long, value_name = "N", default_value_t = 20_000, value_parser = clap::value_parser!(u64).range(1..))]
    steps: u64,
    /// Seed of all random numbers
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// Learning rate at the start [default: 0.01; 0.02 for neural and spherical; 0.005 with --paper]
    #[arg(long, value_name = "RATE")]
    rate: Option<f32>,
    #[command(flatten)]
    spherical: spherical::SphericalArguments,
    /// Go on from the checkpoint of an interrupted fit
    #[arg(long)]
    resume: bool,
    #[command(flatten)]
    hold_out: HoldOut,
    /// Print the errors as JSON
    #[arg(long)]
    json: bool,
}

/// Learning rate at which the network-only model ends best on the RGL materials.
const NEURAL_RATE: f32 = 0.02;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ModelName {
    /// The analytic BRDF alone: Lambert and GGX
    Ggx,
    /// The analytic BRDF, corrected by a network
    Hybrid,
    /// A network with learned shading frames
    Neural,
    /// Tables over single angles; no network and no gradients
    Factor,
    /// Features in tables on hemispheres, decoded by a small network: tens of kilobytes a material, near the
    /// measurement's own noise
    Spherical,
}

impl ModelName {
    /// Whether it has a network whose size can be chosen.
    #[must_use]
    pub fn has_network(self) -> bool {
        match self {
            ModelName::Hybrid | ModelName::Neural | ModelName::Spherical => true,
            ModelName::Ggx | ModelName::Factor => false,
        }
    }
}

/// A size of a network as the command line spells it.
///
/// # Errors
/// In words, another spelling or size.
pub fn parse_net(text: &str) -> Result<Net, String> {
    let parts = text.split_once('x').and_then(|(width, layers)| {
        Some(Net { width: usize::from_str(width).ok()?, layers: usize::from_str(layers).ok()? })
    });
    let net = parts.ok_or_else(|| "expected width times layers, as in 32x2".to_owned())?;
    if net.is_supported() { Ok(net) } else { Err("expected 16, 32 or 64 times 2 or 3".to_owned()) }
}

/// A variant as library files spell it.
pub(crate) fn parse_variant<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    T::deserialize(StrDeserializer::<ValueError>::new(text)).map_err(|error| error.to_string())
}

impl Arguments {
    /// Refuses an output that cannot be written or must not be, before any work is done.
    fn check_output(&self) -> Result<()> {
        self.overwrite.check_file(&self.output, Format::Library)?;
        self.overwrite.check_file(&checkpoint_path(&self.output), Format::Checkpoint)
    }

    /// Refuses options that mean nothing for the model.
    fn check(&self) -> Result<(), Usage> {
        if self.model != ModelName::Hybrid {
            self.refuse(&self.hybrid_only())?;
        }
        if self.model != ModelName::Spherical {
            self.refuse(&self.spherical.given())?;
        }
        if self.model != ModelName::Factor {
            self.refuse(&[("--variant", self.variant.is_some())])?;
        }
        if !matches!(self.model, ModelName::Factor | ModelName::Spherical) {
            self.refuse(&[("--interpolation", self.interpolation.is_some())])?;
        }
        let gradients = [
            ("--net", self.net.is_some()),
            ("--latent", self.latent.is_some()),
            ("--rate", self.rate.is_some()),
        ];
        match self.model {
            ModelName::Hybrid | ModelName::Neural => Ok(()),
            ModelName::Ggx => {
                self.refuse(&gradients)?;
                self.refuse(&[("--resume", self.resume)])
            }
            ModelName::Factor => {
                self.refuse(&gradients)?;
                self.refuse(&[("--paper", self.paper), ("--anisotropic", self.anisotropic)])
            }
            ModelName::Spherical => {
                self.refuse(&[("--latent", self.latent.is_some()), ("--paper", self.paper)])
            }
        }
    }

    /// What to fit to `inputs`, and what there is to say about that.
    fn options(&self, inputs: &[Input]) -> Result<(Options, Option<String>), Usage> {
        let mut note = None;
        let model = match self.model {
            ModelName::Ggx => Model::Ggx(if self.paper { Loss::PAPER } else { DEFAULT_ANALYTIC_LOSS }),
            ModelName::Hybrid => Model::Hybrid(self.hybrid()),
            ModelName::Neural => Model::Neural(self.neural()),
            ModelName::Factor => unreachable!("factor tables have options of their own"),
            ModelName::Spherical => {
                let (options, why) =
                    self.spherical.options(self.net, self.interpolation()?, inputs).map_err(Usage)?;
                note = Some(why);
                Model::Spherical(options)
            }
        };
        let schedule = match (self.model, self.paper) {
            (ModelName::Spherical, _) => Schedule::spherical,
            (_, true) => Schedule::paper,
            (_, false) => Schedule::standard,
        };
        let mut schedule = schedule(self.steps, self.seed);
        if self.model == ModelName::Neural && !self.paper {
            schedule.rate = NEURAL_RATE;
        }
        let schedule = Schedule { rate: self.rate.unwrap_or(schedule.rate), ..schedule };
        Ok((Options { model, schedule }, note))
    }

    fn hybrid(&self) -> HybridOptions {
        let net = self.net.unwrap_or(Net { width: if self.per_material { 16 } else { 32 }, layers: 2 });
        let shared = if self.paper { HybridOptions::paper } else { HybridOptions::shared };
        let mut options = shared(net, self.latent.unwrap_or(4));
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
            inputs: self.inputs.unwrap_or(options.inputs),
            composition: self.composition.unwrap_or(options.composition),
            analytic_input: self.analytic_input,
            ..options
        }
    }

    fn neural(&self) -> NeuralOptions {
        let recipe = HybridOptions::shared(Net { width: 32, layers: 2 }, 12);
        NeuralOptions {
            net: self.net.unwrap_or(recipe.net),
            latent: self.latent.unwrap_or(recipe.latent),
            loss: if self.paper { Loss::PAPER } else { recipe.loss },
        }
    }

    /// Options that mean something for the hybrid model only, and whether they were given.
    fn hybrid_only(&self) -> [(&'static str, bool); 6] {
        [
            ("--per-material", self.per_material),
            ("--inputs", self.inputs.is_some()),
            ("--reciprocal", self.reciprocal),
            ("--composition", self.composition.is_some()),
            ("--analytic-input", self.analytic_input),
            ("--no-analytic-loss", self.no_analytic_loss),
        ]
    }

    fn factor(&self) -> Result<FactorOptions, Usage> {
        Ok(FactorOptions {
            variant: self.variant.unwrap_or(Variant::IndependentG),
            interpolation: self.interpolation()?,
            seed: self.seed,
        })
    }

    /// The model's own kind of interpolation.
    fn interpolation<T: DeserializeOwned + Default>(&self) -> Result<T, Usage> {
        let parse = |text: &String| parse_variant(text).map_err(|e| Usage(format!("--interpolation: {e}")));
        self.interpolation.as_ref().map_or_else(|| Ok(T::default()), parse)
    }

    fn refuse(&self, options: &[(&str, bool)]) -> Result<(), Usage> {
        match options.iter().find(|(_, given)| *given) {
            Some((option, _)) => {
                Err(Usage(format!("{option} means nothing for --model {:?}", self.model).to_lowercase()))
            }
            None => Ok(()),
        }
    }
}

/// What is fitted to.
enum Truths {
    Files(Vec<Source>),
    Simulated(Box<Simulated>),
}

impl Truths {
    fn open(arguments: &Arguments) -> Result<Truths> {
        Ok(match &arguments.from_mitsuba {
            Some(scene) => {
                inputs::keep_apart([scene.as_path()], &[&arguments.output])?;
                let command = fitting::command(std::slice::from_ref(scene));
                Truths::Simulated(Box::new(Simulated::start(scene, arguments.bsdf.as_deref(), &command)?))
            }
            None => {
                let outputs = [&*arguments.output, &checkpoint_path(&arguments.output)];
                Truths::Files(inputs::open(&arguments.files, &outputs)?)
            }
        })
    }

    /// Takes out of scattered samples what the fit is not to see.
    fn hold_out(&mut self, arguments: &Arguments) -> BTreeMap<String, Samples> {
        match self {
            Truths::Files(sources) => arguments.hold_out.take(sources, arguments.seed),
            Truths::Simulated(_) => BTreeMap::new(),
        }
    }

    fn inputs(&self, arguments: &Arguments) -> Result<Vec<Input<'_>>> {
        match self {
            Truths::Files(sources) => {
                fitting::inputs(sources, &fitting::command(&arguments.files), !arguments.anisotropic)
            }
            Truths::Simulated(bsdf) => Ok(vec![bsdf.input(arguments.anisotropic)]),
        }
    }

    /// The error of a simulation that has ended, and of which every value since was 0.
    fn go_on(&self) -> Result<()> {
        match self {
            Truths::Simulated(bsdf) => bsdf.failure().map_or(Ok(()), |failure| bail!("{failure}")),
            Truths::Files(_) => Ok(()),
        }
    }
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> Result<()> {
    arguments.check()?;
    if arguments.model == ModelName::Factor {
        return run_factor(arguments, &arguments.factor()?);
    }
    let path = &arguments.output;
    arguments.check_output()?;
    let checkpoint_path = checkpoint_path(path);
    let resume = arguments.resume.then(|| Checkpoint::open(&checkpoint_path)).transpose()?;
    let mut truths = Truths::open(arguments)?;
    let held = truths.hold_out(arguments);
    let inputs = truths.inputs(arguments)?;
    let (options, note) = arguments.options(&inputs)?;

    let isotropic = inputs.iter().all(|input| input.isotropic);
    let doubts = doubts(&inputs, options.numbers_each(inputs.len(), isotropic));
    truths.go_on()?;
    fitting::warn(&doubts);
    let mut watch = Watch::new()?;
    let mut keeper = Keeper::new(&checkpoint_path);
    let outcome = fit(&inputs, &options, resume, &mut |progress, state| {
        if truths.go_on().is_err() {
            return ControlFlow::Break(());
        }
        if let Some(state) = state {
            keeper.keep(|path| Ok(Checkpoint::new(&inputs, &options, state.clone()).save(path)?));
        }
        watch.report(progress)
    });
    truths.go_on()?;
    let mut entries = match outcome? {
        Outcome::Done(entries) => entries,
        Outcome::Stopped(None) => bail!("stopped before there was anything to save"),
        Outcome::Stopped(Some(checkpoint)) => {
            checkpoint.save(&checkpoint_path)?;
            bail!(
                "stopped at step {} of {}; the same command with --resume goes on from {}",
                checkpoint.state.step,
                options.schedule.steps,
                checkpoint_path.display()
            );
        }
    };
    watch.finish();
    keep(arguments, &mut entries, &truths, &inputs, &held)?;
    keeper.forget(arguments.resume);
    if !arguments.json {
        output::print(&spherical::notes(note, &entries))?;
    }
    fitting::print_errors(path, &entries, arguments.json)
}

/// Fits tables, which takes seconds a material: what is kept on the way is the materials that are finished, as
/// the library that they are.
fn run_factor(arguments: &Arguments, options: &FactorOptions) -> Result<()> {
    let path = &arguments.output;
    arguments.check_output()?;
    let checkpoint_path = checkpoint_path(path);
    let truths = Truths::open(arguments)?;
    let inputs = truths.inputs(arguments)?;
    let doubts = [doubts(&inputs, None), doubts_of_tables(&inputs)].concat();
    truths.go_on()?;
    fitting::warn(&doubts);
    let mut entries = Vec::new();
    if arguments.resume {
        entries = finished(&checkpoint_path, &inputs, options)?;
    }
    let watch = Watch::new()?;
    let mut keeper = Keeper::new(&checkpoint_path);
    let bar = output::progress_bar(inputs.len(), "fit");
    bar.set_position(entries.len() as u64);
    for input in &inputs[entries.len()..] {
        let Truth::Brdf(brdf) = input.truth else {
            bail!(
                "\"{}\" is scattered samples, to which no tables can be fitted; expected a function",
                input.name
            );
        };
        let fit = fit_factor(brdf, options);
        truths.go_on()?;
        let mut origin = Origin { seed: Some(options.seed), ..input.origin.clone() };
        for (channel, trace) in ["red", "green", "blue"].into_iter().zip(&fit.traces) {
            origin.metrics.insert(format!("objective_{channel}"), trace[trace.len() - 1]);
        }
        entries.push(Entry { name: input.name.clone(), material: fit.factor.into(), origin });
        bar.inc(1);
        let save = |path: &Path| Ok(Library::new(path, entries.clone())?.save()?);
        if watch.is_stopped() && entries.len() < inputs.len() {
            save(&checkpoint_path)?;
            bail!(
                "stopped after {} of {} materials; the same command with --resume goes on from {}",
                entries.len(),
                inputs.len(),
                checkpoint_path.display()
            );
        }
        keeper.keep(save);
    }
    keep(arguments, &mut entries, &truths, &inputs, &BTreeMap::new())?;
    keeper.forget(arguments.resume);
    fitting::print_errors(path, &entries, arguments.json)
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

/// Saves the library before it is measured, which takes a while, and again with its errors.
fn keep(
    arguments: &Arguments,
    entries: &mut [Entry],
    truths: &Truths,
    inputs: &[Input],
    held: &BTreeMap<String, Samples>,
) -> Result<()> {
    Library::new(&arguments.output, entries.to_vec())?.save()?;
    fitting::warn(&doubts_of(entries));
    fitting::measure(entries, inputs, held);
    truths.go_on()?;
    Library::new(&arguments.output, entries.to_vec())?.save()?;
    Ok(())
}

/// Keeps a checkpoint from time to time, for the case that the fit does not come to an end of its own.
struct Keeper<'a> {
    path: &'a Path,
    last: Instant,
    /// Whether there is a checkpoint of this fit.
    kept: bool,
}

impl<'a> Keeper<'a> {
    /// Time between checkpoints: what a crash costs at most.
    const INTERVAL: Duration = Duration::from_secs(60);

    fn new(path: &'a Path) -> Keeper<'a> {
        Keeper { path, last: Instant::now(), kept: false }
    }

    /// Has a checkpoint saved, if it is time for one.
    fn keep(&mut self, save: impl FnOnce(&Path) -> Result<()>) {
        if self.last.elapsed() < Self::INTERVAL {
            return;
        }
        self.last = Instant::now();
        match save(self.path) {
            Ok(()) => self.kept = true,
            // A full disk need not be the end of the fit.
            Err(error) => output::note(&format!("warning: {error:#}")),
        }
    }

    /// Removes the checkpoint of this fit, or of the one that was `resumed`.
    fn forget(&self, resumed: bool) {
        if resumed || self.kept {
            // The library is written, so that a checkpoint which stays does no harm.
            let _ = std::fs::remove_file(self.path);
        }
    }
}

/// Where an interrupted fit of this library is kept.
fn checkpoint_path(output: &Path) -> PathBuf {
    let mut path = output.as_os_str().to_owned();
    path.push(".checkpoint");
    path.into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glimt_fit::train::State;

    #[test]
    fn a_checkpoint_is_written_once_a_minute() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lib.safetensors.checkpoint");
        let options =
            Options { model: Model::Ggx(DEFAULT_ANALYTIC_LOSS), schedule: Schedule::standard(100, 0) };
        let at = |step| {
            let options = options.clone();
            let state = State { step, ..State::new(vec![1.0, 2.0]) };
            move |path: &Path| Ok(Checkpoint { options, materials: Vec::new(), state }.save(path)?)
        };
        let mut keeper = Keeper::new(&path);
        keeper.keep(at(1));
        assert!(!path.exists() && !keeper.kept);
        let minute_ago =
            || Instant::now().checked_sub(Keeper::INTERVAL).expect("the machine runs for a minute");
        keeper.last = minute_ago();
        keeper.keep(at(2));
        assert!(keeper.kept);
        assert_eq!(Checkpoint::open(&path).unwrap().state.step, 2);
        keeper.keep(at(3));
        assert_eq!(Checkpoint::open(&path).unwrap().state.step, 2);
        keeper.last = minute_ago();
        keeper.keep(at(4));
        assert_eq!(Checkpoint::open(&path).unwrap().state.step, 4);
    }

    #[test]
    fn a_checkpoint_that_cannot_be_written_is_no_end_of_the_fit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("gone").join("lib.safetensors.checkpoint");
        let mut keeper = Keeper { path: &path, last: Instant::now() - Keeper::INTERVAL, kept: false };
        let options =
            Options { model: Model::Ggx(DEFAULT_ANALYTIC_LOSS), schedule: Schedule::standard(100, 0) };
        let checkpoint = Checkpoint { options, materials: Vec::new(), state: State::new(vec![1.0]) };
        keeper.keep(|path| Ok(checkpoint.save(path)?));
        assert!(!keeper.kept);
    }
}

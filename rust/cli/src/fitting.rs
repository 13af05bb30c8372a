//! What `fit` and `add` share: their inputs, how they are watched and stopped, and what they report.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, bail};
use glimt_core::library::{Entry, Origin};
use glimt_core::models::ggx::Ggx;
use glimt_core::{AnyModel, Brdf, Library};
use glimt_disk::{is_same, printable};
use glimt_files::{Samples, Source, sha256};
use glimt_fit::train::Progress;
use glimt_fit::{Doubt, Input, Truth, held_out};
use glimt_report::brdf_error::Swapped;
use glimt_report::{BrdfError, Protocol};
use indicatif::ProgressBar;
use serde_json::json;

use crate::inputs::STANDARD;
use crate::output::{self, Format, Overwrite};

/// How fits to scattered samples are measured.
#[derive(clap::Args)]
pub struct HoldOut {
    /// Share of scattered samples that is not fitted to, and at which the errors are measured; 0 fits to all and
    /// measures there
    #[arg(long = "hold-out", value_name = "SHARE", default_value_t = 0.1, value_parser = parse_share)]
    share: f64,
}

fn parse_share(text: &str) -> Result<f64, String> {
    let share = text.parse().ok().filter(|share| (0.0..=0.9).contains(share));
    share.ok_or_else(|| "expected a number from 0 to 0.9".to_owned())
}

impl HoldOut {
    /// Takes from every list of samples among `sources` what is not fitted to; by the materials' names.
    pub fn take(&self, sources: &mut [Source], seed: u64) -> BTreeMap<String, Samples> {
        let mut held = BTreeMap::new();
        for source in sources {
            let name = source.names().swap_remove(0);
            if let Source::Samples { samples, .. } = source {
                held.insert(name, samples.take(&held_out(samples.len(), self.share, seed)));
            }
        }
        held.retain(|_, samples| !samples.is_empty());
        held
    }
}

/// Where the errors of a fit are given as JSON.
#[derive(clap::Args)]
pub struct JsonErrors {
    /// Print the errors as JSON instead of the table; with =FILE, write them to FILE besides
    #[arg(long, value_name = "FILE|-", num_args = 0..=1, require_equals = true, default_missing_value = STANDARD)]
    json: Option<PathBuf>,
}

impl JsonErrors {
    /// Whether the standard output is theirs.
    pub fn is_printed(&self) -> bool {
        self.json.as_deref() == Some(Path::new(STANDARD))
    }

    /// The file that they are written to.
    pub fn file(&self) -> Option<&Path> {
        self.json.as_deref().filter(|_| !self.is_printed())
    }

    /// Refuses a file that cannot be written or must not be, before any work is done; `library` is written, too.
    ///
    /// # Errors
    /// Names the file and why.
    pub fn check(&self, overwrite: Overwrite, library: &Path) -> Result<()> {
        let Some(file) = self.file() else { return Ok(()) };
        // By name as well: neither need be there yet.
        let absolute = |path| std::path::absolute(path).ok();
        if is_same(file, library) || absolute(file) == absolute(library) {
            bail!("{} cannot be both the library and its errors as JSON; name another file", file.display());
        }
        overwrite.check(file, Format::Json).map(drop)
    }
}

/// The materials of `sources` to fit to. Scattered samples cannot tell their symmetry: `samples_isotropic`
/// does.
///
/// # Errors
/// Two materials of one name, before anything is fitted to them.
pub fn inputs<'a>(sources: &'a [Source], command: &str, samples_isotropic: bool) -> Result<Vec<Input<'a>>> {
    let mut inputs: Vec<Input> = Vec::new();
    for source in sources {
        let path = source.path();
        let origin = Origin {
            source: path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
            sha256: sha256(path)?,
            command: command.to_owned(),
            ..Origin::default()
        };
        for name in source.names() {
            if inputs.iter().any(|other| other.name == name) {
                bail!("two materials are named \"{name}\"; the second is in {}", path.display());
            }
            let (truth, isotropic) = match source {
                Source::Library(library) => {
                    let material = library.material(Some(&name))?;
                    (Truth::Brdf(material), material.is_isotropic())
                }
                Source::Samples { samples: Samples { light, view, f, .. }, .. } => {
                    (Truth::Samples { light, view, f }, samples_isotropic)
                }
            };
            inputs.push(Input { name, truth, isotropic, origin: origin.clone() });
        }
    }
    Ok(inputs)
}

/// The command line as a library keeps it: without the files, and without what has no influence on the
/// result, so that a fit that was interrupted gives the same bytes.
#[must_use]
pub fn command(files: &[PathBuf]) -> String {
    let mut words = vec!["glimt".to_owned()];
    let mut arguments = std::env::args_os().skip(1);
    while let Some(argument) = arguments.next() {
        if files.iter().any(|file| file.as_os_str() == argument) {
            continue;
        }
        let argument = argument.to_string_lossy().into_owned();
        match argument.as_str() {
            "--resume" | "--json" | "--force" | "--if-changed" => {}
            "-o" | "--output" | "--threads" => drop(arguments.next()),
            _ if ["--output=", "--threads=", "--json="].iter().any(|start| argument.starts_with(start)) => {}
            _ => words.push(argument),
        }
    }
    words.join(" ")
}

/// Prints a warning for each doubt.
pub fn warn(doubts: &[Doubt]) {
    for doubt in doubts {
        output::note(&format!("warning: {doubt}"));
    }
}

/// Shows the progress of a fit on a terminal, and stops it when the user wants that.
pub struct Watch {
    bar: ProgressBar,
    step: u64,
    stop: Arc<AtomicBool>,
}

impl Watch {
    /// From now on an interrupt or a request to terminate stops the fit; a second one ends the process.
    ///
    /// # Errors
    /// If the operating system does not allow it.
    pub fn new() -> Result<Watch> {
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        ctrlc::set_handler(move || {
            if flag.swap(true, Ordering::Relaxed) {
                std::process::exit(1);
            }
        })
        .context("cannot listen to interrupts")?;
        Ok(Watch { bar: output::fit_bar(), step: 0, stop })
    }

    /// What a fit calls every few steps.
    pub fn report(&mut self, progress: &Progress) -> ControlFlow<()> {
        if progress.step < self.step {
            self.bar.reset();
        }
        self.step = progress.step;
        self.bar.set_length(progress.steps);
        self.bar.set_position(progress.step);
        self.bar.set_message(format!("loss {:.3e}, {:.0} steps/s", progress.loss, progress.rate));
        if self.is_stopped() {
            self.bar.finish_and_clear();
            return ControlFlow::Break(());
        }
        ControlFlow::Continue(())
    }

    /// Whether the user wants the fit to stop.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

/// Measures how far every entry is from the input that it was fitted to, and keeps the errors in it:
/// of the model, of its analytic part alone where it has one besides (`analytic_…`), and of the input
/// against itself with light and view exchanged (`swapped_…`), which is a measurement's own noise.
/// Scattered samples have no other order. They are measured against at those that were `held` out, and besides at
/// those that were fitted to (`fitted_…`); where none was held out, at the latter alone.
pub fn measure(entries: &mut [Entry], inputs: &[Input], held: &BTreeMap<String, Samples>) {
    let protocol = Protocol::reference();
    let bar = output::progress_bar(entries.len(), "measure");
    for (entry, input) in entries.iter_mut().zip(inputs) {
        let at_fitted = |model: &dyn Brdf| match input.truth {
            Truth::Brdf(brdf) => BrdfError::measure(brdf, model, &protocol),
            Truth::Samples { light, view, f } => BrdfError::at_samples(light, view, f, model),
        };
        let held = held.get(&input.name);
        let against = |model: &dyn Brdf| match held {
            Some(Samples { light, view, f, .. }) => BrdfError::at_samples(light, view, f, model),
            None => at_fitted(model),
        };
        let error = against(&entry.material);
        let metrics = &mut entry.origin.metrics;
        let mut keep = |key: &str, value: f64| metrics.insert(key.to_owned(), value);
        keep("smape", error.smape);
        keep("log_mae", error.log_mae);
        keep("log_mse", error.log_mse);
        keep("mae", error.mae);
        keep("rmse", error.rmse);
        if let AnyModel::Hybrid(hybrid) = entry.material.model() {
            let part = Ggx::new(*hybrid.microfacet()).expect("a hybrid's parameters are in range");
            let analytic = against(&part);
            keep("analytic_smape", analytic.smape);
            keep("analytic_log_mae", analytic.log_mae);
        }
        if let Some(held) = held {
            let fitted = at_fitted(&entry.material);
            keep("held_out", held.len() as f64);
            keep("fitted_smape", fitted.smape);
            keep("fitted_log_mae", fitted.log_mae);
        }
        if let Truth::Brdf(brdf) = input.truth {
            let swapped = against(&Swapped(brdf));
            keep("swapped_smape", swapped.smape);
            keep("swapped_log_mae", swapped.log_mae);
        }
        bar.inc(1);
    }
}

/// Columns of the table of errors: metric, heading, decimals.
const COLUMNS: [(&str, &str, usize); 10] = [
    ("smape", "SMAPE", 4),
    ("log_mae", "log-MAE", 5),
    ("log_mse", "log-MSE", 6),
    ("analytic_smape", "analytic part: SMAPE", 4),
    ("analytic_log_mae", "log-MAE", 5),
    ("held_out", "samples held out", 0),
    ("fitted_smape", "at the others: SMAPE", 4),
    ("fitted_log_mae", "log-MAE", 5),
    ("swapped_smape", "swapped: SMAPE", 4),
    ("swapped_log_mae", "log-MAE", 5),
];

/// Prints the errors of `entries` of a library as a table, and gives them as JSON where that is asked for.
///
/// # Errors
/// Of the standard output, or the file cannot be written.
pub fn print_errors(library: &Library, entries: &[&Entry], json: &JsonErrors) -> Result<()> {
    if !json.is_printed() {
        output::print(&table(entries))?;
    }
    give_json(library, entries, json)
}

/// Gives the errors of `entries` of a library as JSON where that is asked for.
///
/// # Errors
/// As [`print_errors`].
pub fn give_json(library: &Library, entries: &[&Entry], json: &JsonErrors) -> Result<()> {
    if json.is_printed() {
        return output::print_raw(&errors_json(library, entries)?);
    }
    json.file().map_or(Ok(()), |file| output::write(file, errors_json(library, entries)?.as_bytes()))
}

fn table(entries: &[&Entry]) -> String {
    let columns: Vec<_> = COLUMNS.into_iter().filter(|(key, ..)| mean(entries, key).is_some()).collect();
    let width = entries.iter().map(|entry| printable(&entry.name).chars().count()).max().unwrap_or(0).max(8);
    let row = |name: &str, cell: &dyn Fn(&str, &str, usize) -> String| {
        let cells = columns.iter().map(|&(key, heading, decimals)| {
            format!("  {:>1$}", cell(key, heading, decimals), heading.len().max(decimals + 2))
        });
        format!("{name:width$}{}\n", cells.collect::<String>())
    };
    let mut text = row("material", &|_, heading, _| heading.to_owned());
    for entry in entries {
        text += &row(&printable(&entry.name), &|key, _, decimals| {
            format!("{:.decimals$}", entry.origin.metrics[key])
        });
    }
    if entries.len() > 1 {
        text += &row("mean", &|key, _, decimals| {
            format!("{:.decimals$}", mean(entries, key).expect("a column has a number for every material"))
        });
    }
    text
}

/// The mean of a metric, if all of the materials have it.
fn mean(entries: &[&Entry], key: &str) -> Option<f64> {
    let values: Option<Vec<f64>> = entries.iter().map(|e| e.origin.metrics.get(key).copied()).collect();
    values.map(|values| values.iter().sum::<f64>() / values.len() as f64)
}

/// What docs/guide/scripts.md says of `--json`.
fn errors_json(library: &Library, entries: &[&Entry]) -> Result<String> {
    let mut materials = serde_json::Map::new();
    for entry in entries {
        let (own, _) = Library::new(library.path(), vec![Entry::clone(entry)])?.tensor_bytes()?;
        let mut material = json!(entry.origin.metrics);
        material["bytes"] = json!(own);
        materials.insert(entry.name.clone(), material);
    }
    let keys = entries.first().into_iter().flat_map(|entry| entry.origin.metrics.keys());
    let means: BTreeMap<&str, f64> =
        keys.filter_map(|key| Some((key.as_str(), mean(entries, key)?))).collect();
    let path = library.path();
    let bytes = std::fs::metadata(path).with_context(|| format!("cannot read {}", path.display()))?.len();
    let object = json!({
        "file": path.display().to_string(),
        "model": library.kind().name(),
        "bytes": bytes,
        "shared_bytes": library.tensor_bytes()?.1,
        "materials": materials,
        "mean": means,
    });
    Ok(format!("{object}\n"))
}

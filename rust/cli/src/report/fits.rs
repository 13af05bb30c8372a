//! Fits what a report asks for, by `glimt fit` itself.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use glimt_core::Library;
use glimt_fit::Net;
use serde::{Deserialize, Serialize};

use super::Arguments;
use super::opponents::{Model, Truth};
use crate::fit::ModelName;
use crate::output;

/// How a library was made here, kept beside it: the same again needs no fit.
#[derive(PartialEq, Serialize, Deserialize)]
struct Record {
    options: Vec<String>,
    /// SHA-256 of the measurements.
    inputs: Vec<String>,
    seconds: f64,
}

/// Fits every model in every size to all measurements, into the report's directory.
///
/// # Errors
/// Those of `glimt fit`.
pub fn fit(arguments: &Arguments, truths: &[Truth]) -> Result<Vec<Model>> {
    let directory = directory(arguments);
    if !arguments.models.is_empty() {
        std::fs::create_dir_all(&directory)
            .with_context(|| format!("cannot make the directory {}", directory.display()))?;
    }
    let mut models = Vec::new();
    for &model in &arguments.models {
        for net in sizes(model, &arguments.sizes) {
            models.push(fit_one(arguments, truths, &directory, model, net)?);
        }
    }
    Ok(models)
}

/// The sizes in which to fit a model; `None` is what `glimt fit` takes by itself.
fn sizes(model: ModelName, asked: &[Net]) -> Vec<Option<Net>> {
    if asked.is_empty() || !model.has_network() {
        return vec![None];
    }
    asked.iter().copied().map(Some).collect()
}

fn directory(arguments: &Arguments) -> PathBuf {
    arguments.output.join("libraries")
}

/// The libraries that the fits are written to.
pub fn libraries(arguments: &Arguments) -> Vec<PathBuf> {
    let names = |&model: &ModelName| {
        let name = move |net: Option<Net>| format!("{}.safetensors", name(model, net));
        sizes(model, &arguments.sizes).into_iter().map(name)
    };
    arguments.models.iter().flat_map(names).map(|name| directory(arguments).join(name)).collect()
}

/// The name of a model as an option, and of its network.
fn spelled(model: ModelName, net: Option<Net>) -> (String, Option<String>) {
    (model.name(), net.map(|Net { width, layers }| format!("{width}x{layers}")))
}

/// How a fit is called, and the file that it is written to.
fn name(model: ModelName, net: Option<Net>) -> String {
    let (kind, net) = spelled(model, net);
    net.iter().fold(kind, |name, net| format!("{name}-{net}"))
}

fn fit_one(
    arguments: &Arguments,
    truths: &[Truth],
    directory: &Path,
    model: ModelName,
    net: Option<Net>,
) -> Result<Model> {
    let name = name(model, net);
    let (kind, net) = spelled(model, net);
    let mut options =
        vec!["fit".to_owned(), "--model".into(), kind, "--seed".into(), arguments.seed.to_string()];
    options.extend(net.into_iter().flat_map(|net| ["--net".into(), net]));
    if let Some(steps) = arguments.steps.filter(|_| model.has_network()) {
        options.extend(["--steps".into(), steps.to_string()]);
    }
    let path = directory.join(format!("{name}.safetensors"));
    let record_path = path.with_extension("json");
    let inputs: Vec<String> = truths.iter().map(|truth| truth.sha256.clone()).collect();
    let kept: Option<Record> =
        std::fs::read(&record_path).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok());
    let seconds = match kept.filter(|kept| kept.options == options && kept.inputs == inputs && path.exists())
    {
        Some(kept) => kept.seconds,
        None => {
            output::note(&format!("fitting {name} to {} materials", truths.len()));
            let seconds = run(&options, truths, &path)?;
            let record = Record { options, inputs, seconds };
            output::write(&record_path, &serde_json::to_vec(&record)?)?;
            seconds
        }
    };
    let mut model = Model::of_library(&Library::open(&path)?)?;
    model.fit_seconds = Some(seconds);
    Ok(model)
}

/// Runs `glimt fit`, going on from the checkpoint of an interrupted one. Returns its seconds.
fn run(options: &[String], truths: &[Truth], output: &Path) -> Result<f64> {
    let start = Instant::now();
    let mut checkpoint = output.as_os_str().to_owned();
    checkpoint.push(".checkpoint");
    let resume = PathBuf::from(checkpoint).exists().then_some("--resume");
    let this = std::env::current_exe().context("cannot find the program itself")?;
    let status = Command::new(this)
        .args(options)
        .args(resume)
        .arg("-o")
        .arg(output)
        .args(truths.iter().map(|truth| &truth.file))
        .stdout(Stdio::null())
        .status()
        .context("cannot start the fit")?;
    if !status.success() {
        bail!("glimt {} ended with {status}", options.join(" "));
    }
    Ok(start.elapsed().as_secs_f64())
}

//! Several inputs: files, directories and globs.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use glimt_files::Source;

use crate::output;

/// How the names of files end that a directory is searched for. Of the six files of a set of `.npy`
/// weights, the first stands for all.
const ENDINGS: [&str; 10] =
    [".safetensors", ".bsdf", ".binary", ".bin", ".csv", ".fit", ".h5", ".npz", "_fc1.npy", "_w1.npy"];

/// The files that `arguments` name, those of a directory or a glob in the order of their names.
///
/// # Errors
/// An argument that names nothing.
pub fn expand(arguments: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for argument in arguments {
        if argument.is_dir() {
            files.extend(in_directory(argument)?);
        } else if !argument.exists() && is_pattern(argument) {
            files.extend(matching(argument)?);
        } else {
            files.push(argument.clone());
        }
    }
    Ok(files)
}

/// Opens all inputs, with a progress bar.
///
/// # Errors
/// Those of [`expand`] and [`Source::open`].
pub fn open(arguments: &[PathBuf]) -> Result<Vec<Source>> {
    let files = expand(arguments)?;
    let bar = output::progress_bar(files.len(), "open");
    let open = |file| bar.wrap_iter(std::iter::once(file)).map(Source::open).next().expect("one file");
    Ok(files.iter().map(open).collect::<Result<_, _>>()?)
}

fn in_directory(directory: &Path) -> Result<Vec<PathBuf>> {
    let cannot_read = || format!("cannot read {}", directory.display());
    let mut files = Vec::new();
    for item in std::fs::read_dir(directory).with_context(cannot_read)? {
        let path = item.with_context(cannot_read)?.path();
        let name = path.file_name().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default();
        if path.is_file() && ENDINGS.iter().any(|ending| name.ends_with(ending)) {
            files.push(path);
        }
    }
    if files.is_empty() {
        bail!("{} holds no file whose name ends in {}", directory.display(), ENDINGS.join(", "));
    }
    files.sort();
    Ok(files)
}

fn is_pattern(path: &Path) -> bool {
    path.to_str().is_some_and(|text| text.contains(['*', '?', '[']))
}

fn matching(pattern: &Path) -> Result<Vec<PathBuf>> {
    let text = pattern.to_string_lossy();
    let paths = glob::glob(&text).with_context(|| format!("{text} is not a pattern"))?;
    let files: Vec<PathBuf> = paths.collect::<Result<_, _>>().with_context(|| format!("searching {text}"))?;
    if files.is_empty() {
        bail!("{text} matches no file");
    }
    Ok(files)
}

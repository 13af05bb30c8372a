//! Several inputs: files, directories and globs; and the standard input.

use std::ffi::OsStr;
use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use clap::builder::{PathBufValueParser, TypedValueParser};
use glimt_disk::{STANDARD_OUTPUT, is_same};
use glimt_files::{Source, nbrdf};
use tempfile::TempDir;

use crate::output;

/// How the names of files end that a directory is searched for. Of the six files of a set of `.npy`
/// weights, the first stands for all.
const ENDINGS: [&str; 10] =
    [".safetensors", ".bsdf", ".binary", ".bin", ".csv", ".fit", ".h5", ".npz", "_fc1.npy", "_w1.npy"];

/// The argument that stands for the standard input or output.
pub const STANDARD: &str = "-";

/// Reads an argument that names a file and cannot be the standard input or output.
pub fn file() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path| {
        if path == Path::new(STANDARD) {
            return Err(
                "a file is expected here, not the standard input or output (-); ./- is a file of that name",
            );
        }
        Ok(path)
    })
}

/// Reads an argument that names a file to write, or the standard output.
pub fn file_or_output() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().map(or_standard_output)
}

/// The path under which a file or the standard output is written.
pub fn or_standard_output(path: PathBuf) -> PathBuf {
    if path == Path::new(STANDARD) { STANDARD_OUTPUT.into() } else { path }
}

/// The files that `arguments` name, those of a directory or a glob in the order of their names. What a search
/// finds of `outputs` is left out: an earlier run of the same command has written it.
///
/// # Errors
/// An argument that names nothing, or a file that would be overwritten.
pub fn expand(arguments: &[PathBuf], outputs: &[&Path]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for argument in arguments {
        let found = if argument == Path::new(STANDARD) {
            bail!("the standard input (-) can only be all that is read; ./- is a file of that name");
        } else if argument.is_dir() {
            in_directory(argument)?
        } else if !argument.exists() && is_pattern(argument) {
            matching(argument)?
        } else {
            files.push(argument.clone());
            continue;
        };
        for file in found {
            if outputs.iter().any(|output| is_same(&file, output)) {
                output::note(&format!("{} is written, and therefore not read", file.display()));
            } else {
                files.push(file);
            }
        }
    }
    keep_apart(files.iter().map(PathBuf::as_path), outputs)?;
    Ok(files)
}

/// Refuses to write what is read, whatever the names.
///
/// # Errors
/// Names both.
pub fn keep_apart<'a>(inputs: impl IntoIterator<Item = &'a Path>, outputs: &[&Path]) -> Result<()> {
    for input in inputs {
        // Five more files belong to the first of a set.
        let parts = nbrdf::parts(input);
        for output in outputs {
            if parts.iter().any(|part| is_same(part, output)) {
                bail!(
                    "{} is read, and must not be overwritten by the output {}; name another output, or leave it \
                     out of what is read",
                    input.display(),
                    output.display()
                );
            }
        }
    }
    Ok(())
}

/// Opens all inputs.
///
/// # Errors
/// Those of [`expand`] and [`Source::open`].
pub fn open(arguments: &[PathBuf], outputs: &[&Path]) -> Result<Vec<Source>> {
    open_files(&expand(arguments, outputs)?)
}

/// Opens files, with a progress bar.
///
/// # Errors
/// Those of [`Source::open`].
pub fn open_files(files: &[PathBuf]) -> Result<Vec<Source>> {
    let bar = output::progress_bar(files.len(), "open");
    let open = |file| bar.wrap_iter(std::iter::once(file)).map(Source::open).next().expect("one file");
    Ok(files.iter().map(open).collect::<Result<_, _>>()?)
}

/// [`open`], or the standard input if that is the only argument.
///
/// # Errors
/// As [`open`].
pub fn open_any(arguments: &[PathBuf], outputs: &[&Path]) -> Result<Vec<Source>> {
    match arguments {
        [only] if only == Path::new(STANDARD) => Ok(vec![StandardInput::read()?.open()?]),
        _ => open(arguments, outputs),
    }
}

/// Opens one file that is not written, or the standard input.
///
/// # Errors
/// Those of [`Source::open`], or `file` is the output.
pub fn open_one(file: &Path, output: &Path) -> Result<Source> {
    if file == Path::new(STANDARD) {
        return StandardInput::read()?.open();
    }
    keep_apart([file], &[output])?;
    Ok(Source::open(file)?)
}

/// All of the standard input.
///
/// # Errors
/// What the operating system says.
pub fn read_standard_input() -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    std::io::stdin().lock().read_to_end(&mut bytes).context("cannot read the standard input")?;
    Ok(bytes)
}

/// The standard input as a file, which lives as long as this: formats are told by what a file holds, its start
/// and its length.
pub struct StandardInput(TempDir);

impl StandardInput {
    /// Reads all of it.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn read() -> Result<StandardInput> {
        let input = StandardInput(tempfile::tempdir().context("no place for the standard input")?);
        std::fs::write(input.path(), read_standard_input()?).context("no place for the standard input")?;
        Ok(input)
    }

    fn path(&self) -> PathBuf {
        self.0.path().join("stdin")
    }

    /// # Errors
    /// Those of [`Source::open`], which name the standard input.
    pub fn open(&self) -> Result<Source> {
        let path = self.path();
        Source::open(&path).map_err(|error| {
            anyhow!(error.to_string().replace(&path.display().to_string(), "the standard input"))
        })
    }
}

/// Whether a directory has a file that [`expand`] finds. Beside a glTF file, `.bin` is geometry.
pub fn holds_materials(directory: &Path) -> bool {
    let Ok(files) = of_materials(directory) else { return false };
    let is_geometry = |file: &PathBuf| {
        let is_bin = file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("bin"));
        let has_gltf = |mut files: std::fs::ReadDir| {
            files.any(|file| file.is_ok_and(|file| file.path().extension() == Some(OsStr::new("gltf"))))
        };
        is_bin && std::fs::read_dir(directory).is_ok_and(has_gltf)
    };
    files.iter().any(|file| !is_geometry(file))
}

/// The files of a directory whose names end as those of materials do.
fn of_materials(directory: &Path) -> Result<Vec<PathBuf>> {
    let cannot_read = || format!("cannot read {}", directory.display());
    let mut files = Vec::new();
    for item in std::fs::read_dir(directory).with_context(cannot_read)? {
        let path = item.with_context(cannot_read)?.path();
        let name = path.file_name().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default();
        if path.is_file() && ENDINGS.iter().any(|ending| name.ends_with(ending)) {
            files.push(path);
        }
    }
    Ok(files)
}

fn in_directory(directory: &Path) -> Result<Vec<PathBuf>> {
    let mut files = of_materials(directory)?;
    if files.is_empty() {
        bail!(
            "{} holds no file whose name ends in {}; texture maps become one by glimt convert",
            directory.display(),
            ENDINGS.join(", ")
        );
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

/// What a user typed, of which bytes that are no UTF-8 are replaced.
pub fn words() -> impl Iterator<Item = String> {
    std::env::args_os().skip(1).map(|word| OsStr::to_string_lossy(&word).into_owned())
}

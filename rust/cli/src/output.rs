//! What commands write: files that are checked before the work, progress, text and notes.

use std::fs::File;
use std::io::{self, IsTerminal, Read, Write};
use std::path::Path;

use anyhow::{Context, Result, bail};
use glimt_disk::{Claim, Exclusion, Place, printable, printable_lines, probe, write_whole};
use glimt_measured::{merl, utia};
use indicatif::{ProgressBar, ProgressStyle};

/// What a file is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Library,
    Checkpoint,
    Merl,
    Rgl,
    Utia,
    Array,
    /// A page of `check` or `report`.
    Page,
    /// A table of `report`.
    Csv,
    Json,
}

/// Bytes at a file's start that tell its format: the metadata of a library come first in it.
const START: u64 = 1 << 16;

impl Format {
    fn name(self) -> &'static str {
        match self {
            Format::Library => "a model library",
            Format::Checkpoint => "a checkpoint",
            Format::Merl => "a MERL table",
            Format::Rgl => "an RGL table",
            Format::Utia => "a UTIA table",
            Format::Array => "a NumPy array",
            Format::Page => "a page of glimt",
            Format::Csv => "a table of glimt report",
            Format::Json => "JSON",
        }
    }

    /// Whether a file of this size that begins like this has the format.
    fn fits(self, start: &[u8], size: u64) -> bool {
        let holds = |text: &str| start.windows(text.len()).any(|window| window == text.as_bytes());
        let begins = |text: &str| start.starts_with(text.as_bytes());
        match self {
            Format::Library => holds("\"glimt\":"),
            // Unfinished tables are kept as a library of what is finished.
            Format::Checkpoint => holds("\"glimt-checkpoint\":") || holds("\"glimt\":"),
            Format::Merl => size == merl::FILE_SIZE as u64,
            Format::Rgl => begins("tensor_file"),
            Format::Utia => size == utia::FILE_SIZE as u64,
            Format::Array => start.starts_with(glimt_files::npy::MAGIC),
            Format::Page => begins("<!doctype html>") && holds("glimt"),
            Format::Csv => begins("material,model,"),
            Format::Json => begins("{"),
        }
    }
}

/// What may be written over.
#[derive(clap::Args, Clone, Copy)]
pub struct Overwrite {
    /// Replace an existing file of another format
    #[arg(long, display_order = 99)]
    force: bool,
}

impl Overwrite {
    /// Finds out whether `path` can be written and may be, before any work is done for it.
    ///
    /// # Errors
    /// Names the path and why not: the file system, or that it is a file of another format.
    pub fn check(self, path: &Path, format: Format) -> Result<Place> {
        let place = probe(path).with_context(|| cannot_write(path))?;
        match &place {
            Place::File(file) if !self.force => refuse_other_format(path, file, format)?,
            Place::StandardOutput if io::stdout().is_terminal() => {
                bail!("{} cannot be shown on a terminal; write it to a file or a pipe", format.name())
            }
            _ => {}
        }
        Ok(place)
    }

    /// [`Overwrite::check`] of what is written more than once, and with something beside it.
    ///
    /// # Errors
    /// As [`Overwrite::check`], and that `path` is a pipe or a device.
    pub fn check_file(self, path: &Path, format: Format) -> Result<()> {
        match self.check(path, format)? {
            Place::File(_) => Ok(()),
            Place::StandardOutput | Place::Stream(_) => {
                bail!("{}: it is not a regular file", cannot_write(path))
            }
        }
    }
}

fn cannot_write(path: &Path) -> String {
    format!("cannot write {}", path.display())
}

fn refuse_other_format(path: &Path, file: &Path, format: Format) -> Result<()> {
    if !file.exists() {
        return Ok(());
    }
    let read = || {
        let file = File::open(file)?;
        let size = file.metadata()?.len();
        let mut start = Vec::new();
        file.take(START).read_to_end(&mut start)?;
        Ok::<_, io::Error>((start, size))
    };
    let (start, size) = read().with_context(|| cannot_write(path))?;
    // An empty file is a place that something else made for us.
    if size > 0 && !format.fits(&start, size) {
        bail!(
            "{}: it is there and is not {}; name another output, or replace it with --force",
            cannot_write(path),
            format.name()
        );
    }
    Ok(())
}

/// Writes a file whole or not at all.
///
/// # Errors
/// Names the path and what the operating system says.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    write_whole(path, bytes).with_context(|| cannot_write(path))
}

/// Claims a file that is to be read, changed and written again, or the directory of several. Waits for another
/// process that has claimed it, and says so.
///
/// # Errors
/// Names the path and what the operating system says.
pub fn claim(path: &Path) -> Result<Claim> {
    let wait = || note(&format!("waiting for another process to finish with {}", path.display()));
    let claim = Claim::take(path, wait).with_context(|| cannot_write(path))?;
    if let Exclusion::Watched(error) = claim.exclusion() {
        note(&format!(
            "warning: {} cannot be locked ({error}); change it by one process at a time",
            path.display()
        ));
    }
    Ok(claim)
}

/// A bar on the standard error stream, where that is a terminal; hidden elsewhere and for a single step.
#[must_use]
pub fn progress_bar(steps: usize, what: &'static str) -> ProgressBar {
    if steps < 2 || !io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style =
        ProgressStyle::with_template("{prefix} {wide_bar} {pos}/{len} {eta}").expect("a valid template");
    ProgressBar::new(steps as u64).with_style(style).with_prefix(what)
}

/// A bar for the steps of a fit, with a message; hidden where the standard error is no terminal.
#[must_use]
pub fn fit_bar() -> ProgressBar {
    if !io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style =
        ProgressStyle::with_template("fit {wide_bar} {pos}/{len} {eta} {msg}").expect("a valid template");
    ProgressBar::new(0).with_style(style)
}

/// Writes text for people to the standard output; what would command a terminal is escaped.
///
/// # Errors
/// What the operating system says, a closed pipe among it.
pub fn print(text: &str) -> Result<()> {
    print_raw(&printable_lines(text))
}

/// Writes text for programs to the standard output.
///
/// # Errors
/// As [`print`].
pub fn print_raw(text: &str) -> Result<()> {
    let mut output = io::stdout().lock();
    output
        .write_all(text.as_bytes())
        .and_then(|()| output.flush())
        .context("cannot write to the standard output")
}

/// Writes a line to the standard error stream. Whether anybody can read it changes nothing.
pub fn note(line: &str) {
    let _ = writeln!(io::stderr(), "{}", printable(line));
}

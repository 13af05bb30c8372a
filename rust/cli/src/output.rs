//! What commands write: files that are checked before the work, progress, and text.

use std::io::{IsTerminal, Write};
use std::path::Path;

use anyhow::{Context, Result, bail};
use indicatif::{ProgressBar, ProgressStyle};

/// Finds out whether `path` can be written, before any work is done for it.
///
/// # Errors
/// Names the path and why it cannot.
pub fn check_writable(path: &Path) -> Result<()> {
    let Some(name) = path.file_name().filter(|_| !path.is_dir()) else {
        bail!("cannot write {}: it is a directory", path.display());
    };
    if path.exists() && !path.is_file() {
        bail!("cannot write {}: it is not a regular file", path.display());
    }
    // Files are written beside their place and then renamed: that is what must be possible.
    let probe = path.with_file_name(format!("{}.{}.probe", name.display(), std::process::id()));
    let created = std::fs::File::create_new(&probe).map(drop);
    created
        .and_then(|()| std::fs::remove_file(&probe))
        .with_context(|| format!("cannot write {}", path.display()))
}

/// A bar on the standard error stream, where that is a terminal; hidden elsewhere and for a single step.
#[must_use]
pub fn progress_bar(steps: usize, what: &'static str) -> ProgressBar {
    if steps < 2 || !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style =
        ProgressStyle::with_template("{prefix} {wide_bar} {pos}/{len} {eta}").expect("a valid template");
    ProgressBar::new(steps as u64).with_style(style).with_prefix(what)
}

/// A bar for the steps of a fit, with a message; hidden where the standard error is no terminal.
#[must_use]
pub fn fit_bar() -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style =
        ProgressStyle::with_template("fit {wide_bar} {pos}/{len} {eta} {msg}").expect("a valid template");
    ProgressBar::new(0).with_style(style)
}

/// Writes text to the standard output.
///
/// # Errors
/// What the operating system says, a closed pipe among it.
pub fn print(text: &str) -> Result<()> {
    Ok(std::io::stdout().lock().write_all(text.as_bytes())?)
}

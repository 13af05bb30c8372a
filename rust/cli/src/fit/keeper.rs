//! Checkpoints of a fit that goes on.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::Result;

use crate::output;

/// Keeps a checkpoint from time to time, for the case that the fit does not come to an end of its own.
pub struct Keeper<'a> {
    path: &'a Path,
    last: Instant,
    /// Whether there is a checkpoint of this fit.
    kept: bool,
}

impl<'a> Keeper<'a> {
    /// Time between checkpoints: what a crash costs at most.
    const INTERVAL: Duration = Duration::from_secs(60);

    pub fn new(path: &'a Path) -> Keeper<'a> {
        Keeper { path, last: Instant::now(), kept: false }
    }

    pub fn path(&self) -> &'a Path {
        self.path
    }

    /// Has a checkpoint saved, if it is time for one.
    pub fn keep(&mut self, save: impl FnOnce(&Path) -> Result<()>) {
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
    pub fn forget(&self, resumed: bool) {
        if resumed || self.kept {
            // The library is written, so that a checkpoint which stays does no harm.
            let _ = std::fs::remove_file(self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use glimt_fit::checkpoint::Checkpoint;
    use glimt_fit::options::DEFAULT_ANALYTIC_LOSS;
    use glimt_fit::train::{Schedule, State};
    use glimt_fit::{GgxOptions, Model, Options};

    use super::*;

    #[test]
    fn a_checkpoint_is_written_once_a_minute() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lib.safetensors.checkpoint");
        let options = Options {
            model: Model::Ggx(GgxOptions { loss: DEFAULT_ANALYTIC_LOSS }),
            schedule: Schedule::standard(100, 0),
        };
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
        let options = Options {
            model: Model::Ggx(GgxOptions { loss: DEFAULT_ANALYTIC_LOSS }),
            schedule: Schedule::standard(100, 0),
        };
        let checkpoint = Checkpoint { options, materials: Vec::new(), state: State::new(vec![1.0]) };
        keeper.keep(|path| Ok(checkpoint.save(path)?));
        assert!(!keeper.kept);
    }
}

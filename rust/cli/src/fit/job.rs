//! What is fitted to, whatever the model.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use glimt_files::{Samples, Source};
use glimt_fit::Input;

use super::keeper::Keeper;
use crate::fitting::{self, HoldOut};
use crate::inputs;
use crate::simulated::Simulated;

/// What the fit of any model needs.
pub struct Job<'a> {
    pub truths: &'a Truths,
    pub inputs: Vec<Input<'a>>,
    pub keeper: Keeper<'a>,
    pub seed: u64,
}

/// What is fitted to.
pub enum Truths {
    /// Files, and the command as a library keeps it.
    Files(Vec<Source>, String),
    Simulated(Box<Simulated>),
}

impl Truths {
    /// Opens `files`, which `arguments` named.
    ///
    /// # Errors
    /// Those of the formats.
    pub fn open(files: &[PathBuf], arguments: &[PathBuf]) -> Result<Truths> {
        Ok(Truths::Files(inputs::open_files(files)?, fitting::command(arguments)))
    }

    /// Starts the simulation of a BSDF.
    ///
    /// # Errors
    /// Those of [`Simulated::start`].
    pub fn simulate(scene: &Path, bsdf: Option<&str>) -> Result<Truths> {
        let command = fitting::command(&[scene.to_owned()]);
        Ok(Truths::Simulated(Box::new(Simulated::start(scene, bsdf, &command)?)))
    }

    /// Takes out of scattered samples what the fit is not to see.
    pub fn hold_out(&mut self, share: &HoldOut, seed: u64) -> BTreeMap<String, Samples> {
        match self {
            Truths::Files(sources, _) => share.take(sources, seed),
            Truths::Simulated(_) => BTreeMap::new(),
        }
    }

    /// The materials.
    ///
    /// # Errors
    /// Two of one name.
    pub fn inputs(&self, anisotropic: bool) -> Result<Vec<Input<'_>>> {
        match self {
            Truths::Files(sources, command) => fitting::inputs(sources, command, !anisotropic),
            Truths::Simulated(bsdf) => Ok(vec![bsdf.input(anisotropic)]),
        }
    }

    /// The error of a simulation that has ended, and of which every value since was 0.
    ///
    /// # Errors
    /// That one.
    pub fn check_running(&self) -> Result<()> {
        match self {
            Truths::Simulated(bsdf) => bsdf.failure().map_or(Ok(()), |failure| bail!("{failure}")),
            Truths::Files(..) => Ok(()),
        }
    }
}

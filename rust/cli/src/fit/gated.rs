//! `glimt fit --model gated`: from texture maps to what is seen of them at every scale.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use glimt_core::library::{Entry, Origin};
use glimt_core::models::gated::{Angles, Base};
use glimt_core::models::maps::{Filter, Maps};
use glimt_core::surface::Precision;
use glimt_core::{AnyModel, Material};
use glimt_files::{Source, sha256};
use glimt_fit::Outcome;
use glimt_fit::checkpoint::CheckpointOf;
use glimt_fit::surfaces::errors::{Errors, by_level};
use glimt_fit::surfaces::gated::Learning;
use glimt_fit::surfaces::{Surface, SurfaceOptions, fit_surface};

use super::keeper::Keeper;
use super::shared::{Resume, Training};
use crate::fitting::{self, Watch};
use crate::textures::{self, Opened};
use crate::values::PrecisionName;
use crate::{Usage, inputs};

#[derive(Args)]
pub struct GatedArguments {
    #[command(flatten)]
    pub resume: Resume,
    #[command(flatten)]
    training: Training,
    #[command(flatten)]
    maps: textures::Options,
    /// What the network adds to: the material's own maps, or nothing, as in the paper [default: maps]
    #[arg(long, value_enum, value_name = "BASE")]
    on: Option<BaseName>,
    /// Vectors in the angular textures instead of matrices that the latent code is multiplied by: the tripleplane model
    #[arg(long)]
    no_gate: bool,
    /// Without learned shading frames
    #[arg(long)]
    no_frames: bool,
    /// Without learned radial warps
    #[arg(long)]
    no_warps: bool,
    /// Latent codes along the longer side of the maps [default: half as many as the maps have texels]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1 << 14))]
    latent_size: Option<u32>,
    /// In how many bits texels are kept [default: u8]
    #[arg(long, value_enum, value_name = "BITS")]
    precision: Option<PrecisionName>,
}

#[derive(Clone, Copy, ValueEnum)]
enum BaseName {
    /// The material's own maps
    Maps,
    /// Nothing
    None,
}

/// Steps of a fit if nothing else is asked for.
const DEFAULT_STEPS: u64 = 6_000;

impl GatedArguments {
    /// The checkpoint to go on from, if that is asked for.
    ///
    /// # Errors
    /// There is none.
    pub fn checkpoint(&self, path: &Path) -> Result<Option<CheckpointOf<SurfaceOptions>>> {
        Ok(self.resume.resume.then(|| CheckpointOf::open(path)).transpose()?)
    }

    fn options(&self, size: [usize; 2], seed: u64) -> SurfaceOptions {
        let steps = self.training.steps.unwrap_or(DEFAULT_STEPS);
        let mut options = SurfaceOptions::standard(size, steps, seed);
        let learning = |is_off| if is_off { Learning::Off } else { Learning::Learned };
        options.frames = learning(self.no_frames);
        options.warps = learning(self.no_warps);
        if self.no_gate {
            options.angles = Angles::Vectors;
        }
        if let Some(BaseName::None) = self.on {
            options.base = Base::None;
        }
        if let Some(texels) = self.latent_size {
            options.latent_size = texels as usize;
        }
        options.precision = self.precision.map_or(Precision::U8, Precision::from);
        if let Some(net) = self.training.net {
            options.net = net;
        }
        if let Some(rate) = self.training.rate {
            options.pace.rate = rate;
        }
        options
    }
}

/// The maps that a surface is fitted to.
pub struct SurfaceMaps {
    source: Source,
    /// The files that they were read from.
    pub files: Vec<PathBuf>,
    command: String,
    /// What is said of them.
    pub findings: String,
}

impl SurfaceMaps {
    /// Reads the only argument: a folder of texture maps, or a library of maps.
    ///
    /// # Errors
    /// More than one argument, and those of the folder.
    pub fn open(arguments: &[PathBuf], gated: &GatedArguments, outputs: &[&Path]) -> Result<SurfaceMaps> {
        let [path] = arguments else {
            let reason =
                "--model gated fits one surface: give one folder of texture maps, or one library of maps";
            return Err(Usage(reason.into()).into());
        };
        let command = fitting::command(arguments);
        if textures::are_at(path) {
            let Opened { source, findings, files } =
                textures::open(path, None, &gated.maps, outputs, &command)?;
            let findings = findings.iter().map(|finding| format!("{finding}\n")).collect();
            return Ok(SurfaceMaps { source, files, command, findings });
        }
        gated.maps.refuse()?;
        let source = inputs::open(arguments, outputs)?.swap_remove(0);
        Ok(SurfaceMaps { source, files: vec![path.clone()], command, findings: String::new() })
    }

    fn entry(&self) -> Result<&Entry> {
        let path = self.source.path();
        match &self.source {
            Source::Library(library) => Ok(library.entry(None)?),
            Source::Samples { .. } => bail!(
                "{} holds samples of one BRDF, expected a folder of texture maps or a library of maps",
                path.display()
            ),
        }
    }

    /// The material, its name and where it came from.
    fn maps(&self) -> Result<(&Maps, String, Origin)> {
        let (entry, path) = (self.entry()?, self.source.path());
        let AnyModel::Maps(maps) = entry.material.model() else {
            let kind = entry.material.kind();
            bail!("{} holds a {kind} material, expected maps: --model gated fits surfaces", path.display());
        };
        let mut origin = Origin { command: self.command.clone(), ..entry.origin.clone() };
        if self.files.len() == 1 {
            origin.source = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            origin.sha256 = sha256(path)?;
        }
        Ok((maps, entry.name.clone(), origin))
    }

    /// Refuses options that make no sense for them.
    ///
    /// # Errors
    /// Those of [`SurfaceOptions::shape`].
    pub fn check(&self, gated: &GatedArguments, seed: u64) -> Result<()> {
        let (maps, ..) = self.maps()?;
        gated.options(maps.size(), seed).shape(maps.size(), maps.wrap())?;
        Ok(())
    }

    /// Fits to them; goes on from a checkpoint if there is one.
    ///
    /// # Errors
    /// Options that make no sense, a checkpoint of another fit, an interrupt.
    pub fn fit(
        &self,
        gated: &GatedArguments,
        seed: u64,
        resume: Option<CheckpointOf<SurfaceOptions>>,
        keeper: &mut Keeper,
    ) -> Result<Entry> {
        let (maps, name, origin) = self.maps()?;
        let options = gated.options(maps.size(), seed);
        let surface = Surface { name, maps, field: maps, origin };
        descend(&surface, &options, resume, keeper)
    }

    /// The entry with its errors by level, and a table of them beside those of the maps with mips of either kind.
    ///
    /// # Errors
    /// None, as what was fitted to can be read.
    pub fn measure(&self, mut entry: Entry) -> Result<(Entry, String)> {
        let (maps, ..) = self.maps()?;
        let averages: Material = maps.filtered(Filter::Average).into();
        let moments: Material = maps.filtered(Filter::Moments).into();
        let models = [("maps_average", &averages), ("maps_moments", &moments), ("gated", &entry.material)];
        let errors = models.map(|(name, material)| (name, by_level(maps, material)));
        for (name, levels) in &errors {
            let prefix = if *name == "gated" { String::new() } else { format!("{name}_") };
            let mean = Errors::mean(levels);
            let metrics = &mut entry.origin.metrics;
            metrics.insert(format!("{prefix}log_mae"), mean.log_mae);
            metrics.insert(format!("{prefix}mae"), mean.mae);
            metrics.insert(format!("{prefix}rmse"), mean.rmse);
            for (level, errors) in levels.iter().enumerate() {
                metrics.insert(format!("{prefix}level_{level}_log_mae"), errors.log_mae);
            }
        }
        Ok((entry, table(maps.size(), &errors)))
    }
}

/// log-MAE by level.
fn table(size: [usize; 2], models: &[(&str, Vec<Errors>); 3]) -> String {
    let mut text = format!(
        "{:>17}  {:>12}  {:>12}  {:>8}\n",
        "log-MAE at texels", "maps_average", "maps_moments", "gated"
    );
    let row = |head: String, errors: [f64; 3]| {
        let [average, moments, gated] = errors;
        format!("{head:>17}  {average:12.5}  {moments:12.5}  {gated:8.5}\n")
    };
    let levels = models[0].1.len();
    let longest = size[0].max(size[1]);
    for level in 0..levels {
        let texels = (longest >> level).max(1).to_string();
        text += &row(texels, std::array::from_fn(|i| models[i].1[level].log_mae));
    }
    text += &row("mean".into(), std::array::from_fn(|i| Errors::mean(&models[i].1).log_mae));
    text
}

/// Fits, with a checkpoint now and then.
fn descend(
    surface: &Surface,
    options: &SurfaceOptions,
    resume: Option<CheckpointOf<SurfaceOptions>>,
    keeper: &mut Keeper,
) -> Result<Entry> {
    let mut watch = Watch::new()?;
    let outcome = fit_surface(surface, options, resume, &mut |progress, state| {
        if let Some(state) = state {
            keeper.keep(|path| Ok(surface.checkpoint(options, state.clone()).save(path)?));
        }
        watch.report(progress)
    });
    match outcome? {
        Outcome::Done(mut entries) => {
            watch.finish();
            Ok(entries.swap_remove(0))
        }
        Outcome::Stopped(None) => bail!("stopped before there was anything to save"),
        Outcome::Stopped(Some(checkpoint)) => {
            checkpoint.save(keeper.path())?;
            bail!(super::stopped(checkpoint.state.step, options.pace.steps, keeper.path()))
        }
    }
}

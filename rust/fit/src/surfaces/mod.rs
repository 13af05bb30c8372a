//! Fitting surfaces: what is seen of them at every place and scale.
//!
//! In reading order: [`queries`] (what a fit looks at, and the truth there), [`gated`] (loss and derivatives of a block),
//! [`dual`] (numbers with derivatives), [`training`] (steps), [`errors`] (how far a surface is from the truth, by level).
//! [`mips`] fits mip maps of facets, the baseline.
//! [`fit_surface`] is all of it.

pub mod dual;
pub mod errors;
pub mod gated;
pub mod mips;
pub mod queries;
pub mod training;

use std::ops::ControlFlow;
use std::time::Instant;

use glimt_core::library::{Entry, Origin};
use glimt_core::models::gated::texture::Disk;
use glimt_core::models::gated::{Angles, Base};
use glimt_core::models::maps::Maps;
use glimt_core::surface::{Layout, Precision};
use serde::{Deserialize, Serialize};

use crate::checkpoint::CheckpointOf;
use crate::error::Error;
use crate::fit::{Outcome, state_of};
use crate::net::Net;
use crate::train::{Progress, State, Watch};
use gated::{Learning, Shape, SquareLoss};
use queries::Field;
use training::{Pace, Training, start};

/// The fit of a surface, in full: the same options and maps give the same library.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfaceOptions {
    /// What the network's outputs are added to.
    pub base: Base,
    /// What angular textures hold.
    pub angles: Angles,
    /// Whether shading frames are learned.
    pub frames: Learning,
    /// Whether radial warps are learned.
    pub warps: Learning,
    /// Texels of the latent codes along the longer side; at most as many as the maps have.
    pub latent_size: usize,
    /// Rings and sectors of both angular textures.
    pub disk: Disk,
    /// The network.
    pub net: Net,
    /// In how many bits texels are kept.
    pub precision: Precision,
    /// How long and how fast.
    pub pace: Pace,
}

impl SurfaceOptions {
    /// What glimt fits if nothing else is asked for, to maps of this size.
    #[must_use]
    pub fn standard(size: [usize; 2], steps: u64, seed: u64) -> SurfaceOptions {
        SurfaceOptions {
            base: Base::Maps,
            angles: Angles::Matrices,
            frames: Learning::Learned,
            warps: Learning::Learned,
            latent_size: (size[0].max(size[1]) / 2).max(1),
            disk: Disk { rings: 32, sectors: 32 },
            net: Net { width: 16, layers: 2 },
            precision: Precision::U8,
            pace: Pace {
                steps,
                blocks: 32,
                samples: 8,
                rate: 2e-2,
                network_rate: 0.5,
                floor: 0.5,
                seed,
                loss: SquareLoss { floor: 0.05, absolute: 1e-3 },
            },
        }
    }

    /// What is trained beside maps of this size.
    ///
    /// # Errors
    /// [`Error::Options`] for sizes that no surface has.
    pub fn shape(&self, size: [usize; 2], wrap: glimt_core::surface::Wrap) -> Result<Shape, Error> {
        let refused = |reason: String| Err(Error::Options(reason));
        if let Err(reason) = self.disk.check() {
            return refused(reason.to_string());
        }
        if let Err(reason) = self.net.check(0) {
            return refused(reason);
        }
        let longest = size[0].max(size[1]);
        if self.latent_size == 0 || self.latent_size > longest {
            let found = self.latent_size;
            return refused(format!(
                "latent codes of {found} texels beside maps of {longest}, expected 1 to {longest}"
            ));
        }
        let Pace { blocks, samples, rate, .. } = self.pace;
        if blocks == 0 || samples == 0 || !(rate > 0.0 && rate.is_finite()) {
            return refused(format!(
                "{blocks} blocks of {samples} samples at rate {rate}: expected positive numbers"
            ));
        }
        let of_side = |side: usize| (side * self.latent_size).div_ceil(longest).max(1);
        Ok(Shape {
            base: self.base,
            angles: self.angles,
            frames: self.frames,
            warps: self.warps,
            layout: Layout::new(size.map(of_side), wrap),
            half: self.disk,
            difference: self.disk,
            network: Shape::network(self.base, self.angles, &self.net.hidden()),
        })
    }
}

/// A surface to fit to.
pub struct Surface<'a> {
    /// Its name in the library.
    pub name: String,
    /// What the fit stands on, or what its sampler follows.
    pub maps: &'a Maps,
    /// The truth.
    pub field: &'a dyn Field,
    /// Where it came from.
    pub origin: Origin,
}

impl Surface<'_> {
    fn identity(&self) -> Vec<(String, String)> {
        vec![(self.name.clone(), self.origin.sha256.clone())]
    }

    /// A fit that has come to `state`.
    #[must_use]
    pub fn checkpoint(&self, options: &SurfaceOptions, state: State) -> CheckpointOf<SurfaceOptions> {
        CheckpointOf { options: options.clone(), materials: self.identity(), state }
    }
}

/// Steps between reports.
const REPORT_EVERY: u64 = 20;

/// Fits a [`gated`](glimt_core::models::gated) surface; goes on from `resume` if it is given.
///
/// # Errors
/// [`Error::Options`] for options that make no sense or a checkpoint of another fit, [`Error::Diverged`].
pub fn fit_surface(
    surface: &Surface,
    options: &SurfaceOptions,
    resume: Option<CheckpointOf<SurfaceOptions>>,
    watch: &mut Watch,
) -> Result<Outcome<SurfaceOptions>, Error> {
    let shape = options.shape(surface.maps.size(), surface.maps.wrap())?;
    let mut state = match resume {
        Some(checkpoint) => state_of(checkpoint, options, &surface.identity())?,
        None => State::new(start(&shape, options.pace.seed)),
    };
    if state.numbers.len() != shape.len() {
        let (found, expected) = (state.numbers.len(), shape.len());
        return Err(Error::Options(format!(
            "the checkpoint holds {found} numbers, expected {expected}; fit anew"
        )));
    }
    let guide = match options.base {
        Base::Maps => surface.maps.clone(),
        // Its sampler alone looks at it.
        Base::None => surface.maps.coarser(GUIDE_LEVEL),
    };
    let mut training = Training::new(shape, options.pace, &guide, surface.field);
    let (begin, first) = (Instant::now(), state.step);
    let (mut loss, mut since) = (0.0, 0);
    while state.step < options.pace.steps {
        loss += training.step(&mut state);
        since += 1;
        if !loss.is_finite() {
            return Err(Error::Diverged { step: state.step });
        }
        if state.step.is_multiple_of(REPORT_EVERY) || state.step == options.pace.steps {
            let progress = Progress {
                step: state.step,
                steps: options.pace.steps,
                loss: loss / f64::from(since),
                rate: (state.step - first) as f64 / begin.elapsed().as_secs_f64(),
            };
            (loss, since) = (0.0, 0);
            if let ControlFlow::Break(()) = watch(&progress, Some(&state))
                && state.step < options.pace.steps
            {
                return Ok(Outcome::Stopped(Some(surface.checkpoint(options, state))));
            }
        }
    }
    let material = training.material(&state.numbers, options.precision);
    let material = material.map_err(|_| Error::Diverged { step: state.step })?;
    let origin = Origin {
        seed: Some(options.pace.seed),
        steps: Some(options.pace.steps),
        recipe: Some(serde_json::to_value(options).expect("options are numbers and names")),
        ..surface.origin.clone()
    };
    Ok(Outcome::Done(vec![Entry { name: surface.name.clone(), material: material.into(), origin }]))
}

/// A quarter of the maps' size along each side.
const GUIDE_LEVEL: usize = 2;

//! The fit of a [`gated`](super::gated) surface: its numbers, its steps, and the material that comes of it.

use glimt_core::Invalid;
use glimt_core::kernels::network::Network;
use glimt_core::models::gated::angles::FRAME;
use glimt_core::models::gated::texture::Texture;
use glimt_core::models::gated::{Base, FEATURES, Gated, LATENT, Linear, Parts, WARPS};
use glimt_core::models::hybrid::MAX_BOUND;
use glimt_core::models::maps::Maps;
use glimt_core::surface::{Layout, Precision, Pyramid};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::gated::{Learning, Shape, SquareLoss, Targets, Workspace, block, outputs};
use super::queries::{Drawing, Footprints, Gaussians, Queries, Samples};
use crate::adamw::{AdamW, cosine_decay};
use crate::backprop::{BLOCK, Row, ZERO_ROW};
use crate::net::random_layers;
use crate::train::State;

/// How long and how fast a surface is fitted.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Pace {
    /// Steps.
    pub steps: u64,
    /// Blocks of [`BLOCK`] queries in a step.
    pub blocks: usize,
    /// Samples of a footprint.
    pub samples: usize,
    /// Learning rate at the start; a cosine brings it to 0.
    pub rate: f32,
    /// What of it the network, frames and warps have.
    pub network_rate: f32,
    /// Share of footprints at every scale alike.
    pub floor: f32,
    /// Seed of all.
    pub seed: u64,
    /// What is minimised.
    pub loss: SquareLoss,
}

/// Parts of a step that have a gradient of their own: their sum is the same on any number of threads.
pub const PARTS: usize = 4;

/// Where the fit of a surface begins.
#[must_use]
pub fn start(shape: &Shape, seed: u64) -> Vec<f32> {
    let mut rng = Pcg64::seed_from_u64(seed);
    let places = shape.places();
    let mut numbers = vec![0.0; shape.len()];
    let normal = |deviation: f32, rng: &mut Pcg64| {
        deviation * ((0..12).map(|_| rng.random::<f32>()).sum::<f32>() - 6.0)
    };
    // A product of two small factors does not learn: codes begin away from 0, and as details of their mean.
    let latents = &mut numbers[places.latents.clone()];
    let last = latents.len() - LATENT;
    latents.iter_mut().for_each(|z| *z = normal(0.02, &mut rng));
    latents[last..].iter_mut().for_each(|z| *z += 0.35 + normal(0.15, &mut rng));
    for part in places.textures {
        let columns = shape.angles.columns() * FEATURES;
        let same: Vec<f32> = (0..columns).map(|_| normal(0.5, &mut rng)).collect();
        for texel in numbers[part].chunks_exact_mut(columns) {
            texel.iter_mut().zip(&same).for_each(|(number, same)| *number = same + normal(0.1, &mut rng));
        }
    }
    let biases = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0];
    numbers[places.frames.clone()][FRAME * LATENT..].copy_from_slice(&biases);
    // Both powers are 1 in the mean: softplus of these is ¼ and ¾.
    const EXPONENTS: [f32; 2] = [-1.258_7, 0.110_3];
    let [a, b] = EXPONENTS;
    numbers[places.warps.clone()][WARPS * LATENT..].copy_from_slice(&[0.0, a, b, 0.0, a, b]);
    let network = &mut numbers[places.network.clone()];
    network.copy_from_slice(&random_layers(&shape.network, &mut rng));
    let last = shape.network.layers() - 1;
    let (weight, bias) = shape.network.split_mut(network, last);
    weight.iter_mut().for_each(|w| *w *= 0.3);
    match shape.base {
        Base::None => bias.fill(-1.5),
        Base::Maps => {
            bias[..3].fill(-4.0);
            bias[3..].fill(3.0);
        }
    }
    numbers
}

/// From details to texels: a texel is what the coarser level has there, and its own detail. Steps of a coarse detail
/// move all texels below it, which is what the paper's filter makes of a step (§4.3).
pub fn unfold(layout: &Layout, numbers: &mut [f32]) {
    let sizes: Vec<[usize; 2]> = layout.sizes().collect();
    for level in (0..sizes.len() - 1).rev() {
        let (fine, coarse) = numbers.split_at_mut(layout.texels_of(level + 1).start * LATENT);
        let fine = fine[layout.texels_of(level).start * LATENT..].as_chunks_mut::<LATENT>().0;
        let coarse = coarse.as_chunks::<LATENT>().0;
        let [width, _] = sizes[level];
        for (row, texels) in fine.chunks_exact_mut(width).enumerate() {
            let above = &coarse[row / 2 * sizes[level + 1][0]..];
            for (column, texel) in texels.iter_mut().enumerate() {
                for k in 0..LATENT {
                    texel[k] += above[column / 2][k];
                }
            }
        }
    }
}

/// From derivatives by texels to those by details.
pub fn fold(layout: &Layout, gradient: &mut [f32]) {
    let sizes: Vec<[usize; 2]> = layout.sizes().collect();
    for level in 0..sizes.len() - 1 {
        let (fine, coarse) = gradient.split_at_mut(layout.texels_of(level + 1).start * LATENT);
        let fine = fine[layout.texels_of(level).start * LATENT..].as_chunks::<LATENT>().0;
        let coarse = coarse.as_chunks_mut::<LATENT>().0;
        let [width, _] = sizes[level];
        for (row, texels) in fine.chunks_exact(width).enumerate() {
            let above = &mut coarse[row / 2 * sizes[level + 1][0]..];
            for (column, texel) in texels.iter().enumerate() {
                for k in 0..LATENT {
                    above[column / 2][k] += texel[k];
                }
            }
        }
    }
}

/// What a thread needs.
struct Worker {
    queries: Queries,
    samples: Samples,
    targets: [Row; 3],
    analytic: [Row; 3],
    workspace: Workspace,
    gradient: Vec<f32>,
    loss: f64,
}

impl Worker {
    fn new(shape: &Shape) -> Worker {
        Worker {
            queries: Queries::default(),
            samples: Samples::default(),
            targets: [ZERO_ROW; 3],
            analytic: [ZERO_ROW; 3],
            workspace: Workspace::new(shape),
            gradient: vec![0.0; shape.len()],
            loss: 0.0,
        }
    }
}

/// f_a of a block.
fn analytic(maps: &Maps, queries: &Queries, out: &mut [Row; 3]) {
    let [light, view] =
        [&queries.light, &queries.view].map(|side| side.each_ref().map(|row| row.as_flattened()));
    maps.eval_places(&queries.places, light, view, out.each_mut().map(|row| row.as_flattened_mut()));
}

/// A fit of a surface that is under way.
pub struct Training<'a> {
    /// What is trained.
    pub shape: Shape,
    /// How.
    pub pace: Pace,
    /// Beside what.
    pub maps: &'a Maps,
    drawing: Drawing<'a>,
    workers: Vec<Worker>,
    unfolded: Vec<f32>,
}

impl<'a> Training<'a> {
    /// Of a surface whose truth is `drawing`'s.
    #[must_use]
    pub fn new(shape: Shape, pace: Pace, maps: &'a Maps, field: &'a dyn super::queries::Field) -> Self {
        let drawing = Drawing {
            field,
            gaussians: Gaussians::new(pace.samples),
            footprints: Footprints::Training { floor: pace.floor },
            seed: pace.seed,
        };
        let workers = (0..PARTS).map(|_| Worker::new(&shape)).collect();
        Training { unfolded: vec![0.0; shape.len()], shape, pace, maps, drawing, workers }
    }

    /// Makes a step; its loss per query and channel.
    pub fn step(&mut self, state: &mut State) -> f64 {
        let Training { shape, pace, maps, drawing, workers, unfolded } = self;
        let places = shape.places();
        unfolded.copy_from_slice(&state.numbers);
        unfold(&shape.layout, &mut unfolded[places.latents.clone()]);
        let (first, numbers) = (state.step * pace.blocks as u64, &unfolded[..]);
        workers.par_iter_mut().enumerate().for_each(|(part, worker)| {
            worker.gradient.fill(0.0);
            worker.loss = 0.0;
            for number in (part..pace.blocks).step_by(PARTS) {
                drawing.block(
                    first + number as u64,
                    &mut worker.queries,
                    &mut worker.targets,
                    &mut worker.samples,
                );
                if shape.base == Base::Maps {
                    analytic(maps, &worker.queries, &mut worker.analytic);
                }
                let targets = Targets { f: &worker.targets, analytic: &worker.analytic };
                worker.loss += block(
                    shape,
                    pace.loss,
                    numbers,
                    &worker.queries,
                    &targets,
                    &mut worker.workspace,
                    &mut worker.gradient,
                );
            }
        });
        let (sum, others) = workers.split_first_mut().expect("there are parts");
        let scale = 1.0 / (pace.blocks * BLOCK * 3) as f32;
        for (i, g) in sum.gradient.iter_mut().enumerate() {
            *g = (*g + others.iter().map(|other| other.gradient[i]).sum::<f32>()) * scale;
        }
        fold(&shape.layout, &mut sum.gradient[places.latents.clone()]);
        let loss = sum.loss + others.iter().map(|other| other.loss).sum::<f64>();
        let rate = cosine_decay(pace.rate, state.step, pace.steps);
        state.step += 1;
        let tables = places.latents.start..places.textures[1].end;
        let rest = places.textures[1].end..places.network.end;
        let adam = AdamW { beta1: 0.9, beta2: 0.99, weight_decay: 0.0 };
        for (part, rate) in [(tables, rate), (rest, rate * pace.network_rate)] {
            let moments = state.moments.of(part.clone());
            adam.update(
                &mut state.numbers[part.clone()],
                &sum.gradient[part],
                moments,
                state.step,
                rate,
                |_| false,
            );
        }
        loss * f64::from(scale)
    }

    /// The material that the numbers make.
    ///
    /// # Errors
    /// [`Invalid`] for numbers that are not finite.
    pub fn material(&self, numbers: &[f32], precision: Precision) -> Result<Gated, Invalid> {
        let shape = &self.shape;
        let places = shape.places();
        let mut numbers = numbers.to_vec();
        unfold(&shape.layout, &mut numbers[places.latents.clone()]);
        let bound = self.bound(&numbers);
        let latents = precision.rounded(numbers[places.latents.clone()].as_chunks::<LATENT>().0);
        let [half, difference] = [0, 1].map(|t| {
            let columns = numbers[places.textures[t].clone()].as_chunks::<FEATURES>().0;
            let disk = [shape.half, shape.difference][t];
            Texture::new(disk, shape.angles.columns(), precision.rounded(columns))
        });
        let linear =
            |learning, part: std::ops::Range<usize>| (learning == Learning::Learned).then(|| &numbers[part]);
        let network = shape.network.to_layers(&numbers[places.network.clone()]);
        Gated::new(Parts {
            base: shape.base,
            angles: shape.angles,
            maps: self.maps.rounded(precision),
            latents: Pyramid::of_levels(shape.layout.clone(), latents)?,
            frames: linear(shape.frames, places.frames).map(to_linear),
            warps: linear(shape.warps, places.warps).map(to_linear),
            half: half?,
            difference: difference?,
            network: Network::new(network, shape.angles.inputs(), shape.network.activation())?,
            bound,
        })
    }

    /// A little more than the largest a that queries like those of the fit see.
    fn bound(&self, unfolded: &[f32]) -> f32 {
        const BLOCKS: u64 = 64;
        /// A tenth more.
        const ROOM: f32 = 0.1;
        let greatest = |number: u64| {
            let mut worker = Worker::new(&self.shape);
            self.drawing.block(
                u64::MAX - number,
                &mut worker.queries,
                &mut worker.targets,
                &mut worker.samples,
            );
            let outputs = outputs(&self.shape, unfolded, &worker.queries, &mut worker.workspace);
            outputs[..3].as_flattened().as_flattened().iter().copied().fold(f32::MIN, f32::max)
        };
        let greatest = (0..BLOCKS).into_par_iter().map(greatest).reduce(|| f32::MIN, f32::max);
        (greatest + ROOM).min(MAX_BOUND)
    }
}

fn to_linear<const N: usize>(numbers: &[f32]) -> Linear<N> {
    let (weight, bias) = numbers.split_at(N * LATENT);
    Linear {
        weight: std::array::from_fn(|i| std::array::from_fn(|k| weight[i * LATENT + k])),
        bias: std::array::from_fn(|i| bias[i]),
    }
}

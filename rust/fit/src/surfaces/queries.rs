//! What the fit of a surface looks at: places, footprints and directions, and the mean that is seen there (§4.2).

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};
use glimt_core::models::maps::Maps;
use glimt_core::simd::LANES;
use glimt_core::surface::{Footprint, Place};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::backprop::{BLOCK, Row, ZERO_ROW};
use crate::pairs::mix;

/// A spatially varying reflectance, known at every point.
pub trait Field: Sync {
    /// f of every pair at its point; footprints are not looked at. The slices have one length.
    fn eval(&self, points: &[Place], light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]);

    /// Width and height of its finest detail, in texels a tile.
    fn size(&self) -> [usize; 2];
}

impl Field for Maps {
    fn eval(&self, points: &[Place], light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]) {
        self.eval_points(points, light, view, out);
    }

    fn size(&self) -> [usize; 2] {
        Maps::size(self)
    }
}

/// How footprints are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Footprints {
    /// As a fit looks at them: by eq. 9, turned, and a part of them at every scale alike.
    Training {
        /// Share of those at every scale alike: eq. 9 hardly draws coarse ones.
        floor: f32,
    },
    /// Round, of half a texel's deviation at a level.
    Level(f32),
    /// As eq. 9 draws them at a level.
    Stretched(f32),
}

/// A block of queries, structure of arrays.
pub struct Queries {
    /// Where.
    pub places: Vec<Place>,
    /// Directions to the light, [component].
    pub light: [Row; 3],
    /// Directions to the viewer, [component].
    pub view: [Row; 3],
}

/// Samples of a Gaussian in two dimensions that are spread evenly: each pattern has one at every distance from
/// the centre that is as likely as others.
pub struct Gaussians {
    samples: usize,
    patterns: Vec<Vec2>,
}

/// Patterns to choose from, each of which stands for eight by its reflections.
const PATTERNS: usize = 512;

impl Gaussians {
    /// Patterns of so many samples.
    #[must_use]
    pub fn new(samples: usize) -> Self {
        let mut rng = Pcg64::seed_from_u64(samples as u64);
        let mut patterns = Vec::with_capacity(PATTERNS * samples);
        for _ in 0..PATTERNS {
            let (shift, turn): (f32, f32) = (rng.random(), rng.random());
            // The golden angle.
            const GOLDEN: f32 = 0.381_966;
            for i in 0..samples {
                let u = (i as f32 + (shift + GOLDEN * i as f32).fract()) / samples as f32;
                let radius = (-2.0 * (1.0 - u).max(f32::MIN_POSITIVE).ln()).sqrt();
                let angle = TAU * (turn + GOLDEN * i as f32);
                patterns.push(radius * Vec2::from_angle(angle));
            }
        }
        Gaussians { samples, patterns }
    }

    /// Samples of a pattern.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.samples
    }
}

/// What is needed to draw queries of a surface.
pub struct Drawing<'a> {
    /// The surface.
    pub field: &'a dyn Field,
    /// Samples of a footprint.
    pub gaussians: Gaussians,
    /// How footprints are drawn.
    pub footprints: Footprints,
    /// Seed of all.
    pub seed: u64,
}

impl Drawing<'_> {
    /// The queries of a block, by its number alone, and f there: [channel].
    pub fn block(&self, number: u64, queries: &mut Queries, targets: &mut [Row; 3], samples: &mut Samples) {
        let mut rng = Pcg64::seed_from_u64(mix(self.seed, number));
        let size = self.field.size();
        let texels = Vec2::new(size[0] as f32, size[1] as f32);
        samples.resize(BLOCK * self.gaussians.samples);
        queries.places.clear();
        for i in 0..BLOCK {
            let (light, view) = (cosine(&mut rng), cosine(&mut rng));
            let (column, lane) = (i / LANES, i % LANES);
            for c in 0..3 {
                queries.light[c][column][lane] = light[c];
                queries.view[c][column][lane] = view[c];
            }
            let uv = Vec2::new(rng.random(), rng.random());
            let axes = self.axes(view, texels, &mut rng).map(|axis| axis / texels);
            queries
                .places
                .push(Place { uv: uv.into(), footprint: Footprint::Axes(axes.map(|axis| axis.to_array())) });
            let choice: u32 = rng.random();
            samples.spread(i, &self.gaussians, choice, uv, axes, light, view);
        }
        samples.evaluate(self.field);
        samples.mean(self.gaussians.samples, targets);
    }

    /// Axes of a footprint, in texels.
    fn axes(&self, view: Vec3, texels: Vec2, rng: &mut Pcg64) -> [Vec2; 2] {
        let levels = texels.max_element().log2();
        let stretched = |level: f32, rng: &mut Pcg64| {
            // A normal number of deviation 0.2 by the sum of three uniform ones.
            let z: f32 = 0.4 * ((0..3).map(|_| rng.random::<f32>()).sum::<f32>() - 1.5);
            let minor = 0.5 * level.exp2();
            let major = minor * (1.0 + z).max(0.1) / view.z.max(1e-3);
            let along = Vec2::from_angle(TAU * rng.random::<f32>());
            [major * along, minor * along.perp()]
        };
        match self.footprints {
            Footprints::Level(level) => [0.5 * level.exp2() * Vec2::X, 0.5 * level.exp2() * Vec2::Y],
            Footprints::Stretched(level) => stretched(level, rng),
            Footprints::Training { floor } => {
                let u: f32 = rng.random();
                // From a quarter of a texel to twice the tile.
                let share = if rng.random::<f32>() < floor {
                    u
                } else {
                    ((5.0 * u).exp() - 1.0) / (5f32.exp() - 1.0)
                };
                stretched(-1.0 + (levels + 2.0) * share, rng)
            }
        }
    }
}

impl Default for Queries {
    fn default() -> Self {
        Queries { places: Vec::with_capacity(BLOCK), light: [ZERO_ROW; 3], view: [ZERO_ROW; 3] }
    }
}

fn cosine(rng: &mut Pcg64) -> Vec3 {
    let (u, phi): (f32, f32) = (rng.random(), TAU * rng.random::<f32>());
    let r = u.sqrt();
    let (sin, cos) = phi.sin_cos();
    Vec3::new(r * cos, r * sin, (1.0 - u).max(1e-6).sqrt())
}

/// The points by which the footprints of a block are seen.
#[derive(Default)]
pub struct Samples {
    points: Vec<Place>,
    light: [Vec<f32>; 3],
    view: [Vec<f32>; 3],
    f: [Vec<f32>; 3],
}

impl Samples {
    fn resize(&mut self, count: usize) {
        self.points.resize(count, Place::far());
        for side in [&mut self.light, &mut self.view, &mut self.f] {
            side.iter_mut().for_each(|component| component.resize(count, 0.0));
        }
    }

    #[allow(clippy::too_many_arguments)]
    fn spread(
        &mut self,
        query: usize,
        gaussians: &Gaussians,
        choice: u32,
        uv: Vec2,
        axes: [Vec2; 2],
        light: Vec3,
        view: Vec3,
    ) {
        let count = gaussians.samples;
        let part = query * count..(query + 1) * count;
        let pattern = &gaussians.patterns[choice as usize % PATTERNS * count..][..count];
        let sign = |bit: u32| if choice >> bit & 1 == 0 { 1.0 } else { -1.0 };
        let (signs, swaps) = (Vec2::new(sign(31), sign(30)), choice >> 29 & 1 == 1);
        for (point, &sample) in self.points[part.clone()].iter_mut().zip(pattern) {
            let sample = signs * if swaps { Vec2::new(sample.y, sample.x) } else { sample };
            *point = Place::point((uv + axes[0] * sample.x + axes[1] * sample.y).into());
        }
        for c in 0..3 {
            self.light[c][part.clone()].fill(light[c]);
            self.view[c][part.clone()].fill(view[c]);
        }
    }

    fn evaluate(&mut self, field: &dyn Field) {
        let [light, view] = [&self.light, &self.view].map(|side| side.each_ref().map(|x| &x[..]));
        field.eval(&self.points, light, view, self.f.each_mut().map(|x| &mut x[..]));
    }

    fn mean(&self, count: usize, targets: &mut [Row; 3]) {
        for c in 0..3 {
            for (target, samples) in
                targets[c].as_flattened_mut().iter_mut().zip(self.f[c].chunks_exact(count))
            {
                *target = samples.iter().sum::<f32>() / count as f32;
            }
        }
    }
}

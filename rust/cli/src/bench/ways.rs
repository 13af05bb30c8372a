//! The ways in which a renderer asks a material.

use std::hint::black_box;
use std::time::Instant;

use glimt_core::{Brdf, Material, SampleBrdf, Vec3};
use rayon::prelude::*;

/// Pairs in one measurement: few enough for the caches, and many times the clock's resolution.
pub const PAIRS: usize = 4096;
/// Pairs that a thread takes at once, where there are several.
const CHUNK: usize = 256;
/// Lanes of a packet: those of a kernel that Dr.Jit compiles for AVX2.
const PACKET: usize = 8;

/// A way to ask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// f of a long array of pairs.
    Batch,
    /// f of 8 pairs.
    Packet,
    /// f of one pair, of which each depends on the one before: what counts is the latency.
    Single,
    /// A light direction with its density and weight.
    Sample,
    /// The density of a pair.
    Pdf,
}

impl Way {
    pub const ALL: [Way; 5] = [Way::Batch, Way::Packet, Way::Single, Way::Sample, Way::Pdf];

    pub fn name(self) -> &'static str {
        match self {
            Way::Batch => "batch",
            Way::Packet => "packet of 8",
            Way::Single => "single",
            Way::Sample => "sample",
            Way::Pdf => "pdf",
        }
    }

    /// Seconds for one pair.
    pub fn seconds(self, material: &Material, workspace: &mut Workspace) -> f64 {
        let start = Instant::now();
        workspace.ask(self, material);
        start.elapsed().as_secs_f64() / PAIRS as f64
    }
}

/// Pairs, random numbers and room for the answers.
pub struct Workspace {
    light: Vec<Vec3>,
    view: Vec<Vec3>,
    random: Vec<Vec3>,
    f: Vec<Vec3>,
    /// The same pairs by component, [component][pair], and room for f.
    light_lanes: [Vec<f32>; 3],
    view_lanes: [Vec<f32>; 3],
    f_lanes: [Vec<f32>; 3],
}

impl Workspace {
    pub fn new() -> Self {
        let light = directions([0.856_674_9, 0.733_891_9]);
        let view = directions([0.628_706_7, 0.538_596_9]);
        let component = |of: &[Vec3]| [0, 1, 2].map(|c| of.iter().map(|v| v[c]).collect());
        let random =
            (0..PAIRS).map(|i| (i as f32 * Vec3::new(0.819_172_5, 0.671_043_6, 0.549_700_5)).fract());
        Workspace {
            light_lanes: component(&light),
            view_lanes: component(&view),
            f_lanes: component(&light),
            random: random.collect(),
            f: vec![Vec3::ZERO; PAIRS],
            light,
            view,
        }
    }

    fn ask(&mut self, way: Way, material: &Material) {
        match way {
            Way::Batch if rayon::current_num_threads() == 1 => {
                material.eval_batch(&self.light, &self.view, &mut self.f);
            }
            Way::Batch => {
                let pairs = self.light.par_chunks(CHUNK).zip(self.view.par_chunks(CHUNK));
                let f = self.f.par_chunks_mut(CHUNK);
                pairs.zip(f).for_each(|((light, view), f)| material.eval_batch(light, view, f));
            }
            Way::Packet => {
                for first in (0..PAIRS).step_by(PACKET) {
                    let lanes = first..first + PACKET;
                    let light = self.light_lanes.each_ref().map(|c| &c[lanes.clone()]);
                    let view = self.view_lanes.each_ref().map(|c| &c[lanes.clone()]);
                    let f = self.f_lanes.each_mut().map(|c| &mut c[lanes.clone()]);
                    material.eval_packet(light, view, f);
                }
            }
            Way::Single => {
                let mut last = 0.0;
                for (&light, &view) in self.light.iter().zip(&self.view) {
                    // Too little to change a number, but the next call has to wait for it.
                    last = material.eval(light, view + Vec3::splat(last * 1e-30)).x;
                }
                black_box(last);
            }
            Way::Sample => {
                for ((&view, &u), f) in self.view.iter().zip(&self.random).zip(&mut self.f) {
                    *f = material.sample(view, u).weight;
                }
            }
            Way::Pdf => {
                for ((&light, &view), f) in self.light.iter().zip(&self.view).zip(&mut self.f) {
                    f.x = material.pdf(light, view);
                }
            }
        }
        black_box((&self.f, &self.f_lanes));
    }
}

/// Directions over the hemisphere that repeat no pattern.
fn directions(steps: [f32; 2]) -> Vec<Vec3> {
    let direction = |i: usize| {
        let [u, v] = steps.map(|step| (i as f32 * step).fract());
        let (z, phi) = (0.03 + 0.97 * u, v * std::f32::consts::TAU);
        let r = (1.0 - z * z).sqrt();
        Vec3::new(r * phi.cos(), r * phi.sin(), z)
    };
    (0..PAIRS).map(direction).collect()
}

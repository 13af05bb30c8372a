//! Random inputs that visit the extremes: every order of magnitude of the cosines, of the distance
//! from the mirror direction and of the distance between light and view, and any bit pattern at all.

use std::f32::consts::TAU;

use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use glimt_core::Brdf;

use crate::extremes::{Case, Pair};
use crate::stability::violation;

/// A number whose logarithm is uniform.
pub fn log_uniform(rng: &mut Pcg64Mcg, from: f32, to: f32) -> f32 {
    let (from, to) = (from.log2(), to.log2());
    (from + (to - from) * rng.random::<f32>()).exp2()
}

/// A direction of uniform cosine.
pub fn direction(rng: &mut Pcg64Mcg) -> Vec3 {
    // Down to the horizon's smallest, 2⁻²⁴.
    let cos = 1.0 - rng.random::<f32>();
    at_cosine(rng, cos)
}

/// A direction whose cosine is of any order of magnitude.
pub fn grazing_direction(rng: &mut Pcg64Mcg) -> Vec3 {
    let cos = log_uniform(rng, 1e-37, 1.0);
    at_cosine(rng, cos)
}

fn at_cosine(rng: &mut Pcg64Mcg, cos: f32) -> Vec3 {
    let (sin_phi, cos_phi) = (TAU * rng.random::<f32>()).sin_cos();
    let r = ((1.0 - cos) * (1.0 + cos)).sqrt();
    Vec3::new(r * cos_phi, r * sin_phi, cos)
}

/// `v` moved aside by a distance of any order of magnitude.
fn nudged(rng: &mut Pcg64Mcg, v: Vec3) -> Vec3 {
    let (sin_phi, cos_phi) = (TAU * rng.random::<f32>()).sin_cos();
    let step = log_uniform(rng, 1e-9, 0.3);
    let u = v.any_orthonormal_vector();
    let moved = (v + step * (cos_phi * u + sin_phi * v.cross(u))).normalize();
    moved.with_z(moved.z.abs())
}

/// A pair of directions above the horizon, by one of the ways to be extreme.
pub fn directions(rng: &mut Pcg64Mcg) -> Pair {
    let mirrored = |v: Vec3| Vec3::new(-v.x, -v.y, v.z);
    match rng.random_range(0..10) {
        0..4 => (direction(rng), direction(rng)),
        4 => (grazing_direction(rng), direction(rng)),
        5 => (grazing_direction(rng), grazing_direction(rng)),
        6 | 7 => {
            let view = direction(rng);
            (nudged(rng, mirrored(view)), view)
        }
        8 => {
            // Opposite azimuths, and cosines too small to change the lengths.
            let cos = log_uniform(rng, 1e-37, 1e-4);
            let view = at_cosine(rng, cos);
            (mirrored(view).with_z(log_uniform(rng, 1e-37, 1e-4)), view)
        }
        _ => {
            let view = direction(rng);
            (nudged(rng, view), view)
        }
    }
}

/// [`directions`], or one time in sixteen vectors of any bits: NaN, infinities, denormals, any length.
pub fn anything(rng: &mut Pcg64Mcg) -> Pair {
    let (light, view) = directions(rng);
    if rng.random_range(0..16) > 0 {
        return (light, view);
    }
    let mut broken = |mut v: Vec3| {
        let component: usize = rng.random_range(0..3);
        v[component] = f32::from_bits(rng.random());
        v
    };
    (broken(light), broken(view))
}

/// Pairs of one block.
pub const BLOCK: usize = 1 << 14;

/// What a material answers that it must not, on a block of pairs that follow from `seed`.
#[must_use]
pub fn violations(case: &Case, seed: u64) -> Vec<String> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let (light, view): (Vec<Vec3>, Vec<Vec3>) = (0..BLOCK).map(|_| anything(&mut rng)).unzip();
    let mut f = vec![Vec3::ZERO; BLOCK];
    case.material.eval_batch(&light, &view, &mut f);
    (0..BLOCK)
        .filter_map(|i| {
            let u = Vec3::new(rng.random(), rng.random(), rng.random());
            violation(&case.material, (light[i], view[i]), f[i], u)
        })
        .map(|wrong| format!("{} ({}): {wrong}", case.material.kind(), case.name))
        .collect()
}

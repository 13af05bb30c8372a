//! What every reflectance function in glimt answers, and the conventions it answers in.

use glam::Vec3;

use crate::simd::{LANES, Lane3};

/// A sampled light direction.
///
/// A failed sample has `pdf` 0 and `weight` 0; its `light` is then the normal and carries no meaning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Unit direction towards the light, in the local frame.
    pub light: Vec3,
    /// Density of `light` in sr⁻¹ (solid angle).
    pub pdf: f32,
    /// f · cosθ_light / pdf, linear RGB.
    pub weight: Vec3,
}

impl Sample {
    /// The sample that carries nothing.
    pub const FAILED: Sample = Sample { light: Vec3::Z, pdf: 0.0, weight: Vec3::ZERO };
}

/// A bidirectional reflectance distribution function in a local shading frame.
///
/// The frame is right-handed with the normal n = +z. `light` points to where the energy comes from
/// and `view` to where it goes; both point away from the surface and have unit length. Below the
/// horizon on either side every answer is 0, and so it is for a vector that holds a NaN or has not
/// about unit length: for every input f is finite and ≥ 0. Reciprocity is promised only where a model says so.
pub trait Brdf: Send + Sync {
    /// f_r(light, view) in sr⁻¹, linear RGB, without the cosine.
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3;

    /// [`Brdf::eval`] for [`LANES`] pairs side by side, `[component][lane]`.
    fn eval_tile(&self, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        for lane in 0..LANES {
            let f = self.eval(lane_of(light, lane), lane_of(view, lane));
            set_lane(out, lane, f);
        }
    }

    /// [`Brdf::eval`] for as many pairs as `out` is long.
    ///
    /// # Panics
    /// If the three slices differ in length.
    fn eval_batch(&self, light: &[Vec3], view: &[Vec3], out: &mut [Vec3]) {
        assert!(light.len() == out.len() && view.len() == out.len(), "as many lights as views and results");
        let tiles = light.chunks(LANES).zip(view.chunks(LANES)).zip(out.chunks_mut(LANES));
        for ((light, view), out) in tiles {
            // Lanes beyond the end stay 0: below the horizon.
            let mut tile = [[[0.0; LANES]; 3]; 2];
            for (lane, (&l, &v)) in light.iter().zip(view).enumerate() {
                set_lane(&mut tile[0], lane, l);
                set_lane(&mut tile[1], lane, v);
            }
            let mut f = [[0.0; LANES]; 3];
            self.eval_tile(&tile[0], &tile[1], &mut f);
            for (lane, out) in out.iter_mut().enumerate() {
                *out = lane_of(&f, lane);
            }
        }
    }
}

/// A BRDF that can be importance sampled, with the density of its sampler known exactly.
pub trait SampleBrdf: Brdf {
    /// Density (sr⁻¹, solid angle of `light`) with which [`sample`](Self::sample) chooses `light`.
    fn pdf(&self, light: Vec3, view: Vec3) -> f32;

    /// Chooses a light direction for `view` from three numbers `u` in [0, 1): `u.x` selects the
    /// lobe, `u.y` and `u.z` a direction within it.
    fn sample(&self, view: Vec3, u: Vec3) -> Sample;
}

/// Squared lengths between which a vector passes for a direction. Rounding leaves unit vectors far
/// inside; what is outside was never one, and the models' formulas could overflow there.
const LENGTH_SQUARED: [f32; 2] = [0.25, 4.0];

/// Whether a pair of directions can carry any energy: both are directions, above the horizon.
#[inline]
#[must_use]
pub fn is_lit(light: Vec3, view: Vec3) -> bool {
    // Comparisons with NaN are false.
    let is_direction = |v: Vec3| (LENGTH_SQUARED[0]..=LENGTH_SQUARED[1]).contains(&v.length_squared());
    light.z > 0.0 && view.z > 0.0 && is_direction(light) && is_direction(view)
}

/// Sets the lanes of `f` that [`is_lit`] rejects to 0.
#[inline(always)]
pub fn mask_unlit(light: &Lane3, view: &Lane3, f: &mut Lane3) {
    let is_direction = |v: &Lane3, lane: usize| {
        let square = v[0][lane] * v[0][lane] + v[1][lane] * v[1][lane] + v[2][lane] * v[2][lane];
        (LENGTH_SQUARED[0]..=LENGTH_SQUARED[1]).contains(&square)
    };
    for lane in 0..LANES {
        let lit = (light[2][lane] > 0.0)
            & (view[2][lane] > 0.0)
            & is_direction(light, lane)
            & is_direction(view, lane);
        for f in f.iter_mut() {
            f[lane] = if lit { f[lane] } else { 0.0 };
        }
    }
}

/// The vector in one lane of a tile.
#[inline(always)]
#[must_use]
pub fn lane_of(tile: &Lane3, lane: usize) -> Vec3 {
    Vec3::new(tile[0][lane], tile[1][lane], tile[2][lane])
}

#[inline(always)]
fn set_lane(tile: &mut Lane3, lane: usize, v: Vec3) {
    tile[0][lane] = v.x;
    tile[1][lane] = v.y;
    tile[2][lane] = v.z;
}

//! What every reflectance function in glimt answers, and the conventions it answers in.

use glam::Vec3;

use crate::simd::{LANES, Lane3, Real};

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

    /// [`Brdf::eval`] for as many pairs as the slices are long, `[component][pair]`. Packets of 4, 8 and 16
    /// pairs are what models with kernels evaluate in one go.
    ///
    /// # Panics
    /// If the slices differ in length.
    fn eval_packet(&self, light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]) {
        check_lengths(&light, &view, &out);
        let [red, green, blue] = out;
        for i in 0..red.len() {
            let at = |v: [&[f32]; 3]| Vec3::new(v[0][i], v[1][i], v[2][i]);
            [red[i], green[i], blue[i]] = self.eval(at(light), at(view)).to_array();
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

    /// Whether f is known for this pair. A measurement has holes: [`Brdf::eval`] fills them from what lies
    /// around them, but nothing should be fitted to that or measured against it.
    fn has_data(&self, _light: Vec3, _view: Vec3) -> bool {
        true
    }
}

/// # Panics
/// If the slices of a packet differ in length.
pub(crate) fn check_lengths(light: &[&[f32]; 3], view: &[&[f32]; 3], out: &[&mut [f32]; 3]) {
    let n = out[0].len();
    let inputs_fit = light.iter().chain(view).all(|v| v.len() == n);
    assert!(inputs_fit && out[1].len() == n && out[2].len() == n, "as many lights as views and results");
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
    lit(light.to_array(), view.to_array())
}

/// [`is_lit`] in any number of lanes.
#[inline(always)]
#[must_use]
pub fn lit<F: Real>(light: [F; 3], view: [F; 3]) -> F::Mask {
    // Comparisons with NaN are false.
    light[0].and(is_direction_above(light), is_direction_above(view))
}

#[inline(always)]
fn is_direction_above<F: Real>(v: [F; 3]) -> F::Mask {
    let square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    let [least, most] = [square.splat(LENGTH_SQUARED[0]), square.splat(LENGTH_SQUARED[1])];
    let is_direction = square.and(least.lt(square), square.lt(most));
    square.and(is_direction, square.splat(0.0).lt(v[2]))
}

/// Sets the lanes of `f` that [`is_lit`] rejects to 0.
#[inline(always)]
pub fn mask_unlit(light: &Lane3, view: &Lane3, f: &mut Lane3) {
    for lane in 0..LANES {
        if !is_lit(lane_of(light, lane), lane_of(view, lane)) {
            set_lane(f, lane, Vec3::ZERO);
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

//! Where a pair of directions lies in the angular textures: shading frame, half and difference vector, polar
//! coordinates and radial warp (§3.1, §3.2), in any number of lanes.

use crate::simd::Real;
use crate::simd::math::{angle, exp, ln};
use std::f32::consts::FRAC_1_PI;

/// Numbers of a shading frame: normal and tangent, before they are made a frame.
pub const FRAME: usize = 6;

/// Numbers of a radial warp: the share of the first power, and both exponents.
pub const WARP: usize = 3;

/// A direction in the unit disk.
#[derive(Clone, Copy, Debug)]
pub struct Polar<F> {
    /// Distance from the centre, in [0, 1].
    pub radius: F,
    /// Azimuth, in turns, in [0, 1]; of a difference vector in half turns, so that light and view can change places.
    pub turn: F,
}

/// The half vector and the difference vector (Rusinkiewicz 1998) of a pair above the horizon, in a frame made of
/// [`FRAME`] numbers by Gram and Schmidt.
///
/// In the frame both directions are projected to the disk and lifted to the hemisphere again (§3.1): no frame brings
/// one below the horizon.
#[inline(always)]
#[must_use]
pub fn half_and_difference<F: Real>(
    frame: Option<&[F; FRAME]>,
    light: [F; 3],
    view: [F; 3],
) -> [Polar<F>; 2] {
    let [light, view] = match frame {
        Some(frame) => {
            let axes = tangents(frame);
            [project(&axes, light), project(&axes, view)]
        }
        None => [light, view],
    };
    let (zero, one, least) = (light[0].splat(0.0), light[0].splat(1.0), light[0].splat(LEAST));
    let sum = [light[0] + view[0], light[1] + view[1], light[2] + view[2]];
    let across_squared = sum[0] * sum[0] + sum[1] * sum[1];
    let inverse = (across_squared + sum[2] * sum[2]).max(least).sqrt().reciprocal();
    let (across, up) = (across_squared.max(least).sqrt(), sum[2] * inverse);
    let sine = across * inverse;
    // Turned about z by −φ_h, then about y by −θ_h. A half vector upright has any azimuth.
    let is_tilted = least.lt(across_squared);
    let cos = F::select(is_tilted, sum[0] / across, one);
    let sin = F::select(is_tilted, sum[1] / across, zero);
    let (along, aside) = (cos * light[0] + sin * light[1], cos * light[1] - sin * light[0]);
    let difference = [up * along - sine * light[2], aside];
    let half = Polar { radius: sine.at_most(1.0), turn: turn(sum[1], sum[0]) };
    let squared = difference[0] * difference[0] + aside * aside;
    let doubled = turn(aside, difference[0]) * 2.0;
    let doubled = F::select(one.lt(doubled), doubled - 1.0, doubled);
    [half, Polar { radius: squared.max(least).sqrt().at_most(1.0), turn: doubled }]
}

/// Squares below this are those of no direction.
const LEAST: f32 = 1e-12;

/// Tangent and bitangent of a frame.
#[inline(always)]
fn tangents<F: Real>(&[nx, ny, nz, tx, ty, tz]: &[F; FRAME]) -> [[F; 3]; 2] {
    let n = normalized([nx, ny, nz]);
    let dot = n[0] * tx + n[1] * ty + n[2] * tz;
    let t = normalized([tx - n[0] * dot, ty - n[1] * dot, tz - n[2] * dot]);
    [t, [n[1] * t[2] - n[2] * t[1], n[2] * t[0] - n[0] * t[2], n[0] * t[1] - n[1] * t[0]]]
}

#[inline(always)]
fn normalized<F: Real>(v: [F; 3]) -> [F; 3] {
    let square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    let inverse = square.max(square.splat(LEAST)).sqrt().reciprocal();
    [v[0] * inverse, v[1] * inverse, v[2] * inverse]
}

/// A direction's place in the disk across the normal, lifted to the hemisphere.
#[inline(always)]
fn project<F: Real>(axes: &[[F; 3]; 2], w: [F; 3]) -> [F; 3] {
    let [t, b] = axes;
    let x = w[0] * t[0] + w[1] * t[1] + w[2] * t[2];
    let y = w[0] * b[0] + w[1] * b[1] + w[2] * b[2];
    let height = -(x * x + y * y) + 1.0;
    [x, y, height.max(x.splat(LEAST)).sqrt()]
}

/// Azimuth of (x, y) in turns, in [0, 1].
#[inline(always)]
fn turn<F: Real>(y: F, x: F) -> F {
    let zero = x.splat(0.0);
    let quarter = angle(y.abs(), x.abs().max(x.splat(LEAST_RADIUS))) * (0.5 * FRAC_1_PI);
    let half = F::select(x.lt(zero), -quarter + 0.5, quarter);
    F::select(y.lt(zero), -half + 1.0, half)
}

/// A radial warp, r' = w r^α₁ + (1 − w) r^α₂ (eq. 7 with two powers), and what it is made of.
#[derive(Clone, Copy, Debug)]
pub struct Warp<F> {
    /// w, in (0, 1).
    pub share: F,
    /// α, at least ½.
    pub exponents: [F; 2],
}

impl<F: Real> Warp<F> {
    /// Of [`WARP`] numbers: a logit, and what softplus makes of ½ + α.
    #[inline(always)]
    #[must_use]
    pub fn new([share, first, second]: [F; WARP]) -> Self {
        Warp {
            share: crate::simd::math::sigmoid(share),
            exponents: [softplus(first) + LEAST_EXPONENT, softplus(second) + LEAST_EXPONENT],
        }
    }

    /// Both powers of a radius.
    #[inline(always)]
    #[must_use]
    pub fn powers(&self, radius: F) -> [F; 2] {
        let log = ln(radius.max(radius.splat(LEAST_RADIUS)));
        [exp(self.exponents[0] * log), exp(self.exponents[1] * log)]
    }

    /// r'.
    #[inline(always)]
    #[must_use]
    pub fn apply(&self, radius: F) -> F {
        let [first, second] = self.powers(radius);
        (first - second) * self.share + second
    }
}

/// α is at least this (§3.2).
pub const LEAST_EXPONENT: f32 = 0.5;

/// Radii below this are 0: their logarithm is not wanted.
pub const LEAST_RADIUS: f32 = 1e-6;

/// ln(1 + eˣ).
#[inline(always)]
#[must_use]
pub fn softplus<F: Real>(x: F) -> F {
    // Of the smaller magnitude, so that neither end overflows.
    ln(exp(-x.abs()) + 1.0) + x.max(x.splat(0.0))
}

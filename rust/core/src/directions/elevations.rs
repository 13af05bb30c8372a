//! Knots over the elevation of a direction, for tables that follow the view: about as many degrees apart, and closer
//! near the horizon, where reflectances change fast.

use std::f32::consts::{FRAC_1_SQRT_2, FRAC_PI_4};

use crate::simd::Real;

/// Where among the knots a direction lies, from 0 at the horizon to 1 at the normal: √cosθ + 1 − √(1 − cosθ), halved. It
/// is linear in θ at the normal and in the root of the elevation at the horizon.
#[inline(always)]
#[must_use]
pub fn place<F: Real>(cos_theta: F) -> F {
    let (zero, one) = (cos_theta.splat(0.0), cos_theta.splat(1.0));
    let cos = cos_theta.max(zero).min(one);
    // 1 − √(1 − cosθ) is written so that grazing views keep their digits.
    (cos.sqrt() + cos / ((one - cos).sqrt() + 1.0)) * 0.5
}

/// The cosine of the direction at a place.
#[must_use]
pub fn cos_at(place: f32) -> f32 {
    // √cosθ = cos β and √(1 − cosθ) = sin β, and their difference is √2 cos(β + π/4).
    let beta = ((2.0 * place - 1.0) * FRAC_1_SQRT_2).acos() - FRAC_PI_4;
    beta.cos().powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_and_cosines_are_inverse() {
        assert_eq!((place(0.0f32), place(1.0f32)), (0.0, 1.0));
        for i in 0..=100 {
            let t = i as f32 / 100.0;
            assert!((place(cos_at(t)) - t).abs() < 1e-4, "{t}: {}", place(cos_at(t)));
        }
    }
}

//! What a network sees of a pair of directions.
//!
//! The paper feeds the Cartesian directions. The other choices are functions of the half vector h
//! and the difference angles (Rusinkiewicz 1998), so that a lobe, which is narrow in h, is a smooth
//! function of few numbers. They are computed without inverse trigonometry: √θ_h becomes
//! (1 − cosθ_h)^¼, which is proportional to it near the normal, and the difference angles enter as
//! cosines.

use serde::{Deserialize, Serialize};

use crate::microfacet::{Half, Roughness};
use crate::simd::math::ln;
use crate::simd::{Real, Spread};

/// Most features that any choice of inputs has.
pub const MAX_FEATURES: usize = 8;

/// A choice of inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Inputs {
    /// light xyz, view xyz: the paper's. An isotropic material is isotropic as far as the fit
    /// found out.
    Cartesian,
    /// (1 − cosθ_h)^¼, cosθ_d, cos φ_d, cosθ_l, cosθ_v, ln(1 + tan²θ_h/α²): isotropic and
    /// mirror-symmetric by construction.
    Isotropic,
    /// As `Isotropic` but with cos²φ_d and the sum and product of the cosines: reciprocal as well.
    IsotropicReciprocal,
    /// As `Isotropic` with (1 − cosθ_h)^¼ times the azimuth of h as a vector, and sin φ_d.
    Anisotropic,
    /// As `Anisotropic` with cos 2φ_d, sin 2φ_d and the sum and product of the cosines.
    AnisotropicReciprocal,
}

impl Inputs {
    /// Number of features.
    #[must_use]
    pub fn count(self) -> usize {
        match self {
            Inputs::Cartesian | Inputs::Isotropic | Inputs::IsotropicReciprocal => 6,
            Inputs::Anisotropic | Inputs::AnisotropicReciprocal => 8,
        }
    }

    /// Whether f cannot depend on the azimuth of the pair.
    #[must_use]
    pub fn is_isotropic(self) -> bool {
        matches!(self, Inputs::Isotropic | Inputs::IsotropicReciprocal)
    }

    /// Whether f(light, view) = f(view, light) by construction.
    #[must_use]
    pub fn is_reciprocal(self) -> bool {
        matches!(self, Inputs::IsotropicReciprocal | Inputs::AnisotropicReciprocal)
    }

    /// Index of the feature ln(1 + tan²θ_h/α²), the one that depends on the roughness.
    #[must_use]
    pub fn lobe_feature(self) -> Option<usize> {
        (self != Inputs::Cartesian).then(|| self.count() - 1)
    }

    /// The features of pairs above the horizon, in any number of lanes; the first [`Inputs::count`] are set.
    #[inline(always)]
    #[must_use]
    pub fn compute<F: Real>(self, light: [F; 3], view: [F; 3], alpha: [f32; 2]) -> [F; MAX_FEATURES] {
        let roughness = Roughness::new(alpha);
        self.compute_half(&Half::new(light, view), light, view, &roughness)
    }

    /// [`Inputs::compute`] where the half vector is known.
    #[inline(always)]
    #[must_use]
    pub fn compute_half<F: Real>(
        self,
        half: &Half<F>,
        light: [F; 3],
        view: [F; 3],
        roughness: &Roughness<impl Spread<F>>,
    ) -> [F; MAX_FEATURES] {
        let none = light[0].splat(0.0);
        if self == Inputs::Cartesian {
            return [light[0], light[1], light[2], view[0], view[1], view[2], none, none];
        }
        let root_h = root_h(half);
        let cos_d = centre(half.cos_d());
        let [cos_phi_d, sin_phi_d] = azimuth_d(half, light, view);
        // cos 2φ_d and sin 2φ_d do not change when light and view change places.
        let [cos_2_phi_d, sin_2_phi_d] =
            [cos_phi_d * cos_phi_d - sin_phi_d * sin_phi_d, cos_phi_d * sin_phi_d * 2.0];
        let [sum, product] = [light[2] + view[2] - 1.0, centre(light[2] * view[2])];
        let [light_z, view_z] = [centre(light[2]), centre(view[2])];
        let lobe = lobe(half, roughness);
        match self {
            Inputs::Cartesian | Inputs::Isotropic => {
                [centre(root_h), cos_d, cos_phi_d, light_z, view_z, lobe, none, none]
            }
            Inputs::IsotropicReciprocal => {
                [centre(root_h), cos_d, cos_2_phi_d, sum, product, lobe, none, none]
            }
            Inputs::Anisotropic => {
                let [x, y] = azimuth_h(half);
                [x * root_h, y * root_h, cos_d, cos_phi_d, sin_phi_d, light_z, view_z, lobe]
            }
            Inputs::AnisotropicReciprocal => {
                let [x, y] = azimuth_h(half);
                [x * root_h, y * root_h, cos_d, cos_2_phi_d, sin_2_phi_d, sum, product, lobe]
            }
        }
    }

    /// Derivatives of the lobe feature with respect to α_x and α_y.
    #[inline(always)]
    #[must_use]
    pub fn lobe_derivative<F: Real>(half: &Half<F>, alpha: [f32; 2]) -> [F; 2] {
        let spread = half.height + half.slope(&Roughness::new(alpha));
        let scale = half.height.splat(-2.0 * LOBE_SCALE) / spread;
        let [x, y] = [alpha[0] * alpha[0] * alpha[0], alpha[1] * alpha[1] * alpha[1]];
        [scale * half.tangential[0] * (1.0 / x), scale * half.tangential[1] * (1.0 / y)]
    }
}

/// Brings ln(1 + tan²θ_h/α²), which reaches 10 to 20, to the size of the other features.
const LOBE_SCALE: f32 = 0.2;

/// Largest tan²θ_h/α² that counts. It is reached where h is within 10⁻⁶ of the horizon or less, and
/// before the limit of [`Half`]'s z shows.
const MAX_SLOPE: f32 = 1e20;

/// Length of l − v, and of l + v seen along the normal, up to which an azimuth is undefined: the square
/// of the product of two is still a normal number.
const MIN_LENGTH: f32 = 1e-9;
const MIN_LENGTH_SQUARED: f32 = MIN_LENGTH * MIN_LENGTH;

/// [0, 1] to [−1, 1].
#[inline(always)]
fn centre<F: Real>(x: F) -> F {
    x * 2.0 - 1.0
}

/// (1 − cosθ_h)^¼.
#[inline(always)]
fn root_h<F: Real>(half: &Half<F>) -> F {
    // 1 − cosθ_h = sin²θ_h/(1 + cosθ_h), with no cancellation near the normal.
    let divisor = half.length_squared + half.length * half.vector[2];
    (half.across / divisor).sqrt().sqrt()
}

/// cos φ_h, sin φ_h; 0 where h = n.
#[inline(always)]
fn azimuth_h<F: Real>(half: &Half<F>) -> [F; 2] {
    let none = half.across.splat(0.0);
    let inverse = half.across.sqrt().reciprocal();
    let inverse = Real::select(half.across.splat(MIN_LENGTH_SQUARED).lt(half.across), inverse, none);
    [half.vector[0] * inverse, half.vector[1] * inverse]
}

/// Cosine and sine of the azimuth of the light about h, from the plane of n and h; 0 where h = n or
/// light = view.
#[inline(always)]
fn azimuth_d<F: Real>(half: &Half<F>, light: [F; 3], view: [F; 3]) -> [F; 2] {
    let [h_x, h_y, h_z] = half.vector;
    // The components of d = light − view in the plane of n and h, and along n × h, both multiplied by
    // |n × h| |h|. As d is at right angles to h, the first is −d_z |h|² too, but that takes lengths of
    // exactly 1, all the more the closer h is to n.
    let d = [light[0] - view[0], light[1] - view[1], light[2] - view[2]];
    let along = h_z * (d[0] * h_x + d[1] * h_y) - half.across * d[2];
    let beside = (d[1] * h_x - d[0] * h_y) * half.length;
    let square = along * along + beside * beside;
    let least = square.splat(MIN_LENGTH_SQUARED);
    let distinct = square.and(least.lt(half.across), (least * half.across * half.length_squared).lt(square));
    let inverse = Real::select(distinct, square.sqrt().reciprocal(), square.splat(0.0));
    [along * inverse, beside * inverse]
}

/// ln(1 + tan²θ_h/α²), scaled; the same in every direction that has the same D(h).
#[inline(always)]
fn lobe<F: Real>(half: &Half<F>, roughness: &Roughness<impl Spread<F>>) -> F {
    ln((half.slope(roughness) / half.height).at_most(MAX_SLOPE) + 1.0) * LOBE_SCALE
}

/// The same features in float64 by the angles' definitions. What tests compare against.
pub mod reference {
    use super::{Inputs, LOBE_SCALE, MAX_SLOPE, MIN_LENGTH};
    use glam::{DMat3, DVec2, DVec3};

    /// The features of one pair above the horizon.
    #[must_use]
    pub fn compute(inputs: Inputs, light: DVec3, view: DVec3, alpha: [f64; 2]) -> Vec<f64> {
        let h = (light + view).normalize();
        let cos_d = (0.5 * (light + view).length()).min(1.0);
        // Of the arc functions the tangent's alone keeps the digits of small angles.
        let theta_h = h.x.hypot(h.y).atan2(h.z);
        let [cos_h, sin_h] = azimuth((light + view).truncate());
        let [cos, sin] = azimuth(difference(light, view));
        let root = (2.0 * (theta_h / 2.0).sin().powi(2)).powf(0.25);
        let slope = (h.x / alpha[0]).powi(2) + (h.y / alpha[1]).powi(2);
        let lobe = f64::from(LOBE_SCALE) * (1.0 + (slope / h.z.powi(2)).min(MAX_SLOPE.into())).ln();
        let centre = |x: f64| 2.0 * x - 1.0;
        let (cos_d, sum, product) = (centre(cos_d), light.z + view.z - 1.0, centre(light.z * view.z));
        let (x, y) = (root * cos_h, root * sin_h);
        let (cos_2, sin_2) = (cos * cos - sin * sin, 2.0 * cos * sin);
        let (l, v) = (centre(light.z), centre(view.z));
        match inputs {
            Inputs::Cartesian => [light.to_array(), view.to_array()].concat(),
            Inputs::Isotropic => vec![centre(root), cos_d, cos, l, v, lobe],
            Inputs::IsotropicReciprocal => vec![centre(root), cos_d, cos_2, sum, product, lobe],
            Inputs::Anisotropic => vec![x, y, cos_d, cos, sin, l, v, lobe],
            Inputs::AnisotropicReciprocal => vec![x, y, cos_d, cos_2, sin_2, sum, product, lobe],
        }
    }

    /// Cosine and sine of a vector's azimuth, 0 where it has none.
    fn azimuth(v: DVec2) -> [f64; 2] {
        if v.length() > MIN_LENGTH.into() { v.normalize().into() } else { [0.0; 2] }
    }

    /// l − v seen as Rusinkiewicz does: rotate h to the pole.
    fn difference(light: DVec3, view: DVec3) -> DVec2 {
        let h = light + view;
        let [cos, sin] = azimuth(h.truncate());
        if [cos, sin] == [0.0; 2] {
            return DVec2::ZERO;
        }
        let to_azimuth_zero = DMat3::from_cols_array(&[cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0]);
        let theta_h = h.x.hypot(h.y).atan2(h.z);
        (DMat3::from_rotation_y(-theta_h) * (to_azimuth_zero * (light - view))).truncate()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec3, Vec3};
    use proptest::prelude::*;

    const ALL: [Inputs; 5] = [
        Inputs::Cartesian,
        Inputs::Isotropic,
        Inputs::IsotropicReciprocal,
        Inputs::Anisotropic,
        Inputs::AnisotropicReciprocal,
    ];

    fn direction() -> impl Strategy<Value = DVec3> {
        (0.02..0.999f64, 0.0..std::f64::consts::TAU).prop_map(|(z, phi)| {
            let r = (1.0 - z * z).sqrt();
            DVec3::new(r * phi.cos(), r * phi.sin(), z)
        })
    }

    proptest! {
        #[test]
        fn features_are_the_reference(light in direction(), view in direction()) {
            // Close to h = n or light = view the azimuths are ill-conditioned, not wrong.
            let h = (light + view).normalize();
            prop_assume!(h.z < 0.999 && light.distance(view) > 0.05);
            for inputs in ALL {
                let truth = reference::compute(inputs, light, view, [0.1, 0.3]);
                let features: [f32; MAX_FEATURES] =
                    inputs.compute(light.as_vec3().into(), view.as_vec3().into(), [0.1, 0.3]);
                prop_assert_eq!(truth.len(), inputs.count());
                for (i, truth) in truth.iter().enumerate() {
                    prop_assert!((f64::from(features[i]) - truth).abs() < 2e-5, "{:?} {}: {} {}", inputs, i, features[i], truth);
                }
            }
        }

        #[test]
        fn reciprocal_features_do_not_see_the_order(light in direction(), view in direction()) {
            let (l, v): ([f32; 3], [f32; 3]) = (light.as_vec3().into(), view.as_vec3().into());
            for inputs in ALL.into_iter().filter(|i| i.is_reciprocal()) {
                prop_assert_eq!(inputs.compute(l, v, [0.2, 0.4]), inputs.compute(v, l, [0.2, 0.4]));
            }
        }

        #[test]
        fn lobe_derivative_is_the_slope(light in direction(), view in direction()) {
            let (l, v): ([f32; 3], [f32; 3]) = (light.as_vec3().into(), view.as_vec3().into());
            let alpha = [0.3f32, 0.5];
            for axis in 0..2 {
                let shifted = |delta: f32| {
                    let mut alpha = alpha;
                    alpha[axis] += delta;
                    Inputs::Anisotropic.compute(l, v, alpha)[7]
                };
                let slope = (shifted(2e-3) - shifted(-2e-3)) / 4e-3;
                let derivative = Inputs::lobe_derivative(&Half::new(l, v), alpha)[axis];
                prop_assert!((derivative - slope).abs() < 1e-3 * (1.0 + slope.abs()), "{} {}", derivative, slope);
            }
        }
    }

    #[test]
    fn poles_and_grazing_pairs_are_finite() {
        let grazing = Vec3::new(1.0, 0.0, 1e-30);
        let pairs =
            [(Vec3::Z, Vec3::Z), (grazing, -grazing.with_z(-1e-30)), (grazing, grazing), (Vec3::Z, grazing)];
        for inputs in ALL {
            for (l, v) in pairs {
                let features: [f32; MAX_FEATURES] = inputs.compute(l.into(), v.into(), [1e-4; 2]);
                assert!(features.iter().all(|f| f.abs() <= 40.0), "{inputs:?} at {l} {v}: {features:?}");
            }
        }
    }
}

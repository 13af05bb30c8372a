//! What a network sees of a pair of directions.
//!
//! The paper feeds the Cartesian directions. The other choices are functions of the half vector h
//! and the difference angles (Rusinkiewicz 1998), so that a lobe, which is narrow in h, is a smooth
//! function of few numbers. They are computed without inverse trigonometry: √θ_h becomes
//! (1 − cosθ_h)^¼, which is proportional to it near the normal, and the difference angles enter as
//! cosines.

use serde::{Deserialize, Serialize};

use crate::math::ln;
use crate::simd::{LANES, Lane, Lane3};

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

    /// The features of one pair above the horizon; the first [`Inputs::count`] are set.
    #[inline(always)]
    #[must_use]
    pub fn compute(self, light: [f32; 3], view: [f32; 3], alpha: [f32; 2]) -> [f32; MAX_FEATURES] {
        match self {
            Inputs::Cartesian => [light[0], light[1], light[2], view[0], view[1], view[2], 0.0, 0.0],
            Inputs::Isotropic => {
                let p = HalfDifference::new(light, view);
                let lobe = p.lobe(alpha);
                [
                    centre(p.root_h),
                    centre(p.cos_d),
                    p.cos_phi_d,
                    centre(light[2]),
                    centre(view[2]),
                    lobe,
                    0.0,
                    0.0,
                ]
            }
            Inputs::IsotropicReciprocal => {
                let p = HalfDifference::new(light, view);
                let (cos_2_phi, _) = p.double_phi_d();
                let (sum, product) = symmetric(light[2], view[2]);
                [centre(p.root_h), centre(p.cos_d), cos_2_phi, sum, product, p.lobe(alpha), 0.0, 0.0]
            }
            Inputs::Anisotropic => {
                let p = HalfDifference::new(light, view);
                let [x, y] = p.azimuth_h.map(|a| a * p.root_h);
                let lobe = p.lobe(alpha);
                [x, y, centre(p.cos_d), p.cos_phi_d, p.sin_phi_d, centre(light[2]), centre(view[2]), lobe]
            }
            Inputs::AnisotropicReciprocal => {
                let p = HalfDifference::new(light, view);
                let [x, y] = p.azimuth_h.map(|a| a * p.root_h);
                let (cos_2_phi, sin_2_phi) = p.double_phi_d();
                let (sum, product) = symmetric(light[2], view[2]);
                [x, y, centre(p.cos_d), cos_2_phi, sin_2_phi, sum, product, p.lobe(alpha)]
            }
        }
    }

    /// [`Inputs::compute`] in every lane, to `x[feature][lane]`.
    #[inline(always)]
    pub fn compute_lanes(self, light: &Lane3, view: &Lane3, alpha: [f32; 2], x: &mut [Lane]) {
        // One loop for each choice, so that the choice is not made in every lane.
        match self {
            Inputs::Cartesian => fill(Inputs::Cartesian, light, view, alpha, x),
            Inputs::Isotropic => fill(Inputs::Isotropic, light, view, alpha, x),
            Inputs::IsotropicReciprocal => fill(Inputs::IsotropicReciprocal, light, view, alpha, x),
            Inputs::Anisotropic => fill(Inputs::Anisotropic, light, view, alpha, x),
            Inputs::AnisotropicReciprocal => fill(Inputs::AnisotropicReciprocal, light, view, alpha, x),
        }
    }

    /// Derivatives of the lobe feature with respect to α_x and α_y.
    #[must_use]
    pub fn lobe_derivative(light: [f32; 3], view: [f32; 3], alpha: [f32; 2]) -> [f32; 2] {
        let p = HalfDifference::new(light, view);
        let scale = -2.0 * LOBE_SCALE / (p.height + p.slope(alpha)).max(f32::MIN_POSITIVE);
        [0, 1].map(|i| scale * p.tangential[i] / alpha[i].powi(3))
    }
}

#[inline(always)]
fn fill(inputs: Inputs, light: &Lane3, view: &Lane3, alpha: [f32; 2], x: &mut [Lane]) {
    let x = &mut x[..inputs.count()];
    for lane in 0..LANES {
        let features = inputs.compute(
            [light[0][lane], light[1][lane], light[2][lane]],
            [view[0][lane], view[1][lane], view[2][lane]],
            alpha,
        );
        for (x, feature) in x.iter_mut().zip(features) {
            x[lane] = feature;
        }
    }
}

/// Brings ln(1 + tan²θ_h/α²), which reaches 10 to 20, to the size of the other features.
const LOBE_SCALE: f32 = 0.2;

/// [0, 1] to [−1, 1].
#[inline(always)]
fn centre(x: f32) -> f32 {
    2.0 * x - 1.0
}

/// Sum and product of the cosines, each on [−1, 1]; equal for both orders.
#[inline(always)]
fn symmetric(a: f32, b: f32) -> (f32, f32) {
    (a + b - 1.0, centre(a * b))
}

/// A pair of directions as half vector h and difference d.
struct HalfDifference {
    /// (1 − cosθ_h)^¼.
    root_h: f32,
    /// cos φ_h, sin φ_h; 0 where h = n.
    azimuth_h: [f32; 2],
    /// cosθ_d.
    cos_d: f32,
    /// Azimuth of the light about h, from the plane of n and h; 0 where h = n or light = view.
    cos_phi_d: f32,
    sin_phi_d: f32,
    /// h_x², h_y² and h_z² of the half vector that is not normalised.
    tangential: [f32; 2],
    height: f32,
}

impl HalfDifference {
    #[inline(always)]
    fn new(light: [f32; 3], view: [f32; 3]) -> Self {
        let h = [light[0] + view[0], light[1] + view[1], light[2] + view[2]];
        let d = [light[0] - view[0], light[1] - view[1], light[2] - view[2]];
        let tangential = [h[0] * h[0], h[1] * h[1]];
        let height = h[2] * h[2];
        let across = tangential[0] + tangential[1];
        let length_squared = (across + height).max(f32::MIN_POSITIVE);
        let length = length_squared.sqrt();
        // 1 − cosθ_h = sin²θ_h/(1 + cosθ_h), with no cancellation near the normal.
        let one_minus_cos = across / (length_squared + length * h[2]);
        let inverse_across = inverse_or_zero(across.sqrt());
        let azimuth_h = [h[0] * inverse_across, h[1] * inverse_across];
        // d is at right angles to h. Its components in the plane of n and h, and along n × h, are
        // −d_z/sinθ_h and d·(n × h)/|n × h|; they add up to |d| = 2 sinθ_d.
        let along = -d[2] * length * inverse_across;
        let beside = d[1] * azimuth_h[0] - d[0] * azimuth_h[1];
        let inverse_d = inverse_or_zero((along * along + beside * beside).sqrt());
        HalfDifference {
            root_h: one_minus_cos.sqrt().sqrt(),
            azimuth_h,
            cos_d: (0.5 * length).min(1.0),
            cos_phi_d: along * inverse_d,
            sin_phi_d: beside * inverse_d,
            tangential,
            height,
        }
    }

    /// (h_x/α_x)² + (h_y/α_y)².
    #[inline(always)]
    fn slope(&self, alpha: [f32; 2]) -> f32 {
        self.tangential[0] / (alpha[0] * alpha[0]) + self.tangential[1] / (alpha[1] * alpha[1])
    }

    /// ln(1 + tan²θ_h/α²), scaled; the same in every direction that has the same D(h).
    #[inline(always)]
    fn lobe(&self, alpha: [f32; 2]) -> f32 {
        // Both directions above the horizon make h_z² > 0, but it may be denormal.
        LOBE_SCALE * ln(1.0 + (self.slope(alpha) / self.height.max(f32::MIN_POSITIVE)).min(f32::MAX))
    }

    /// cos 2φ_d and sin 2φ_d, which do not change when light and view change places.
    #[inline(always)]
    fn double_phi_d(&self) -> (f32, f32) {
        (
            self.cos_phi_d * self.cos_phi_d - self.sin_phi_d * self.sin_phi_d,
            2.0 * self.cos_phi_d * self.sin_phi_d,
        )
    }
}

/// 1/x, or 0 where x is so small that the direction it would scale is rounding noise.
#[inline(always)]
fn inverse_or_zero(x: f32) -> f32 {
    const NOISE: f32 = 1e-7;
    if x > NOISE { 1.0 / x } else { 0.0 }
}

/// The same features in float64 by the angles' definitions. What tests compare against.
pub mod reference {
    use super::{Inputs, LOBE_SCALE};
    use glam::DVec3;

    /// The features of one pair above the horizon.
    #[must_use]
    pub fn compute(inputs: Inputs, light: DVec3, view: DVec3, alpha: [f64; 2]) -> Vec<f64> {
        let h = (light + view).normalize();
        let theta_h = h.z.clamp(-1.0, 1.0).acos();
        let theta_d = light.angle_between(h);
        let (phi_h, phi_d) = azimuths(light, h);
        let root = (2.0 * (theta_h / 2.0).sin().powi(2)).powf(0.25);
        let slope = (h.x / alpha[0]).powi(2) + (h.y / alpha[1]).powi(2);
        let lobe = f64::from(LOBE_SCALE) * (1.0 + slope / h.z.powi(2)).ln();
        let centre = |x: f64| 2.0 * x - 1.0;
        let (cos_d, sum, product) = (centre(theta_d.cos()), light.z + view.z - 1.0, centre(light.z * view.z));
        let (x, y) = (root * phi_h.cos(), root * phi_h.sin());
        let (l, v) = (centre(light.z), centre(view.z));
        match inputs {
            Inputs::Cartesian => [light.to_array(), view.to_array()].concat(),
            Inputs::Isotropic => vec![centre(root), cos_d, phi_d.cos(), l, v, lobe],
            Inputs::IsotropicReciprocal => vec![centre(root), cos_d, (2.0 * phi_d).cos(), sum, product, lobe],
            Inputs::Anisotropic => vec![x, y, cos_d, phi_d.cos(), phi_d.sin(), l, v, lobe],
            Inputs::AnisotropicReciprocal => {
                vec![x, y, cos_d, (2.0 * phi_d).cos(), (2.0 * phi_d).sin(), sum, product, lobe]
            }
        }
    }

    /// φ_h, and the azimuth of `light` about h measured as Rusinkiewicz does: rotate h to the pole.
    fn azimuths(light: DVec3, h: DVec3) -> (f64, f64) {
        let phi_h = h.y.atan2(h.x);
        let d = glam::DMat3::from_rotation_y(-h.z.acos()) * (glam::DMat3::from_rotation_z(-phi_h) * light);
        (phi_h, d.y.atan2(d.x))
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
                let features = inputs.compute(light.as_vec3().into(), view.as_vec3().into(), [0.1, 0.3]);
                prop_assert_eq!(truth.len(), inputs.count());
                for (i, truth) in truth.iter().enumerate() {
                    prop_assert!((f64::from(features[i]) - truth).abs() < 2e-5, "{:?} {}: {} {}", inputs, i, features[i], truth);
                }
            }
        }

        #[test]
        fn reciprocal_features_do_not_see_the_order(light in direction(), view in direction()) {
            let (l, v) = (light.as_vec3().into(), view.as_vec3().into());
            for inputs in ALL.into_iter().filter(|i| i.is_reciprocal()) {
                prop_assert_eq!(inputs.compute(l, v, [0.2, 0.4]), inputs.compute(v, l, [0.2, 0.4]));
            }
        }

        #[test]
        fn lobe_derivative_is_the_slope(light in direction(), view in direction()) {
            let (l, v) = (light.as_vec3().into(), view.as_vec3().into());
            let alpha = [0.3f32, 0.5];
            for axis in 0..2 {
                let shifted = |delta: f32| {
                    let mut alpha = alpha;
                    alpha[axis] += delta;
                    Inputs::Anisotropic.compute(l, v, alpha)[7]
                };
                let slope = (shifted(2e-3) - shifted(-2e-3)) / 4e-3;
                let derivative = Inputs::lobe_derivative(l, v, alpha)[axis];
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
                let features = inputs.compute(l.into(), v.into(), [1e-4; 2]);
                assert!(features.iter().all(|f| f.abs() <= 40.0), "{inputs:?} at {l} {v}: {features:?}");
            }
        }
    }
}

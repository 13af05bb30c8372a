//! The analytic BRDF: a Lambertian lobe under an anisotropic GGX lobe (Walter et al. 2007) with
//! exact dielectric Fresnel reflectance per colour channel and separable Smith masking.
//!
//! f_a = k_d/π + F D G / (4 cosθ_l cosθ_v), De Oliveira et al., *A Hybrid Neural-Microfacet BRDF
//! Model*, eq. 3. It is reciprocal by construction. It is not energy conserving: k_d and the
//! microfacet lobe are fitted independently, as in the paper.

use std::f32::consts::{FRAC_1_PI, PI};

use crate::error::Invalid;
use crate::simd::{Lanes, Real, Spread, Vector};

/// Smallest roughness: below it, the lobe is narrower than float32 half vectors resolve.
pub const MIN_ALPHA: f32 = 1e-4;

/// Range of the relative index of refraction (the paper, §3.2).
pub const ETA_RANGE: [f32; 2] = [1.0, 10.0];

/// Parameters p = (k_d, η, α) of the analytic BRDF: those of a material, or in lanes another set in each.
///
/// ```
/// use glimt_core::microfacet::Microfacet;
///
/// let gold = Microfacet { kd: [0.0; 3], eta: [6.0, 4.0, 2.0], alpha: [0.1, 0.3] };
/// assert!(gold.validate().is_ok() && !gold.is_isotropic());
/// let [r, g, b] = gold.eval([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]);
/// assert!(r > g && g > b);
///
/// let mirror = Microfacet { alpha: [0.0; 2], ..gold };
/// assert_eq!(mirror.validate().unwrap_err().to_string(), "alpha is 0, expected a value in [0.0001, 1]");
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Microfacet<F = f32> {
    /// Diffuse albedo per channel, linear RGB, in [0, 1].
    pub kd: [F; 3],
    /// Relative index of refraction per channel, in [1, 10].
    pub eta: [F; 3],
    /// GGX roughness along x and y, in [[`MIN_ALPHA`], 1].
    pub alpha: [F; 2],
}

impl Microfacet {
    /// Whether every parameter is in its range.
    ///
    /// # Errors
    /// The name, value and range of the first parameter that is not.
    pub fn validate(&self) -> Result<(), Invalid> {
        let check = |name: &'static str, values: &[f32], [low, high]: [f32; 2]| match values
            .iter()
            .find(|v| !(low..=high).contains(*v))
        {
            Some(&value) => Err(Invalid::OutOfRange { name, value, low, high }),
            None => Ok(()),
        };
        check("kd", &self.kd, [0.0, 1.0])?;
        check("eta", &self.eta, ETA_RANGE)?;
        check("alpha", &self.alpha, [MIN_ALPHA, 1.0])
    }

    /// Whether the lobe is the same in every azimuth.
    #[must_use]
    pub fn is_isotropic(&self) -> bool {
        self.alpha[0] == self.alpha[1]
    }

    /// α times a factor, kept in its range.
    #[must_use]
    pub fn scaled_alpha(&self, factor: f32) -> [f32; 2] {
        self.alpha.map(|a| (a * factor).clamp(MIN_ALPHA, 1.0))
    }

    /// Between two sets of parameters, with a share `t` of the second: k_d is linear, η by √F₀, which is
    /// (η − 1)/(η + 1), and α by √α, steps of which look alike (Burley 2012, §5.4).
    #[must_use]
    pub fn mix(&self, other: &Microfacet, t: f32) -> Microfacet {
        let by = |scale: fn(f32) -> f32, back: fn(f32) -> f32, a: f32, b: f32| {
            back(scale(a) + (scale(b) - scale(a)) * t)
        };
        let kd = |c: usize| by(|x| x, |x| x, self.kd[c], other.kd[c]).clamp(0.0, 1.0);
        let eta = |c: usize| {
            let eta = by(|n| (n - 1.0) / (n + 1.0), |r| (1.0 + r) / (1.0 - r), self.eta[c], other.eta[c]);
            eta.clamp(ETA_RANGE[0], ETA_RANGE[1])
        };
        let alpha = |i: usize| by(f32::sqrt, |x| x * x, self.alpha[i], other.alpha[i]).clamp(MIN_ALPHA, 1.0);
        Microfacet { kd: [kd(0), kd(1), kd(2)], eta: [eta(0), eta(1), eta(2)], alpha: [alpha(0), alpha(1)] }
    }

    /// f_a for directions above the horizon, of this material in every lane.
    #[inline(always)]
    #[must_use]
    pub fn eval<F: Real>(&self, light: [F; 3], view: [F; 3]) -> [F; 3] {
        self.terms().eval(light, view)
    }
}

impl<F: Real> Microfacet<F> {
    /// What f_a needs of the parameters.
    #[inline(always)]
    #[must_use]
    pub fn terms(&self) -> Terms<F> {
        let [r, g, b] = self.kd;
        let diffuse = [r * FRAC_1_PI, g * FRAC_1_PI, b * FRAC_1_PI];
        Terms { diffuse, eta: self.eta, roughness: Roughness::new(self.alpha) }
    }
}

/// What f_a needs of [`Microfacet`], in any number of lanes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Terms<F = f32> {
    /// k_d/π, in sr⁻¹.
    pub diffuse: [F; 3],
    /// η.
    pub eta: [F; 3],
    /// What depends on α.
    pub roughness: Roughness<F>,
}

impl Terms {
    /// How many numbers they are.
    pub const COUNT: usize = 6 + Roughness::COUNT;
}

impl<F: Copy> Terms<F> {
    /// The numbers in a row.
    #[inline(always)]
    #[must_use]
    pub fn to_row(&self) -> [F; Terms::COUNT] {
        let ([d0, d1, d2], [e0, e1, e2]) = (self.diffuse, self.eta);
        let [r0, r1, r2, r3, r4] = self.roughness.to_row();
        [d0, d1, d2, e0, e1, e2, r0, r1, r2, r3, r4]
    }

    /// From [`Terms::to_row`].
    #[inline(always)]
    #[must_use]
    pub fn from_row([d0, d1, d2, e0, e1, e2, r0, r1, r2, r3, r4]: [F; Terms::COUNT]) -> Self {
        let roughness = Roughness::from_row([r0, r1, r2, r3, r4]);
        Terms { diffuse: [d0, d1, d2], eta: [e0, e1, e2], roughness }
    }
}

impl<S: Copy> Terms<S> {
    /// f_a for directions above the horizon, in any number of lanes. Branch-free.
    #[inline(always)]
    #[must_use]
    pub fn eval<F: Real>(&self, light: [F; 3], view: [F; 3]) -> [F; 3]
    where
        S: Spread<F>,
    {
        self.eval_half(&Half::new(light, view), light, view)
    }

    /// [`Terms::eval`] where the half vector is known.
    #[inline(always)]
    #[must_use]
    pub fn eval_half<F: Real>(&self, half: &Half<F>, light: [F; 3], view: [F; 3]) -> [F; 3]
    where
        S: Spread<F>,
    {
        let shape = self.roughness.shape(half, light, view);
        let cos_d = half.cos_d();
        let mut f = [shape; 3];
        for c in 0..3 {
            f[c] = fresnel(cos_d, self.eta[c].spread(shape)).fma(shape, self.diffuse[c].spread(shape));
        }
        f
    }
}

impl Terms {
    /// [`Terms::eval_half`] of one pair, which stands in every lane, with r, g and b in the lanes.
    #[inline(always)]
    #[must_use]
    pub fn eval_one<I: Lanes<4>>(
        &self,
        isa: I,
        half: &Half<Vector<I, 4>>,
        light: [Vector<I, 4>; 3],
        view: [Vector<I, 4>; 3],
    ) -> Vector<I, 4> {
        let shape = self.roughness.shape(half, light, view);
        let ([eta_r, eta_g, eta_b], [diffuse_r, diffuse_g, diffuse_b]) = (self.eta, self.diffuse);
        let diffuse = Vector::load(isa, &[diffuse_r, diffuse_g, diffuse_b, 0.0]);
        fresnel(half.cos_d(), Vector::load(isa, &[eta_r, eta_g, eta_b, 1.0])).fma(shape, diffuse)
    }
}

/// α, and what D and the networks' features need of it, in any number of lanes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Roughness<F = f32> {
    /// α.
    pub alpha: [F; 2],
    /// 1/α².
    pub inverse_square: [F; 2],
    /// 1/(π α_x α_y).
    pub ndf_scale: F,
}

impl Roughness {
    /// How many numbers they are.
    const COUNT: usize = 5;
}

impl<F: Copy> Roughness<F> {
    #[inline(always)]
    fn to_row(self) -> [F; Roughness::COUNT] {
        let ([x, y], [inverse_x, inverse_y]) = (self.alpha, self.inverse_square);
        [x, y, inverse_x, inverse_y, self.ndf_scale]
    }

    #[inline(always)]
    fn from_row([x, y, inverse_x, inverse_y, ndf_scale]: [F; Roughness::COUNT]) -> Self {
        Roughness { alpha: [x, y], inverse_square: [inverse_x, inverse_y], ndf_scale }
    }
}

impl<F: Real> Roughness<F> {
    /// Of α along x and y.
    #[inline(always)]
    #[must_use]
    pub fn new(alpha: [F; 2]) -> Self {
        let [x, y] = [alpha[0].reciprocal(), alpha[1].reciprocal()];
        let ndf_scale = (alpha[0] * PI * alpha[1]).reciprocal();
        Roughness { alpha, inverse_square: [x * x, y * y], ndf_scale }
    }
}

impl<S: Copy> Roughness<S> {
    /// D G / (4 cosθ_l cosθ_v), which the colour channels share, in sr⁻¹.
    #[inline(always)]
    #[must_use]
    pub fn shape<F: Real>(&self, half: &Half<F>, light: [F; 3], view: [F; 3]) -> F
    where
        S: Spread<F>,
    {
        let masking = masking_denominator(light, self.alpha) * masking_denominator(view, self.alpha);
        half.ndf(self) / masking
    }
}

/// Least z of the sum of two directions that counts. Below it the squares of the sum could vanish.
///
/// A sum is that small only where light and view are within 10⁻¹⁸ of the horizon and opposite; the
/// direction of their half vector is then the rounding error of their other components.
pub const MIN_SUM_Z: f32 = 1e-18;

/// The half vector of a pair of directions, h = light + view, not normalised, and its squares.
#[derive(Clone, Copy, Debug)]
pub struct Half<F> {
    /// h.
    pub vector: [F; 3],
    /// h_x² and h_y².
    pub tangential: [F; 2],
    /// h_z².
    pub height: F,
    /// h_x² + h_y².
    pub across: F,
    /// |h|².
    pub length_squared: F,
    /// |h|.
    pub length: F,
}

impl<F: Real> Half<F> {
    /// Of a pair of directions.
    #[inline(always)]
    #[must_use]
    pub fn new(light: [F; 3], view: [F; 3]) -> Self {
        let z = (light[2] + view[2]).max(light[2].splat(MIN_SUM_Z));
        let vector = [light[0] + view[0], light[1] + view[1], z];
        let tangential = [vector[0] * vector[0], vector[1] * vector[1]];
        let height = vector[2] * vector[2];
        let across = tangential[0] + tangential[1];
        let length_squared = across + height;
        Half { vector, tangential, height, across, length_squared, length: length_squared.sqrt() }
    }

    /// Cosine between the half vector and either direction: for unit vectors |l + v| = 2 cosθ_d, which
    /// stays accurate at grazing differences.
    #[inline(always)]
    #[must_use]
    pub fn cos_d(&self) -> F {
        (self.length * 0.5).min(self.length.splat(1.0))
    }

    /// D(h) of GGX in sr⁻¹.
    ///
    /// It depends on directions through r = |h|² / ((h_x/α_x)² + (h_y/α_y)² + h_z²) alone, which is 1 at
    /// h = n and falls off it, without the difference of close numbers that the usual form in cosθ_h has
    /// at small α.
    #[inline(always)]
    #[must_use]
    pub fn ndf(&self, roughness: &Roughness<impl Spread<F>>) -> F {
        let spread = self.slope(roughness) + self.height;
        let r = self.length_squared / spread.max(spread.splat(f32::MIN_POSITIVE));
        r * r * roughness.ndf_scale.spread(r)
    }

    /// (h_x/α_x)² + (h_y/α_y)².
    #[inline(always)]
    #[must_use]
    pub fn slope(&self, roughness: &Roughness<impl Spread<F>>) -> F {
        let [x, y] = roughness.inverse_square;
        self.tangential[0] * x.spread(self.height) + self.tangential[1] * y.spread(self.height)
    }
}

/// cosθ + √(cos²θ + (α_x x)² + (α_y y)²), with which Smith's G₁ = 2 cosθ / this.
///
/// Masking over 4 cosθ_l cosθ_v is then 1 / (this for the light · this for the view), with no
/// division by a cosine that may vanish.
#[inline(always)]
#[must_use]
pub fn masking_denominator<F: Real>(direction: [F; 3], alpha: [impl Spread<F>; 2]) -> F {
    let [x, y, z] = direction;
    let (x, y) = (x * alpha[0].spread(z), y * alpha[1].spread(z));
    (z + (z * z + x * x + y * y).sqrt()).max(z.splat(f32::MIN_POSITIVE))
}

/// Reflectance of a smooth dielectric with relative index `eta` ≥ 1 for unpolarized light that
/// arrives from outside at cosine `cos`.
///
/// The form of Cook & Torrance 1982: with g = √(η² − 1 + c²) and s = g + c, the reflectances are the
/// squares of (g − c)/s and of that times (c s − 1)/(c (g − c) + 1). Written with g − c = (η² − 1)/s it
/// keeps its relative accuracy where η is close to 1, and on a common denominator it takes one division.
#[inline(always)]
#[must_use]
pub fn fresnel<F: Real>(cos: F, eta: F) -> F {
    // At η = 1 and cos = 0 the sum vanishes; any is right there, for 0 is what η = 1 has. At the next
    // float above 1 the sum is at least 4e-4.
    const LEAST_SUM: f32 = 1e-8;
    let excess = (eta - 1.0) * (eta + 1.0);
    let sum = ((cos * cos + excess).sqrt() + cos).max(cos.splat(LEAST_SUM));
    let divisor = cos * excess + sum;
    let ratio = excess / (sum * sum * divisor);
    let perpendicular = ratio * divisor;
    let parallel = ratio * ((cos * sum - 1.0) * sum);
    (perpendicular * perpendicular + parallel * parallel) * 0.5
}

/// The same functions in float64, written as the paper prints them. What tests compare against.
pub mod reference {
    use super::Microfacet;
    use std::f64::consts::PI;

    /// f_a for directions above the horizon.
    #[must_use]
    pub fn eval(p: &Microfacet, light: [f64; 3], view: [f64; 3]) -> [f64; 3] {
        let alpha = p.alpha.map(f64::from);
        // l·h of the paper is |l + v|/2 for unit vectors. For float32 directions, whose lengths are off
        // by some 1e-7, this form alone treats both alike and is stable where l + v is small.
        let sum: [f64; 3] = std::array::from_fn(|i| light[i] + view[i]);
        let cos_d = (0.5 * dot(sum, sum).sqrt()).min(1.0);
        let half = sum.map(|x| x / dot(sum, sum).sqrt());
        let specular = ndf(half, alpha) * g1(light, alpha) * g1(view, alpha) / (4.0 * light[2] * view[2]);
        std::array::from_fn(|c| f64::from(p.kd[c]) / PI + fresnel(cos_d, p.eta[c].into()) * specular)
    }

    /// GGX distribution of normals (Walter et al. 2007, eq. 33; anisotropic form of Heitz 2014, eq. 85).
    #[must_use]
    pub fn ndf(half: [f64; 3], alpha: [f64; 2]) -> f64 {
        let slope = (half[0] / alpha[0]).powi(2) + (half[1] / alpha[1]).powi(2);
        1.0 / (PI * alpha[0] * alpha[1] * (slope + half[2].powi(2)).powi(2))
    }

    /// Smith's masking (Heitz 2014, eq. 43 and 72).
    #[must_use]
    pub fn g1(v: [f64; 3], alpha: [f64; 2]) -> f64 {
        let tangent_squared = ((alpha[0] * v[0]).powi(2) + (alpha[1] * v[1]).powi(2)) / v[2].powi(2);
        2.0 / (1.0 + (1.0 + tangent_squared).sqrt())
    }

    /// Fresnel's equations by Snell's law, with η cosθ_t = √(η² − 1 + cos²θ_i).
    #[must_use]
    pub fn fresnel(cos_i: f64, eta: f64) -> f64 {
        if eta == 1.0 {
            return 0.0;
        }
        let eta_cos_t = ((eta - 1.0) * (eta + 1.0) + cos_i * cos_i).sqrt();
        let perpendicular = (cos_i - eta_cos_t) / (cos_i + eta_cos_t);
        let parallel = (eta * eta * cos_i - eta_cos_t) / (eta * eta * cos_i + eta_cos_t);
        0.5 * (perpendicular.powi(2) + parallel.powi(2))
    }

    fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn direction() -> impl Strategy<Value = [f64; 3]> {
        (1e-3..1.0f64, 0.0..std::f64::consts::TAU).prop_map(|(z, phi)| {
            let r = (1.0 - z * z).sqrt();
            [r * phi.cos(), r * phi.sin(), z]
        })
    }

    fn parameters() -> impl Strategy<Value = Microfacet> {
        (
            prop::array::uniform3(0.0..1.0f32),
            prop::array::uniform3(1.0..10.0f32),
            prop::array::uniform2((MIN_ALPHA.ln()..0.0f32).prop_map(|x| x.exp().clamp(MIN_ALPHA, 1.0))),
        )
            .prop_map(|(kd, eta, alpha)| Microfacet { kd, eta, alpha })
    }

    proptest! {
        #[test]
        fn eval_is_the_reference(p in parameters(), light in direction(), view in direction()) {
            // Both see the same rounded directions: what is compared is the arithmetic alone.
            let (l, v) = (light.map(|x| x as f32), view.map(|x| x as f32));
            let truth = reference::eval(&p, l.map(f64::from), v.map(f64::from));
            for (f, truth) in p.eval(l, v).into_iter().zip(truth) {
                prop_assert!((f64::from(f) - truth).abs() <= 2e-6 * truth, "{} against {}", f, truth);
            }
        }

        #[test]
        fn eval_is_reciprocal(p in parameters(), light in direction(), view in direction()) {
            let (l, v) = (light.map(|x| x as f32), view.map(|x| x as f32));
            prop_assert_eq!(p.eval(l, v), p.eval(v, l));
        }

        #[test]
        fn eval_is_finite_and_not_negative_at_any_grazing_angle(
            p in parameters(), x in -1.0..1.0f32, y in -1.0..1.0f32, zl in 0.0..1e-30f32, zv in 0.0..1e-30f32,
        ) {
            for f in p.eval([x, y, zl], [-x, -y, zv]).into_iter().chain(p.eval([x, y, zl], [x, y, zv])) {
                prop_assert!(f.is_finite() && f >= 0.0);
            }
        }

        #[test]
        fn fresnel_is_the_reference(cos in 0.0..1.0f32, eta in 1.0..10.0f32) {
            let truth = reference::fresnel(cos.into(), eta.into());
            prop_assert!((f64::from(fresnel(cos, eta)) - truth).abs() <= 2e-6 * truth.max(1e-6));
        }
    }

    #[test]
    fn fresnel_has_its_known_values() {
        assert!((fresnel(1.0, 1.5) - 0.04).abs() < 1e-7);
        assert!((fresnel(0.0, 1.5) - 1.0).abs() < 1e-6);
        assert_eq!(fresnel(0.3, 1.0), 0.0);
        // Brewster's angle: tan θ = η, and only the perpendicular half remains.
        let cos = 1.0 / (1.0f32 + 1.5 * 1.5).sqrt();
        assert!((fresnel(cos, 1.5) - 0.073_964_5).abs() < 1e-6);
    }

    #[test]
    fn ndf_integrates_to_one_over_projected_area() {
        for alpha in [[0.1, 0.1], [0.3, 0.7], [1.0, 1.0]] {
            let (n_theta, n_phi) = (4000, 64);
            let mut sum = 0.0;
            for i in 0..n_theta {
                // Midpoints in t = tan(θ/2)-like spacing that resolves the peak.
                let t = (f64::from(i) + 0.5) / f64::from(n_theta);
                let theta = t * t * std::f64::consts::FRAC_PI_2;
                let d_theta = 2.0 * t * std::f64::consts::FRAC_PI_2 / f64::from(n_theta);
                for j in 0..n_phi {
                    let phi = (f64::from(j) + 0.5) / f64::from(n_phi) * std::f64::consts::TAU;
                    let h = [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()].map(|x| x as f32);
                    let d_omega = theta.sin() * d_theta * std::f64::consts::TAU / f64::from(n_phi);
                    sum += f64::from(Half::new(h, h).ndf(&Roughness::new(alpha))) * theta.cos() * d_omega;
                }
            }
            assert!((sum - 1.0).abs() < 1e-4, "α = {alpha:?}: ∫ D cosθ = {sum}");
        }
    }

    #[test]
    fn parameters_out_of_range_are_named() {
        let p = Microfacet { kd: [0.5; 3], eta: [1.5; 3], alpha: [0.1; 2] };
        assert!(p.validate().is_ok());
        assert!(
            Microfacet { eta: [1.5, 0.9, 1.5], ..p }
                .validate()
                .unwrap_err()
                .to_string()
                .contains("eta is 0.9")
        );
        assert!(
            Microfacet { alpha: [0.0, 0.1], ..p }.validate().unwrap_err().to_string().contains("alpha is 0")
        );
        assert!(
            Microfacet { kd: [f32::NAN, 0.0, 0.0], ..p }
                .validate()
                .unwrap_err()
                .to_string()
                .contains("kd is NaN")
        );
    }
}

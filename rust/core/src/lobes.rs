//! The sampler that every model shares: a mixture of a cosine lobe and the GGX distribution of
//! visible normals. It needs no network, and its density is known exactly.

use std::f32::consts::{FRAC_1_PI, TAU};

use glam::Vec3;

use crate::brdf::{Brdf, is_lit};
use crate::microfacet::{Half, masking_denominator};

/// A cosine lobe and a GGX lobe, mixed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lobes {
    /// GGX roughness along x and y, as in [`Microfacet`].
    pub alpha: [f32; 2],
    /// Probability of the GGX lobe.
    pub specular_weight: f32,
}

/// Roughnesses to try for a material that has none of its own: from 0.01 to 1, a fourth apart. Steps twice as long
/// cost up to a fifth more variance on measured materials, shorter ones gain nothing.
pub const PROXY_ALPHAS: [[f32; 2]; 21] = {
    let steps = [
        0.01, 0.0126, 0.0158, 0.02, 0.0251, 0.0316, 0.0398, 0.0501, 0.0631, 0.0794, 0.1, 0.126, 0.158, 0.2,
        0.251, 0.316, 0.398, 0.501, 0.631, 0.794, 1.0,
    ];
    let mut alphas = [[0.0; 2]; 21];
    let mut i = 0;
    while i < steps.len() {
        alphas[i] = [steps[i]; 2];
        i += 1;
    }
    alphas
};

/// Least probability of either lobe. With the cosine lobe's share every direction has a density
/// that is bounded below by its cosine, and so every weight is bounded by f.
const MIN_SHARE: f32 = 0.1;

impl Lobes {
    /// Density (sr⁻¹) of `light` given `view`.
    #[must_use]
    pub fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        if is_lit(light, view) { self.pdf_lit(light, view) } else { 0.0 }
    }

    /// [`Lobes::pdf`] where both directions are known to be above the horizon.
    fn pdf_lit(&self, light: Vec3, view: Vec3) -> f32 {
        let diffuse = light.z * FRAC_1_PI;
        let specular = visible_normal_pdf(self.alpha, light, view);
        (1.0 - self.specular_weight) * diffuse + self.specular_weight * specular
    }

    /// Chooses a light direction; `None` where it falls below the horizon. Arguments as in
    /// [`SampleBrdf::sample`](crate::SampleBrdf::sample).
    #[must_use]
    pub fn sample_direction(&self, view: Vec3, u: Vec3) -> Option<Vec3> {
        if !is_lit(view, view) || !u.is_finite() {
            return None;
        }
        let light = if u.x < self.specular_weight {
            sample_visible_normal(self.alpha, view, u.y, u.z)
        } else {
            sample_cosine(u.y, u.z)
        };
        is_lit(light, view).then_some(light)
    }

    /// The lobes that sample `brdf` with least variance, among the roughnesses `alphas` and a grid of
    /// mixture weights.
    ///
    /// The second moment of the weight, ∫ (f cosθ)²/pdf, is estimated for every candidate from the
    /// same quasi-random directions, over views from the normal to grazing and summed relative to
    /// each view's albedo. Deterministic; around two and a half thousand evaluations of `brdf`.
    #[must_use]
    pub fn fit(brdf: &impl Brdf, alphas: &[[f32; 2]]) -> Lobes {
        let candidates: Vec<(usize, Lobes)> = (0..alphas.len())
            .flat_map(|index| (0..=WEIGHT_STEPS).map(move |step| (index, step)))
            .map(|(index, step)| {
                let t = step as f32 / WEIGHT_STEPS as f32;
                let specular_weight = MIN_SHARE + (1.0 - 2.0 * MIN_SHARE) * t;
                (index, Lobes { alpha: alphas[index], specular_weight })
            })
            .collect();
        let mut moments = vec![0.0; candidates.len()];
        // View by view: the probes of one are tens of kilobytes, and whoever opens a library holds them.
        for cos_view in PROBE_VIEWS {
            let probes = probe_view(brdf, cos_view, alphas);
            for (moment, (index, lobes)) in moments.iter_mut().zip(&candidates) {
                *moment += lobes.relative_moment(&probes, *index);
            }
        }
        let mut best = Lobes { alpha: alphas[0], specular_weight: 0.5 };
        let mut least = f64::INFINITY;
        for (&moment, &(_, lobes)) in moments.iter().zip(&candidates) {
            if moment < least {
                (best, least) = (lobes, moment);
            }
        }
        best
    }

    /// Estimate of ∫ (f cosθ)²/pdf over (∫ f cosθ)² from one view's probes; `candidate` is the index
    /// of this roughness among their densities.
    fn relative_moment(&self, probes: &[Probe], candidate: usize) -> f64 {
        let (mut moment, mut albedo) = (0.0, 0.0);
        for probe in probes {
            let pdf = (1.0 - self.specular_weight) * probe.diffuse
                + self.specular_weight * probe.specular[candidate];
            let response = f64::from(probe.response);
            moment += response * response / f64::from(pdf * probe.pdf);
            albedo += f64::from(probe.response / probe.pdf);
        }
        if albedo > 0.0 { moment * probes.len() as f64 / (albedo * albedo) } else { 0.0 }
    }
}

/// Cosines of the views at which [`Lobes::fit`] looks.
const PROBE_VIEWS: [f32; 5] = [0.98, 0.85, 0.65, 0.4, 0.15];
/// Directions per view.
const PROBES: usize = 512;
/// Steps of the grid of mixture weights.
const WEIGHT_STEPS: usize = 16;

/// One direction at which a BRDF was evaluated for [`Lobes::fit`].
struct Probe {
    /// Mean over the channels of f cosθ.
    response: f32,
    /// Density with which the direction was chosen.
    pdf: f32,
    /// Density of the cosine lobe there.
    diffuse: f32,
    /// Density of the GGX lobe there, for each roughness.
    specular: Vec<f32>,
}

/// Evaluates `brdf` at directions drawn from the cosine lobe and every GGX lobe in equal shares.
fn probe_view(brdf: &impl Brdf, cos_view: f32, alphas: &[[f32; 2]]) -> Vec<Probe> {
    // An azimuth off the axes, so that an anisotropic material is seen between them.
    let sin_view = (1.0 - cos_view * cos_view).sqrt();
    let view = Vec3::new(sin_view * 0.8, sin_view * 0.6, cos_view);
    (0..PROBES)
        .filter_map(|i| {
            // Points of the R2 sequence (Roberts 2018), dealt to the lobes in turn.
            let [u1, u2] = [0.754_877_7, 0.569_840_3].map(|step: f32| (0.5 + i as f32 * step).fract());
            let light = match i % (alphas.len() + 1) {
                0 => sample_cosine(u1, u2),
                turn => sample_visible_normal(alphas[turn - 1], view, u1, u2),
            };
            if !is_lit(light, view) {
                return None;
            }
            let response = brdf.eval(light, view).element_sum() / 3.0 * light.z;
            let diffuse = light.z * FRAC_1_PI;
            let specular: Vec<f32> =
                alphas.iter().map(|&alpha| visible_normal_pdf(alpha, light, view)).collect();
            let pdf = (diffuse + specular.iter().sum::<f32>()) / (alphas.len() + 1) as f32;
            Some(Probe { response, pdf, diffuse, specular })
        })
        .collect()
}

/// Cosine-distributed direction, by the polar map.
pub(crate) fn sample_cosine(u1: f32, u2: f32) -> Vec3 {
    let (r, phi) = (u1.sqrt(), TAU * u2);
    Vec3::new(r * phi.cos(), r * phi.sin(), (1.0 - u1).max(0.0).sqrt())
}

/// Light reflected by a visible normal of the GGX distribution.
///
/// Sampling by spherical caps, Dupuy & Benyoub 2023, *Sampling Visible GGX Normals with Spherical
/// Caps*, algorithm 3.
pub(crate) fn sample_visible_normal(alpha: [f32; 2], view: Vec3, u1: f32, u2: f32) -> Vec3 {
    let stretch = Vec3::new(alpha[0], alpha[1], 1.0);
    let standard_view = (view * stretch).normalize();
    // The cap's z is uniform on [−v_z, 1]. Only z + v_z and 1 − z² are needed, and written as here
    // they have no difference that cancels: at grazing views, or near either end of the range.
    let (x, y) = (standard_view.x, standard_view.y);
    let above = 1.0 + standard_view.z;
    let height = (1.0 - u2) * above;
    let r = (u2 * (x * x + y * y + above * height)).max(0.0).sqrt();
    let phi = TAU * u1;
    let sum = Vec3::new(r * phi.cos() + x, r * phi.sin() + y, height);
    let half = (sum * stretch).normalize();
    2.0 * view.dot(half) * half - view
}

/// Density of [`sample_visible_normal`]: D_v(h)/(4 cosθ_d) = G₁(v) D(h) / (4 cosθ_v).
pub(crate) fn visible_normal_pdf(alpha: [f32; 2], light: Vec3, view: Vec3) -> f32 {
    let view: [f32; 3] = view.into();
    0.5 * Half::new(light.into(), view).ndf(alpha) / masking_denominator(view, alpha)
}

/// The same sampler in float64, written as the papers print it. What tests compare against.
pub mod reference {
    use super::Lobes;
    use crate::microfacet::reference::{g1, ndf};
    use glam::{DVec2, DVec3};
    use std::f64::consts::{PI, TAU};

    /// Density of `light`, both directions above the horizon.
    #[must_use]
    pub fn pdf(lobes: &Lobes, light: DVec3, view: DVec3) -> f64 {
        let (alpha, share) = (lobes.alpha.map(f64::from), f64::from(lobes.specular_weight));
        let half = (light + view).normalize();
        let specular = g1(view.into(), alpha) * ndf(half.into(), alpha) / (4.0 * view.z);
        (1.0 - share) * light.z / PI + share * specular
    }

    /// The direction that [`Lobes::sample_direction`] chooses, also where it is below the horizon.
    #[must_use]
    pub fn sample_direction(lobes: &Lobes, view: DVec3, u: DVec3) -> DVec3 {
        let phi = TAU * if u.x < f64::from(lobes.specular_weight) { u.y } else { u.z };
        let around = DVec2::from_angle(phi);
        if u.x >= f64::from(lobes.specular_weight) {
            return (u.y.sqrt() * around).extend((1.0 - u.y).sqrt());
        }
        let stretch = DVec2::from_array(lobes.alpha.map(f64::from)).extend(1.0);
        let standard_view = (view * stretch).normalize();
        let z = (1.0 - u.z) * (1.0 + standard_view.z) - standard_view.z;
        let cap = ((1.0 - z * z).sqrt() * around).extend(z);
        let half = ((cap + standard_view) * stretch).normalize();
        2.0 * view.dot(half) * half - view
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brdf::Sample;
    use crate::microfacet::Microfacet;
    use crate::sampler::Sampler;

    struct Lambert;

    impl Brdf for Lambert {
        fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
            if is_lit(light, view) { Vec3::splat(FRAC_1_PI) } else { Vec3::ZERO }
        }
    }

    struct Lobe(Microfacet);

    impl Brdf for Lobe {
        fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
            if is_lit(light, view) { self.0.eval(light.into(), view.into()).into() } else { Vec3::ZERO }
        }
    }

    fn view(cos: f32) -> Vec3 {
        Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos)
    }

    /// ∫ pdf over the hemisphere plus the share of failed samples is 1.
    #[test]
    fn density_and_failures_add_up_to_one() {
        for (alpha, cos) in [([0.2, 0.2], 0.9), ([0.5, 0.3], 0.5), ([0.4, 0.4], 0.2), ([1.0, 1.0], 0.7)] {
            let lobes = Lobes { alpha, specular_weight: 0.7 };
            let (n_theta, n_phi) = (800, 1600);
            let mut integral = 0.0;
            for i in 0..n_theta {
                let theta = (i as f64 + 0.5) / n_theta as f64 * std::f64::consts::FRAC_PI_2;
                for j in 0..n_phi {
                    let phi = (j as f64 + 0.5) / n_phi as f64 * std::f64::consts::TAU;
                    let light =
                        glam::DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
                    integral += f64::from(lobes.pdf(light.as_vec3(), view(cos))) * theta.sin();
                }
            }
            integral *= std::f64::consts::FRAC_PI_2 / n_theta as f64 * std::f64::consts::TAU / n_phi as f64;

            let n = 200_000;
            let failed = (0..n)
                .filter(|&i| {
                    let u = Vec3::new(
                        (i as f32 * 0.819_172_5).fract(),
                        (i as f32 * 0.671_043_6).fract(),
                        (i as f32 * 0.549_700_5).fract(),
                    );
                    lobes.sample_direction(view(cos), u).is_none()
                })
                .count();
            let total = integral + failed as f64 / f64::from(n);
            assert!((total - 1.0).abs() < 4e-3, "α {alpha:?}, cos {cos}: {total}");
        }
    }

    /// A histogram of samples in (cosθ, φ) against the density integrated over the same cells.
    #[test]
    fn samples_follow_the_density() {
        let lobes = Lobes { alpha: [0.3, 0.6], specular_weight: 0.6 };
        let view = Vec3::new(0.48, 0.36, 0.8);
        let (n_cos, n_phi, fine, n) = (8, 16, 16, 400_000);
        let mut counts = vec![0.0; n_cos * n_phi];
        for i in 0..n {
            let i = i as f64;
            let u = glam::DVec3::new(
                (i * 0.819_172_513).fract(),
                (i * 0.671_043_607).fract(),
                (i * 0.549_700_478).fract(),
            );
            if let Some(light) = lobes.sample_direction(view, u.as_vec3()) {
                let phi = light.y.atan2(light.x).rem_euclid(TAU) / TAU;
                let cell = ((light.z * n_cos as f32) as usize).min(n_cos - 1) * n_phi
                    + ((phi * n_phi as f32) as usize).min(n_phi - 1);
                counts[cell] += 1.0 / n as f64;
            }
        }
        for (cell, &count) in counts.iter().enumerate() {
            let mut expected = 0.0;
            for i in 0..fine * fine {
                let z = ((cell / n_phi) as f32 + ((i / fine) as f32 + 0.5) / fine as f32) / n_cos as f32;
                let phi =
                    ((cell % n_phi) as f32 + ((i % fine) as f32 + 0.5) / fine as f32) / n_phi as f32 * TAU;
                let r = (1.0 - z * z).sqrt();
                expected += f64::from(lobes.pdf(Vec3::new(r * phi.cos(), r * phi.sin(), z), view));
            }
            expected *= f64::from(TAU) / (n_cos * n_phi * fine * fine) as f64;
            // Five standard deviations of a binomial count; the quasi-random points do better.
            let tolerance = 5.0 * (expected / f64::from(n)).sqrt() + 1e-4;
            assert!((count - expected).abs() < tolerance, "cell {cell}: {count} against {expected}");
        }
    }

    #[test]
    fn weight_is_f_cos_over_pdf() {
        let brdf = Lobe(Microfacet { kd: [0.2, 0.3, 0.4], eta: [1.5; 3], alpha: [0.2, 0.4] });
        let lobes = Lobes { alpha: [0.2, 0.4], specular_weight: 0.4 };
        for i in 0..1000 {
            let u = Vec3::new(
                (i as f32 * 0.819).fract(),
                (i as f32 * 0.671).fract(),
                (i as f32 * 0.5497).fract(),
            );
            let sample = Sampler::from(lobes).sample(&brdf, view(0.6), u);
            if sample.pdf > 0.0 {
                let expected =
                    brdf.eval(sample.light, view(0.6)) * sample.light.z / lobes.pdf(sample.light, view(0.6));
                assert!((sample.weight - expected).abs().max_element() <= 1e-6 * expected.max_element());
                assert!((sample.light.length() - 1.0).abs() < 1e-5);
            } else {
                assert_eq!(sample, Sample::FAILED);
            }
        }
    }

    #[test]
    fn fit_finds_the_lobe_of_the_material() {
        let alphas = [0.02, 0.05, 0.1, 0.2, 0.4].map(|a| [a; 2]);
        assert_eq!(Lobes::fit(&Lambert, &alphas).specular_weight, MIN_SHARE);
        let mirror = Lobe(Microfacet { kd: [0.0; 3], eta: [3.0; 3], alpha: [0.05; 2] });
        let fitted = Lobes::fit(&mirror, &alphas);
        assert_eq!(fitted.alpha, [0.05; 2]);
        assert!(fitted.specular_weight > 0.8);
    }

    #[test]
    fn directions_that_carry_nothing_have_no_density() {
        let lobes = Lobes { alpha: [0.3; 2], specular_weight: 0.5 };
        let down = Vec3::new(0.6, 0.0, -0.8);
        assert_eq!(lobes.pdf(down, Vec3::Z), 0.0);
        assert_eq!(lobes.pdf(Vec3::Z, down), 0.0);
        assert_eq!(lobes.pdf(Vec3::new(f32::NAN, 0.0, 1.0), Vec3::Z), 0.0);
        assert_eq!(Sampler::from(lobes).sample(&Lambert, down, Vec3::splat(0.5)), Sample::FAILED);
        assert_eq!(
            Sampler::from(lobes).sample(&Lambert, Vec3::splat(f32::NAN), Vec3::splat(0.5)),
            Sample::FAILED
        );
    }
}

//! Smith's masking of a tabulated distribution of normals, as `factor` derives G from D.
//!
//! Bagher et al. 2016, *A Non-Parametric Factor Microfacet Model*, §4.3: G(θ) = 1/(1 + Λ(cot θ)) with
//!
//! Λ(μ) = 1/μ ∫_{atan μ}^{π/2} (tan ω − μ)(1 + tan²ω) p₂(tan ω) dω,
//! p₂(r) = 2 ∫_0^{π/2} p₂₂(r² + tan²ψ)(1 + tan²ψ) dψ,
//! p₂₂(u) = D̃(atan √u) cos⁴(atan √u), where D̃ = D / (2π ∫ D cosθ sinθ dθ).
//!
//! Λ is linear in D: what does not depend on the material is one matrix, which is made once.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::LazyLock;

use super::bins::{HALF_BINS, MASKING_KNOTS};

/// Points of each Gauss–Legendre rule. The paper takes 15 over the angles themselves, too few for lobes
/// of a degree; these stand at the squares of their positions, as dense near 0 as the bins of D.
const POINTS: usize = 64;

/// G at whole degrees from D over the bins of √θ_h. Where D vanishes altogether, G = 1.
#[must_use]
pub fn masking(ndf: &[f32; HALF_BINS]) -> [f64; MASKING_KNOTS] {
    masking_of(&ndf.map(f64::from))
}

/// [`masking`] of float64.
#[must_use]
pub fn masking_of(ndf: &[f64; HALF_BINS]) -> [f64; MASKING_KNOTS] {
    static SMITH: LazyLock<Smith> = LazyLock::new(|| Smith::new(&squares(&legendre(POINTS))));
    SMITH.masking(ndf)
}

/// ∫ D̃ and Λ as linear functions of D's bins.
struct Smith {
    /// 2π ∫ D cosθ sinθ dθ.
    norm: [f64; HALF_BINS],
    /// Λ at whole degrees, before D is normalised.
    lambda: [[f64; HALF_BINS]; MASKING_KNOTS],
}

/// Positions in [0, 1] and weights that sum to 1.
type Rule = Vec<(f64, f64)>;

impl Smith {
    fn new(rule: &Rule) -> Smith {
        let over =
            |from: f64, to: f64| rule.iter().map(move |&(x, w)| (from + (to - from) * x, w * (to - from)));
        let mut norm = [0.0; HALF_BINS];
        for (theta, w) in over(0.0, FRAC_PI_2) {
            add(&mut norm, theta, w * 2.0 * PI * theta.cos() * theta.sin());
        }
        let mut lambda = [[0.0; HALF_BINS]; MASKING_KNOTS];
        // At 0° Λ vanishes.
        for (degree, row) in lambda.iter_mut().enumerate().skip(1) {
            let mu = 1.0 / (degree as f64).to_radians().tan();
            for (omega, w_omega) in over(mu.atan(), FRAC_PI_2) {
                let r = omega.tan();
                let outer = w_omega * (r - mu) * (1.0 + r * r) / mu;
                for (psi, w_psi) in over(0.0, FRAC_PI_2) {
                    let q = psi.tan();
                    // cos(atan √u) = 1/√(1 + u).
                    let u = r * r + q * q;
                    let inner = 2.0 * w_psi * (1.0 + q * q) / (1.0 + u).powi(2);
                    add(row, u.sqrt().atan(), outer * inner);
                }
            }
        }
        Smith { norm, lambda }
    }

    fn masking(&self, ndf: &[f64; HALF_BINS]) -> [f64; MASKING_KNOTS] {
        let dot = |row: &[f64; HALF_BINS]| row.iter().zip(ndf).map(|(a, b)| a * b).sum::<f64>();
        let norm = dot(&self.norm);
        std::array::from_fn(|i| if norm > 0.0 { 1.0 / (1.0 + dot(&self.lambda[i]) / norm) } else { 1.0 })
    }
}

/// Adds `weight` times D(θ), which is linear in √θ between the centres of the bins.
fn add(row: &mut [f64; HALF_BINS], theta: f64, weight: f64) {
    let last = (HALF_BINS - 1) as f64;
    let position = ((theta / FRAC_PI_2).sqrt() * HALF_BINS as f64 - 0.5).clamp(0.0, last);
    let low = (position as usize).min(HALF_BINS - 2);
    let t = position - low as f64;
    row[low] += weight * (1.0 - t);
    row[low + 1] += weight * t;
}

/// The Gauss–Legendre rule on [0, 1]; Newton's iteration from Tricomi's estimate of the roots.
fn legendre(points: usize) -> Rule {
    let n = points as f64;
    (0..points)
        .map(|i| {
            let mut x = (PI * (i as f64 + 0.75) / (n + 0.5)).cos();
            let mut slope = 1.0;
            for _ in 0..8 {
                let (mut p, mut before) = (x, 1.0);
                for k in 2..=points {
                    let k = k as f64;
                    (p, before) = (((2.0 * k - 1.0) * x * p - (k - 1.0) * before) / k, p);
                }
                slope = n * (x * p - before) / (x * x - 1.0);
                x -= p / slope;
            }
            (0.5 * (1.0 - x), 1.0 / ((1.0 - x * x) * slope * slope))
        })
        .collect()
}

/// The rule with x = s² put in.
fn squares(rule: &Rule) -> Rule {
    rule.iter().map(|&(s, w)| (s * s, 2.0 * s * w)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(d: impl Fn(f64) -> f64) -> [f64; HALF_BINS] {
        std::array::from_fn(|i| d(((i as f64 + 0.5) / HALF_BINS as f64).powi(2) * FRAC_PI_2))
    }

    /// GGX without its factor, which cancels (Walter et al. 2007, eq. 33).
    fn ggx(alpha: f64) -> [f64; HALF_BINS] {
        table(|theta| (theta.cos().powi(2) * (alpha * alpha - 1.0) + 1.0).powi(-2))
    }

    #[test]
    fn of_a_tabulated_ggx_it_is_that_of_walter_et_al() {
        for alpha in [0.02, 0.1, 0.3, 0.7] {
            let g = masking_of(&ggx(alpha));
            for (degree, g) in g.iter().enumerate() {
                let tan = (degree as f64).to_radians().tan();
                let truth = 2.0 / (1.0 + (1.0 + (alpha * tan).powi(2)).sqrt());
                assert!((g - truth).abs() < 6e-3, "α {alpha}, {degree}°: {g} against {truth}");
            }
        }
    }

    #[test]
    fn fifteen_points_over_the_angles_are_enough_for_one_lobe_but_lose_a_peak_over_haze() {
        let paper = Smith::new(&legendre(15));
        let error = |ndf: &[f64; HALF_BINS]| {
            paper
                .masking(ndf)
                .iter()
                .zip(masking_of(ndf))
                .map(|(g, exact)| (g - exact).abs())
                .fold(0.0, f64::max)
        };
        for alpha in [0.005, 0.01, 0.02, 0.05, 0.1, 0.3, 1.0] {
            assert!(error(&ggx(alpha)) < 0.02, "α {alpha}: {}", error(&ggx(alpha)));
        }
        let haze = ggx(0.5);
        let chrome = table(|theta| (-(theta / 0.003).powi(2)).exp());
        let both = std::array::from_fn(|i| chrome[i] + 1e-5 * haze[i]);
        assert!(error(&both) > 0.05, "{}", error(&both));
    }

    #[test]
    fn it_falls_from_one_and_survives_an_empty_table() {
        let g = masking_of(&ggx(0.4));
        assert_eq!(g[0], 1.0);
        assert!(g.windows(2).all(|pair| pair[1] <= pair[0] + 1e-12 && pair[1] > 0.0));
        assert_eq!(masking_of(&[0.0; HALF_BINS]), [1.0; MASKING_KNOTS]);
    }

    #[test]
    fn rule_integrates_polynomials() {
        let integral: f64 = legendre(5).iter().map(|(x, w)| w * x.powi(9)).sum();
        assert!((integral - 0.1).abs() < 1e-14);
    }
}

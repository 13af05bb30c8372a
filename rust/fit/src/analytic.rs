//! The analytic BRDF in training: its parameters without bounds, and its derivatives.
//!
//! k_d, η and α have ranges; the optimiser works on numbers that have none. A logistic curve maps
//! them, so that α, whose scale spans orders of magnitude, moves by ratios where it is small.

use glimt_core::microfacet::{ETA_RANGE, Half, MIN_ALPHA, Microfacet};
use std::f32::consts::FRAC_1_PI;

/// Numbers of the analytic BRDF: k_d (3), η (3), α (1 or 2), in this order.
#[must_use]
pub fn len(isotropic: bool) -> usize {
    if isotropic { 7 } else { 8 }
}

/// The ranges of the numbers in their order.
fn range(index: usize) -> [f32; 2] {
    match index {
        0..3 => [0.0, 1.0],
        3..6 => ETA_RANGE,
        _ => [MIN_ALPHA, 1.0],
    }
}

/// The parameters that unbounded numbers stand for. One α is used for both axes.
#[must_use]
pub fn to_parameters(numbers: &[f32]) -> Microfacet {
    let value = |i: usize| {
        let [low, high] = range(i);
        // Rounding may carry a value over the end of its range by one unit.
        (low + (high - low) * logistic(numbers[i])).clamp(low, high)
    };
    Microfacet {
        kd: [value(0), value(1), value(2)],
        eta: [value(3), value(4), value(5)],
        alpha: [value(6), value(numbers.len() - 1)],
    }
}

/// The unbounded numbers of parameters; those at the end of their range go a little inside, where
/// the optimiser can move them.
#[must_use]
pub fn from_parameters(parameters: &Microfacet, isotropic: bool) -> Vec<f32> {
    const INSIDE: f32 = 1e-4;
    let values = [&parameters.kd[..], &parameters.eta, &parameters.alpha].concat();
    (0..len(isotropic))
        .map(|i| {
            let [low, high] = range(i);
            let x = ((values[i] - low) / (high - low)).clamp(INSIDE, 1.0 - INSIDE);
            (x / (1.0 - x)).ln()
        })
        .collect()
}

/// Derivatives of the parameters with respect to their unbounded numbers.
fn slopes(numbers: &[f32]) -> Vec<f32> {
    numbers
        .iter()
        .enumerate()
        .map(|(i, &x)| {
            let [low, high] = range(i);
            (high - low) * logistic(x) * logistic(-x)
        })
        .collect()
}

fn logistic(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// Adds to `gradient` what sums of [`Derivatives`] mean for the unbounded numbers.
pub fn add_gradient(numbers: &[f32], sums: &[f64; 8], gradient: &mut [f32]) {
    let isotropic = numbers.len() == 7;
    for (i, (gradient, slope)) in gradient.iter_mut().zip(slopes(numbers)).enumerate() {
        let sum = if isotropic && i == 6 { sums[6] + sums[7] } else { sums[i] };
        *gradient += (sum * f64::from(slope)) as f32;
    }
}

/// f_a of one pair, and what its derivatives are made of.
#[derive(Clone, Copy, Debug)]
pub struct Derivatives {
    /// f_a per channel.
    pub value: [f32; 3],
    /// ∂f_a/∂η per channel.
    pub eta: [f32; 3],
    /// ∂ ln(specular part)/∂α_x and ∂α_y, the same for every channel.
    pub log_alpha: [f32; 2],
    /// The specular part of f_a per channel.
    pub specular: [f32; 3],
}

impl Derivatives {
    /// Of `p` at one pair above the horizon.
    #[inline(always)]
    #[must_use]
    pub fn new(p: &Microfacet, light: [f32; 3], view: [f32; 3]) -> Self {
        let half = Half::new(light, view);
        let (shape, cos_d) = (p.shape(&half, light, view), half.cos_d());
        let mut value = [0.0; 3];
        let mut eta = [0.0; 3];
        let mut specular = [0.0; 3];
        for c in 0..3 {
            let (fresnel, slope) = fresnel_and_slope(cos_d, p.eta[c]);
            specular[c] = fresnel * shape;
            value[c] = p.kd[c] * FRAC_1_PI + specular[c];
            eta[c] = slope * shape;
        }
        Derivatives { value, eta, log_alpha: log_alpha_slopes(p.alpha, light, view), specular }
    }

    /// Adds `delta` = ∂loss/∂f_a times ∂f_a/∂(k_d, η, α) to `sums`.
    #[inline(always)]
    pub fn accumulate(&self, delta: [f32; 3], sums: &mut [f32; 8]) {
        let mut specular = 0.0;
        for c in 0..3 {
            sums[c] += delta[c] * FRAC_1_PI;
            sums[3 + c] += delta[c] * self.eta[c];
            specular += delta[c] * self.specular[c];
        }
        sums[6] += specular * self.log_alpha[0];
        sums[7] += specular * self.log_alpha[1];
    }
}

/// ∂/∂α of ln D − ln(masking of light) − ln(masking of view), see [`Microfacet::shape`].
#[inline(always)]
fn log_alpha_slopes(alpha: [f32; 2], light: [f32; 3], view: [f32; 3]) -> [f32; 2] {
    let h = [light[0] + view[0], light[1] + view[1], light[2] + view[2]];
    let (sx, sy) = (h[0] / alpha[0], h[1] / alpha[1]);
    let spread = (sx * sx + sy * sy + h[2] * h[2]).max(f32::MIN_POSITIVE);
    let masking = |w: [f32; 3]| {
        let (x, y) = (w[0] * alpha[0], w[1] * alpha[1]);
        let root = (w[2] * w[2] + x * x + y * y).sqrt().max(f32::MIN_POSITIVE);
        let scale = 1.0 / (root * (w[2] + root));
        [alpha[0] * w[0] * w[0] * scale, alpha[1] * w[1] * w[1] * scale]
    };
    let (l, v) = (masking(light), masking(view));
    let ndf = [(4.0 * sx * sx / spread - 1.0) / alpha[0], (4.0 * sy * sy / spread - 1.0) / alpha[1]];
    [ndf[0] - l[0] - v[0], ndf[1] - l[1] - v[1]]
}

/// [`glimt_core::microfacet::fresnel`] and its derivative with respect to η.
#[inline(always)]
fn fresnel_and_slope(cos: f32, eta: f32) -> (f32, f32) {
    let excess = (eta - 1.0) * (eta + 1.0);
    let root = (excess + cos * cos).sqrt().max(f32::MIN_POSITIVE);
    let sum = root + cos;
    let difference = excess / sum;
    let ratio = difference / sum;
    let numerator = cos * sum - 1.0;
    let denominator = cos * difference + 1.0;
    let parallel = numerator / denominator;
    // Derivatives of sum, excess/sum, excess/sum² and the parallel quotient, in this order.
    let d_sum = eta / root;
    let d_difference = (2.0 * eta - difference * d_sum) / sum;
    let d_ratio = (d_difference - ratio * d_sum) / sum;
    let d_parallel = cos * (d_sum - parallel * d_difference) / denominator;
    let square = 1.0 + parallel * parallel;
    let value = 0.5 * ratio * ratio * square;
    (value, ratio * (d_ratio * square + ratio * parallel * d_parallel))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glimt_core::microfacet::reference;

    fn direction(i: usize) -> [f32; 3] {
        let (z, phi) = (0.05 + 0.95 * (i as f32 * 0.754_877_7).fract(), i as f32 * 2.399);
        let r = (1.0 - z * z).sqrt();
        [r * phi.cos(), r * phi.sin(), z]
    }

    #[test]
    fn derivatives_are_finite_differences_for_every_parameter() {
        for isotropic in [true, false] {
            let parameters = Microfacet { kd: [0.3, 0.6, 0.1], eta: [1.4, 2.5, 6.0], alpha: [0.2, 0.2] };
            let mut numbers = from_parameters(&parameters, isotropic);
            if !isotropic {
                numbers[7] += 0.8;
            }
            for i in 0..60 {
                let (light, view) = (direction(i), direction(5 * i + 2));
                // Σ of the channels with different signs, so that no channel hides another.
                let delta = [1.0, -0.7, 0.4];
                let value = |numbers: &[f32]| -> f64 {
                    let f =
                        reference::eval(&to_parameters(numbers), light.map(f64::from), view.map(f64::from));
                    f.iter().zip(delta).map(|(f, d)| f * f64::from(d)).sum()
                };
                let mut sums = [0.0; 8];
                Derivatives::new(&to_parameters(&numbers), light, view).accumulate(delta, &mut sums);
                let mut gradient = vec![0.0; numbers.len()];
                add_gradient(&numbers, &sums.map(f64::from), &mut gradient);
                for n in 0..numbers.len() {
                    // Steps that float32 parameters still resolve.
                    let step = 4e-3;
                    let (mut above, mut below) = (numbers.clone(), numbers.clone());
                    above[n] += step;
                    below[n] -= step;
                    let slope = (value(&above) - value(&below)) / (2.0 * f64::from(step));
                    let error = (f64::from(gradient[n]) - slope).abs();
                    let scale = value(&numbers).abs().max(slope.abs());
                    assert!(
                        error < 2e-3 * scale + 1e-5,
                        "number {n} of pair {i}: {} against {slope}",
                        gradient[n]
                    );
                }
            }
        }
    }

    #[test]
    fn parameters_survive_the_way_there_and_back() {
        let parameters = Microfacet { kd: [0.0, 0.5, 1.0], eta: [1.0, 1.5, 10.0], alpha: [0.02, 0.9] };
        let back = to_parameters(&from_parameters(&parameters, false));
        let values = |p: &Microfacet| [&p.kd[..], &p.eta, &p.alpha].concat();
        for (a, b) in values(&parameters).iter().zip(values(&back)) {
            assert!((a - b).abs() <= 1e-3, "{a} {b}");
        }
        assert!(back.validate().is_ok());
        assert!(
            to_parameters(&[-90.0; 8]).validate().is_ok() && to_parameters(&[90.0; 8]).validate().is_ok()
        );
    }
}

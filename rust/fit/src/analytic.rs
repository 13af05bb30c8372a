//! The analytic BRDF in training: its parameters without bounds, and its derivatives.
//!
//! k_d, η and α have ranges; the optimiser works on numbers that have none. A logistic curve maps
//! them, so that α, whose scale spans orders of magnitude, moves by ratios where it is small.

use glimt_core::microfacet::{ETA_RANGE, Half, MIN_ALPHA, Microfacet, Roughness};
use glimt_core::simd::Real;
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

/// f_a of pairs in any number of lanes, and what its derivatives are made of.
#[derive(Clone, Copy, Debug)]
pub struct Derivatives<F> {
    /// f_a per channel.
    pub value: [F; 3],
    /// ∂f_a/∂η per channel.
    pub eta: [F; 3],
    /// ∂ ln(specular part)/∂α_x and ∂α_y, the same for every channel.
    pub log_alpha: [F; 2],
    /// The specular part of f_a per channel.
    pub specular: [F; 3],
}

impl<F: Real> Derivatives<F> {
    /// Of `p` at pairs above the horizon.
    #[inline(always)]
    #[must_use]
    pub fn new(p: &Microfacet, light: [F; 3], view: [F; 3]) -> Self {
        let half = Half::new(light, view);
        let roughness = Roughness::new(p.alpha);
        let (shape, cos_d) = (roughness.shape(&half, light, view), half.cos_d());
        let mut value = [shape; 3];
        let mut eta = [shape; 3];
        let mut specular = [shape; 3];
        for c in 0..3 {
            let (fresnel, slope) = fresnel_and_slope(cos_d, p.eta[c]);
            specular[c] = fresnel * shape;
            value[c] = specular[c] + p.kd[c] * FRAC_1_PI;
            eta[c] = slope * shape;
        }
        Derivatives { value, eta, log_alpha: log_alpha_slopes(&half, p.alpha, light, view), specular }
    }

    /// Adds `delta` = ∂loss/∂f_a times ∂f_a/∂(k_d, η, α) to `sums`.
    #[inline(always)]
    pub fn accumulate(&self, delta: [F; 3], sums: &mut [F; 8]) {
        let mut specular = delta[0] * self.specular[0];
        for c in 0..3 {
            sums[c] = sums[c] + delta[c] * FRAC_1_PI;
            sums[3 + c] = delta[c].fma(self.eta[c], sums[3 + c]);
            if c > 0 {
                specular = delta[c].fma(self.specular[c], specular);
            }
        }
        sums[6] = specular.fma(self.log_alpha[0], sums[6]);
        sums[7] = specular.fma(self.log_alpha[1], sums[7]);
    }
}

/// ∂/∂α of ln D − ln(masking of light) − ln(masking of view), see [`Roughness::shape`].
#[inline(always)]
fn log_alpha_slopes<F: Real>(half: &Half<F>, alpha: [f32; 2], light: [F; 3], view: [F; 3]) -> [F; 2] {
    let spread = half.slope(&Roughness::new(alpha)) + half.height;
    let scale = spread.splat(4.0) / spread.max(spread.splat(f32::MIN_POSITIVE));
    let (l, v) = (log_masking_slopes(light, alpha), log_masking_slopes(view, alpha));
    let mut slopes = l;
    for axis in 0..2 {
        let inverse = 1.0 / alpha[axis];
        let ndf = (half.tangential[axis] * (inverse * inverse) * scale - 1.0) * inverse;
        slopes[axis] = ndf - l[axis] - v[axis];
    }
    slopes
}

#[inline(always)]
fn log_masking_slopes<F: Real>(direction: [F; 3], alpha: [f32; 2]) -> [F; 2] {
    let [x, y, z] = direction;
    let (stretched_x, stretched_y) = (x * alpha[0], y * alpha[1]);
    let square = z * z + stretched_x * stretched_x + stretched_y * stretched_y;
    let root = square.sqrt().max(z.splat(f32::MIN_POSITIVE));
    let scale = (root * (z + root)).reciprocal();
    [x * stretched_x * scale, y * stretched_y * scale]
}

/// [`glimt_core::microfacet::fresnel`] and its derivative with respect to η.
#[inline(always)]
fn fresnel_and_slope<F: Real>(cos: F, eta: f32) -> (F, F) {
    let excess = (eta - 1.0) * (eta + 1.0);
    let root = (cos * cos + excess).sqrt().max(cos.splat(f32::MIN_POSITIVE));
    let inverse_sum = (root + cos).reciprocal();
    let difference = inverse_sum * excess;
    let ratio = difference * inverse_sum;
    let numerator = cos * (root + cos) - 1.0;
    let inverse_denominator = (cos * difference + 1.0).reciprocal();
    let parallel = numerator * inverse_denominator;
    // Derivatives of sum, excess/sum, excess/sum² and the parallel quotient, in this order.
    let d_sum = cos.splat(eta) / root;
    let d_difference = (cos.splat(2.0 * eta) - difference * d_sum) * inverse_sum;
    let d_ratio = (d_difference - ratio * d_sum) * inverse_sum;
    let d_parallel = cos * (d_sum - parallel * d_difference) * inverse_denominator;
    let square = parallel * parallel + 1.0;
    let value = ratio * ratio * square * 0.5;
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

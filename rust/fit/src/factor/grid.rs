//! The grid of the MERL database: where its samples lie, what they weigh, and a material resampled to it.

use std::f32::consts::LN_2;
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::LazyLock;

use glam::{DVec3, Vec3};
use glimt_core::models::factor::{AZIMUTH_BINS, DIFF_BINS, HALF_BINS, MAX_THETA};
use glimt_core::simd::math::{exp, ln};
use glimt_core::{Brdf, dispatch};
use rayon::prelude::*;

/// Samples with the same θ_h and θ_d.
pub const ROWS: usize = HALF_BINS * DIFF_BINS;
/// Samples of one colour channel.
pub const SAMPLES: usize = ROWS * AZIMUTH_BINS;

/// The power p of the compressive weight (the paper, §4.1).
const COMPRESSION: f32 = 1.4;

/// θ_h at the centre of a bin; the bins divide √θ_h evenly.
#[must_use]
pub fn theta_half(bin: usize) -> f64 {
    ((bin as f64 + 0.5) / HALF_BINS as f64).powi(2) * FRAC_PI_2
}

/// θ_d at the centre of a bin.
#[must_use]
pub fn theta_diff(bin: usize) -> f64 {
    (bin as f64 + 0.5) / DIFF_BINS as f64 * FRAC_PI_2
}

/// φ_d at the centre of a bin.
#[must_use]
pub fn phi_diff(bin: usize) -> f64 {
    (bin as f64 + 0.5) / AZIMUTH_BINS as f64 * PI
}

/// cosθ_light and cosθ_view (eq. 1 and 2, with the light farther from the normal at φ_d = 0, as the
/// database has it; both orders are one sample).
#[must_use]
pub fn cosines(half: usize, diff: usize, azimuth: usize) -> [f64; 2] {
    let [half, diff, azimuth] = [HALVES[half], DIFFS[diff], AZIMUTHS[azimuth]];
    let (even, odd) = (half.cos * diff.cos, half.sin * diff.sin * azimuth.cos);
    [even - odd, even + odd]
}

/// Sine and cosine of an angle.
#[derive(Clone, Copy)]
struct Turn {
    sin: f64,
    cos: f64,
}

fn turns(bins: usize, angle: impl Fn(usize) -> f64) -> Vec<Turn> {
    (0..bins).map(|bin| angle(bin).sin_cos()).map(|(sin, cos)| Turn { sin, cos }).collect()
}

static HALVES: LazyLock<Vec<Turn>> = LazyLock::new(|| turns(HALF_BINS, theta_half));
static DIFFS: LazyLock<Vec<Turn>> = LazyLock::new(|| turns(DIFF_BINS, theta_diff));
static AZIMUTHS: LazyLock<Vec<Turn>> = LazyLock::new(|| turns(AZIMUTH_BINS, phi_diff));

/// Samples beyond 89° on either side are left out.
#[must_use]
pub fn is_included(cosines: [f64; 2]) -> bool {
    let least = f64::from(MAX_THETA).cos();
    cosines.iter().all(|&cos| cos >= least)
}

/// w_V w_I of every sample, φ_d fastest; 0 where a sample is left out (eq. 9 and 10).
pub static GEOMETRIC_WEIGHTS: LazyLock<Vec<f32>> = LazyLock::new(|| {
    (0..SAMPLES)
        .map(|sample| {
            let (half, diff, azimuth) = coordinates(sample);
            let cosines = cosines(half, diff, azimuth);
            if !is_included(cosines) {
                return 0.0;
            }
            let Turn { sin, cos } = DIFFS[diff];
            let volume = (8.0 * sin.powi(2) * (cos.powi(2) + (sin * AZIMUTHS[azimuth].cos).powi(2))).sqrt();
            // dθ_h = 2 √θ_h d√θ_h.
            (2.0 * theta_half(half).sqrt() * volume * cosines[0] * cosines[1]) as f32
        })
        .collect()
});

fn coordinates(sample: usize) -> (usize, usize, usize) {
    (sample / AZIMUTH_BINS / DIFF_BINS, sample / AZIMUTH_BINS % DIFF_BINS, sample % AZIMUTH_BINS)
}

/// What a sample counts where the material has no data. Every bin of a factor needs something to go by, and where
/// no sample of it was measured, that is what lies around.
const HOLE_WEIGHT: f32 = 1e-3;

/// A material on the grid, φ_d fastest.
pub struct Resampled {
    /// f at the centre of every bin per colour channel: the mean of both orders of light and view, which are one
    /// sample here. 0 where a sample is left out; where f is not finite or negative, too.
    pub values: [Vec<f32>; 3],
    /// What every sample counts besides its weight: 1, and next to nothing where the material has no data.
    pub trust: Vec<f32>,
}

/// A material on the grid.
#[must_use]
pub fn resample(brdf: &dyn Brdf) -> Resampled {
    let slabs: Vec<Resampled> =
        (0..HALF_BINS).into_par_iter().map(|half| resample_slab(brdf, half)).collect();
    Resampled {
        values: std::array::from_fn(|c| slabs.iter().flat_map(|slab| &slab.values[c]).copied().collect()),
        trust: slabs.iter().flat_map(|slab| &slab.trust).copied().collect(),
    }
}

/// The samples of one θ_h: batches that are long enough for a `brdf` in another process.
fn resample_slab(brdf: &dyn Brdf, half: usize) -> Resampled {
    let places: Vec<(usize, usize)> = (0..DIFF_BINS)
        .flat_map(|diff| (0..AZIMUTH_BINS).map(move |azimuth| (diff, azimuth)))
        .filter(|&(diff, azimuth)| is_included(cosines(half, diff, azimuth)))
        .collect();
    let (light, view): (Vec<Vec3>, Vec<Vec3>) =
        places.iter().map(|&(diff, azimuth)| directions(half, diff, azimuth)).unzip();
    let mut f = [vec![Vec3::ZERO; light.len()], vec![Vec3::ZERO; light.len()]];
    brdf.eval_batch(&light, &view, &mut f[0]);
    brdf.eval_batch(&view, &light, &mut f[1]);
    let mut values = [0; 3].map(|_| vec![0.0; DIFF_BINS * AZIMUTH_BINS]);
    let mut trust = vec![1.0; DIFF_BINS * AZIMUTH_BINS];
    for (i, (diff, azimuth)) in places.into_iter().enumerate() {
        if !(brdf.has_data(light[i], view[i]) && brdf.has_data(view[i], light[i])) {
            trust[diff * AZIMUTH_BINS + azimuth] = HOLE_WEIGHT;
        }
        let mean = 0.5 * (f[0][i] + f[1][i]);
        for c in 0..3 {
            values[c][diff * AZIMUTH_BINS + azimuth] =
                if mean[c].is_finite() { mean[c].max(0.0) } else { 0.0 };
        }
    }
    Resampled { values, trust }
}

/// The pair (light, view) at the centres of these bins whose half vector has azimuth 0.
fn directions(half: usize, diff: usize, azimuth: usize) -> (Vec3, Vec3) {
    let [half, diff, azimuth] = [HALVES[half], DIFFS[diff], AZIMUTHS[azimuth]];
    let normal = DVec3::new(half.sin, 0.0, half.cos);
    let tangent = DVec3::new(half.cos, 0.0, -half.sin);
    let across = (DVec3::Y * azimuth.sin + tangent * azimuth.cos) * diff.sin;
    let along = normal * diff.cos;
    ((along + across).as_vec3(), (along - across).as_vec3())
}

/// w_V w_I w_C of every sample of one channel (eq. 8), times what it is trusted.
#[must_use]
pub fn weights(values: &[f32], trust: &[f32]) -> Vec<f32> {
    let mut weights: Vec<f32> =
        GEOMETRIC_WEIGHTS.iter().zip(trust).map(|(weight, trust)| weight * trust).collect();
    let median = weighted_median(values, &weights);
    compress(values, LN_2 / median, &mut weights);
    weights
}

dispatch! {
    /// Multiplies the weights by (f(x; ln 2)/x)^p with x = ρ*/ρ̄ (eq. 11 and 12); `scale` is ln 2/ρ̄.
    fn compress(_isa, values: &[f32], scale: f32, weights: &mut [f32]) {
        for (weight, value) in weights.iter_mut().zip(values) {
            let x = scale * value;
            // (1 − e⁻ˣ)/x, and the first terms of its series where the difference would cancel.
            let ratio = if x < 0.02 { 1.0 - x * (0.5 - x * (1.0 / 6.0)) } else { (1.0 - exp(-x)) / x };
            *weight *= exp(COMPRESSION * ln(ratio));
        }
    }
}

/// The value below and above which lies half of the weight. Where that is 0, the weighted mean, or 1 if all
/// is black: the compressive weight divides by it.
fn weighted_median(values: &[f32], weights: &[f32]) -> f32 {
    let mut samples: Vec<(f32, f32)> =
        values.iter().copied().zip(weights.iter().copied()).filter(|&(_, weight)| weight > 0.0).collect();
    let total: f64 = samples.iter().map(|&(_, weight)| f64::from(weight)).sum();
    // Quickselect by weight: the half that holds the median is searched on.
    let (mut below, mut rest) = (0.0, &mut samples[..]);
    while rest.len() > 1 {
        let middle = rest.len() / 2;
        let (low, _, _) = rest.select_nth_unstable_by(middle, |a, b| a.0.total_cmp(&b.0));
        let weight: f64 = low.iter().map(|&(_, weight)| f64::from(weight)).sum();
        if below + weight >= 0.5 * total {
            rest = &mut rest[..middle];
        } else {
            below += weight;
            rest = &mut rest[middle..];
            if middle == 0 {
                break;
            }
        }
    }
    let median = rest.first().map_or(0.0, |&(value, _)| value);
    if median > 0.0 {
        return median;
    }
    let sum: f64 =
        values.iter().zip(weights).map(|(&value, &weight)| f64::from(value) * f64::from(weight)).sum();
    if sum > 0.0 { (sum / total) as f32 } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glimt_core::models::factor::reference::position;

    #[test]
    fn directions_have_their_angles_and_cosines() {
        for sample in (0..SAMPLES).step_by(977) {
            let (half, diff, azimuth) = coordinates(sample);
            let (light, view) = directions(half, diff, azimuth);
            let [cos_light, cos_view] = cosines(half, diff, azimuth);
            assert!(
                (f64::from(light.z) - cos_light).abs() < 1e-6 && (f64::from(view.z) - cos_view).abs() < 1e-6
            );
            let found = position(light.as_dvec3().normalize(), view.as_dvec3().normalize());
            // Near the pole of half vectors float32 leaves little of the azimuth.
            for (found, (bin, tolerance)) in found.iter().zip([(half, 0.05), (diff, 1e-3), (azimuth, 0.2)]) {
                assert!((found - bin as f64 - 0.5).abs() < tolerance, "{sample}: {found} for {bin}");
            }
        }
    }

    #[test]
    fn median_halves_the_weight() {
        assert_eq!(weighted_median(&[5.0, 1.0, 3.0], &[1.0, 1.0, 1.0]), 3.0);
        assert_eq!(weighted_median(&[5.0, 1.0, 3.0], &[5.0, 1.0, 1.0]), 5.0);
        assert_eq!(weighted_median(&[5.0, 1.0, 3.0], &[0.0, 3.0, 1.0]), 1.0);
        assert_eq!(weighted_median(&[0.0, 0.0, 3.0], &[1.0; 3]), 1.0);
        assert_eq!(weighted_median(&[0.0; 3], &[1.0; 3]), 1.0);
        let values: Vec<f32> = (0..1001).map(|i| ((i * 619) % 1001) as f32 + 1.0).collect();
        assert_eq!(weighted_median(&values, &[0.5; 1001]), 501.0);
    }

    #[test]
    fn samples_without_data_count_next_to_nothing() {
        /// Known above the light's 60°.
        struct Upper;
        impl Brdf for Upper {
            fn eval(&self, _: Vec3, _: Vec3) -> Vec3 {
                Vec3::ONE
            }

            fn has_data(&self, light: Vec3, _: Vec3) -> bool {
                light.z > 0.5
            }
        }
        let Resampled { values: [red, ..], trust } = resample(&Upper);
        let weights = weights(&red, &trust);
        let full = super::weights(&red, &vec![1.0; SAMPLES]);
        for sample in (0..SAMPLES).step_by(331) {
            let (half, diff, azimuth) = coordinates(sample);
            let lowest = cosines(half, diff, azimuth).into_iter().fold(1.0, f64::min);
            if full[sample] > 0.0 && (lowest - 0.5).abs() > 1e-3 {
                let expected = if lowest > 0.5 { 1.0 } else { HOLE_WEIGHT };
                assert!((weights[sample] / full[sample] - expected).abs() < 1e-6, "{sample}");
            }
        }
    }

    #[test]
    fn weights_are_the_papers() {
        // θ_h = 0.0028°, θ_d = 0.5°, φ_d = 0.5°: nearly the normal.
        let (sin, cos) = 0.5f64.to_radians().sin_cos();
        let volume = (8.0 * sin * sin * (cos * cos + sin * sin * cos * cos)).sqrt();
        let expected = 2.0 * (theta_half(0)).sqrt() * volume * cos * cos;
        assert!((f64::from(GEOMETRIC_WEIGHTS[0]) / expected - 1.0).abs() < 1e-4);
        assert_eq!(GEOMETRIC_WEIGHTS[SAMPLES - 1], 0.0);
        // All samples at the median: f(1; ln 2) = 1/(2 ln 2).
        let weights = weights(&vec![0.3; SAMPLES], &vec![1.0; SAMPLES]);
        let expected = (0.5 / LN_2).powf(COMPRESSION);
        assert!((weights[0] / GEOMETRIC_WEIGHTS[0] - expected).abs() < 1e-6);
    }
}

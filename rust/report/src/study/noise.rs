//! How much noise a sampler leaves in an image: its variance against the number of samples.

use glam::Vec3;
use glimt_core::{Brdf, Material, SampleBrdf};
use glimt_image::Rgb;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::light::Light;
use super::sphere::Frame;

/// Numbers of samples for which the variance is measured.
pub const SAMPLE_COUNTS: [usize; 7] = [1, 2, 4, 8, 16, 32, 64];
/// Samples of a pixel in all; the most of [`SAMPLE_COUNTS`] makes four groups of them.
const SAMPLES: usize = 256;

/// A way to choose directions for a material.
#[derive(Clone, Copy, Debug)]
pub enum Chosen<'a> {
    /// By the cosine, whatever the material.
    Cosine,
    /// By the sampler of this material.
    By(&'a Material),
}

/// Variance of a pixel of a sphere in the studio, as a renderer would see it that samples the BRDF alone, for each
/// of [`SAMPLE_COUNTS`]: mean over the pixels and channels, relative to the squared mean of the image.
///
/// Groups of so many independent samples are averaged; the variance of their means is the figure (unbiased, no
/// reference image needed).
#[must_use]
pub fn variance(material: &Material, chosen: Chosen, size: usize, seed: u64) -> Vec<f64> {
    let studio = Light::studio();
    let pixels: Vec<usize> =
        (0..size * size).filter(|i| Frame::at(i % size, i / size, size).is_some()).collect();
    let sums: Vec<([f64; SAMPLE_COUNTS.len()], f64)> = pixels
        .par_iter()
        .map(|&pixel| {
            let samples = pixel_samples(material, chosen, &studio, [pixel, size], seed);
            let mut variances = [0.0; SAMPLE_COUNTS.len()];
            for (variance, count) in variances.iter_mut().zip(SAMPLE_COUNTS) {
                *variance = (0..3).map(|c| variance_of_means(&samples, c, count)).sum::<f64>() / 3.0;
            }
            let mean = samples.iter().flatten().map(|x| f64::from(*x)).sum::<f64>();
            (variances, mean / (3 * SAMPLES) as f64)
        })
        .collect();
    let count = pixels.len() as f64;
    let mean = sums.iter().map(|(_, mean)| mean).sum::<f64>() / count;
    let at = |i: usize| sums.iter().map(|(variances, _)| variances[i]).sum::<f64>() / count / (mean * mean);
    (0..SAMPLE_COUNTS.len()).map(|i| if mean > 0.0 { at(i) } else { 0.0 }).collect()
}

fn pixel_samples(
    material: &Material,
    chosen: Chosen,
    light: &Light,
    [pixel, size]: [usize; 2],
    seed: u64,
) -> Vec<Rgb> {
    let frame = Frame::at(pixel % size, pixel / size, size).expect("only pixels of the sphere are asked for");
    let view = frame.to_local(Vec3::Z);
    let mut random = Pcg64::seed_from_u64(seed ^ (pixel as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let sample = |_| {
        let u = Vec3::new(random.random(), random.random(), random.random());
        let (direction, weight) = match chosen {
            Chosen::By(material) => {
                let sample = material.sample(view, u);
                (sample.light, sample.weight)
            }
            Chosen::Cosine => {
                let (r, phi) = (u.x.sqrt(), std::f32::consts::TAU * u.y);
                let direction = Vec3::new(r * phi.cos(), r * phi.sin(), (1.0 - u.x).sqrt());
                (direction, material.eval(direction, view) * std::f32::consts::PI)
            }
        };
        let radiance = light.radiance(frame.to_world(direction));
        [0, 1, 2].map(|c| weight[c] * radiance[c])
    };
    (0..SAMPLES).map(sample).collect()
}

/// The variance of the mean of `count` samples, from all disjoint groups of so many.
fn variance_of_means(samples: &[Rgb], channel: usize, count: usize) -> f64 {
    let means: Vec<f64> = samples
        .chunks_exact(count)
        .map(|group| group.iter().map(|sample| f64::from(sample[channel])).sum::<f64>() / count as f64)
        .collect();
    let mean = means.iter().sum::<f64>() / means.len() as f64;
    means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (means.len() - 1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use glimt_core::microfacet::Microfacet;
    use glimt_core::models::ggx::Ggx;

    #[test]
    fn variance_falls_with_the_samples_and_lobes_are_quieter_than_the_cosine() {
        let glossy = Microfacet { kd: [0.1; 3], eta: [1.5; 3], alpha: [0.05; 2] };
        let glossy: Material = Ggx::new(glossy).unwrap().into();
        let lobes = variance(&glossy, Chosen::By(&glossy), 16, 1);
        let cosine = variance(&glossy, Chosen::Cosine, 16, 1);
        // 64 times as many samples, within what four groups a pixel allow.
        let ratio = lobes[0] / lobes[SAMPLE_COUNTS.len() - 1];
        assert!((40.0..100.0).contains(&ratio), "{ratio}");
        assert!(cosine[0] > 3.0 * lobes[0], "{} {}", cosine[0], lobes[0]);
    }
}

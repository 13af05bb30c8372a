//! Whether two noisy images can be images of the same scene.
//!
//! A renderer's pixel is a mean of samples with a variance. Where two renderers compute the same integrals,
//! the difference of their pixels over its standard deviation is standard normal, but for the few samples per
//! pixel that noise with rare bright values needs more of. Means over square blocks are nearer to normal,
//! and one too large among n is judged by Šidák's bound for n.

use statrs::distribution::{ContinuousCDF, Normal};

use glimt_image::{Image, Rgb, Rows};

use crate::error::Error;

/// Pixels along the side of a block.
const BLOCK: usize = 4;

/// A renderer's image: the mean of its samples in each pixel and the variance of that mean.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The means.
    pub mean: Image,
    /// Their variances.
    pub variance: Image,
}

/// What the test found.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct ZTest {
    /// Blocks of pixels and channels that were compared.
    pub tests: usize,
    /// The largest |z| among them.
    pub largest: f64,
    /// x and y of the pixel at the upper left of the block where it is, and its channel.
    pub at: [usize; 3],
    /// z of the difference of the means over the whole image, by channel.
    pub whole: [f64; 3],
    /// The probability of a |z| as large as the largest of all, blocks and whole image, by chance alone.
    pub p_value: f64,
}

/// The relative error that no test can tell from rounding and table look-ups of two renderers; it widens the
/// standard deviation of every block.
const RELATIVE_TOLERANCE: f64 = 2e-3;

impl ZTest {
    /// Compares two estimates of one image.
    ///
    /// # Errors
    /// Images of different sizes.
    pub fn compare(a: &Estimate, b: &Estimate) -> Result<Self, Error> {
        let size = a.mean.size();
        for other in [a.variance.size(), b.mean.size(), b.variance.size()] {
            if other != size {
                return Err(Error::Sizes(size, other));
            }
        }
        let mut result = ZTest { tests: 0, largest: 0.0, at: [0; 3], whole: [0.0; 3], p_value: 1.0 };
        let mut whole = [Sums::default(); 3];
        for y in (0..size[1]).step_by(BLOCK) {
            for x in (0..size[0]).step_by(BLOCK) {
                let mut block = [Sums::default(); 3];
                for row in y..(y + BLOCK).min(size[1]) {
                    for column in x..(x + BLOCK).min(size[0]) {
                        let i = row * size[0] + column;
                        let pixel =
                            [&a.mean, &b.mean, &a.variance, &b.variance].map(|image| image.pixels()[i]);
                        for channel in 0..3 {
                            block[channel].add(pixel, channel);
                            whole[channel].add(pixel, channel);
                        }
                    }
                }
                for (channel, sums) in block.iter().enumerate() {
                    let z = sums.z();
                    result.tests += 1;
                    if z.abs() >= result.largest.abs() || z.is_nan() {
                        (result.largest, result.at) = (z, [x, y, channel]);
                    }
                }
            }
        }
        result.whole = whole.map(|sums| sums.z());
        let extreme =
            result.whole.iter().fold(result.largest.abs(), |m, z| if z.abs() > m { z.abs() } else { m });
        let normal = Normal::standard();
        let single = 2.0 * normal.sf(extreme);
        // 1 − (1 − p)ⁿ without the loss of digits for small p. A NaN proves an error.
        let tests = (result.tests + 3) as f64;
        result.p_value =
            if extreme.is_nan() { 0.0 } else { -f64::exp_m1(tests * f64::ln_1p(-single.min(1.0 - 1e-16))) };
        Ok(result)
    }
}

#[derive(Clone, Copy, Default)]
struct Sums {
    difference: f64,
    variance: f64,
    value: f64,
}

impl Sums {
    fn add(&mut self, [a, b, variance_a, variance_b]: [Rgb; 4], channel: usize) {
        self.difference += f64::from(a[channel]) - f64::from(b[channel]);
        self.variance += f64::from(variance_a[channel]) + f64::from(variance_b[channel]);
        self.value += f64::from(a[channel].abs().max(b[channel].abs()));
    }

    fn z(&self) -> f64 {
        let deviation = (self.variance + (RELATIVE_TOLERANCE * self.value).powi(2)).sqrt();
        if self.difference == 0.0 { 0.0 } else { self.difference / deviation }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    /// Means of `samples` exponential variates a pixel, whose variance is known only from themselves.
    fn noisy(seed: u64, mean: impl Fn(usize) -> f64) -> Estimate {
        const SAMPLES: usize = 64;
        let mut rng = Pcg64::seed_from_u64(seed);
        let (mut means, mut variances) = (Vec::new(), Vec::new());
        for i in 0..64 * 48 {
            let mut draw = || -mean(i) * (1.0 - rng.random::<f64>()).ln();
            let drawn: Vec<f64> = (0..SAMPLES).map(|_| draw()).collect();
            let m = drawn.iter().sum::<f64>() / SAMPLES as f64;
            let square: f64 = drawn.iter().map(|x| (x - m).powi(2)).sum();
            means.push([m as f32; 3]);
            variances.push([(square / (SAMPLES * (SAMPLES - 1)) as f64) as f32; 3]);
        }
        Estimate { mean: Image::new(64, means), variance: Image::new(64, variances) }
    }

    #[test]
    fn images_of_one_scene_pass() {
        for seed in 0..5 {
            let test = ZTest::compare(&noisy(seed, |_| 1.0), &noisy(100 + seed, |_| 1.0)).unwrap();
            assert!(test.p_value > 0.001, "{test:?}");
        }
    }

    #[test]
    fn a_small_error_everywhere_and_a_large_one_somewhere_are_found() {
        let truth = noisy(1, |_| 1.0);
        let everywhere = ZTest::compare(&truth, &noisy(2, |_| 1.03)).unwrap();
        assert!(everywhere.p_value < 1e-4, "{everywhere:?}");
        let somewhere = ZTest::compare(&truth, &noisy(3, |i| if i < 4 { 3.0 } else { 1.0 })).unwrap();
        assert!(somewhere.p_value < 1e-4 && somewhere.at[..2] == [0, 0], "{somewhere:?}");
    }

    #[test]
    fn a_nan_is_an_error() {
        let truth = noisy(1, |_| 1.0);
        let mut pixels = truth.mean.pixels().to_vec();
        pixels[77][2] = f32::NAN;
        let image = Estimate { mean: Image::new(64, pixels), variance: truth.variance.clone() };
        assert_eq!(ZTest::compare(&truth, &image).unwrap().p_value, 0.0);
    }
}

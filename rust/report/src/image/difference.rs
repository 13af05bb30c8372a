//! Differences of images by pixel (MAE, RMSE, PSNR) and by neighbourhood (SSIM).

use serde::{Deserialize, Deserializer, Serialize};

use super::exposure::{automatic, shown};
use glimt_image::{Rgb, Rows};

use super::{Band, for_each_band};
use crate::error::Error;

/// How far an image is from the truth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// Mean of |a − b| over pixels and channels, of linear radiance.
    pub mae: f64,
    /// Root of the mean of (a − b)², of linear radiance.
    pub rmse: f64,
    /// Mean of a − b where b is the truth: a constant error shows here where noise does not.
    pub bias: f64,
    /// Mean of the truth, to hold the others against.
    pub mean: f64,
    /// Peak signal to noise ratio in dB, of the images as shown; infinite where they are equal.
    #[serde(deserialize_with = "infinite_if_null")]
    pub psnr: f64,
    /// Structural similarity (Wang et al. 2004) of the images as shown, mean over channels; 1 where they are equal.
    pub ssim: f64,
    /// The factor by which both images were multiplied before they were shown.
    pub exposure: f32,
    /// Pixels that are not finite in either image; they count nowhere else.
    pub not_finite: usize,
}

/// JSON has no infinity: it writes `null`.
fn infinite_if_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
}

impl Difference {
    /// Of `image` against `truth`; the exposure for what is measured as shown is the truth's own
    /// ([`automatic`]) unless given.
    ///
    /// # Errors
    /// Images of different sizes, or what reading them says.
    pub fn measure(truth: &dyn Rows, image: &dyn Rows, exposure: Option<f32>) -> Result<Self, Error> {
        let exposure = exposure.map_or_else(|| automatic(truth), Ok)?;
        let mut sums = [0.0; 5];
        let (mut counted, mut not_finite) = (0, 0);
        let mut similarity = Mean::default();
        for_each_band([truth, image], WINDOW / 2, |band| {
            for (truth, image) in band.finite_pairs() {
                let visible = [shown(truth, exposure), shown(image, exposure)];
                for c in 0..3 {
                    let difference = f64::from(image[c]) - f64::from(truth[c]);
                    let squared = f64::from(visible[0][c] - visible[1][c]).powi(2);
                    let terms = [difference.abs(), difference.powi(2), difference, truth[c].into(), squared];
                    for (sum, term) in sums.iter_mut().zip(terms) {
                        *sum += term;
                    }
                }
                counted += 3;
            }
            not_finite += band.finite.iter().filter(|finite| !**finite).count();
            add_similarity(&band.map(|pixel| shown(pixel, exposure)), truth.size()[1], &mut similarity);
            Ok(())
        })?;
        let [mae, square, bias, mean, shown_square] = sums.map(|sum| sum / f64::from(counted.max(1)));
        Ok(Difference {
            mae,
            rmse: square.sqrt(),
            bias,
            mean,
            psnr: -10.0 * shown_square.log10(),
            ssim: similarity.value(),
            exposure,
            not_finite,
        })
    }
}

#[derive(Default)]
struct Mean {
    sum: f64,
    count: usize,
}

impl Mean {
    /// 1 for none: images too small for a window have nothing that differs in structure.
    fn value(&self) -> f64 {
        if self.count > 0 { self.sum / self.count as f64 } else { 1.0 }
    }
}

// Wang et al. 2004, §III-C: a Gaussian window of 11 × 11 with σ = 1.5, and the constants against
// division by little, for values in [0, 1].
const WINDOW: usize = 11;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Adds the structural similarity at all pixels of a band whose window lies within the image.
fn add_similarity(band: &Band, height: usize, mean: &mut Mean) {
    let half = WINDOW / 2;
    let weight: Vec<f64> =
        (0..WINDOW).map(|i| (-0.5 * ((i as f64 - half as f64) / SIGMA).powi(2)).exp()).collect();
    let total: f64 = weight.iter().sum();
    if band.width < WINDOW {
        return;
    }
    // Moments of each row's windows first, then their sums down the columns.
    let moments = |[a, b]: [Rgb; 2]| -> [f64; 15] {
        let mut moments = [0.0; 15];
        for c in 0..3 {
            let (a, b) = (f64::from(a[c]), f64::from(b[c]));
            moments[5 * c..][..5].copy_from_slice(&[a, b, a * a, b * b, a * b]);
        }
        moments
    };
    let rows = band.rows.len() + 2 * half;
    let columns = band.width - 2 * half;
    let mut across = vec![[0.0; 15]; rows * columns];
    for y in 0..rows {
        for x in 0..columns {
            let sums = &mut across[y * columns + x];
            for (i, w) in weight.iter().enumerate() {
                let at = y * band.width + x + i;
                for (sum, m) in sums.iter_mut().zip(moments([band.pixels[0][at], band.pixels[1][at]])) {
                    *sum += w / total * m;
                }
            }
        }
    }
    for (y, row) in band.rows.clone().enumerate() {
        if row < half || row + half >= height {
            continue;
        }
        for x in 0..columns {
            let mut sums = [0.0; 15];
            for (i, w) in weight.iter().enumerate() {
                for (sum, m) in sums.iter_mut().zip(across[(y + i) * columns + x]) {
                    *sum += w / total * m;
                }
            }
            for [a, b, aa, bb, ab] in sums.as_chunks::<5>().0.iter().copied() {
                let structure = (2.0 * a * b + C1) * (2.0 * (ab - a * b) + C2);
                mean.sum += structure / ((a * a + b * b + C1) * (aa - a * a + bb - b * b + C2));
                mean.count += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use glimt_image::Image;

    fn pattern(width: usize, height: usize, shift: f32) -> Image {
        let pixel = |i: usize| {
            let (x, y) = ((i % width) as f32, (i / width) as f32);
            [0.7, 1.3, 2.1].map(|k| 0.5 + 0.4 * (0.1 * k * x + shift).sin() * (0.13 * y).cos())
        };
        Image::new(width, (0..width * height).map(pixel).collect())
    }

    #[test]
    fn equal_images_differ_by_nothing() {
        let image = pattern(40, 150, 0.0);
        let difference = Difference::measure(&image, &image, None).unwrap();
        assert_eq!((difference.mae, difference.rmse, difference.bias), (0.0, 0.0, 0.0));
        assert_eq!(difference.psnr, f64::INFINITY);
        assert_relative_eq!(difference.ssim, 1.0, epsilon = 1e-12);
    }

    #[test]
    fn a_constant_offset_is_mae_rmse_and_bias() {
        let truth = pattern(30, 70, 0.0);
        let image = Image::new(30, truth.pixels().iter().map(|p| p.map(|x| x + 0.25)).collect());
        let difference = Difference::measure(&truth, &image, Some(1.0)).unwrap();
        for value in [difference.mae, difference.rmse, difference.bias] {
            assert_relative_eq!(value, 0.25, epsilon = 1e-6);
        }
    }

    #[test]
    fn pixels_that_are_not_finite_are_counted_and_left_out() {
        let truth = pattern(30, 70, 0.0);
        let mut pixels = truth.pixels().to_vec();
        pixels[100][1] = f32::NAN;
        pixels[2000][0] = f32::INFINITY;
        let difference = Difference::measure(&truth, &Image::new(30, pixels), None).unwrap();
        assert_eq!((difference.not_finite, difference.mae), (2, 0.0));
    }

    #[test]
    fn images_of_different_sizes_are_refused() {
        let message = Difference::measure(&pattern(3, 4, 0.0), &pattern(4, 3, 0.0), None).unwrap_err();
        assert!(message.to_string().starts_with("the images have 3 × 4 and 4 × 3 pixels"), "{message}");
    }

    /// scikit-image 0.26: structural_similarity(a, b, gaussian_weights=True, sigma=1.5,
    /// use_sample_covariance=False, channel_axis=2, data_range=1) of the images as shown.
    #[test]
    fn ssim_and_psnr_are_those_of_scikit_image() {
        let (truth, image) = (pattern(60, 150, 0.0), pattern(60, 150, 0.4));
        let difference = Difference::measure(&truth, &image, Some(1.0)).unwrap();
        assert_relative_eq!(difference.ssim, SCIKIT_SSIM, epsilon = 2e-5);
        assert_relative_eq!(difference.psnr, SCIKIT_PSNR, epsilon = 1e-3);
    }

    const SCIKIT_SSIM: f64 = 0.912_518_54;
    const SCIKIT_PSNR: f64 = 24.606_703;
}

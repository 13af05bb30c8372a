//! ꟻLIP: the difference that a viewer sees when two images alternate.
//!
//! Andersson et al. 2020, *FLIP: A Difference Evaluator for Alternating Images* (equations by their numbers
//! there), and for high dynamic range Andersson et al. 2021, *Visualizing Errors in Rendered High Dynamic
//! Range Images*.

use super::exposure::{Of, quantiles};
use glimt_image::{Rgb, Rows};

use super::{Band, for_each_band};
use crate::error::Error;

/// Pixels per degree of a monitor of 0.7 m and 3840 pixels seen from 0.7 m, the papers' default.
pub const PIXELS_PER_DEGREE: f64 = 0.7 * 3840.0 / 0.7 * std::f64::consts::PI / 180.0;

/// What is shown to the viewer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shown {
    /// The images times this factor, clipped to [0, 1].
    Exposed(f32),
    /// The images at every exposure that shows something in the truth; the largest error of all counts.
    AllExposures,
}

/// The mean ꟻLIP error of `image` against `truth`, from 0 to 1, over pixels that are finite in both; `row` is
/// called with the number and the errors of each row of pixels.
///
/// # Errors
/// Images of different sizes, or what reading them says.
pub fn flip(
    truth: &dyn Rows,
    image: &dyn Rows,
    shown: Shown,
    mut row: impl FnMut(usize, &[f32]),
) -> Result<f64, Error> {
    let filters = Filters::new(PIXELS_PER_DEGREE);
    let exposures = match shown {
        Shown::Exposed(_) => Vec::new(),
        Shown::AllExposures => exposures(truth)?,
    };
    let (mut sum, mut counted) = (0.0, 0_usize);
    for_each_band([truth, image], filters.radius, |band| {
        let mut errors = match shown {
            Shown::Exposed(exposure) => filters.errors(&band.map(|pixel| exposed(pixel, exposure))),
            Shown::AllExposures => {
                let mut largest = vec![0.0; band.finite.len()];
                for &stop in &exposures {
                    let mapped = band.map(|pixel| pixel.map(|x| tone_map(x * stop.exp2()).clamp(0.0, 1.0)));
                    for (largest, error) in largest.iter_mut().zip(filters.errors(&mapped)) {
                        *largest = error.max(*largest);
                    }
                }
                largest
            }
        };
        for (error, finite) in errors.iter_mut().zip(&band.finite) {
            if *finite {
                sum += f64::from(*error);
                counted += 1;
            } else {
                *error = 0.0;
            }
        }
        for (y, errors) in band.rows.clone().zip(errors.chunks(band.width)) {
            row(y, errors);
        }
        Ok(())
    })?;
    Ok(sum / counted.max(1) as f64)
}

fn exposed(pixel: Rgb, exposure: f32) -> Rgb {
    pixel.map(|x| (x * exposure).clamp(0.0, 1.0))
}

/// ACES' tone curve as Narkowicz 2015 fits it, with the exposure of 0.6 that the paper takes in.
const ACES: [f32; 6] = [0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.0, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14];

fn tone_map(x: f32) -> f32 {
    let [a, b, c, d, e, f] = ACES;
    ((a * x + b) * x + c) / ((d * x + e) * x + f)
}

/// Exposures in stops, from the one that just shows the brightest pixel to the one that shows the median well
/// (2021, §4): one for each stop between, at least two.
fn exposures(truth: &dyn Rows) -> Result<Vec<f32>, Error> {
    /// Brightness on the display at which the ends are set.
    const BRIGHT: f64 = 0.85;
    let [a, b, c, d, e, f] = ACES.map(f64::from);
    // tone_map(x) = BRIGHT, solved for x.
    let (p, q, r) = (a - BRIGHT * d, b - BRIGHT * e, c - BRIGHT * f);
    let at_bright = (-q + (q * q - 4.0 * p * r).sqrt()) / (2.0 * p);
    let [median, largest] = quantiles(truth, Of::Luminance, [0.5, 1.0])?;
    if largest <= 0.0 {
        return Ok(vec![0.0]);
    }
    /// The least luminance that an exposure is set for: black has none.
    const DARKEST: f32 = 1e-4;
    let stop = |luminance: f32| (at_bright / f64::from(luminance.max(DARKEST))).log2();
    let (start, end) = (stop(largest), stop(median));
    let count = (end - start).ceil().max(2.0) as usize;
    Ok((0..count).map(|i| (start + (end - start) * i as f64 / (count - 1) as f64) as f32).collect())
}

/// The filters of both pipelines for a number of pixels per degree.
struct Filters {
    radius: usize,
    /// One or two Gaussians for each of the achromatic, red–green and blue–yellow channels (equation 4): weight
    /// and samples of one dimension.
    contrast: [Vec<(f32, Vec<f32>)>; 3],
    /// Samples of the Gaussian, its first and its second derivative, which find edges and points (equations 11, 12).
    features: [Vec<f32>; 3],
}

impl Filters {
    fn new(pixels_per_degree: f64) -> Self {
        use std::f64::consts::PI;
        // Table 1: a₁, b₁, a₂, b₂ of the contrast sensitivity functions.
        const SENSITIVITY: [&[[f64; 2]]; 3] =
            [&[[1.0, 0.0047]], &[[1.0, 0.0053]], &[[34.1, 0.04], [13.5, 0.025]]];
        const WIDEST: f64 = 0.04;
        // Equation 5: three standard deviations of the widest Gaussian, for all channels.
        let contrast_radius = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as isize;
        let contrast = SENSITIVITY.map(|gaussians| {
            let mut parts: Vec<(f64, Vec<f64>)> = gaussians
                .iter()
                .map(|[a, b]| {
                    let sample = |x: isize| (-(PI * x as f64 / pixels_per_degree).powi(2) / b).exp();
                    (a * (PI / b).sqrt(), (-contrast_radius..=contrast_radius).map(sample).collect())
                })
                .collect();
            let total: f64 = parts.iter().map(|(a, samples)| a * samples.iter().sum::<f64>().powi(2)).sum();
            parts.iter_mut().for_each(|(a, _)| *a /= total);
            parts
                .into_iter()
                .map(|(a, samples)| (a as f32, samples.into_iter().map(|x| x as f32).collect()))
                .collect()
        });
        // §4.2.1: the width of features that the eye sees best, in degrees.
        const FEATURE_WIDTH: f64 = 0.082;
        let sigma = 0.5 * FEATURE_WIDTH * pixels_per_degree;
        let feature_radius = (3.0 * sigma).ceil() as isize;
        let radius = contrast_radius.max(feature_radius);
        let sampled = |f: &dyn Fn(f64) -> f64| -> Vec<f64> {
            let value = |x: isize| if x.abs() <= feature_radius { f(x as f64) } else { 0.0 };
            (-radius..=radius).map(value).collect()
        };
        let gaussian = |x: f64| (-x * x / (2.0 * sigma * sigma)).exp();
        let mut smooth = sampled(&gaussian);
        let mut edge = sampled(&|x| -x * gaussian(x));
        let mut point = sampled(&|x| (x * x / (sigma * sigma) - 1.0) * gaussian(x));
        // Positive weights sum to 1 and negative ones to −1.
        for filter in [&mut smooth, &mut edge, &mut point] {
            let positive: f64 = filter.iter().filter(|x| **x > 0.0).sum();
            let negative: f64 = -filter.iter().filter(|x| **x < 0.0).sum::<f64>();
            filter
                .iter_mut()
                .for_each(|x| *x /= if *x > 0.0 { positive } else { negative.max(f64::MIN_POSITIVE) });
        }
        let padding = (radius - contrast_radius) as usize;
        let mut filters = Filters {
            radius: radius as usize,
            contrast,
            features: [smooth, edge, point].map(|filter| filter.into_iter().map(|x| x as f32).collect()),
        };
        for (_, samples) in filters.contrast.iter_mut().flatten() {
            *samples = [vec![0.0; padding], std::mem::take(samples), vec![0.0; padding]].concat();
        }
        filters
    }

    /// The errors of a band's pixels within the halo; values are in [0, 1].
    fn errors(&self, band: &Band) -> Vec<f32> {
        let seen = [0, 1].map(|i| self.seen(band, i));
        let features = [0, 1].map(|i| self.features(band, i));
        seen[0]
            .iter()
            .zip(&seen[1])
            .zip(features[0].iter().zip(&features[1]))
            .map(|((&a, &b), (f, g))| {
                let color = redistribute(hyab(a, b));
                // Equations 13, 14.
                let feature = (f[0] - g[0]).abs().max((f[1] - g[1]).abs()) / std::f32::consts::SQRT_2;
                color.powf(1.0 - feature.sqrt())
            })
            .collect()
    }

    /// What the eye's contrast sensitivity leaves of an image, in L*a*b* after Hunt's adjustment.
    fn seen(&self, band: &Band, image: usize) -> Vec<[f32; 3]> {
        let opponent: Vec<[f32; 3]> = band.pixels[image].iter().map(|&pixel| ycxcz(xyz(pixel))).collect();
        let mut filtered = vec![[0.0; 3]; band.rows.len() * band.width];
        for (channel, gaussians) in self.contrast.iter().enumerate() {
            let plane: Vec<f32> = opponent.iter().map(|pixel| pixel[channel]).collect();
            for (weight, samples) in gaussians {
                let part = self.convolve(band, &plane, samples, samples);
                for (pixel, value) in filtered.iter_mut().zip(part) {
                    pixel[channel] += weight * value;
                }
            }
        }
        let seen = |pixel: [f32; 3]| {
            let rgb = linear_rgb(from_ycxcz(pixel)).map(|x| x.clamp(0.0, 1.0));
            hunt(lab(xyz(rgb)))
        };
        filtered.into_iter().map(seen).collect()
    }

    /// Strength of edges and points in the luminance.
    fn features(&self, band: &Band, image: usize) -> Vec<[f32; 2]> {
        let plane: Vec<f32> =
            band.pixels[image].iter().map(|&pixel| (ycxcz(xyz(pixel))[0] + 16.0) / 116.0).collect();
        let [smooth, edge, point] = &self.features;
        let strength = |filter: &[f32]| -> Vec<f32> {
            let (x, y) =
                (self.convolve(band, &plane, filter, smooth), self.convolve(band, &plane, smooth, filter));
            x.into_iter().zip(y).map(|(x, y)| x.hypot(y)).collect()
        };
        strength(edge).into_iter().zip(strength(point)).map(|(edge, point)| [edge, point]).collect()
    }

    /// A separable filter at the band's pixels within the halo; columns beyond the image repeat those at its edge.
    fn convolve(&self, band: &Band, plane: &[f32], across: &[f32], down: &[f32]) -> Vec<f32> {
        let (width, rows) = (band.width, band.rows.len());
        let mut columns = vec![0.0; rows * width];
        for (y, row) in columns.chunks_mut(width).enumerate() {
            for (i, weight) in down.iter().enumerate() {
                for (sum, value) in row.iter_mut().zip(&plane[(y + i) * width..][..width]) {
                    *sum += weight * value;
                }
            }
        }
        let mut filtered = vec![0.0; rows * width];
        let mut padded = vec![0.0; width + 2 * self.radius];
        for (out, row) in filtered.chunks_mut(width).zip(columns.chunks(width)) {
            padded[..self.radius].fill(row[0]);
            padded[self.radius..][..width].copy_from_slice(row);
            padded[self.radius + width..].fill(row[width - 1]);
            for (i, weight) in across.iter().enumerate() {
                for (sum, value) in out.iter_mut().zip(&padded[i..]) {
                    *sum += weight * value;
                }
            }
        }
        filtered
    }
}

/// Linear sRGB to CIE XYZ (IEC 61966-2-1).
const XYZ_FROM_RGB: [[f32; 3]; 3] = [
    [0.412_390_8, 0.357_584_33, 0.180_480_8],
    [0.212_639, 0.715_168_65, 0.072_192_32],
    [0.019_330_818, 0.119_194_78, 0.950_532_14],
];

/// The inverse of [`XYZ_FROM_RGB`].
const RGB_FROM_XYZ: [[f32; 3]; 3] = [
    [3.240_97, -1.537_383_2, -0.498_610_76],
    [-0.969_243_65, 1.875_967_5, 0.041_555_06],
    [0.055_630_08, -0.203_976_96, 1.056_971_5],
];

/// XYZ of the display's white.
const WHITE: [f32; 3] = [0.950_455_9, 1.0, 1.089_057_7];

fn multiply(matrix: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

fn xyz(rgb: Rgb) -> [f32; 3] {
    multiply(&XYZ_FROM_RGB, rgb)
}

fn linear_rgb(xyz: [f32; 3]) -> Rgb {
    multiply(&RGB_FROM_XYZ, xyz)
}

/// The linearised L*a*b* in which the eye's filters are stated (equation 3).
fn ycxcz(xyz: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = [0, 1, 2].map(|i| xyz[i] / WHITE[i]);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn from_ycxcz([y, cx, cz]: [f32; 3]) -> [f32; 3] {
    let y = (y + 16.0) / 116.0;
    [(y + cx / 500.0) * WHITE[0], y * WHITE[1], (y - cz / 200.0) * WHITE[2]]
}

/// CIE L*a*b* 1976.
fn lab(xyz: [f32; 3]) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let f = |t: f32| if t > DELTA.powi(3) { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
    let [x, y, z] = [0, 1, 2].map(|i| f(xyz[i] / WHITE[i]));
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Chroma counts for less in the dark (equation 6).
fn hunt([l, a, b]: [f32; 3]) -> [f32; 3] {
    [l, 0.01 * l * a, 0.01 * l * b]
}

/// The HyAB distance of two colours (equation 7).
fn hyab(p: [f32; 3], q: [f32; 3]) -> f32 {
    (p[0] - q[0]).abs() + (p[1] - q[1]).hypot(p[2] - q[2])
}

/// A distance of colours mapped to [0, 1] (equations 8, 9).
fn redistribute(distance: f32) -> f32 {
    const POWER: f32 = 0.7;
    const KNEE: f32 = 0.4;
    const KNEE_VALUE: f32 = 0.95;
    // Green against blue, the largest distance of two colours that a display shows.
    let [green, blue] = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|rgb| hunt(lab(xyz(rgb))));
    let largest = hyab(green, blue).powf(POWER);
    let powered = distance.powf(POWER);
    let knee = KNEE * largest;
    if powered < knee {
        powered * KNEE_VALUE / knee
    } else {
        KNEE_VALUE + (powered - knee) / (largest - knee) * (1.0 - KNEE_VALUE)
    }
}

#[cfg(test)]
mod tests {
    use super::super::exposure::shown;
    use super::*;
    use approx::assert_abs_diff_eq;
    use glimt_image::Image;

    const SIZE: [usize; 2] = [120, 90];

    /// Smooth gradients, edges and points, brighter than 1 by up to `peak`.
    fn scene(phase: f32, peak: f32) -> Image {
        let pixel = |i: usize| {
            let (x, y) = ((i % SIZE[0]) as f32, (i / SIZE[0]) as f32);
            let stripe = if (0.15 * x + phase).sin() > 0.6 { 0.5 } else { 0.05 };
            let point = if (i + (40.0 * phase) as usize).is_multiple_of(613) { peak } else { 0.0 };
            [0.3, 0.5, 0.8].map(|k| (k * stripe + 0.2 * (0.05 * y * k + phase).sin().abs() + point) * 0.8)
        };
        Image::new(SIZE[0], (0..SIZE[0] * SIZE[1]).map(pixel).collect())
    }

    /// The implementation of the paper's authors, which takes images as displays show them, in 8 bits.
    #[test]
    fn errors_are_those_of_the_published_implementation() {
        let images = [scene(0.0, 1.0), scene(0.3, 1.0)];
        let bytes = images.each_ref().map(|image| -> Vec<u8> {
            let quantised = |pixel: &Rgb| shown(*pixel, 1.0).map(|x| (x * 255.0).round() as u8);
            image.pixels().iter().flat_map(quantised).collect()
        });
        let linear = |bytes: &[u8]| {
            let decoded = |x: u8| {
                let x = f32::from(x) / 255.0;
                if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
            };
            Image::new(
                SIZE[0],
                bytes.as_chunks().0.iter().map(|pixel: &[u8; 3]| pixel.map(decoded)).collect(),
            )
        };
        let [width, height] = SIZE.map(|n| n as u32);
        let published = bytes.each_ref().map(|b| nv_flip::FlipImageRgb8::with_data(width, height, b));
        let [truth, image] = published;
        let map = nv_flip::flip(truth, image, PIXELS_PER_DEGREE as f32);
        let mut published = vec![0.0_f32; SIZE[0] * SIZE[1]];
        for (pixel, value) in published.iter_mut().zip(map.to_vec()) {
            *pixel = value;
        }
        let mut ours = Vec::new();
        let mean =
            flip(&linear(&bytes[0]), &linear(&bytes[1]), Shown::Exposed(1.0), |_, row| ours.extend(row))
                .unwrap();
        for (i, (a, b)) in ours.iter().zip(&published).enumerate() {
            assert_abs_diff_eq!(a, b, epsilon = 2e-3);
            assert!(a.is_finite(), "pixel {i}");
        }
        assert!(mean > 0.05, "the test's images differ: {mean}");
    }

    #[test]
    fn equal_images_have_no_error_at_any_exposure() {
        let image = scene(0.0, 300.0);
        for shown in [Shown::Exposed(1.0), Shown::AllExposures] {
            assert_abs_diff_eq!(flip(&image, &image, shown, |_, _| ()).unwrap(), 0.0, epsilon = 1e-6);
        }
    }

    #[test]
    fn what_a_clipped_image_hides_counts_at_all_exposures() {
        let (truth, image) = (scene(0.0, 5.0), scene(0.0, 50.0));
        let clipped = flip(&truth, &image, Shown::Exposed(1.0), |_, _| ()).unwrap();
        let all = flip(&truth, &image, Shown::AllExposures, |_, _| ()).unwrap();
        assert!(clipped < 1e-6 && all > 1e-3, "{clipped} {all}");
    }
    /// Goldens of the paper's authors' own implementation: tests/goldens/flip.py.
    #[test]
    fn errors_at_all_exposures_are_those_of_the_published_implementation() {
        for (phases, peaks, published) in
            [([0.0, 0.0], [5.0, 50.0], 0.003_444_5), ([0.0, 0.3], [40.0, 80.0], 0.415_827_5)]
        {
            let [truth, image] = [0, 1].map(|i| scene(phases[i], peaks[i]));
            let ours = flip(&truth, &image, Shown::AllExposures, |_, _| ()).unwrap();
            assert_abs_diff_eq!(ours, published, epsilon = 1e-3);
        }
    }
}

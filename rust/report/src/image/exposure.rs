//! How bright an image is: order statistics of its values, exact and without holding them.

use glimt_image::{Rgb, Rows};

use super::luminance;
use crate::error::Error;

/// Rows that are read at a time.
const ROWS: usize = 64;

/// What a value is taken of in each pixel.
#[derive(Clone, Copy, Debug)]
pub enum Of {
    /// The three components, each by itself.
    Components,
    /// The luminance.
    Luminance,
}

/// The values at some ranks of an image, ranks from 0 (least) to 1 (largest), among its finite values;
/// negative ones count as 0. A rank between two values yields the lower.
///
/// # Errors
/// What reading the image says.
pub fn quantiles<const N: usize>(image: &dyn Rows, of: Of, ranks: [f64; N]) -> Result<[f32; N], Error> {
    // Non-negative floats sort as their bits: two passes over 16 bits each find a value exactly.
    let mut high = vec![0_u64; 1 << 16];
    for_each_value(image, of, |bits| high[(bits >> 16) as usize] += 1)?;
    let total: u64 = high.iter().sum();
    if total == 0 {
        return Ok([0.0; N]);
    }
    let found = ranks.map(|rank| locate(&high, (rank * (total - 1) as f64) as u64));
    let mut low = vec![vec![0_u64; 1 << 16]; N];
    for_each_value(image, of, |bits| {
        for (low, (upper, _)) in low.iter_mut().zip(found) {
            if bits >> 16 == upper {
                low[(bits & 0xffff) as usize] += 1;
            }
        }
    })?;
    Ok(std::array::from_fn(|i| {
        let (upper, rest) = found[i];
        f32::from_bits(upper << 16 | locate(&low[i], rest).0)
    }))
}

/// The bin in which the value of a rank lies, and its rank within the bin.
fn locate(histogram: &[u64], mut rank: u64) -> (u32, u64) {
    for (bin, &count) in histogram.iter().enumerate() {
        if rank < count {
            return (bin as u32, rank);
        }
        rank -= count;
    }
    unreachable!("a rank is below the number of values")
}

fn for_each_value(image: &dyn Rows, of: Of, mut visit: impl FnMut(u32)) -> Result<(), Error> {
    let mut value = |x: f32| {
        if x.is_finite() {
            visit(x.max(0.0).to_bits());
        }
    };
    let height = image.size()[1];
    for start in (0..height).step_by(ROWS) {
        for pixel in image.read(start..(start + ROWS).min(height))? {
            match of {
                Of::Components => pixel.into_iter().for_each(&mut value),
                Of::Luminance => value(luminance(pixel)),
            }
        }
    }
    Ok(())
}

/// The factor that brings all but the brightest twentieth of an image's values below 1.
///
/// # Errors
/// What reading the image says.
pub fn automatic(image: &dyn Rows) -> Result<f32, Error> {
    let [bright] = quantiles(image, Of::Components, [0.95])?;
    Ok(if bright > 0.0 { 1.0 / bright } else { 1.0 })
}

/// A colour as a display shows it: encoded by sRGB's curve (IEC 61966-2-1), clipped to [0, 1].
#[must_use]
pub fn shown(pixel: Rgb, exposure: f32) -> Rgb {
    pixel.map(|value| {
        let value = (value * exposure).clamp(0.0, 1.0);
        if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glimt_image::Image;

    #[test]
    fn quantiles_are_those_of_the_sorted_values() {
        let mut values: Vec<f32> =
            (0..3 * 5000).map(|i| (i as f32 * 0.618).fract().powi(8) * 1e4 - 0.001).collect();
        let mut pixels: Vec<Rgb> = values.as_chunks().0.to_vec();
        pixels.extend([[f32::NAN; 3], [f32::INFINITY; 3]].repeat(2));
        let image = Image::new(1, pixels);
        values.iter_mut().for_each(|x| *x = x.max(0.0));
        values.sort_by(f32::total_cmp);
        let ranks = [0.0, 0.25, 0.5, 0.95, 1.0];
        let expected = ranks.map(|rank| values[(rank * (values.len() - 1) as f64) as usize]);
        assert_eq!(quantiles(&image, Of::Components, ranks).unwrap(), expected);
        let exposure = automatic(&image).unwrap();
        assert_eq!(exposure, 1.0 / expected[3]);
        assert_eq!(shown([f32::MAX, -1.0, 0.0], exposure).map(|x| (x * 255.0).round()), [255.0, 0.0, 0.0]);
    }

    #[test]
    fn a_black_image_has_exposure_1() {
        assert_eq!(automatic(&Image::new(2, vec![[0.0; 3]; 4])).unwrap(), 1.0);
    }
}

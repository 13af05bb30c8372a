//! How far images are apart.
//!
//! Everything here reads its images in bands of rows ([`Rows`]), so that memory holds a few rows of each
//! however large they are. Values are linear sRGB radiance. A pixel that is not finite in either image counts
//! nowhere but in the number of such pixels.

pub mod difference;
pub mod exposure;
pub mod flip;
pub mod z_test;

use std::ops::Range;

use glimt_image::{Rgb, Rows};

use crate::error::Error;

/// Rows that are looked at together: enough to spread the cost of the halo.
const BAND: usize = 64;

/// Some rows of two images with a halo around them; beyond the image the rows at its edge repeat.
struct Band {
    width: usize,
    /// The rows within the halo.
    rows: Range<usize>,
    halo: usize,
    /// Both images: (rows + 2 halo) × width pixels, 0 where either is not finite.
    pixels: [Vec<Rgb>; 2],
    /// Whether both images are finite, of the pixels within the halo.
    finite: Vec<bool>,
}

impl Band {
    /// Both images' pixels within the halo where both are finite.
    fn finite_pairs(&self) -> impl Iterator<Item = (Rgb, Rgb)> {
        let inner = self.halo * self.width..(self.halo + self.rows.len()) * self.width;
        let pairs = self.pixels[0][inner.clone()].iter().zip(&self.pixels[1][inner]);
        pairs.zip(&self.finite).filter(|(_, finite)| **finite).map(|((a, b), _)| (*a, *b))
    }

    /// The band with each pixel of both images put through `map`.
    fn map(&self, map: impl Fn(Rgb) -> Rgb) -> Band {
        let pixels = [0, 1].map(|i| self.pixels[i].iter().map(|&pixel| map(pixel)).collect());
        Band { pixels, finite: self.finite.clone(), rows: self.rows.clone(), ..*self }
    }
}

/// Calls `visit` with all bands of two images, from the top.
fn for_each_band(
    images: [&dyn Rows; 2],
    halo: usize,
    mut visit: impl FnMut(&Band) -> Result<(), Error>,
) -> Result<(), Error> {
    let [width, height] = images[0].size();
    if images[1].size() != [width, height] {
        return Err(Error::Sizes([width, height], images[1].size()));
    }
    for start in (0..height).step_by(BAND) {
        let rows = start..(start + BAND).min(height);
        let held = start.saturating_sub(halo)..(rows.end + halo).min(height);
        let read = |image: &dyn Rows| -> Result<Vec<Rgb>, Error> {
            let pixels = image.read(held.clone())?;
            let mut band = Vec::with_capacity((rows.len() + 2 * halo) * width);
            for y in 0..rows.len() + 2 * halo {
                let row = (start + y).saturating_sub(halo).clamp(held.start, held.end - 1) - held.start;
                band.extend_from_slice(&pixels[row * width..][..width]);
            }
            Ok(band)
        };
        let mut pixels = [read(images[0])?, read(images[1])?];
        let mut finite = vec![true; pixels[0].len()];
        for (i, finite) in finite.iter_mut().enumerate() {
            *finite = pixels.iter().all(|image| image[i].iter().all(|value| value.is_finite()));
            if !*finite {
                pixels[0][i] = [0.0; 3];
                pixels[1][i] = [0.0; 3];
            }
        }
        let finite = finite[halo * width..][..rows.len() * width].to_vec();
        visit(&Band { width, rows, halo, pixels, finite })?;
    }
    Ok(())
}

/// Relative luminance of linear sRGB (ITU-R BT.709).
pub(crate) fn luminance([r, g, b]: Rgb) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

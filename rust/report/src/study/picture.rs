//! Small pictures as a page embeds them: PNG in base64.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glimt_image::{Image, Rgb, Rows};
use serde::{Deserialize, Serialize};

use crate::image::exposure::shown;

/// A PNG in base64.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Picture(String);

/// Colours of maps from 0 to 1, evenly spaced: dark violet over red and orange to pale yellow, rising in lightness.
const MAP: [[u8; 3]; 7] = [
    [6, 4, 20],
    [61, 15, 90],
    [128, 33, 108],
    [193, 62, 83],
    [237, 112, 47],
    [251, 179, 50],
    [252, 248, 180],
];

impl Picture {
    /// An image as a display shows it; transparent where it is not finite.
    #[must_use]
    pub fn shown(image: &Image, exposure: f32) -> Picture {
        rgba(image, |i| shown(image.pixels()[i], exposure))
    }

    /// |image − truth| times a scale, as a display shows it.
    #[must_use]
    pub fn difference(truth: &Image, image: &Image, scale: f32) -> Picture {
        let difference = |i: usize| {
            let (a, b) = (truth.pixels()[i], image.pixels()[i]);
            shown([0, 1, 2].map(|c| (a[c] - b[c]).abs()), scale)
        };
        rgba(image, difference)
    }

    /// Values from 0 to 1 by pixel of `image` as colours.
    #[must_use]
    pub fn map(values: &[f32], image: &Image) -> Picture {
        let color = |i: usize| {
            let place = values[i].clamp(0.0, 1.0) * (MAP.len() - 1) as f32;
            let (step, rest) =
                ((place as usize).min(MAP.len() - 2), place - (place as usize).min(MAP.len() - 2) as f32);
            [0, 1, 2].map(|c| {
                let (a, b) = (f32::from(MAP[step][c]), f32::from(MAP[step + 1][c]));
                (a + rest * (b - a)) / 255.0
            })
        };
        rgba(image, color)
    }

    /// The `src` of an image in a page.
    #[must_use]
    pub fn source(&self) -> String {
        format!("data:image/png;base64,{}", self.0)
    }
}

/// A PNG with the colours that `color` says, transparent where `image` is not finite.
fn rgba(image: &Image, color: impl Fn(usize) -> Rgb) -> Picture {
    let [width, height] = image.size();
    let mut bytes = Vec::with_capacity(4 * width * height);
    for (i, pixel) in image.pixels().iter().enumerate() {
        if pixel.iter().all(|x| x.is_finite()) {
            bytes.extend(color(i).map(|x| (x * 255.0).round() as u8));
            bytes.push(255);
        } else {
            bytes.extend([0; 4]);
        }
    }
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::High);
    let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(&bytes));
    written.expect("memory takes all, and there are as many bytes as pixels need");
    Picture(STANDARD.encode(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_a_png_of_its_colours() {
        let image = Image::new(2, vec![[0.0; 3], [1.0, 0.0, 0.5], [f32::NAN; 3], [2.0; 3]]);
        let Picture(text) = Picture::shown(&image, 1.0);
        let file = STANDARD.decode(text).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        assert_eq!(bytes, [0, 0, 0, 255, 255, 0, 188, 255, 0, 0, 0, 0, 255, 255, 255, 255]);
    }
}

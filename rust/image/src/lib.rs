//! Images of linear sRGB radiance, in memory and as OpenEXR files.

pub mod error;
pub mod exr;

use std::ops::Range;

pub use error::Error;

/// A linear sRGB colour.
pub type Rgb = [f32; 3];

/// An image that can be read some rows at a time, so that memory need not hold it.
pub trait Rows {
    /// Width and height in pixels.
    fn size(&self) -> [usize; 2];

    /// The pixels of `rows`, row by row from the top.
    ///
    /// # Errors
    /// What the file system or the format says.
    fn read(&self, rows: Range<usize>) -> Result<Vec<Rgb>, Error>;
}

/// An image in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    width: usize,
    pixels: Vec<Rgb>,
}

impl Image {
    /// An image from its rows, top first.
    ///
    /// # Panics
    /// If `pixels` are no whole number of rows.
    #[must_use]
    pub fn new(width: usize, pixels: Vec<Rgb>) -> Self {
        assert!(width > 0 && pixels.len().is_multiple_of(width), "whole rows of pixels");
        Image { width, pixels }
    }

    /// All of another image, in memory.
    ///
    /// # Errors
    /// What reading it says.
    pub fn hold(image: &dyn Rows) -> Result<Self, Error> {
        let [width, height] = image.size();
        Ok(Image::new(width, image.read(0..height)?))
    }

    /// The pixels, row by row from the top.
    #[must_use]
    pub fn pixels(&self) -> &[Rgb] {
        &self.pixels
    }
}

impl Rows for Image {
    fn size(&self) -> [usize; 2] {
        [self.width, self.pixels.len() / self.width]
    }

    fn read(&self, rows: Range<usize>) -> Result<Vec<Rgb>, Error> {
        Ok(self.pixels[rows.start * self.width..rows.end * self.width].to_vec())
    }
}

//! From images to maps.

use std::sync::Arc;

use crate::error::Error;
use crate::finding::{Finding, Map, Oddity};
use crate::green::{COMPARED, points_up};
use crate::image::{Curve, Image, Texels};
use crate::maps::{Maps, resized_roughness, resized_slopes};
use crate::names::Green;
use crate::normal::{STEEPEST, bounded, is_no_normal, length, slope_of, vector_of};
use crate::recipe::{Channel, Color, Normals, Recipe, SPECULAR, Scalar};
use crate::resample::resample;

/// Bytes of a texel of [`Maps`], and of slopes while they become normals.
const TEXEL: u64 = 52;

/// The image whose decoding takes most, and what it and the maps take in bytes.
pub(crate) fn memory(recipe: &Recipe, size: [usize; 2]) -> (Option<&Arc<Image>>, u64) {
    let images = recipe.images().map(|(_, image)| image).chain(&recipe.normal.heights);
    let hungriest = images.reduce(|a, b| if b.memory() > a.memory() { b } else { a });
    let result = (size[0] as u64).saturating_mul(size[1] as u64).saturating_mul(TEXEL);
    (hungriest, result.saturating_add(hungriest.map_or(0, |image| image.memory())))
}

/// Decodes all images, one after another.
pub(crate) fn decode(recipe: &Recipe, size: [usize; 2]) -> Result<Maps, Error> {
    let mut decoder = Decoder { size, last: None, findings: Vec::new() };
    let base_color = decoder.color(&recipe.base_color)?;
    let roughness = decoder.scalar(Map::Roughness, &recipe.roughness)?;
    let metalness = decoder.scalar(Map::Metalness, &recipe.metalness)?;
    let (normal, variance) = decoder.normals(&recipe.normal)?;
    let specular = decoder.scalar(Map::Specular, &recipe.specular)?;
    Ok(Maps {
        size,
        base_color,
        roughness,
        metalness,
        normal,
        variance,
        specular,
        findings: decoder.findings,
    })
}

struct Decoder {
    size: [usize; 2],
    /// The image that was decoded last: roughness and metalness may be packed into one.
    last: Option<(Arc<Image>, Curve, Texels)>,
    findings: Vec<Finding>,
}

impl Decoder {
    fn texels(&mut self, map: Map, image: &Arc<Image>, curve: Curve) -> Result<&Texels, Error> {
        if image.size != self.size {
            let (file, from, to) = (image.file(), image.size, self.size);
            self.findings.push(Finding::Resized { map, file, from, to });
        }
        // The old one goes before the new one comes.
        let kept =
            self.last.take().filter(|(last, last_curve, _)| Arc::ptr_eq(last, image) && *last_curve == curve);
        let texels = match kept {
            Some((_, _, texels)) => texels,
            None => image.decode(curve)?,
        };
        Ok(&self.last.insert((image.clone(), curve, texels)).2)
    }

    fn color(&mut self, color: &Color) -> Result<Vec<[f32; 3]>, Error> {
        let scaled = |texel: [f32; 3]| [0, 1, 2].map(|i| texel[i] * color.factor[i]);
        let clean = |texel: [f32; 3]| scaled(texel).map(|x| tidy(x, fallback(Map::BaseColor)));
        let Some(image) = &color.image else { return Ok(vec![clean([1.0; 3]); self.size[0] * self.size[1]]) };
        let to = self.size;
        let texels = self.texels(Map::BaseColor, image, Curve::Srgb)?;
        let all = 0..image.texels() as usize;
        let count = |is: &dyn Fn(usize) -> bool| all.clone().filter(|&i| is(i)).count() as u64;
        let odd = [
            (Oddity::NotFinite, count(&|i| scaled(texels.color(i)).iter().any(|x| !x.is_finite()))),
            (Oddity::OutOfRange, count(&|i| scaled(texels.color(i)).into_iter().any(is_out_of_range))),
            (Oddity::Transparent, count(&|i| texels.alpha(i) < 0.999)),
        ];
        let colors = resample(image.size, to, |i| clean(texels.color(i)));
        self.note(Map::BaseColor, image, odd);
        Ok(colors)
    }

    fn scalar(&mut self, map: Map, scalar: &Scalar) -> Result<Vec<f32>, Error> {
        let clean = |x: f32| tidy(scalar.offset + scalar.scale * x, fallback(map));
        let Some(image) = &scalar.image else { return Ok(vec![clean(1.0); self.size[0] * self.size[1]]) };
        let to = self.size;
        let texels = self.texels(map, image, Curve::Linear)?;
        let value = |i: usize| match scalar.channel {
            Channel::Red => texels.color(i)[0],
            Channel::Green => texels.color(i)[1],
            Channel::Blue => texels.color(i)[2],
            Channel::Alpha => texels.alpha(i),
        };
        let all = 0..image.texels() as usize;
        let count = |is: &dyn Fn(usize) -> bool| all.clone().filter(|&i| is(i)).count() as u64;
        let is_colored = |i: usize| scalar.channel == Channel::Red && spread(texels.color(i)) > 0.05;
        let odd = [
            (Oddity::NotFinite, count(&|i| !value(i).is_finite())),
            (Oddity::OutOfRange, count(&|i| is_out_of_range(value(i)))),
            (Oddity::Colored, count(&is_colored)),
        ];
        let values = match map {
            Map::Roughness => resized_roughness(image.size, to, |i| clean(value(i))),
            _ => resample(image.size, to, |i| [clean(value(i))]).into_flattened(),
        };
        self.note(map, image, odd);
        Ok(values)
    }

    /// Normals, and the variance of their slopes within a texel.
    fn normals(&mut self, normals: &Normals) -> Result<(Vec<[f32; 3]>, Vec<f32>), Error> {
        let flat = [0.0, 0.0, 1.0];
        let number = self.size[0] * self.size[1];
        let Some(image) = &normals.image else { return Ok((vec![flat; number], vec![0.0; number])) };
        let to = self.size;
        let reduced = normals.heights.as_ref().and_then(|heights| self.heights(heights, image));
        let texels = self.texels(Map::Normal, image, Curve::Linear)?;
        let is_up = reduced.as_ref().map(|(size, heights)| {
            let slopes = resample(image.size, *size, |i| slope_of(vector_of(texels.color(i))).map(bounded));
            points_up(*size, heights, &slopes)
        });
        let up = if normals.green == Green::Down || is_up == Some(Some(false)) { -1.0 } else { 1.0 };
        let vector = |i: usize| {
            let [x, y, z] = vector_of(texels.color(i));
            [x, up * y, z]
        };
        let all = 0..image.texels() as usize;
        let count = |is: &dyn Fn(usize) -> bool| all.clone().filter(|&i| is(i)).count() as u64;
        let odd = [
            (Oddity::NotFinite, count(&|i| !length(vector(i)).is_finite())),
            (Oddity::Length, count(&|i| (length(vector(i)) - 1.0).abs() > 0.1)),
            (Oddity::Steep, count(&|i| vector(i)[2] * STEEPEST < length(vector(i)))),
        ];
        let colored = count(&|i| spread(texels.color(i)) > 0.02);
        let impossible = count(&|i| is_no_normal(vector(i)));
        refuse_what_is_no_normal(image, colored, impossible)?;
        let slope = |i: usize| slope_of(vector(i)).map(|s| bounded(s * normals.scale));
        let result = resized_slopes(image.size, to, slope, |_| 0.0);
        if let (Some(heights), Some(is_up)) = (&normals.heights, is_up) {
            self.findings.push(Finding::Green { file: image.file(), heights: heights.file(), is_up });
        }
        self.note(Map::Normal, image, odd);
        Ok(result)
    }

    /// Heights in a size that is small enough to compare. Those that are broken say nothing.
    fn heights(&mut self, heights: &Image, normals: &Image) -> Option<([usize; 2], Vec<[f32; 1]>)> {
        // One image at a time.
        self.last = None;
        let size = [0, 1].map(|i| normals.size[i].min(heights.size[i]).min(COMPARED));
        let texels = heights.decode(Curve::Linear).ok()?;
        Some((size, resample(heights.size, size, |i| [texels.color(i)[0]])))
    }

    fn note(&mut self, map: Map, image: &Image, odd: impl IntoIterator<Item = (Oddity, u64)>) {
        for (what, count) in odd.into_iter().filter(|(_, count)| *count > 0) {
            self.findings.push(Finding::Odd { map, file: image.file(), what, count, of: image.texels() });
        }
    }
}

/// A height map that is called a normal map is grey, or its vectors point anywhere.
fn refuse_what_is_no_normal(image: &Image, colored: u64, impossible: u64) -> Result<(), Error> {
    let of = image.texels();
    let found = if colored == 0 {
        "all its texels are grey, as in a map of heights".to_owned()
    } else if impossible > of / 2 {
        format!("{impossible} of its {of} texels point below the surface, or are much too short or long")
    } else {
        return Ok(());
    };
    Err(Error::NotNormals { path: image.path().to_owned(), found })
}

fn spread([r, g, b]: [f32; 3]) -> f32 {
    r.max(g).max(b) - r.min(g).min(b)
}

fn is_out_of_range(x: f32) -> bool {
    // Half floats round, and filters ring.
    (x - 0.5).abs() > 0.501
}

fn tidy(x: f32, fallback: f32) -> f32 {
    if x.is_finite() { x.clamp(0.0, 1.0) } else { fallback }
}

/// What a number that is not finite is taken as.
fn fallback(map: Map) -> f32 {
    match map {
        Map::Roughness => 0.5,
        Map::Specular => SPECULAR,
        Map::BaseColor | Map::Metalness | Map::Normal => 0.0,
    }
}

//! From images to the parameters of a material at every texel.

use std::sync::Arc;

use crate::error::Error;
use crate::finding::{Finding, Map, Oddity};
use crate::image::{Curve, Image, Texels};
use crate::names::Green;
use crate::recipe::{Channel, Color, Normals, Recipe, SPECULAR, Scalar};
use crate::resample::resample;

/// The size that maps should have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// That of the largest image, so that nothing is lost.
    Own,
    /// As [`Size::Own`], but smaller where the longer side has more texels than this; the shape stays.
    LongestSide(usize),
    /// This width and height, whatever the shape of the images.
    Exactly([usize; 2]),
}

/// The parameters of a metallic-roughness material at every texel, row by row from the top of the image.
///
/// All numbers but normals are from 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Maps {
    /// Width and height.
    pub size: [usize; 2],
    /// Linear sRGB: albedo of what is no metal, reflectance at normal incidence of metal.
    pub base_color: Vec<[f32; 3]>,
    /// Perceptual roughness r as it is painted. The α of GGX is r².
    pub roughness: Vec<f32>,
    /// Share of metal.
    pub metalness: Vec<f32>,
    /// Unit vectors: x to the right in the image, y up in it, z out of the surface and above 0.
    pub normal: Vec<[f32; 3]>,
    /// Reflectance at normal incidence of what is no metal: 0.04 where nothing else is said.
    pub specular: Vec<f32>,
    /// What was resized or odd.
    pub findings: Vec<Finding>,
}

/// Bytes of a texel of [`Maps`].
const TEXEL: u64 = 36;

/// The steepest slope that is kept, 86°: quotients of small numbers of 8 bits say nothing beyond.
const STEEPEST: f32 = 16.0;

impl Maps {
    /// The maps in another size: box-filtered along a side that becomes shorter, bilinear and around the edges along
    /// one that becomes longer.
    ///
    /// Normals are averaged as slopes n_x/n_z and n_y/n_z. The mean slope of a patch is that of the surface from one
    /// edge to the other, so that a tile that closes stays flat in the mean, and two steps give what one gives. Means
    /// of unit vectors tilt towards the gentler side of a groove. Roughness is averaged as it is: what normals vary
    /// within a texel is not added to it.
    ///
    /// # Panics
    /// If a side has no texel.
    #[must_use]
    pub fn resized(&self, size: [usize; 2]) -> Maps {
        assert!(!size.contains(&0), "maps of at least one texel");
        if size == self.size {
            return self.clone();
        }
        let scalar =
            |values: &[f32]| resample(self.size, size, |i| [values[i]]).into_iter().flatten().collect();
        let slopes = resample(self.size, size, |i| {
            let [x, y, z] = self.normal[i];
            [x / z, y / z]
        });
        Maps {
            size,
            base_color: resample(self.size, size, |i| self.base_color[i]),
            roughness: scalar(&self.roughness),
            metalness: scalar(&self.metalness),
            normal: slopes.into_iter().map(normal_of).collect(),
            specular: scalar(&self.specular),
            findings: self.findings.clone(),
        }
    }

    /// A rectangle of the maps, from the column and row of its `corner` at the top left.
    ///
    /// # Panics
    /// If it has no texel, or reaches beyond the maps.
    #[must_use]
    pub fn cropped(&self, corner: [usize; 2], size: [usize; 2]) -> Maps {
        let is_within =
            |i: usize| size[i] > 0 && corner[i] <= self.size[i] && size[i] <= self.size[i] - corner[i];
        assert!(is_within(0) && is_within(1), "a rectangle of the maps");
        let rows = || (corner[1]..corner[1] + size[1]).map(|y| y * self.size[0] + corner[0]);
        let scalar = |values: &[f32]| rows().flat_map(|start| &values[start..][..size[0]]).copied().collect();
        let vector =
            |values: &[[f32; 3]]| rows().flat_map(|start| &values[start..][..size[0]]).copied().collect();
        Maps {
            size,
            base_color: vector(&self.base_color),
            roughness: scalar(&self.roughness),
            metalness: scalar(&self.metalness),
            normal: vector(&self.normal),
            specular: scalar(&self.specular),
            findings: self.findings.clone(),
        }
    }
}

/// The unit vector of a slope.
fn normal_of([x, y]: [f32; 2]) -> [f32; 3] {
    let length = (1.0 + f64::from(x) * f64::from(x) + f64::from(y) * f64::from(y)).sqrt();
    [(f64::from(x) / length) as f32, (f64::from(y) / length) as f32, (1.0 / length) as f32]
}

/// The size of maps of a recipe.
pub(crate) fn size_of(recipe: &Recipe, size: Size) -> [usize; 2] {
    let own = recipe.largest().map_or([1, 1], |image| image.size);
    match size {
        Size::Own => own,
        Size::Exactly(size) => size,
        Size::LongestSide(most) => {
            let longest = own[0].max(own[1]);
            if longest <= most {
                return own;
            }
            own.map(|side| {
                ((side as f64 * most as f64 / longest as f64).round() as usize).clamp(1, most.max(1))
            })
        }
    }
}

/// The image whose decoding takes most, and what it and the maps take in bytes.
pub(crate) fn memory(recipe: &Recipe, size: [usize; 2]) -> (Option<&Arc<Image>>, u64) {
    let images = recipe.images().map(|(_, image)| image);
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
    let normal = decoder.normals(&recipe.normal)?;
    let specular = decoder.scalar(Map::Specular, &recipe.specular)?;
    Ok(Maps { size, base_color, roughness, metalness, normal, specular, findings: decoder.findings })
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
        let values = resample(image.size, to, |i| [clean(value(i))]).into_flattened();
        self.note(map, image, odd);
        Ok(values)
    }

    fn normals(&mut self, normals: &Normals) -> Result<Vec<[f32; 3]>, Error> {
        let flat = [0.0, 0.0, 1.0];
        let Some(image) = &normals.image else { return Ok(vec![flat; self.size[0] * self.size[1]]) };
        let to = self.size;
        let up = if normals.green == Green::Down { -1.0 } else { 1.0 };
        let texels = self.texels(Map::Normal, image, Curve::Linear)?;
        let vector = |i: usize| {
            let [r, g, b] = texels.color(i);
            [2.0 * r - 1.0, up * (2.0 * g - 1.0), 2.0 * b - 1.0]
        };
        let all = 0..image.texels() as usize;
        let count = |is: &dyn Fn(usize) -> bool| all.clone().filter(|&i| is(i)).count() as u64;
        let odd = [
            (Oddity::NotFinite, count(&|i| !length(vector(i)).is_finite())),
            (Oddity::Length, count(&|i| (length(vector(i)) - 1.0).abs() > 0.1)),
            (Oddity::Steep, count(&|i| vector(i)[2] * STEEPEST < length(vector(i)))),
        ];
        let colored = count(&|i| spread(texels.color(i)) > 0.02);
        refuse_what_is_no_normal(image, colored, odd[1].1)?;
        let slope = |i: usize| slope_of(vector(i)).map(|s| bounded(s * normals.scale));
        let result = resample(image.size, to, slope).into_iter().map(normal_of).collect();
        self.note(Map::Normal, image, odd);
        Ok(result)
    }

    fn note(&mut self, map: Map, image: &Image, odd: impl IntoIterator<Item = (Oddity, u64)>) {
        for (what, count) in odd.into_iter().filter(|(_, count)| *count > 0) {
            self.findings.push(Finding::Odd { map, file: image.file(), what, count, of: image.texels() });
        }
    }
}

/// A height map that is called a normal map is grey, or has vectors of any length.
fn refuse_what_is_no_normal(image: &Image, colored: u64, odd_lengths: u64) -> Result<(), Error> {
    let of = image.texels();
    let found = if colored == 0 {
        "all its texels are grey, as in a map of heights".to_owned()
    } else if odd_lengths > of / 2 {
        format!("{odd_lengths} of its {of} texels have a length far from 1")
    } else {
        return Ok(());
    };
    Err(Error::NotNormals { path: image.path().to_owned(), found })
}

fn length([x, y, z]: [f32; 3]) -> f32 {
    (x * x + y * y + z * z).sqrt()
}

fn spread([r, g, b]: [f32; 3]) -> f32 {
    r.max(g).max(b) - r.min(g).min(b)
}

fn slope_of(vector: [f32; 3]) -> [f32; 2] {
    let z = vector[2].max(length(vector) / STEEPEST);
    [vector[0] / z, vector[1] / z]
}

fn bounded(slope: f32) -> f32 {
    // 0/0 of a vector of no length.
    if slope.is_nan() { 0.0 } else { slope.clamp(-STEEPEST, STEEPEST) }
}

fn is_out_of_range(x: f32) -> bool {
    // Half floats round, and filters ring.
    x < -1e-3 || x > 1.0 + 1e-3
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

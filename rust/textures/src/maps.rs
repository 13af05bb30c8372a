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
        let result = resample(image.size, to, slope).into_iter().map(normal_of).collect();
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

/// The longest side of heights and normals that are compared.
const COMPARED: usize = 256;

/// Whether y points up in the image in these slopes of normals, which are −∂h/∂x and −∂h/∂y of the heights h. What is
/// painted as heights may be depths: that shows along x.
fn points_up(size: [usize; 2], heights: &[[f32; 1]], slopes: &[[f32; 2]]) -> Option<bool> {
    let [width, height] = size;
    let at = |x: usize, y: usize| f64::from(heights[y % height * width + x % width][0]);
    let (mut across, mut along) = (Correlation::default(), Correlation::default());
    for y in 0..height {
        for x in 0..width {
            let [right, up] = slopes[y * width + x].map(f64::from);
            across.add(right, at(x + width - 1, y) - at(x + 1, y));
            // Rows go down.
            along.add(up, at(x, y + 1) - at(x, y + height - 1));
        }
    }
    let sign = if across.value() < -CLEAR { -1.0 } else { 1.0 };
    let agreement = sign * along.value();
    (agreement.abs() > CLEAR).then_some(agreement > 0.0)
}

/// A correlation that says something.
const CLEAR: f64 = 0.3;

/// The correlation of numbers whose means are 0, as those of slopes of a closed tile are.
#[derive(Default)]
struct Correlation {
    squares: [f64; 2],
    products: f64,
}

impl Correlation {
    fn add(&mut self, a: f64, b: f64) {
        if a.is_finite() && b.is_finite() {
            self.squares[0] += a * a;
            self.squares[1] += b * b;
            self.products += a * b;
        }
    }

    /// 0 where there is nothing to compare.
    fn value(&self) -> f64 {
        let scale = (self.squares[0] * self.squares[1]).sqrt();
        if scale > 0.0 { self.products / scale } else { 0.0 }
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

/// Averaged normals are shorter than 1: those of ambientCG's Wood047 are 0.84 in the mean.
fn is_no_normal(vector: [f32; 3]) -> bool {
    !(0.3..1.5).contains(&length(vector)) || vector[2] <= 0.0
}

fn vector_of(color: [f32; 3]) -> [f32; 3] {
    color.map(|x| 2.0 * x - 1.0)
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

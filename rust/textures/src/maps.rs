//! The parameters of a material at every texel.

use crate::finding::Finding;
use crate::normal::normal_of;
use crate::recipe::Recipe;
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
/// All numbers but normals and their variance are from 0 to 1.
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
    /// Variance of the slopes within a texel, the sum of both axes: what a reduction took from the normals.
    pub variance: Vec<f32>,
    /// Reflectance at normal incidence of what is no metal: 0.04 where nothing else is said.
    pub specular: Vec<f32>,
    /// What was resized or odd.
    pub findings: Vec<Finding>,
}

impl Maps {
    /// The maps in another size: box-filtered along a side that becomes shorter, bilinear and around the edges along
    /// one that becomes longer.
    ///
    /// Normals are averaged as slopes n_x/n_z and n_y/n_z. The mean slope of a patch is that of the surface from one
    /// edge to the other, so that a tile that closes stays flat in the mean, and two steps give what one gives. Means
    /// of unit vectors tilt towards the gentler side of a groove. Roughness is averaged as r², the α of GGX. What
    /// normals vary within a texel is not added to it but kept beside it, as the variance.
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
        let slope = |i: usize| {
            let [x, y, z] = self.normal[i];
            [x / z, y / z]
        };
        let (normal, variance) = resized_slopes(self.size, size, slope, |i| self.variance[i]);
        Maps {
            size,
            base_color: resample(self.size, size, |i| self.base_color[i]),
            roughness: resized_roughness(self.size, size, |i| self.roughness[i]),
            metalness: scalar(&self.metalness),
            normal,
            variance,
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
            variance: scalar(&self.variance),
            specular: scalar(&self.specular),
            findings: self.findings.clone(),
        }
    }
}

/// Perceptual roughness in another size, averaged as α = r². That is what mips of α do, so that fewer texels are a
/// mip of more of them.
pub(crate) fn resized_roughness(
    from: [usize; 2],
    to: [usize; 2],
    roughness: impl Fn(usize) -> f32,
) -> Vec<f32> {
    // The root of a square is the number to the bit.
    resample(from, to, |i| [roughness(i) * roughness(i)]).into_iter().map(|[alpha]| alpha.sqrt()).collect()
}

/// Slopes in another size as normals, and their variance within a texel besides what is there already.
pub(crate) fn resized_slopes(
    from: [usize; 2],
    to: [usize; 2],
    slope: impl Fn(usize) -> [f32; 2],
    variance: impl Fn(usize) -> f32,
) -> (Vec<[f32; 3]>, Vec<f32>) {
    // Between the texels of an enlarged map slopes are linear, which is no roughness.
    let is_reduced = from != to && to[0] <= from[0] && to[1] <= from[1];
    let moments = resample(from, to, |i| {
        let [x, y] = slope(i);
        [x, y, if is_reduced { x * x + y * y } else { 0.0 }, variance(i)]
    });
    let varied = |[x, y, square, before]: [f32; 4]| {
        let within = if is_reduced { (square - x * x - y * y).max(0.0) } else { 0.0 };
        (normal_of([x, y]), before + within)
    };
    moments.into_iter().map(varied).unzip()
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

//! Numbers over a surface at every size: textures with mip maps.
//!
//! Level 0 is the texture; each next one has half the size, rounded up, down to one texel. A texel of level l holds
//! what a Gaussian of half a texel's width sees. Between texels numbers are linear, and so they are between levels.

use serde::{Deserialize, Serialize};

use super::place::{Ellipse, Place};
use crate::error::Invalid;

/// What lies beyond the edges of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Wrap {
    /// The texture again.
    Repeat,
    /// Its edge.
    Clamp,
}

/// Most texels along the longer axis of a footprint; beyond that it is shortened, as graphics cards do.
const MOST_TAPS: f32 = 16.0;

/// Where the texels of a pyramid are: level after level from the finest, each row by row from the bottom, as v goes
/// up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    levels: Vec<Level>,
    wrap: Wrap,
}

/// One size of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Level {
    width: usize,
    height: usize,
    /// Texels of finer levels, which come before.
    first: usize,
}

impl Layout {
    /// Of a texture whose level 0 has this size.
    ///
    /// # Panics
    /// If there is no texel.
    #[must_use]
    pub fn new([width, height]: [usize; 2], wrap: Wrap) -> Layout {
        assert!(width > 0 && height > 0, "a texture has texels");
        let mut levels = vec![Level { width, height, first: 0 }];
        while let Some(&level) = levels.last()
            && level.texels() > 1
        {
            let (width, height) = (level.width.div_ceil(2), level.height.div_ceil(2));
            levels.push(Level { width, height, first: level.first + level.texels() });
        }
        Layout { levels, wrap }
    }

    /// Width and height of level 0.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        [self.levels[0].width, self.levels[0].height]
    }

    /// Width and height of every level, from the finest.
    pub fn sizes(&self) -> impl ExactSizeIterator<Item = [usize; 2]> {
        self.levels.iter().map(|level| [level.width, level.height])
    }

    /// Where the texels of a level are among those of all.
    ///
    /// # Panics
    /// If there is no such level.
    #[must_use]
    pub fn texels_of(&self, level: usize) -> std::ops::Range<usize> {
        let level = self.levels[level];
        level.first..level.first + level.texels()
    }

    /// Texels of all levels.
    #[must_use]
    pub fn texels(&self) -> usize {
        self.texels_of(self.levels.len() - 1).end
    }

    /// What lies beyond the edges.
    #[must_use]
    pub fn wrap(&self) -> Wrap {
        self.wrap
    }

    /// The texels that a footprint sees, and their weights, whose sum is 1. The level is that of the footprint's
    /// shorter axis, and up to 16 places lie along the longer one. A place that is no number is (0, 0). Texels come
    /// more than once where they serve several places.
    #[inline(always)]
    pub fn taps(&self, place: &Place, mut tap: impl FnMut(usize, f32)) {
        self.places(place, |uv, weight, level| self.trilinear(uv, level, weight, &mut tap));
    }

    /// The points, weights and the level by which a footprint is seen.
    #[inline(always)]
    fn places(&self, place: &Place, mut point: impl FnMut([f64; 2], f32, f32)) {
        let size = self.size().map(|texels| texels as f32);
        let uv = finite(place.uv);
        let ellipse = Ellipse::new(place.footprint, size);
        let taps = (ellipse.major / ellipse.minor.max(0.5)).ceil().clamp(1.0, MOST_TAPS);
        // Places are two texels apart, over which texels are blended, or less: none between them is left out.
        let level = (2.0 * ellipse.minor.max(ellipse.major / taps)).log2().max(0.0);
        if taps <= 1.0 {
            return point(uv, 1.0, level);
        }
        // Places of equal distance over two standard deviations to either side, weighted by the Gaussian.
        let [x, y] = ellipse.direction();
        let offset = |tap: usize| 2.0 * ((2 * tap + 1) as f32 / taps - 1.0);
        let weight = |tap: usize| (-0.5 * offset(tap) * offset(tap)).exp();
        let whole: f32 = (0..taps as usize).map(weight).sum();
        for tap in 0..taps as usize {
            let along = offset(tap) * ellipse.major;
            let at = [uv[0] + f64::from(along * x / size[0]), uv[1] + f64::from(along * y / size[1])];
            point(at, weight(tap) / whole, level);
        }
    }

    /// A level, the way from it to the next coarser one, and whether there is one.
    fn between_levels(&self, level: f32) -> (usize, f32) {
        let last = self.levels.len() - 1;
        let fine = (level as usize).min(last);
        (fine, if fine == last { 0.0 } else { level - fine as f32 })
    }

    #[inline(always)]
    fn trilinear(&self, uv: [f64; 2], level: f32, weight: f32, tap: &mut impl FnMut(usize, f32)) {
        let (fine, between) = self.between_levels(level);
        self.levels[fine].bilinear(uv, self.wrap, weight * (1.0 - between), tap);
        if between > 0.0 {
            self.levels[fine + 1].bilinear(uv, self.wrap, weight * between, tap);
        }
    }
}

/// A place that is no number is the origin.
#[inline(always)]
fn finite(uv: [f32; 2]) -> [f64; 2] {
    uv.map(|x| if x.is_finite() { f64::from(x) } else { 0.0 })
}

impl Level {
    fn texels(self) -> usize {
        self.width * self.height
    }

    #[inline(always)]
    fn bilinear(self, uv: [f64; 2], wrap: Wrap, weight: f32, tap: &mut impl FnMut(usize, f32)) {
        let ([left, right], x) = between(uv[0], self.width, wrap);
        let ([below, above], y) = between(uv[1], self.height, wrap);
        let (below, above) = (self.first + below * self.width, self.first + above * self.width);
        let (up, down) = (weight * y, weight * (1.0 - y));
        tap(below + left, down * (1.0 - x));
        tap(below + right, down * x);
        tap(above + left, up * (1.0 - x));
        tap(above + right, up * x);
    }
}

/// `C` numbers at every texel of every level.
#[derive(Clone, Debug, PartialEq)]
pub struct Pyramid<const C: usize> {
    layout: Layout,
    texels: Vec<[f32; C]>,
}

impl<const C: usize> Pyramid<C> {
    /// Of a texture, row by row from the bottom. Each coarser level is the exact mean of the one before it: textures
    /// of any size lose nothing.
    ///
    /// # Errors
    /// [`Invalid::Parts`] for a texture without texels or of rows that differ.
    pub fn new(width: usize, texels: Vec<[f32; C]>, wrap: Wrap) -> Result<Self, Invalid> {
        if width == 0 || texels.is_empty() || !texels.len().is_multiple_of(width) {
            return Err(Invalid::Parts(format!("{} texels do not make rows of {width}", texels.len())));
        }
        let layout = Layout::new([width, texels.len() / width], wrap);
        let mut pyramid = Pyramid { layout, texels };
        for level in 1..pyramid.layout.levels.len() {
            pyramid.push_half(level);
        }
        Ok(pyramid)
    }

    /// Of the texels of all levels.
    ///
    /// # Errors
    /// [`Invalid::Parts`] if they are more or less than the layout has.
    pub fn of_levels(layout: Layout, texels: Vec<[f32; C]>) -> Result<Self, Invalid> {
        if texels.len() == layout.texels() {
            Ok(Pyramid { layout, texels })
        } else {
            let (found, expected) = (texels.len(), layout.texels());
            Err(Invalid::Parts(format!("a pyramid has {found} texels, expected {expected}")))
        }
    }

    /// Where its texels are.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Level 0, row by row from the bottom.
    #[must_use]
    pub fn texels(&self) -> &[[f32; C]] {
        &self.texels[self.layout.texels_of(0)]
    }

    /// All levels.
    #[must_use]
    pub fn all_texels(&self) -> &[[f32; C]] {
        &self.texels
    }

    /// The coarsest texel.
    #[must_use]
    pub fn mean(&self) -> &[f32; C] {
        &self.texels[self.texels.len() - 1]
    }

    /// What a footprint sees, see [`Layout::taps`]. Where all texels are the same, it is they to the bit.
    #[must_use]
    #[inline(always)]
    pub fn fetch(&self, place: &Place) -> [f32; C] {
        let (mut mean, mut whole) = ([0.0; C], 0.0);
        self.layout.places(place, |uv, weight, level| {
            let seen = self.trilinear(uv, level);
            whole += weight;
            // The mean moves towards each place by its share: it stays where all are the same.
            let share = weight / whole;
            for c in 0..C {
                mean[c] += share * (seen[c] - mean[c]);
            }
        });
        mean
    }

    /// Between the texels of level 0.
    #[must_use]
    #[inline(always)]
    pub fn at_point(&self, uv: [f32; 2]) -> [f32; C] {
        self.bilinear(0, finite(uv))
    }

    #[inline(always)]
    fn trilinear(&self, uv: [f64; 2], level: f32) -> [f32; C] {
        let (fine, between) = self.layout.between_levels(level);
        let near = self.bilinear(fine, uv);
        if between <= 0.0 {
            return near;
        }
        let far = self.bilinear(fine + 1, uv);
        let mut seen = near;
        for c in 0..C {
            seen[c] += (far[c] - near[c]) * between;
        }
        seen
    }

    /// Between the four nearest texels.
    #[inline(always)]
    fn bilinear(&self, level: usize, uv: [f64; 2]) -> [f32; C] {
        let Level { width, height, first } = self.layout.levels[level];
        let (columns, x) = between(uv[0], width, self.layout.wrap);
        let (rows, y) = between(uv[1], height, self.layout.wrap);
        let texels = &self.texels[first..];
        let texel = |row: usize, column: usize| &texels[rows[row] * width + columns[column]];
        let [a, b, c, d] = [texel(0, 0), texel(0, 1), texel(1, 0), texel(1, 1)];
        let mut seen = [0.0; C];
        for i in 0..C {
            let (below, above) = (a[i] + (b[i] - a[i]) * x, c[i] + (d[i] - c[i]) * x);
            seen[i] = below + (above - below) * y;
        }
        seen
    }

    /// Adds `level`, of half the size of the last.
    fn push_half(&mut self, level: usize) {
        let [Level { width, height, first }, half] =
            [self.layout.levels[level - 1], self.layout.levels[level]];
        let (columns, rows) = (shares(width, half.width), shares(height, half.height));
        for row in &rows {
            for column in &columns {
                let mut sum = [0.0; C];
                for &(y, of_row) in row {
                    for &(x, of_column) in column {
                        let texel = &self.texels[first + y * width + x];
                        for c in 0..C {
                            sum[c] += of_row * of_column * f64::from(texel[c]);
                        }
                    }
                }
                self.texels.push(sum.map(|x| x as f32));
            }
        }
    }
}

/// The two texels beside a coordinate, and how far it is on the way from the first to the second. It is wrapped in
/// float64: after some thousand tiles float32 has no digits left for the place in one.
fn between(coordinate: f64, texels: usize, wrap: Wrap) -> ([usize; 2], f32) {
    let last = texels - 1;
    let wrapped = match wrap {
        Wrap::Repeat => coordinate - coordinate.floor(),
        Wrap::Clamp => coordinate.clamp(0.0, 1.0),
    };
    let place = wrapped * texels as f64 - 0.5;
    let below = place.floor();
    let first = below as isize;
    let at = |texel: isize| match wrap {
        Wrap::Repeat => texel.rem_euclid(texels as isize) as usize,
        Wrap::Clamp => texel.clamp(0, last as isize) as usize,
    };
    ([at(first), at(first + 1)], (place - below) as f32)
}

/// Of each of `to` texels the texels of a row of `from` that it covers, with their shares of it.
fn shares(from: usize, to: usize) -> Vec<Vec<(usize, f64)>> {
    let size = from as f64 / to as f64;
    let of = |texel: usize| {
        let (start, end) = (texel as f64 * size, (texel + 1) as f64 * size);
        let covered = |i: usize| (end.min((i + 1) as f64) - start.max(i as f64)).max(0.0) / size;
        let range = start as usize..(end.ceil() as usize).min(from);
        range.map(|i| (i, covered(i))).filter(|&(_, share)| share > 0.0).collect()
    };
    (0..to).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::Footprint;
    use proptest::prelude::*;

    /// A texture of one number that has no pattern.
    fn texture(width: usize, height: usize, wrap: Wrap) -> Pyramid<1> {
        let texel = |i: usize| [((i * i + 7 * i) as f32 * 0.618).fract()];
        Pyramid::new(width, (0..width * height).map(texel).collect(), wrap).unwrap()
    }

    fn mean_of(pyramid: &Pyramid<1>) -> f64 {
        let texels = pyramid.texels();
        texels.iter().map(|texel| f64::from(texel[0])).sum::<f64>() / texels.len() as f64
    }

    #[test]
    fn every_level_has_the_mean_of_the_texture_whatever_its_size() {
        for (width, height) in [(8, 8), (10, 6), (7, 7), (1, 5), (745, 3), (1, 1), (666, 1)] {
            let pyramid = texture(width, height, Wrap::Repeat);
            let mean = mean_of(&pyramid);
            assert!((f64::from(pyramid.mean()[0]) - mean).abs() < 1e-5, "{width}×{height}");
            assert_eq!(pyramid.layout().sizes().last(), Some([1, 1]));
            let far = pyramid.fetch(&Place::far());
            assert_eq!(far, *pyramid.mean(), "{width}×{height}");
        }
    }

    #[test]
    fn centres_of_texels_are_the_texels_and_edges_are_wrapped_or_clamped() {
        let pyramid = texture(4, 4, Wrap::Repeat);
        for (i, texel) in pyramid.texels().iter().enumerate() {
            let uv = [((i % 4) as f32 + 0.5) / 4.0, ((i / 4) as f32 + 0.5) / 4.0];
            assert_eq!(pyramid.fetch(&Place::point(uv)), *texel);
            assert_eq!(pyramid.fetch(&Place::point([uv[0] - 3.0, uv[1] + 1000.0])), *texel);
        }
        let at = |pyramid: &Pyramid<1>, u: f32| pyramid.fetch(&Place::point([u, 0.125]))[0];
        let [first, last] = [pyramid.texels()[0][0], pyramid.texels()[3][0]];
        assert!((at(&pyramid, 0.0) - 0.5 * (first + last)).abs() < 1e-6);
        assert_eq!(at(&pyramid, 0.0), at(&pyramid, 1.0));
        let clamped = texture(4, 4, Wrap::Clamp);
        assert_eq!((at(&clamped, -2.0), at(&clamped, 3.0)), (first, last));
    }

    #[test]
    fn a_place_that_is_no_number_is_the_origin() {
        let pyramid = texture(4, 4, Wrap::Repeat);
        let at = |u| pyramid.fetch(&Place::point([u, f32::NAN]));
        assert_eq!(at(f32::INFINITY), pyramid.fetch(&Place::point([0.0; 2])));
    }

    #[test]
    fn rows_that_differ_are_refused() {
        assert!(Pyramid::new(3, vec![[0.0]; 4], Wrap::Repeat).unwrap_err().to_string().contains("4 texels"));
        assert!(Pyramid::<1>::new(0, Vec::new(), Wrap::Repeat).is_err());
    }

    proptest! {
        #[test]
        fn what_is_seen_lies_between_the_least_and_the_greatest(
            u in -5.0..5.0f32, v in -5.0..5.0f32, axes in prop::array::uniform2(prop::array::uniform2(-0.5..0.5f32))
        ) {
            let pyramid = texture(13, 9, Wrap::Repeat);
            let seen = pyramid.fetch(&Place { uv: [u, v], footprint: Footprint::Axes(axes) })[0];
            let (least, most) = pyramid.texels().iter().fold((1.0f32, 0.0f32), |(a, b), t| (a.min(t[0]), b.max(t[0])));
            prop_assert!(seen >= least - 1e-6 && seen <= most + 1e-6);
        }

        /// A texture of slow waves is what a Gaussian makes of it.
        #[test]
        fn a_footprint_sees_the_gaussian_mean(u in 0.0..1.0f32, v in 0.0..1.0f32, sigma in 0.01..0.15f32, turn in 0.0..3.1f32) {
            const TAU: f32 = std::f32::consts::TAU;
            let size = 64;
            let wave = |i: usize| {
                let [x, y] = [i % size, i / size].map(|i| (i as f32 + 0.5) / size as f32);
                [(TAU * x).sin(), (TAU * y).cos()]
            };
            let pyramid = Pyramid::new(size, (0..size * size).map(wave).collect(), Wrap::Repeat).unwrap();
            let (c, s) = (turn.cos(), turn.sin());
            // Four times as long as wide.
            let axes = [[sigma * c, sigma * s], [-0.25 * sigma * s, 0.25 * sigma * c]];
            let seen = pyramid.fetch(&Place { uv: [u, v], footprint: Footprint::Axes(axes) });
            let damped = |i: usize| {
                let variance = axes[0][i].powi(2) + axes[1][i].powi(2);
                (-0.5 * TAU * TAU * variance).exp()
            };
            prop_assert!((seen[0] - damped(0) * (TAU * u).sin()).abs() < 0.08, "{}", seen[0]);
            prop_assert!((seen[1] - damped(1) * (TAU * v).cos()).abs() < 0.08, "{}", seen[1]);
        }
    }
}

//! Numbers over a surface at every size: textures with mip maps.
//!
//! Level 0 is the texture; each next one has half the size, rounded up, down to one texel, and is the exact mean of
//! the one before it: textures of any size lose nothing. A texel of level l holds what a Gaussian of half a texel's
//! width sees. Between texels numbers are linear, and so they are between levels.

use serde::{Deserialize, Serialize};

use super::place::{Ellipse, Place};

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

/// `C` numbers at every texel of every level.
#[derive(Clone, Debug, PartialEq)]
pub struct Pyramid<const C: usize> {
    levels: Vec<Level<C>>,
    wrap: Wrap,
}

/// One size of a texture, row by row from the bottom: v goes up.
#[derive(Clone, Debug, PartialEq)]
struct Level<const C: usize> {
    width: usize,
    height: usize,
    texels: Vec<[f32; C]>,
}

impl<const C: usize> Pyramid<C> {
    /// Of a texture, row by row from the bottom.
    ///
    /// # Errors
    /// In words, a texture without texels or of rows that differ.
    pub fn new(width: usize, texels: Vec<[f32; C]>, wrap: Wrap) -> Result<Self, String> {
        if width == 0 || texels.is_empty() || !texels.len().is_multiple_of(width) {
            return Err(format!("{} texels do not make rows of {width}", texels.len()));
        }
        let height = texels.len() / width;
        let mut levels = vec![Level { width, height, texels }];
        while let Some(level) = levels.last()
            && level.texels.len() > 1
        {
            levels.push(level.half());
        }
        Ok(Pyramid { levels, wrap })
    }

    /// Width and height of level 0.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        [self.levels[0].width, self.levels[0].height]
    }

    /// Width and height of every level, from the finest.
    pub fn sizes(&self) -> impl Iterator<Item = [usize; 2]> {
        self.levels.iter().map(|level| [level.width, level.height])
    }

    /// Level 0, row by row from the bottom.
    #[must_use]
    pub fn texels(&self) -> &[[f32; C]] {
        &self.levels[0].texels
    }

    /// What lies beyond the edges.
    #[must_use]
    pub fn wrap(&self) -> Wrap {
        self.wrap
    }

    /// The mean of the whole texture.
    #[must_use]
    pub fn mean(&self) -> &[f32; C] {
        &self.levels[self.levels.len() - 1].texels[0]
    }

    /// What a footprint sees: the level is that of its shorter axis, and up to 16 places of it lie along the
    /// longer one. A place that is no number is (0, 0).
    #[must_use]
    pub fn fetch(&self, place: &Place) -> [f32; C] {
        let [width, height] = self.size();
        let ellipse = Ellipse::new(place.footprint, [width as f32, height as f32]);
        let taps = (ellipse.major / ellipse.minor.max(0.5)).ceil().clamp(1.0, MOST_TAPS);
        let level = (2.0 * ellipse.minor.max(ellipse.major / (2.0 * taps))).log2().max(0.0);
        let uv = place.uv.map(|x| if x.is_finite() { f64::from(x) } else { 0.0 });
        let mut sum = [0.0; C];
        let mut whole = 0.0;
        for tap in 0..taps as usize {
            // Places of equal distance over two standard deviations to either side, weighted by the Gaussian.
            let offset = 2.0 * ((2 * tap + 1) as f32 / taps - 1.0);
            let weight = (-0.5 * offset * offset).exp();
            let along = offset * ellipse.major;
            let [x, y] = ellipse.direction;
            let at =
                [uv[0] + f64::from(along * x) / width as f64, uv[1] + f64::from(along * y) / height as f64];
            let at = if taps > 1.0 { at } else { uv };
            let texel = self.trilinear(at, level);
            whole += weight;
            for c in 0..C {
                sum[c] += weight * texel[c];
            }
        }
        // One place keeps its bits.
        if taps > 1.0 { sum.map(|x| x / whole) } else { self.trilinear(uv, level) }
    }

    fn trilinear(&self, uv: [f64; 2], level: f32) -> [f32; C] {
        let last = self.levels.len() - 1;
        let fine = (level as usize).min(last);
        let between = if fine == last { 0.0 } else { level - fine as f32 };
        let near = self.levels[fine].bilinear(uv, self.wrap);
        if between <= 0.0 {
            return near;
        }
        let far = self.levels[fine + 1].bilinear(uv, self.wrap);
        std::array::from_fn(|c| near[c] + (far[c] - near[c]) * between)
    }
}

impl<const C: usize> Level<C> {
    /// The level of half the size.
    fn half(&self) -> Level<C> {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let (columns, rows) = (shares(self.width, width), shares(self.height, height));
        let texel = |row: &[(usize, f64)], column: &[(usize, f64)]| {
            let mut sum = [0.0; C];
            for &(y, of_row) in row {
                for &(x, of_column) in column {
                    let texel = &self.texels[y * self.width + x];
                    for c in 0..C {
                        sum[c] += of_row * of_column * f64::from(texel[c]);
                    }
                }
            }
            sum.map(|x| x as f32)
        };
        let texels = rows.iter().flat_map(|row| columns.iter().map(|column| texel(row, column)));
        Level { width, height, texels: texels.collect() }
    }

    /// Between the four nearest texels.
    fn bilinear(&self, uv: [f64; 2], wrap: Wrap) -> [f32; C] {
        let (columns, x) = between(uv[0], self.width, wrap);
        let (rows, y) = between(uv[1], self.height, wrap);
        let texel = |row: usize, column: usize| &self.texels[rows[row] * self.width + columns[column]];
        let [a, b, c, d] = [texel(0, 0), texel(0, 1), texel(1, 0), texel(1, 1)];
        std::array::from_fn(|i| {
            let (below, above) = (a[i] + (b[i] - a[i]) * x, c[i] + (d[i] - c[i]) * x);
            below + (above - below) * y
        })
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
            assert_eq!(pyramid.sizes().last(), Some([1, 1]));
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
        assert!(Pyramid::new(3, vec![[0.0]; 4], Wrap::Repeat).unwrap_err().contains("4 texels"));
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

//! The ways to lay points on a hemisphere that the paper compares (its §3.2.1, figure 3).

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use crate::healpix::{Healpix, Pixel, azimuth, quarter_turn};

/// A choice of points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pixelation {
    /// [`crate::healpix`]: equal areas, found in a few instructions.
    #[default]
    Healpix,
    /// Rows of equal colatitude and columns of equal azimuth, as many as HEALPix has points: crowded at
    /// the pole.
    LatLong,
    /// A Fibonacci lattice of as many points (González 2010): even, but the nearest points must be
    /// searched for. For comparisons.
    Fibonacci,
}

/// Points on a hemisphere.
#[derive(Clone, Debug)]
pub enum Hemisphere {
    /// See [`Pixelation::Healpix`].
    Healpix(Healpix),
    /// See [`Pixelation::LatLong`].
    LatLong(LatLong),
    /// See [`Pixelation::Fibonacci`].
    Fibonacci(Fibonacci),
}

impl Hemisphere {
    /// As many points as the HEALPix grid `size` has, or nearly.
    #[must_use]
    pub fn new(pixelation: Pixelation, size: Healpix) -> Self {
        match pixelation {
            Pixelation::Healpix => Hemisphere::Healpix(size),
            Pixelation::LatLong => Hemisphere::LatLong(LatLong::new(size.points())),
            Pixelation::Fibonacci => Hemisphere::Fibonacci(Fibonacci::new(size.points())),
        }
    }

    /// Number of points.
    #[must_use]
    pub fn points(&self) -> usize {
        match self {
            Hemisphere::Healpix(grid) => grid.points(),
            Hemisphere::LatLong(grid) => (grid.rows * grid.columns) as usize,
            Hemisphere::Fibonacci(grid) => grid.directions.len(),
        }
    }

    /// Where a point is.
    ///
    /// # Panics
    /// If there is no such point.
    #[must_use]
    pub fn direction(&self, point: usize) -> DVec3 {
        match self {
            Hemisphere::Healpix(grid) => grid.direction(point).into(),
            Hemisphere::LatLong(grid) => grid.direction(point),
            Hemisphere::Fibonacci(grid) => grid.directions[point].as_dvec3(),
        }
    }

    /// The pixel of a direction; of a Fibonacci lattice, the four nearest points.
    #[must_use]
    pub fn pixel(&self, direction: [f32; 3]) -> Pixel {
        match self {
            Hemisphere::Healpix(grid) => grid.pixel(direction),
            Hemisphere::LatLong(grid) => grid.pixel(direction),
            Hemisphere::Fibonacci(grid) => grid.nearest(direction.into()),
        }
    }

    /// [`Hemisphere::pixel`] for several directions, `[component][lane]`.
    #[inline(always)]
    pub(crate) fn pixels<const N: usize>(&self, d: &[[f32; N]; 3], to: &mut Pixels<N>) {
        // One loop for each choice, so that the choice is not made in every lane.
        match self {
            Hemisphere::Healpix(grid) => fill(d, to, |d| grid.pixel(d)),
            Hemisphere::LatLong(grid) => fill(d, to, |d| grid.pixel(d)),
            Hemisphere::Fibonacci(grid) => fill(d, to, |d| grid.nearest(d.into())),
        }
    }
}

/// Pixels side by side.
pub(crate) struct Pixels<const N: usize> {
    pub corners: [[u32; N]; 4],
    pub at: [[f32; N]; 2],
}

#[inline(always)]
fn fill<const N: usize>(d: &[[f32; N]; 3], to: &mut Pixels<N>, pixel: impl Fn([f32; 3]) -> Pixel) {
    for lane in 0..N {
        let pixel = pixel([d[0][lane], d[1][lane], d[2][lane]]);
        for c in 0..4 {
            to.corners[c][lane] = pixel.corners[c];
        }
        to.at[0][lane] = pixel.at[0];
        to.at[1][lane] = pixel.at[1];
    }
}

/// See [`Pixelation::LatLong`].
#[derive(Clone, Copy, Debug)]
pub struct LatLong {
    rows: i32,
    columns: i32,
}

impl LatLong {
    /// At most `points` of them, with cells that are square at the equator.
    fn new(points: usize) -> Self {
        let mut rows = 2;
        while 4 * (rows + 1) * rows <= points as i32 {
            rows += 1;
        }
        LatLong { rows, columns: 4 * (rows - 1) }
    }

    #[inline(always)]
    fn pixel(self, [x, y, z]: [f32; 3]) -> Pixel {
        let (quarter, t) = azimuth(x, y);
        let down = quarter_turn((x * x + y * y).sqrt(), z.max(0.0)) * (self.rows - 1) as f32;
        let right = (quarter as f32 + t) * (0.25 * self.columns as f32);
        let row = (down as i32).max(0).min(self.rows - 2);
        let column = (right as i32).max(0).min(self.columns - 1);
        let next = if column + 1 < self.columns { column + 1 } else { 0 };
        let at = [down - row as f32, right - column as f32].map(|x| x.clamp(0.0, 1.0));
        let point = |row: i32, column: i32| (row * self.columns + column) as u32;
        let corners = [point(row, column), point(row + 1, column), point(row, next), point(row + 1, next)];
        Pixel { corners, at }
    }

    fn direction(self, point: usize) -> DVec3 {
        let (row, column) = (point / self.columns as usize, point % self.columns as usize);
        let theta = row as f64 / f64::from(self.rows - 1) * std::f64::consts::FRAC_PI_2;
        let phi = column as f64 / f64::from(self.columns) * std::f64::consts::TAU;
        DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
    }
}

/// See [`Pixelation::Fibonacci`].
#[derive(Clone, Debug)]
pub struct Fibonacci {
    /// By descending z, in equal steps.
    directions: Vec<Vec3>,
}

impl Fibonacci {
    fn new(points: usize) -> Self {
        let golden = std::f64::consts::TAU * (0.5 * (5.0f64.sqrt() - 1.0));
        let direction = |i: usize| {
            let (z, phi) = (1.0 - (i as f64 + 0.5) / points as f64, i as f64 * golden);
            let r = (1.0 - z * z).sqrt();
            DVec3::new(r * phi.cos(), r * phi.sin(), z).as_vec3()
        };
        Fibonacci { directions: (0..points).map(direction).collect() }
    }

    /// The four nearest points, and no place among them.
    fn nearest(&self, direction: Vec3) -> Pixel {
        // The fourth is never further than this times the mean distance, the side of a point's share of
        // the hemisphere.
        const REACH: f32 = 2.0;
        let count = self.directions.len();
        let reach = REACH * (std::f32::consts::TAU / count as f32).sqrt();
        let sine = (1.0 - direction.z * direction.z).max(0.0).sqrt();
        let height = reach * sine + 0.5 * reach * reach;
        let index = |z: f32| ((1.0 - z) * count as f32).clamp(0.0, count as f32) as usize;
        let last = index(direction.z - height).max(4).min(count);
        let first = index(direction.z + height).min(last - 4);
        let mut best = [(f32::MIN, first as u32); 4];
        for (i, candidate) in self.directions[first..last].iter().enumerate() {
            let mut entry = (candidate.dot(direction), (first + i) as u32);
            for best in &mut best {
                if entry.0 > best.0 {
                    std::mem::swap(best, &mut entry);
                }
            }
        }
        Pixel { corners: best.map(|(_, point)| point), at: [0.5; 2] }
    }
}

/// Weights of a pixel's corners by inverse great-circle distance (paper, §3.2.2), `[corner][lane]`.
#[inline(always)]
pub(crate) fn inverse_distances<const N: usize>(
    directions: &[[f32; 3]],
    d: &[[f32; N]; 3],
    corners: &[[u32; N]; 4],
    weights: &mut [[f32; N]; 4],
) {
    let mut distance = [[0.0; N]; 4];
    for (corners, distance) in corners.iter().zip(&mut distance) {
        let mut p = [[0.0; N]; 3];
        for lane in 0..N {
            let position = directions[corners[lane] as usize];
            for c in 0..3 {
                p[c][lane] = position[c];
            }
        }
        for lane in 0..N {
            distance[lane] =
                angle([d[0][lane], d[1][lane], d[2][lane]], [p[0][lane], p[1][lane], p[2][lane]]);
        }
    }
    for lane in 0..N {
        // The product of the other three is 1/d times the product of all; on a corner, or on two that
        // meet in a pole, it still tells them apart.
        const LEAST: f32 = 1e-7;
        let [a, b, c, e] = [0, 1, 2, 3].map(|i| distance[i][lane].max(LEAST));
        let products = [b * c * e, a * c * e, a * b * e, a * b * c];
        let scale = 1.0 / (products[0] + products[1] + products[2] + products[3]);
        for i in 0..4 {
            weights[i][lane] = products[i] * scale;
        }
    }
}

/// Angle between unit vectors less than a right angle apart, as a part of that.
#[inline(always)]
fn angle(a: [f32; 3], b: [f32; 3]) -> f32 {
    let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let sine = (cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]).sqrt();
    quarter_turn(sine, (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).max(0.0))
}

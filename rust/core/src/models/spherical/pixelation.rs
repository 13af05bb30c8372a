//! The ways to lay points on a hemisphere that the paper compares (its §3.2.1, figure 3).

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use crate::directions::healpix::{Healpix, Pixel, Pixels, azimuth, limit, quarter_turn};
use crate::simd::Real;
use crate::simd::math::floor;

/// A choice of points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pixelation {
    /// [`crate::directions::healpix`]: equal areas, found in a few instructions.
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

    /// The pixel of one direction; of a Fibonacci lattice, the four nearest points, and no place among them.
    #[must_use]
    pub fn pixel(&self, direction: [f32; 3]) -> Pixel {
        self.pixels(direction).into()
    }

    /// The pixels of directions; of a Fibonacci lattice, the four nearest points.
    #[inline(always)]
    pub(crate) fn pixels<F: Real>(&self, direction: [F; 3]) -> Pixels<F> {
        match self {
            Hemisphere::Healpix(grid) => grid.pixels(direction),
            Hemisphere::LatLong(grid) => grid.pixels(direction),
            Hemisphere::Fibonacci(grid) => grid.nearest(direction),
        }
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
    fn pixels<F: Real>(self, [x, y, z]: [F; 3]) -> Pixels<F> {
        let (rows, columns) = (self.rows as f32, self.columns as f32);
        let [zero, one] = [x.splat(0.0), x.splat(1.0)];
        let (quarter, t) = azimuth(x, y);
        let down = quarter_turn((x * x + y * y).sqrt(), z.max(zero)) * (rows - 1.0);
        let right = (quarter + t) * (0.25 * columns);
        let row = limit(floor(down), x.splat(rows - 2.0));
        let column = limit(floor(right), x.splat(columns - 1.0));
        let next = Real::select(column.lt(x.splat(columns - 1.0)), column + 1.0, zero);
        let at = [limit(down - row, one), limit(right - column, one)];
        let first = row * columns;
        let second = first + columns;
        Pixels { corners: [first + column, second + column, first + next, second + next], at }
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

    /// The four nearest points, and no place among them. One lane after the other: a search has no fixed length.
    #[inline(always)]
    fn nearest<F: Real>(&self, [x, y, z]: [F; 3]) -> Pixels<F> {
        let (xs, ys, zs) = (x.array(), y.array(), z.array());
        let mut corners = [xs; 4];
        for lane in 0..xs.as_ref().len() {
            let direction = Vec3::new(xs.as_ref()[lane], ys.as_ref()[lane], zs.as_ref()[lane]);
            let nearest = self.nearest_to(direction);
            for (corner, point) in corners.iter_mut().zip(nearest) {
                corner.as_mut()[lane] = point as f32;
            }
        }
        let [a, b, c, d] = &corners;
        let corners = [x.with_array(a), x.with_array(b), x.with_array(c), x.with_array(d)];
        Pixels { corners, at: [x.splat(0.5); 2] }
    }

    fn nearest_to(&self, direction: Vec3) -> [u32; 4] {
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
        best.map(|(_, point)| point)
    }
}

/// Weights of a pixel's corners by inverse great-circle distance (paper, §3.2.2).
#[inline(always)]
pub(crate) fn inverse_distances<F: Real>(directions: &[[f32; 3]], d: [F; 3], corners: [F; 4]) -> [F; 4] {
    // The product of the other three is 1/d times the product of all; on a corner, or on two that
    // meet in a pole, it still tells them apart.
    const LEAST: f32 = 1e-7;
    let mut distance = [d[0].splat(LEAST); 4];
    for i in 0..4 {
        distance[i] = angle(d, positions(directions, corners[i])).max(distance[i]);
    }
    let [a, b, c, e] = distance;
    let (ab, ce) = (a * b, c * e);
    let products = [b * ce, a * ce, ab * e, ab * c];
    let scale = (products[0] + products[1] + products[2] + products[3]).reciprocal();
    [products[0] * scale, products[1] * scale, products[2] * scale, products[3] * scale]
}

/// Where points are.
#[inline(always)]
fn positions<F: Real>(directions: &[[f32; 3]], points: F) -> [F; 3] {
    let numbers = points.array();
    let mut p = [numbers; 3];
    for (lane, &point) in numbers.as_ref().iter().enumerate() {
        let position = directions[point as usize];
        for c in 0..3 {
            p[c].as_mut()[lane] = position[c];
        }
    }
    [points.with_array(&p[0]), points.with_array(&p[1]), points.with_array(&p[2])]
}

/// Angle between unit vectors less than a right angle apart, as a part of that.
#[inline(always)]
fn angle<F: Real>(a: [F; 3], b: [F; 3]) -> F {
    let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let sine = (cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]).sqrt();
    quarter_turn(sine, (a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).max(sine.splat(0.0)))
}

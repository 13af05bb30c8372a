//! HEALPix (Górski et al. 2005, *HEALPix: A Framework for High-Resolution Discretization and Fast
//! Analysis of Data Distributed on the Sphere*), for features on the corners of the pixels of a
//! hemisphere, in float32.
//!
//! All of a hemisphere is one lattice in two coordinates p and m, which count pixel edges from the
//! north pole: along a quarter of the circle, of which t ∈ [0, 1] is the azimuth, p grows with t and m
//! against it. In the polar cap, z > 2/3, with σ = √(3(1 − z)),
//!
//! p = N t σ, m = N (1 − t) σ,
//!
//! and in the equatorial belt
//!
//! p = N (t + 1/2 − 3z/4), m = N (3/2 − t − 3z/4).
//!
//! Both are continuous. Pixel edges are where p or m is an integer, and p + m is the ring: 0 at the
//! pole, N where cap and belt meet, 2N on the equator. The pixels that a hemisphere touches have corners
//! down to the ring 2N + 1, one below the equator: 6N² + 6N + 1 points, ring after ring, each from
//! azimuth 0 eastward.

use serde::{Deserialize, Serialize};

use crate::simd::Real;
use crate::simd::math::floor;

/// A HEALPix grid of a hemisphere.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u16", into = "u16")]
pub struct Healpix {
    /// N, a power of two.
    nside: i32,
}

/// Largest N.
pub const MAX_NSIDE: u16 = 256;

/// A pixel, and where in it a direction is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pixel {
    /// Its corners by p and m: (0, 0), the nearest to the pole, (1, 0), (0, 1), (1, 1).
    pub corners: [u32; 4],
    /// p and m within the pixel, each in [0, 1].
    pub at: [f32; 2],
}

/// Pixels side by side, of whatever hemisphere. Numbers of points are whole numbers below 2²³, which float32
/// holds exactly.
pub(crate) struct Pixels<F> {
    pub corners: [F; 4],
    pub at: [F; 2],
}

impl From<Pixels<f32>> for Pixel {
    fn from(Pixels { corners, at }: Pixels<f32>) -> Pixel {
        Pixel { corners: corners.map(|corner| corner as u32), at }
    }
}

impl TryFrom<u16> for Healpix {
    type Error = String;

    fn try_from(nside: u16) -> Result<Self, String> {
        if nside.is_power_of_two() && nside <= MAX_NSIDE {
            Ok(Healpix { nside: nside.into() })
        } else {
            Err(format!("N_side is {nside}, expected a power of two up to {MAX_NSIDE}"))
        }
    }
}

impl From<Healpix> for u16 {
    fn from(grid: Healpix) -> u16 {
        grid.nside as u16
    }
}

/// z where polar cap and equatorial belt meet.
const CAP_Z: f32 = 2.0 / 3.0;

impl Healpix {
    /// N.
    #[must_use]
    pub fn nside(self) -> u16 {
        self.into()
    }

    /// Number of points.
    #[must_use]
    pub fn points(self) -> usize {
        let n = self.nside as usize;
        6 * n * n + 6 * n + 1
    }

    /// The pixel of a unit vector with z ≥ 0. Whatever the numbers are, the corners are points of the
    /// grid.
    #[must_use]
    pub fn pixel(self, direction: [f32; 3]) -> Pixel {
        self.pixels(direction).into()
    }

    /// [`Healpix::pixel`] in any number of lanes.
    #[inline(always)]
    pub(crate) fn pixels<F: Real>(self, [x, y, z]: [F; 3]) -> Pixels<F> {
        let n = self.nside as f32;
        let one = z.splat(1.0);
        let (quarter, t) = azimuth(x, y);
        let in_cap = z.splat(CAP_Z).lt(z);
        // 1 − z = (x² + y²)/(1 + z), with no cancellation at the pole.
        let sigma = ((x * x + y * y) * 3.0 / (z.abs() + 1.0)).sqrt().min(one);
        let belt = z * 0.75;
        let p = Real::select(in_cap, t * sigma, t + 0.5 - belt) * n;
        let m = Real::select(in_cap, (one - t) * sigma, z.splat(1.5) - t - belt) * n;
        // Edges belong to the pixel before them where the one behind is not of this quarter of the cap,
        // or has corners two rings below the equator.
        let last = Real::select(in_cap, z.splat(n - 1.0), z.splat(2.0 * n - 1.0));
        let column = limit(floor(p), last);
        let row = limit(floor(m), limit(z.splat(2.0 * n - 1.0) - column, last));
        let at = [limit(p - column, one), limit(m - row, one)];
        let first = column + row;
        let [near, side, far] =
            [Ring::new(self, first), Ring::new(self, first + 1.0), Ring::new(self, first + 2.0)];
        // The pole is a ring of one point.
        let nearest = Real::select(z.splat(0.5).lt(first), near.point(quarter, column), z.splat(0.0));
        let corners = [
            nearest,
            side.point(quarter, column + 1.0),
            side.point(quarter, column),
            far.point(quarter, column + 1.0),
        ];
        Pixels { corners, at }
    }

    /// Where a point is, as z and azimuth in [0, 2π).
    ///
    /// # Panics
    /// If there is no such point.
    #[must_use]
    pub fn position(self, point: usize) -> (f64, f64) {
        assert!(point < self.points(), "the grid has {} points", self.points());
        let n = self.nside as usize;
        if point == 0 {
            return (1.0, 0.0);
        }
        let first_of_belt = 1 + 2 * n * (n - 1);
        if point < first_of_belt {
            let mut ring = 1;
            while 2 * ring * (ring + 1) < point {
                ring += 1;
            }
            let place = point - 1 - 2 * ring * (ring - 1);
            let z = 1.0 - (ring * ring) as f64 / (3 * n * n) as f64;
            return (z, place as f64 / ring as f64 * std::f64::consts::FRAC_PI_2);
        }
        let (below, place) = ((point - first_of_belt) / (4 * n), (point - first_of_belt) % (4 * n));
        let z = 2.0 / 3.0 * (1.0 - below as f64 / n as f64);
        let place = place as f64 + 0.5 * (below % 2) as f64;
        (z, place / n as f64 * std::f64::consts::FRAC_PI_2)
    }

    /// Where a point is, as a unit vector.
    ///
    /// # Panics
    /// If there is no such point.
    #[must_use]
    pub fn direction(self, point: usize) -> [f64; 3] {
        let (z, phi) = self.position(point);
        let r = (1.0 - z * z).max(0.0).sqrt();
        [r * phi.cos(), r * phi.sin(), z]
    }
}

/// Points on one ring.
#[derive(Clone, Copy)]
struct Ring<F> {
    /// Of a quarter.
    size: F,
    /// By how many columns the ring begins west of azimuth 0.
    shift: F,
    /// Its number of points.
    count: F,
    /// Number of its first point.
    first: F,
}

impl<F: Real> Ring<F> {
    #[inline(always)]
    fn new(grid: Healpix, ring: F) -> Self {
        // Rings of the cap have a quarter of `size` points; below it all have N, of which every other
        // ring's are half a step off, so that a column stands half a step further west on each ring.
        let n = grid.nside as f32;
        let size = ring.min(ring.splat(n));
        let below = ring - size;
        let first = size * (size - 1.0) * 2.0 + below * (4.0 * n) + 1.0;
        Ring { size, shift: floor((below + 1.0) * 0.5), count: size * 4.0, first }
    }

    /// The point that is the `column`-th pixel edge of a quarter.
    #[inline(always)]
    fn point(self, quarter: F, column: F) -> F {
        let place = quarter * self.size + column - self.shift;
        let place = Real::select(place.lt(place.splat(0.0)), place + self.count, place);
        let place = Real::select(place.lt(self.count), place, place - self.count);
        self.first + place
    }
}

/// x limited to [0, high]; 0 in place of NaN.
#[inline(always)]
pub(crate) fn limit<F: Real>(x: F, high: F) -> F {
    x.max(x.splat(0.0)).min(high)
}

/// The azimuth of (x, y) as a whole number of quarter turns, 0 to 3, and what is left of it in [0, 1];
/// 0 and 0 at the origin. An axis belongs to the quarter before or behind it.
#[inline(always)]
pub(crate) fn azimuth<F: Real>(x: F, y: F) -> (F, F) {
    let zero = x.splat(0.0);
    let (west, south) = (x.lt(zero), y.lt(zero));
    let (x, y) = (x.abs(), y.abs());
    // Every second quarter begins at the y axis.
    let (along, beside) = (Real::select(west, y, x), Real::select(west, x, y));
    let (along, beside) = (Real::select(south, beside, along), Real::select(south, along, beside));
    let quarter = Real::select(west, x.splat(1.0), zero);
    (Real::select(south, x.splat(3.0) - quarter, quarter), quarter_turn(beside, along))
}

/// atan(y/x)/(π/2) for x, y ≥ 0: exact at 0, ½ and 1; 0 at the origin.
///
/// Range reduction to |r| ≤ tan(π/8) and the polynomial of Cephes' `atanf` (Moshier 1992).
#[inline(always)]
pub(crate) fn quarter_turn<F: Real>(y: F, x: F) -> F {
    const TAN_PI_8: f32 = 0.414_213_56;
    let (small, large) = (x.min(y), x.max(y));
    let middle = (large * TAN_PI_8).lt(small);
    let numerator = Real::select(middle, small - large, small);
    let denominator = Real::select(middle, small + large, large);
    let r = numerator / denominator.max(x.splat(f32::MIN_POSITIVE));
    let square = r * r;
    // Not fused, so that a direction's pixel is the same in every instruction set.
    let mut p = square * 8.053_744_5e-2 - 1.387_768_6e-1;
    p = p * square + 1.997_771_1e-1;
    p = p * square - 3.333_295e-1;
    let turn =
        (p * square * r + r) * std::f32::consts::FRAC_2_PI + Real::select(middle, x.splat(0.5), x.splat(0.0));
    Real::select(x.lt(y), x.splat(1.0) - turn, turn)
}

#[cfg(test)]
mod tests {
    use super::*;
    use cdshealpix::nested;
    use glam::DVec3;

    const SIZES: [u16; 9] = [1, 2, 4, 8, 16, 32, 64, 128, 256];

    fn grid(nside: u16) -> Healpix {
        nside.try_into().unwrap()
    }

    fn direction(z: f64, phi: f64) -> DVec3 {
        let r = (1.0 - z * z).max(0.0).sqrt();
        DVec3::new(r * phi.cos(), r * phi.sin(), z)
    }

    fn point(grid: Healpix, point: u32) -> DVec3 {
        grid.direction(point as usize).into()
    }

    /// Corners of the oracle's pixel of a direction.
    fn oracle(nside: u16, phi: f64, z: f64) -> [DVec3; 4] {
        let depth = nside.trailing_zeros() as u8;
        let hash = nested::hash(depth, phi, z.asin());
        nested::vertices(depth, hash).map(|(lon, lat)| direction(lat.sin(), lon))
    }

    #[test]
    fn a_hemisphere_with_a_ring_below_the_equator_has_as_many_points_as_the_paper_says() {
        for nside in SIZES {
            let (grid, n) = (grid(nside), usize::from(nside));
            assert_eq!(grid.points(), 6 * n * n + 6 * n + 1);
            let rings = (0..grid.points()).map(|i| grid.position(i).0);
            let below = rings.clone().filter(|&z| z < -1e-9).count();
            let equator = rings.filter(|z| z.abs() < 1e-9).count();
            assert_eq!((equator, below), (4 * n, 4 * n));
        }
        assert_eq!(grid(64).points(), 24_961);
    }

    #[test]
    fn corners_are_those_of_the_oracle_in_a_million_directions() {
        let mut seen = 0;
        for nside in SIZES {
            let grid = grid(nside);
            for i in 0..120_000 {
                // The R2 sequence of Roberts, rounded to float32 before either side sees it.
                let z = (i as f64 * 0.754_877_666_2).fract();
                let phi = (i as f64 * 0.569_840_290_9).fract() * std::f64::consts::TAU;
                let d = direction(z, phi).as_vec3();
                let pixel = grid.pixel(d.to_array());
                // Float32 cannot tell the sides of an edge that is nearer than its own rounding.
                let rounding = 1e-6 * f32::from(nside);
                if pixel.at.iter().any(|x| !(rounding..=1.0 - rounding).contains(x)) {
                    continue;
                }
                seen += 1;
                let exact = d.as_dvec3().normalize();
                let expected = oracle(nside, exact.y.atan2(exact.x), exact.z);
                for corner in pixel.corners.map(|corner| point(grid, corner)) {
                    let nearest = expected.iter().map(|e| e.distance(corner)).fold(f64::INFINITY, f64::min);
                    assert!(nearest < 1e-9, "N {nside}, {d}: corner {corner} is {nearest} off {expected:?}");
                }
            }
        }
        assert!(seen >= 1_000_000, "{seen}");
    }

    /// Every point of every grid, and every middle of an edge, is a direction on a boundary: the pixel
    /// found must be one that it touches, and the bilinear coordinates must lead back to it.
    #[test]
    fn on_every_boundary_the_pixel_is_one_that_touches_it() {
        for nside in SIZES {
            let grid = grid(nside);
            let step = if nside > 64 { 7 } else { 1 };
            for index in (0..grid.points()).step_by(step) {
                let exact = DVec3::from(grid.direction(index));
                if exact.z < 0.0 {
                    continue;
                }
                let pixel = grid.pixel(exact.as_vec3().to_array());
                let nearest = (0..4)
                    .min_by(|&a, &b| {
                        let d = |c: usize| point(grid, pixel.corners[c]).distance(exact);
                        d(a).total_cmp(&d(b))
                    })
                    .unwrap();
                assert_eq!(pixel.corners[nearest] as usize, index, "N {nside}, point {index} {exact}");
                let rounding = 2e-6 * f32::from(nside);
                let [p, m] = pixel.at;
                // At the pole p and m are 0 in every quarter.
                assert!((p - (nearest % 2) as f32).abs() < rounding, "N {nside}, {index}: {:?}", pixel.at);
                assert!((m - (nearest / 2) as f32).abs() < rounding, "N {nside}, {index}: {:?}", pixel.at);
            }
        }
    }

    #[test]
    fn seams_poles_ring_changes_and_the_equator_have_neighbouring_corners() {
        use std::f64::consts::{FRAC_PI_2, TAU};
        for nside in SIZES {
            let grid = grid(nside);
            // No pixel reaches further from a direction in it than this.
            let diameter = 2.2 / f64::from(nside);
            let ring_z = |ring: u16| {
                let (i, n) = (f64::from(ring), f64::from(nside));
                if ring < nside { 1.0 - i * i / (3.0 * n * n) } else { 2.0 / 3.0 * (2.0 - i / n) }
            };
            for ring in 0..=2 * nside {
                for turn in 0..=64 {
                    let phi = f64::from(turn) / 64.0 * TAU;
                    for offset in [-1e-7, 0.0, 1e-7] {
                        let z = (ring_z(ring) + offset).clamp(0.0, 1.0);
                        let d = direction(z, phi);
                        // 2π is the azimuth 0 again, as is the sign of a zero.
                        for d in [d.as_vec3(), direction(z, phi + offset).as_vec3()] {
                            for d in [d, glam::Vec3::new(d.x, -d.y, d.z)] {
                                let pixel = grid.pixel(d.to_array());
                                for corner in pixel.corners {
                                    let distance = point(grid, corner).distance(d.as_dvec3());
                                    assert!(distance < diameter, "N {nside} at {d}: {distance}");
                                }
                                assert!(pixel.at.iter().all(|x| (0.0..=1.0).contains(x)));
                            }
                        }
                    }
                }
            }
            for quarter in 0..4 {
                let (s, c) = (f64::from(quarter) * FRAC_PI_2).sin_cos();
                let pixel = grid.pixel([c.round() as f32, s.round() as f32, 0.0]);
                assert!(pixel.corners.iter().all(|&c| (c as usize) < grid.points()));
            }
        }
    }

    /// What is interpolated from the corners does not jump between two directions that are close,
    /// wherever an edge runs between them.
    #[test]
    fn bilinear_coordinates_are_continuous_across_pixels() {
        for nside in [1, 4, 16, 64] {
            let grid = grid(nside);
            // Random values on the points: any jump would show.
            let value = |point: u32| {
                let hash = (point + 1).wrapping_mul(2_654_435_761);
                f64::from(hash ^ (hash >> 15)) / f64::from(u32::MAX)
            };
            let interpolate = |d: glam::Vec3| {
                let Pixel { corners, at: [p, m] } = grid.pixel(d.to_array());
                let (p, m) = (f64::from(p), f64::from(m));
                let weights = [(1.0 - p) * (1.0 - m), p * (1.0 - m), (1.0 - p) * m, p * m];
                corners.iter().zip(weights).map(|(&c, w)| value(c) * w).sum::<f64>()
            };
            for i in 0..20_000 {
                let phi = (i as f64 * 0.569_840_290_9).fract() * std::f64::consts::TAU;
                let z = match i % 4 {
                    0 => 2.0 / 3.0,
                    1 => 1.0 - 1e-3 * (i as f64 * 0.754_877_666_2).fract() / f64::from(nside),
                    _ => (i as f64 * 0.754_877_666_2).fract(),
                };
                let phi = if i % 8 == 7 { (i % 5) as f64 * std::f64::consts::FRAC_PI_2 } else { phi };
                let a = direction(z, phi);
                let turn = i as f64 * 2.399;
                let step = 1e-5 * DVec3::new(turn.cos(), turn.sin(), 0.3 * turn.sin());
                let b = (a + step).normalize();
                let b = if b.z < 0.0 { a } else { b };
                let jump = (interpolate(a.as_vec3()) - interpolate(b.as_vec3())).abs();
                assert!(jump < 2e-4 * f64::from(nside), "N {nside} between {a} and {b}: {jump}");
            }
        }
    }

    #[test]
    fn whatever_the_numbers_are_the_corners_are_points() {
        let odd = [0.0, -0.0, 1.0, -1.0, 0.7, -1.9, 2.0, 1e-40, f32::MAX, f32::INFINITY, f32::NAN];
        for nside in SIZES {
            let grid = grid(nside);
            for x in odd {
                for y in odd {
                    for z in odd {
                        let pixel = grid.pixel([x, y, z]);
                        assert!(pixel.corners.iter().all(|&c| (c as usize) < grid.points()), "{x} {y} {z}");
                    }
                }
            }
        }
    }

    #[test]
    fn azimuths_keep_float32_precision_and_are_exact_on_the_axes() {
        for i in 0..100_000 {
            let phi = f64::from(i) / 100_000.0 * std::f64::consts::TAU;
            let (x, y) = (phi.cos() as f32, phi.sin() as f32);
            let (quarter, t) = azimuth(x, y);
            let truth = f64::from(y).atan2(f64::from(x)).rem_euclid(std::f64::consts::TAU);
            let error = f64::from(quarter) + f64::from(t) - truth / std::f64::consts::FRAC_PI_2;
            assert!(error.abs() < 2e-7, "{phi}: {error}");
        }
        for (x, y, expected) in [
            (1.0, 0.0, 0.0),
            (0.3, 0.3, 0.5),
            (0.0, 1.0, 1.0),
            (-1.0, 0.0, 2.0),
            (-1.0, -1.0, 2.5),
            (0.0, -1.0, 3.0),
            (1.0, -0.0, 0.0),
            (0.0, 0.0, 0.0),
        ] {
            let (quarter, t) = azimuth(x, y);
            assert_eq!(quarter + t, expected, "{x} {y}");
        }
    }

    #[test]
    fn other_sizes_than_powers_of_two_are_refused() {
        for nside in [0, 3, 48, 512] {
            assert!(Healpix::try_from(nside).unwrap_err().contains("power of two up to 256"));
        }
    }
}

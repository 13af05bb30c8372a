//! The bilinear warp of Dupuy & Jakob, *An Adaptive Parameterization for Efficient Material
//! Acquisition and Rendering*, 2018.
//!
//! A density p on the unit square that interpolates a table bilinearly, optionally dependent on a
//! direction, and the map from uniform points to points distributed as p: first the row u.y from the
//! marginal distribution, then u.x from the distribution along that row. Between the knots of the
//! direction the tables *and* their integrals are interpolated linearly, so the density stays exact.

use glam::{Vec2, Vec4};

use crate::grid::{Blend, Extent, Patch};

/// Two adjacent knots whose densities differ by less than this fraction count as equal: the
/// quadratic that inverts a linear density loses its digits there, and the linear answer is closer.
const FLAT: f32 = 1e-4;

/// A piecewise bilinear density on the unit square and the warp that samples it.
#[derive(Clone, Debug)]
pub struct Warp {
    extent: Extent,
    /// Per knot: density, and its integral along the row up to the knot. Unit of length: one patch.
    knots: Vec<f32>,
    /// Per row: integral over the whole row, and integral over all rows before.
    rows: Vec<f32>,
}

/// The knots around a point, interpolated between slices.
struct Corners {
    /// Density and row integral at the left and right knot of the lower row.
    low: Vec4,
    /// The same of the upper row.
    high: Vec4,
}

impl Corners {
    /// Density at the left and the right edge at height `y` of the patch.
    #[inline]
    fn edges(&self, y: f32) -> (f32, f32) {
        (mix(self.low.x, self.high.x, y), mix(self.low.z, self.high.z, y))
    }

    /// Integral along the row at height `y` from 0 to the left edge.
    #[inline]
    fn before(&self, y: f32) -> f32 {
        mix(self.low.y, self.high.y, y)
    }
}

impl Warp {
    /// Builds the warp of `values`, one or more slices of `extent`, row by row, all finite and ≥ 0.
    ///
    /// Every slice is scaled to integrate to 1; one without any mass becomes the uniform density.
    #[must_use]
    pub fn new(extent: Extent, values: &[f32]) -> Warp {
        let mut warp = Warp {
            extent,
            knots: Vec::with_capacity(2 * values.len()),
            rows: Vec::with_capacity(2 * values.len() / extent.width),
        };
        for slice in values.chunks_exact(extent.knots()) {
            if slice.iter().any(|&value| value > 0.0) {
                warp.push_slice(slice);
            } else {
                warp.push_slice(&vec![1.0; extent.knots()]);
            }
        }
        warp
    }

    fn push_slice(&mut self, slice: &[f32]) {
        let trapezoid = |a: f32, b: f32| 0.5 * (f64::from(a) + f64::from(b));
        let rows = slice.chunks_exact(self.extent.width);
        let totals: Vec<f64> =
            rows.clone().map(|row| row.windows(2).map(|pair| trapezoid(pair[0], pair[1])).sum()).collect();
        let mass: f64 = totals.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).sum();
        let scale = 1.0 / mass;

        let mut below = 0.0;
        for (index, row) in rows.enumerate() {
            let mut before = 0.0;
            for (x, &value) in row.iter().enumerate() {
                if x > 0 {
                    before += trapezoid(row[x - 1], value);
                }
                self.knots.push((f64::from(value) * scale) as f32);
                self.knots.push((before * scale) as f32);
            }
            if index > 0 {
                below += 0.5 * (totals[index - 1] + totals[index]);
            }
            self.rows.push((totals[index] * scale) as f32);
            self.rows.push((below * scale) as f32);
        }
    }

    #[inline]
    fn corners(&self, column: usize, row: usize, blend: &Blend) -> Corners {
        let stride = 2 * self.extent.width;
        let corner = 2 * column + row * stride;
        let slice_size = 2 * self.extent.knots();
        let load = |at: usize| blend.sum(|slice| four(&self.knots, slice * slice_size + at));
        Corners { low: load(corner), high: load(corner + stride) }
    }

    /// Total of and mass below `row`, then the same of the row above it.
    #[inline]
    fn rows(&self, row: usize, blend: &Blend) -> Vec4 {
        blend.sum(|slice| four(&self.rows, 2 * (slice * self.extent.height + row)))
    }

    /// Density of the warped points at `u`, per unit area of the square.
    #[inline]
    #[must_use]
    pub fn pdf(&self, u: Vec2, blend: &Blend) -> f32 {
        let Patch { column, row, at } = self.extent.patch(u);
        let (left, right) = self.corners(column, row, blend).edges(at.y);
        mix(left, right, at.x) * self.extent.patches().element_product()
    }

    /// The uniform point that [`sample`](Self::sample) takes to `u`, and the density at `u`.
    #[inline]
    #[must_use]
    pub fn invert(&self, u: Vec2, blend: &Blend) -> (Vec2, f32) {
        let Patch { column, row, at } = self.extent.patch(u);
        let corners = self.corners(column, row, blend);
        let rows = self.rows(row, blend);

        let (left, right) = corners.edges(at.y);
        let along = corners.before(at.y) + at.x * (left + 0.5 * at.x * (right - left));
        let total = mix(rows.x, rows.z, at.y);
        let y = rows.y + at.y * (rows.x + 0.5 * at.y * (rows.z - rows.x));
        // A row without mass is never sampled: any answer will do.
        let x = if total > 0.0 { along / total } else { u.x };
        let pdf = mix(left, right, at.x) * self.extent.patches().element_product();
        (Vec2::new(x, y), pdf)
    }

    /// Warps the uniform point `u` in [0, 1)²; returns the point and its density.
    #[must_use]
    pub fn sample(&self, u: Vec2, blend: &Blend) -> (Vec2, f32) {
        let row = last_below(self.extent.height - 1, |row| self.rows(row, blend).y <= u.y);
        let rows = self.rows(row, blend);
        let y = invert_linear(u.y - rows.y, rows.x, rows.z);

        let target = u.x * mix(rows.x, rows.z, y);
        let column =
            last_below(self.extent.width - 1, |column| self.corners(column, row, blend).before(y) <= target);
        let corners = self.corners(column, row, blend);
        let (left, right) = corners.edges(y);
        let x = invert_linear(target - corners.before(y), left, right);

        let patches = self.extent.patches();
        let point = (Vec2::new(column as f32, row as f32) + Vec2::new(x, y)) / patches;
        (point, mix(left, right, x) * patches.element_product())
    }
}

/// The last of `count` patches that starts at or before a target; the first one if none does.
fn last_below(count: usize, starts_before: impl Fn(usize) -> bool) -> usize {
    let (mut low, mut high) = (0, count);
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if starts_before(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// The t in [0, 1] at which ∫₀ᵗ ((1−s)·a + s·b) ds reaches `mass`.
fn invert_linear(mass: f32, a: f32, b: f32) -> f32 {
    let t = if (a - b).abs() <= FLAT * (a + b) {
        2.0 * mass / (a + b)
    } else {
        (a - (a * a - 2.0 * mass * (a - b)).max(0.0).sqrt()) / (a - b)
    };
    // 0/0 in a patch without mass.
    if t.is_nan() { 0.0 } else { t.clamp(0.0, 1.0) }
}

#[inline]
fn mix(a: f32, b: f32, t: f32) -> f32 {
    (1.0 - t) * a + t * b
}

#[inline]
fn four(values: &[f32], at: usize) -> Vec4 {
    Vec4::from_slice(&values[at..at + 4])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Directions;

    const EXTENT: Extent = Extent { width: 7, height: 5 };

    /// Two slices of an uneven density, the second with a row and a corner of zeros.
    fn warp() -> Warp {
        let value = |k: usize| 0.2 + (k as f32 * 1.7).sin().abs() * 3.0;
        let mut values: Vec<f32> = (0..2 * EXTENT.knots()).map(value).collect();
        values[EXTENT.knots()..EXTENT.knots() + 9].fill(0.0);
        Warp::new(EXTENT, &values)
    }

    fn blends() -> [Blend; 3] {
        let directions = Directions::new(vec![0.0], vec![0.0, 1.0]);
        [0.0, 0.3, 1.0].map(|theta| directions.blend(0.0, theta))
    }

    #[test]
    fn invert_undoes_sample_and_both_know_the_density() {
        let warp = warp();
        for blend in blends() {
            for k in 0..400 {
                let u = Vec2::new((k as f32 * 0.618_034).fract(), (k as f32 + 0.5) / 400.0);
                let (point, pdf) = warp.sample(u, &blend);
                let (back, inverse_pdf) = warp.invert(point, &blend);
                assert!((back - u).abs().max_element() < 2e-5, "{u} -> {point} -> {back}");
                // The density is steep across a patch: a rounding of the point moves it.
                assert!((pdf - inverse_pdf).abs() < 1e-3 * (1.0 + pdf), "{pdf} {inverse_pdf}");
                assert_eq!(inverse_pdf, warp.pdf(point, &blend));
            }
        }
    }

    #[test]
    fn the_density_integrates_to_one() {
        let warp = warp();
        for blend in blends() {
            // The midpoint rule is exact for a bilinear function if no cell straddles two patches.
            let (nx, ny) = (6 * 4, 4 * 4);
            let mut sum = 0.0;
            for j in 0..ny {
                for i in 0..nx {
                    let u = Vec2::new((i as f32 + 0.5) / nx as f32, (j as f32 + 0.5) / ny as f32);
                    sum += f64::from(warp.pdf(u, &blend));
                }
            }
            assert!((sum / f64::from(nx * ny) - 1.0).abs() < 1e-5, "{sum}");
        }
    }

    #[test]
    fn a_slice_without_mass_is_uniform() {
        let warp = Warp::new(EXTENT, &vec![0.0; EXTENT.knots()]);
        let u = Vec2::new(0.3, 0.8);
        let (point, pdf) = warp.sample(u, &Blend::SINGLE);
        assert!((point - u).abs().max_element() < 1e-6 && (pdf - 1.0).abs() < 1e-5);
    }
}

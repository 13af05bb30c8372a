//! Multilinear interpolation of tables over the unit square that depend on a direction (φ, θ).

use std::ops::{Add, Mul};

use glam::Vec2;

/// The directions (φ, θ) at which slices of a table were measured.
#[derive(Clone, Debug)]
pub struct Directions {
    phi: Vec<f32>,
    theta: Vec<f32>,
}

/// The slices next to a direction, with their linear weights (which sum to 1).
#[derive(Clone, Copy, Debug)]
pub struct Blend {
    slices: [(usize, f32); 4],
    count: usize,
}

impl Directions {
    /// Knots in radians; each list strictly increasing and not empty. Slices are numbered φ-major.
    #[must_use]
    pub fn new(phi: Vec<f32>, theta: Vec<f32>) -> Directions {
        Directions { phi, theta }
    }

    /// Number of slices.
    #[must_use]
    pub fn count(&self) -> usize {
        self.phi.len() * self.theta.len()
    }

    /// The slices around (φ, θ), both in radians; outside the knots the nearest slice answers.
    #[inline]
    #[must_use]
    pub fn blend(&self, phi: f32, theta: f32) -> Blend {
        let (row, t) = interval(&self.theta, theta);
        let next_row = (row + 1).min(self.theta.len() - 1);
        if self.phi.len() == 1 {
            let slices = [(row, 1.0 - t), (next_row, t), (0, 0.0), (0, 0.0)];
            return Blend { slices, count: 2 };
        }
        let (column, s) = interval(&self.phi, phi);
        let first = column * self.theta.len();
        let second = first + self.theta.len();
        let slices = [
            (first + row, (1.0 - s) * (1.0 - t)),
            (first + next_row, (1.0 - s) * t),
            (second + row, s * (1.0 - t)),
            (second + next_row, s * t),
        ];
        Blend { slices, count: 4 }
    }
}

/// The interval of `knots` that holds `x`, and the position of `x` in it, clamped to [0, 1].
#[inline]
pub(crate) fn interval(knots: &[f32], x: f32) -> (usize, f32) {
    let last = knots.len().saturating_sub(2);
    let index = knots.partition_point(|&knot| knot < x).saturating_sub(1).min(last);
    match knots.get(index + 1) {
        Some(&end) => (index, ((x - knots[index]) / (end - knots[index])).clamp(0.0, 1.0)),
        None => (0, 0.0),
    }
}

impl Blend {
    /// The blend of a table that depends on no direction: its only slice.
    pub const SINGLE: Blend = Blend { slices: [(0, 1.0), (0, 0.0), (0, 0.0), (0, 0.0)], count: 1 };

    /// Σ weight · value(slice).
    #[inline]
    pub fn sum<T>(&self, value: impl Fn(usize) -> T) -> T
    where
        T: Add<Output = T> + Mul<f32, Output = T>,
    {
        let weighted = |k: usize| value(self.slices[k].0) * self.slices[k].1;
        match self.count {
            1 => value(self.slices[0].0),
            2 => weighted(0) + weighted(1),
            _ => (weighted(0) + weighted(1)) + (weighted(2) + weighted(3)),
        }
    }
}

/// Extent of a table over the unit square: `width` knots along u.x (adjacent in memory), `height` along u.y.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// Knots along u.x, at least 2.
    pub width: usize,
    /// Knots along u.y, at least 2.
    pub height: usize,
}

/// The patch of a table in which a point of the unit square lies.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// Column of the patch's low corner.
    pub column: usize,
    /// Row of the patch's low corner.
    pub row: usize,
    /// Position within the patch, in [0, 1]².
    pub at: Vec2,
}

impl Extent {
    /// Knots of one slice.
    #[must_use]
    pub fn knots(self) -> usize {
        self.width * self.height
    }

    /// Number of patches along either axis.
    #[inline]
    #[must_use]
    pub fn patches(self) -> Vec2 {
        Vec2::new((self.width - 1) as f32, (self.height - 1) as f32)
    }

    /// The patch around `u`, which is clamped to the unit square.
    #[inline]
    #[must_use]
    pub fn patch(self, u: Vec2) -> Patch {
        let position = u.clamp(Vec2::ZERO, Vec2::ONE) * self.patches();
        let column = (position.x as usize).min(self.width - 2);
        let row = (position.y as usize).min(self.height - 2);
        Patch { column, row, at: position - Vec2::new(column as f32, row as f32) }
    }
}

/// A table over the unit square, interpolated linearly in u and between its slices.
#[derive(Clone, Debug)]
pub struct Grid<T> {
    extent: Extent,
    values: Vec<T>,
}

impl<T> Grid<T>
where
    T: Copy + Add<Output = T> + Mul<f32, Output = T>,
{
    /// `values` holds one or more slices of `extent`, row by row.
    #[must_use]
    pub fn new(extent: Extent, values: Vec<T>) -> Grid<T> {
        debug_assert_eq!(values.len() % extent.knots(), 0);
        Grid { extent, values }
    }

    /// Knots of a slice.
    #[must_use]
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// The value at `u` (clamped to the unit square) for the direction that `blend` stands for.
    #[inline]
    #[must_use]
    pub fn eval(&self, u: Vec2, blend: &Blend) -> T {
        let Patch { column, row, at } = self.extent.patch(u);
        let corner = column + row * self.extent.width;
        let knots = self.extent.knots();
        blend.sum(|slice| {
            let low = slice * knots + corner;
            let high = low + self.extent.width;
            let (low, high) = (&self.values[low..low + 2], &self.values[high..high + 2]);
            let low = low[0] * (1.0 - at.x) + low[1] * at.x;
            let high = high[0] * (1.0 - at.x) + high[1] * at.x;
            low * (1.0 - at.y) + high * at.y
        })
    }
}

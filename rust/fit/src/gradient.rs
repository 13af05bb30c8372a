//! Derivatives by the numbers of a model: dense for most of them, and sparse for tables.
//!
//! A texture of latent codes has millions of numbers, and a block of pairs touches a few rows of it. What a block
//! says of a table is therefore kept row by row, and only of the rows that it touched.

use std::collections::BTreeMap;

/// A table at the end of a material's own numbers, row after row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// Rows.
    pub rows: usize,
    /// Numbers of a row.
    pub width: usize,
}

impl Table {
    /// No table: all gradients are dense.
    pub const NONE: Table = Table { rows: 0, width: 0 };

    /// How many numbers there are.
    #[must_use]
    pub const fn len(self) -> usize {
        self.rows * self.width
    }

    /// Whether there are none.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.len() == 0
    }
}

/// Derivatives by the rows of a table that were touched.
#[derive(Clone, Debug, PartialEq)]
pub struct RowGradient {
    width: usize,
    /// For each row, which of `values` it has, counted in rows.
    places: BTreeMap<usize, usize>,
    values: Vec<f32>,
}

impl RowGradient {
    /// No row is touched yet.
    #[must_use]
    pub fn new(width: usize) -> RowGradient {
        RowGradient { width, places: BTreeMap::new(), values: Vec::new() }
    }

    /// The derivatives by a row, which is touched from now on; 0 at first.
    pub fn row(&mut self, row: usize) -> &mut [f32] {
        let next = self.places.len();
        let place = *self.places.entry(row).or_insert(next);
        if place == next {
            self.values.resize(self.values.len() + self.width, 0.0);
        }
        &mut self.values[place * self.width..][..self.width]
    }

    /// The rows that were touched and their derivatives, in the order of the table.
    pub fn iter(&self) -> impl Iterator<Item = (usize, &[f32])> {
        self.places.iter().map(|(&row, place)| (row, &self.values[place * self.width..][..self.width]))
    }
}

/// Derivatives by the shared numbers and by those of one material.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradient {
    /// By the shared numbers.
    pub shared: Vec<f32>,
    /// By the material's own, without its table.
    pub own: Vec<f32>,
    /// By the material's table.
    pub rows: RowGradient,
}

/// sum += part, for dense derivatives.
pub(crate) fn add(sum: &mut [f32], part: &[f32]) {
    for (sum, part) in sum.iter_mut().zip(part) {
        *sum += part;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_add_up_and_come_in_the_order_of_the_table() {
        let mut gradient = RowGradient::new(2);
        for (row, x) in [(7, 1.0), (2, 2.0), (7, 3.0), (900, 4.0)] {
            add(gradient.row(row), &[x, -x]);
        }
        let rows: Vec<(usize, &[f32])> = gradient.iter().collect();
        assert_eq!(rows, [(2, &[2.0, -2.0][..]), (7, &[4.0, -4.0]), (900, &[4.0, -4.0])]);
        assert_eq!(gradient.values.len(), 6);
    }
}

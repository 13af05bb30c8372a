//! Holes in tables: values that nobody measured.

use std::ops::{Add, Mul};

/// One axis of a table, slowest first in a list of them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axis {
    /// Values along it.
    pub length: usize,
    /// Whether the last value is beside the first.
    pub is_cyclic: bool,
}

/// Fills every value that has no data with the mean of its neighbours that have a value already: first those at
/// the edge of the data, then those beside them, and so on. A table without any data stays as it is.
///
/// Values go on as constants, so that a hole is never brighter or darker than all that surrounds it.
pub(crate) fn fill<T, const N: usize>(values: &mut [T], has_data: &[bool], axes: [Axis; N])
where
    T: Copy + Add<Output = T> + Mul<f32, Output = T>,
{
    let mut has_value = has_data.to_vec();
    let beside_data = |&i: &usize| !has_data[i] && neighbours(i, axes).any(|j| has_data[j]);
    let mut layer: Vec<usize> = (0..values.len()).filter(beside_data).collect();
    while !layer.is_empty() {
        let filled: Vec<T> =
            layer.iter().map(|&i| mean(values, neighbours(i, axes).filter(|&j| has_value[j]))).collect();
        for (&i, value) in layer.iter().zip(filled) {
            values[i] = value;
            has_value[i] = true;
        }
        layer = layer.iter().flat_map(|&i| neighbours(i, axes)).collect();
        layer.retain(|&i| !has_value[i]);
        layer.sort_unstable();
        layer.dedup();
    }
}

/// The numbers of the values beside number `index`: two along every axis, where there are any.
fn neighbours<const N: usize>(index: usize, axes: [Axis; N]) -> impl Iterator<Item = usize> + Clone {
    let mut stride = 1;
    let mut beside = [[None; 2]; N];
    for (axis, beside) in axes.iter().zip(&mut beside).rev() {
        let at = index / stride % axis.length;
        let moved = |to: usize| index + to * stride - at * stride;
        let wraps = axis.is_cyclic && axis.length > 1;
        *beside = [
            if at > 0 { Some(moved(at - 1)) } else { wraps.then(|| moved(axis.length - 1)) },
            if at + 1 < axis.length { Some(moved(at + 1)) } else { wraps.then(|| moved(0)) },
        ];
        stride *= axis.length;
    }
    beside.into_iter().flatten().flatten()
}

/// The mean of some values, of which there is at least one.
fn mean<T>(values: &[T], of: impl Iterator<Item = usize> + Clone) -> T
where
    T: Copy + Add<Output = T> + Mul<f32, Output = T>,
{
    // Weighted before they are added: sums of large values would overflow.
    let weight = (of.clone().count() as f32).recip();
    of.map(|i| values[i] * weight).reduce(T::add).expect("a layer lies beside what has a value")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled<const N: usize>(values: &[f32], axes: [Axis; N]) -> Vec<f32> {
        let has_data: Vec<bool> = values.iter().map(|value| !value.is_nan()).collect();
        let mut values = values.to_vec();
        fill(&mut values, &has_data, axes);
        values
    }

    const NONE: f32 = f32::NAN;

    #[test]
    fn layers_grow_from_the_edge_of_the_data_inwards() {
        let line = |is_cyclic| [Axis { length: 6, is_cyclic }];
        assert_eq!(filled(&[1.0, NONE, NONE, NONE, 5.0, 7.0], line(false)), [1.0, 1.0, 3.0, 5.0, 5.0, 7.0]);
        assert_eq!(filled(&[NONE, NONE, 4.0, 4.0, 2.0, NONE], line(false)), [4.0, 4.0, 4.0, 4.0, 2.0, 2.0]);
        assert_eq!(filled(&[NONE, 4.0, 4.0, 4.0, 2.0, 2.0], line(true))[0], 3.0);
    }

    #[test]
    fn neighbours_of_all_axes_count_alike() {
        let axes = [Axis { length: 3, is_cyclic: false }, Axis { length: 3, is_cyclic: false }];
        let table = [0.0, 1.0, 0.0, 2.0, NONE, 3.0, 0.0, 6.0, 0.0];
        assert_eq!(filled(&table, axes)[4], 3.0);
        assert!(filled(&[NONE; 9], axes).iter().all(|value| value.is_nan()));
    }
}

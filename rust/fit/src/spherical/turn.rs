//! Features that make the same of every pair, and whose distances matter alike.
//!
//! The network's first layer is linear, so that the features of a table can be turned into others, and the
//! layer's weights against them. Here they become those in which a step in any direction moves the first
//! hidden layer by its length, and whose directions come by falling variance. Primitives that lie near each other then
//! do the same to the network whatever table they stand in; and tables, each of which the network sees
//! through weights of its own, look alike and can share primitives. On two measurements this took SMAPE of short
//! fits with a codebook from .089 to .061, and log-MAE to a third.

use nalgebra::{DMatrix, DVector};

use super::SphericalObjective;
use super::codebook::row_weights;
use crate::objective::Objective;
use crate::train::State;

/// Turns network and features. The mean squares of their derivatives turn with them as if derivatives were
/// independent; the means are forgotten.
pub(super) fn turn(objective: &SphericalObjective, state: &mut State) {
    let k = objective.features();
    let (shape, layout) = (&objective.shape, objective.layout());
    let (shared, own) = (objective.shared_len(), objective.own_len());
    let inputs = shape.inputs();
    state.moments.first.fill(0.0);
    let (features, squares) =
        (objective.all_features(&state.numbers), objective.all_features(&state.moments.second));
    let weights = row_weights(&squares, k);
    for table in 0..layout.form().grids.tables() {
        let rows = (0..weights.len()).filter(|row| layout.places()[row % objective.rows()].0 == table);
        let rows: Vec<(DVector<f64>, f64)> =
            rows.map(|row| (wide(&features[row * k..][..k]), f64::from(weights[row]))).collect();
        let (network, _) = state.numbers.split_at_mut(shape.len());
        let (weight, bias) = shape.split_mut(network, 0);
        let (weight_squares, _) = shape.split_mut(&mut state.moments.second[..shape.len()], 0);
        let mut seen = DMatrix::zeros(k, k);
        weight.chunks_exact(inputs).for_each(|neuron| {
            let neuron = wide(&neuron[table * k..][..k]);
            seen.ger(1.0, &neuron, &neuron, 1.0);
        });
        let turn = Turn::new(&rows, seen);

        // Weights turn against features: W x = (W B)(A (x − μ)) + W μ, with B = A⁻¹.
        let neurons = weight.chunks_exact_mut(inputs).zip(weight_squares.chunks_exact_mut(inputs)).zip(bias);
        for ((weight, squares), bias) in neurons {
            let old = wide(&weight[table * k..][..k]);
            *bias += old.dot(&turn.mean) as f32;
            set(&mut weight[table * k..][..k], &turn.back.tr_mul(&old));
            let old = wide(&squares[table * k..][..k]);
            set(&mut squares[table * k..][..k], &(squared(&turn.there) * old));
        }
        let own_squares = state.moments.second[shared..].chunks_exact_mut(own);
        for (numbers, squares) in state.numbers[shared..].chunks_exact_mut(own).zip(own_squares) {
            for (row, _) in layout.places().iter().enumerate().filter(|(_, place)| place.0 == table) {
                let row = row * k..(row + 1) * k;
                let old = wide(&numbers[row.clone()]) - &turn.mean;
                set(&mut numbers[row.clone()], &(&turn.there * old));
                let old = wide(&squares[row.clone()]);
                set(&mut squares[row], &squared(&turn.back).tr_mul(&old));
            }
        }
    }
}

/// x ↦ A (x − μ).
struct Turn {
    mean: DVector<f64>,
    there: DMatrix<f64>,
    /// A⁻¹.
    back: DMatrix<f64>,
}

impl Turn {
    /// Of `rows` and how much they count, which the network sees through `seen` = WᵀW.
    fn new(rows: &[(DVector<f64>, f64)], seen: DMatrix<f64>) -> Turn {
        // What the network is all but blind to is not blown up further.
        const LEAST: f64 = 1e-6;
        let k = seen.nrows();
        let eigen = seen.symmetric_eigen();
        let least = (LEAST * eigen.eigenvalues.max()).max(f64::MIN_POSITIVE);
        let power = |exponent: f64| {
            let values = eigen.eigenvalues.map(|value| value.max(least).powf(exponent));
            &eigen.eigenvectors * DMatrix::from_diagonal(&values) * eigen.eigenvectors.transpose()
        };
        let (root, inverse_root) = (power(0.5), power(-0.5));

        let total: f64 = rows.iter().map(|(_, weight)| weight).sum::<f64>().max(f64::MIN_POSITIVE);
        let mut mean = DVector::zeros(k);
        rows.iter().for_each(|(row, weight)| mean.axpy(weight / total, row, 1.0));
        let mut covariance = DMatrix::zeros(k, k);
        for (row, weight) in rows {
            let centred = &root * (row - &mean);
            covariance.ger(weight / total, &centred, &centred, 1.0);
        }
        let axes = falling_axes(covariance);
        // Of the two signs of an axis that for which the rows lean to the positive side.
        let mut lean: DVector<f64> = DVector::zeros(k);
        for (row, weight) in rows {
            lean.axpy(*weight, &(&axes * &root * (row - &mean)).map(|x| x.powi(3)), 1.0);
        }
        let axes = DMatrix::from_diagonal(&lean.map(f64::signum)) * axes;
        Turn { there: &axes * root, back: inverse_root * axes.transpose(), mean }
    }
}

/// Unit eigenvectors of a symmetric matrix as rows, eigenvalues falling.
fn falling_axes(matrix: DMatrix<f64>) -> DMatrix<f64> {
    let eigen = matrix.symmetric_eigen();
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|&i, &j| eigen.eigenvalues[j].total_cmp(&eigen.eigenvalues[i]));
    let axes: Vec<_> = order.into_iter().map(|i| eigen.eigenvectors.column(i).transpose()).collect();
    DMatrix::from_rows(&axes)
}

/// Every number squared.
fn squared(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    matrix.component_mul(matrix)
}

fn wide(x: &[f32]) -> DVector<f64> {
    DVector::from_iterator(x.len(), x.iter().map(|&x| x.into()))
}

fn set(to: &mut [f32], x: &DVector<f64>) {
    to.iter_mut().zip(x).for_each(|(to, x)| *to = *x as f32);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turned_features_are_uncorrelated_and_seen_as_they_were() {
        let uneven = |i: usize, j: usize| (0.37 * (i * i * (j + 1)) as f64 + j as f64).sin();
        let row = |i: usize| DVector::from_fn(4, |j, _| uneven(i, j) * (1.0 + j as f64));
        let rows: Vec<(DVector<f64>, f64)> = (0..50).map(|i| (row(i), 1.0 + (i % 3) as f64)).collect();
        let neurons = DMatrix::from_fn(6, 4, |i, j| uneven(i + 3, j));
        let turn = Turn::new(&rows, neurons.tr_mul(&neurons));
        assert!((&turn.there * &turn.back - DMatrix::identity(4, 4)).amax() < 1e-9);
        let turned = |row: &DVector<f64>| &turn.there * (row - &turn.mean);
        let mut covariance = DMatrix::zeros(4, 4);
        for (row, weight) in &rows {
            let [before, after] = [&neurons * (row - &turn.mean), &neurons * &turn.back * turned(row)];
            assert!((&before - after).amax() < 1e-9);
            // A step's length is what it moves the hidden layer by.
            assert!((turned(row).norm() - before.norm()).abs() < 1e-9);
            covariance.ger(*weight, &turned(row), &turned(row), 1.0);
        }
        let variances = covariance.diagonal();
        assert!(variances.as_slice().is_sorted_by(|a, b| a >= b), "{variances}");
        covariance.set_diagonal(&DVector::zeros(4));
        assert!(covariance.amax() < 1e-9 * variances.max(), "{covariance}");
    }
}

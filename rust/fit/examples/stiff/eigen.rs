//! How unlike the directions of a symmetric matrix are.

use nalgebra::DMatrix;

/// A symmetric matrix.
pub type Matrix = DMatrix<f64>;

/// The matrix with a unit diagonal that scaling each number makes of `matrix`: what is left for an
/// optimiser that scales each number by itself, as Adam does.
pub fn scaled(matrix: &Matrix) -> Matrix {
    let scale = |a: usize, b: usize| (matrix[(a, a)] * matrix[(b, b)]).sqrt().max(f64::MIN_POSITIVE);
    Matrix::from_fn(matrix.nrows(), matrix.ncols(), |a, b| matrix[(a, b)] / scale(a, b))
}

/// Largest over smallest eigenvalue.
pub fn condition(matrix: &Matrix) -> f64 {
    let eigenvalues = matrix.symmetric_eigenvalues();
    eigenvalues.max() / eigenvalues.min().max(f64::MIN_POSITIVE)
}

//! How unlike the directions of a symmetric matrix are.

/// A symmetric matrix, row by row.
pub type Matrix = Vec<Vec<f64>>;

/// The matrix with a unit diagonal that scaling each number makes of `matrix`: what is left for an
/// optimiser that scales each number by itself, as Adam does.
pub fn scaled(matrix: &Matrix) -> Matrix {
    let scale = |a: usize, b: usize| (matrix[a][a] * matrix[b][b]).sqrt().max(f64::MIN_POSITIVE);
    let row = |a: usize| (0..matrix.len()).map(|b| matrix[a][b] / scale(a, b)).collect();
    (0..matrix.len()).map(row).collect()
}

/// Largest over smallest eigenvalue.
pub fn condition(matrix: &Matrix) -> f64 {
    let eigenvalues = eigenvalues(matrix);
    let (least, largest) = (eigenvalues[0], eigenvalues[eigenvalues.len() - 1]);
    largest / least.max(f64::MIN_POSITIVE)
}

/// In ascending order, by Jacobi's rotations.
pub fn eigenvalues(matrix: &Matrix) -> Vec<f64> {
    /// More than any matrix here needs.
    const SWEEPS: usize = 60;
    let mut m = matrix.clone();
    let n = m.len();
    let total: f64 = m.iter().flatten().map(|x| x * x).sum();
    for _ in 0..SWEEPS {
        let beside: f64 =
            (0..n).flat_map(|p| (0..p).map(move |q| (p, q))).map(|(p, q)| m[p][q].powi(2)).sum();
        if beside <= 1e-30 * total {
            break;
        }
        for p in 0..n {
            for q in p + 1..n {
                if m[p][q] != 0.0 {
                    rotate(&mut m, p, q);
                }
            }
        }
    }
    let mut eigenvalues: Vec<f64> = (0..n).map(|i| m[i][i]).collect();
    eigenvalues.sort_by(f64::total_cmp);
    eigenvalues
}

/// The rotation that makes m[p][q] 0.
fn rotate(m: &mut Matrix, p: usize, q: usize) {
    let theta = (m[q][q] - m[p][p]) / (2.0 * m[p][q]);
    let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let c = 1.0 / (t * t + 1.0).sqrt();
    let s = t * c;
    for row in m.iter_mut() {
        let (a, b) = (row[p], row[q]);
        (row[p], row[q]) = (c * a - s * b, s * a + c * b);
    }
    for k in 0..m.len() {
        let (a, b) = (m[p][k], m[q][k]);
        (m[p][k], m[q][k]) = (c * a - s * b, s * a + c * b);
    }
}

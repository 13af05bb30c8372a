//! The Hessian of the analytic fit at its end: how unlike its directions are.

use glimt_core::microfacet::Microfacet;
use glimt_core::simd::LANES;
use glimt_fit::analytic::{self, Derivatives};
use glimt_fit::backprop::BLOCK;
use glimt_fit::pairs::{Drawing, draw};

/// Numbers of an isotropic analytic BRDF.
const N: usize = 7;

/// A symmetric matrix.
pub type Matrix = [[f64; N]; N];

/// Σ w JᵀJ over pairs as a fit draws them, J = ∂ ln(1 + cosθ f_a)/∂(unbounded numbers): the Gauss-Newton
/// Hessian of the squared loss, which is the Hessian where the fit is perfect.
pub fn gauss_newton(parameters: &Microfacet) -> Matrix {
    let numbers = analytic::from_parameters(parameters, true);
    let parameters = analytic::to_parameters(&numbers);
    let mut hessian = [[0.0; N]; N];
    for pairs in draw(Drawing::Lobes, 1, 0, 256) {
        for i in 0..BLOCK {
            let (column, lane) = (i / LANES, i % LANES);
            let direction = |rows: &[[[f32; LANES]; 16]; 3]| std::array::from_fn(|c| rows[c][column][lane]);
            let (light, view): ([f32; 3], [f32; 3]) = (direction(&pairs.light), direction(&pairs.view));
            let derivatives = Derivatives::new(&parameters, light, view);
            for channel in 0..3 {
                let mut delta = [0.0; 3];
                delta[channel] = light[2] / (1.0 + light[2] * derivatives.value[channel]);
                let mut sums = [0.0; 8];
                derivatives.accumulate(delta, &mut sums);
                let mut row = vec![0.0; N];
                analytic::add_gradient(&numbers, &sums.map(f64::from), &mut row);
                for a in 0..N {
                    for b in 0..N {
                        hessian[a][b] +=
                            f64::from(pairs.weight[column][lane]) * f64::from(row[a]) * f64::from(row[b]);
                    }
                }
            }
        }
    }
    hessian
}

/// The matrix with a unit diagonal that scaling each number makes of `matrix`: what is left for an
/// optimiser that scales each number by itself, as Adam does.
pub fn scaled(matrix: &Matrix) -> Matrix {
    std::array::from_fn(|a| {
        std::array::from_fn(|b| matrix[a][b] / (matrix[a][a] * matrix[b][b]).sqrt().max(f64::MIN_POSITIVE))
    })
}

/// Largest over smallest eigenvalue, by Jacobi's rotations.
pub fn condition(matrix: &Matrix) -> f64 {
    let mut m = *matrix;
    for _ in 0..60 {
        for p in 0..N {
            for q in p + 1..N {
                if m[p][q] == 0.0 {
                    continue;
                }
                let theta = (m[q][q] - m[p][p]) / (2.0 * m[p][q]);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let c = 1.0 / (t * t + 1.0).sqrt();
                let s = t * c;
                for k in 0..N {
                    let (a, b) = (m[k][p], m[k][q]);
                    (m[k][p], m[k][q]) = (c * a - s * b, s * a + c * b);
                }
                for k in 0..N {
                    let (a, b) = (m[p][k], m[q][k]);
                    (m[p][k], m[q][k]) = (c * a - s * b, s * a + c * b);
                }
            }
        }
    }
    let eigenvalues = (0..N).map(|i| m[i][i]);
    eigenvalues.clone().fold(0.0, f64::max) / eigenvalues.fold(f64::INFINITY, f64::min).max(f64::MIN_POSITIVE)
}

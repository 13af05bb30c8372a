//! The Hessian of the analytic fit at its end: how unlike its directions are.

use glimt_core::microfacet::Microfacet;
use glimt_core::simd::LANES;
use glimt_fit::analytic::{self, Derivatives};
use glimt_fit::backprop::BLOCK;
use glimt_fit::pairs::{Drawing, draw};

use crate::eigen::Matrix;

/// Numbers of an isotropic analytic BRDF.
const N: usize = 7;

/// Σ w JᵀJ over pairs as a fit draws them, J = ∂ ln(1 + cosθ f_a)/∂(unbounded numbers): the Gauss-Newton
/// Hessian of the squared loss, which is the Hessian where the fit is perfect.
pub fn gauss_newton(parameters: &Microfacet) -> Matrix {
    let numbers = analytic::from_parameters(parameters, true);
    let parameters = analytic::to_parameters(&numbers);
    let mut hessian = Matrix::zeros(N, N);
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
                        hessian[(a, b)] +=
                            f64::from(pairs.weight[column][lane]) * f64::from(row[a]) * f64::from(row[b]);
                    }
                }
            }
        }
    }
    hessian
}

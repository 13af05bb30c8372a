//! The Hessian of a fit of factor tables at its end: how unlike its directions are.
//!
//! `cargo test -p glimt-fit --lib condition_of -- --nocapture` prints the table of docs/stiff-fits.md.

use glimt_core::Brdf;
use glimt_core::microfacet::Microfacet;
use glimt_core::models::factor::{DIFF_BINS, HALF_BINS};
use glimt_core::models::ggx::Ggx;

use super::descent::{self, Descent};
use super::eigen::{Matrix, condition, scaled};
use super::masking::{Folded, Masking};
use super::product::{STRIDE, State, Sums};
use super::{Channel, FIRST, grid};

/// Σ w JᵀJ of one colour channel by ρ_d, ρ_s, D and F, G held, which is half the Hessian of the objective
/// (eq. 7) where the fit is perfect. What no sample decides is left out: the largest of D and of F, which are 1,
/// and bins without weight or on which nothing depends because the other factor is 0.
fn hessian(folded: &Folded, state: &State, masking: &Masking) -> Matrix {
    let mut sums = Sums::new();
    folded.sum(masking, &mut sums);
    let (d, f) = (&state.ndf, &state.fresnel);
    let (ndf, fresnel) = (2, 2 + HALF_BINS);
    let mut m = Matrix::zeros(2 + HALF_BINS + DIFF_BINS, 2 + HALF_BINS + DIFF_BINS);
    for h in 0..HALF_BINS {
        for k in 0..DIFF_BINS {
            let (g, gg) = (sums.g[h * STRIDE + k], sums.gg[h * STRIDE + k]);
            // What the model of a sample is multiplied by, over g: by ρ_s, D and F.
            let by =
                [(1, d[h] * f[k]), (ndf + h, state.specular * f[k]), (fresnel + k, state.specular * d[h])];
            for (a, x) in by {
                m[(0, a)] += x * g;
                m[(a, 0)] += x * g;
                for (b, y) in by {
                    m[(a, b)] += x * y * gg;
                }
            }
        }
    }
    m[(0, 0)] = folded.fixed.weight;
    let largest = |curve: &[f64]| curve.iter().position(|&x| x == 1.0).expect("factors are normalised");
    let fixed = [ndf + largest(d), fresnel + largest(&f[..DIFF_BINS])];
    let free: Vec<usize> = (0..m.nrows()).filter(|&a| !fixed.contains(&a) && m[(a, a)] > 0.0).collect();
    m.select_rows(&free).select_columns(&free)
}

/// The rows and columns of `matrix` from `first` on.
fn corner(matrix: &Matrix, first: usize) -> Matrix {
    let rest = matrix.nrows() - first;
    matrix.view((first, first), (rest, rest)).into_owned()
}

#[test]
fn condition_of_factor_tables_is_bounded_once_each_number_is_scaled() {
    println!("condition of the Hessian of rho_d, rho_s, D and F (eq. 7), and without rho_d and rho_s");
    println!(
        "{:24} {:>13} {:>8} {:>9} {:>9} {:>12}",
        "material", "variant", "numbers", "as it is", "scaled", "D, F scaled"
    );
    for (name, kd, eta, alpha) in [
        ("rough plastic", 0.2, 1.5, 0.5),
        ("plastic", 0.2, 1.5, 0.2),
        ("polished plastic", 0.2, 1.5, 0.05),
        ("metal", 0.0, 8.0, 0.2),
        ("dark base", 1e-4, 1.5, 0.2),
    ] {
        let parameters = Microfacet { kd: [kd; 3], eta: [eta; 3], alpha: [alpha; 2] };
        let brdf = Ggx::new(parameters).expect("parameters are in their ranges");
        let grid::Resampled { values: [values, ..], trust } = grid::resample(&brdf as &dyn Brdf);
        let channel = Channel { weights: grid::weights(&values, &trust), values };
        let folded = channel.folded();
        let from_d = channel.g_from_d(&folded);
        let own = descent::independent_g(&folded, from_d.state.clone(), from_d.third, FIRST);
        for (variant, Descent { state, third, .. }) in [("g-from-d", &from_d), ("independent-g", &own)] {
            let hessian = hessian(&folded, state, third);
            let all = scaled(&hessian);
            let (plain, whole, tables) = (condition(&hessian), condition(&all), condition(&corner(&all, 2)));
            println!(
                "{name:24} {variant:>13} {:>8} {plain:>9.1e} {whole:>9.1e} {tables:>12.1e}",
                hessian.nrows()
            );
            assert!(whole <= plain && whole < 1e9, "{name}, {variant}: {plain:e}, scaled {whole:e}");
        }
    }
}

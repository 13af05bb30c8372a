//! Laws of the fits of factor tables, on materials whose factors are known.

use glimt_core::microfacet::Microfacet;
use glimt_core::models::factor::{Factor, Factors, Interpolation, Product, Variant};
use glimt_core::models::ggx::Ggx;
use glimt_core::{Brdf, Vec3};
use glimt_fit::{FactorOptions, fit_factor};

const ALL: [Variant; 4] = [Variant::IndependentG, Variant::GFromD, Variant::Naive, Variant::Bivariate];

fn options(variant: Variant, seed: u64) -> FactorOptions {
    FactorOptions { variant, interpolation: Interpolation::Nearest, seed }
}

fn glossy() -> Ggx {
    Ggx::new(Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.5, 1.8, 2.5], alpha: [0.25; 2] }).unwrap()
}

fn last(trace: &[f64]) -> f64 {
    trace[trace.len() - 1]
}

#[test]
fn the_objective_never_rises_and_richer_variants_end_lower() {
    let brdf = glossy();
    let fits = ALL.map(|variant| fit_factor(&brdf, &options(variant, 0)));
    for fit in &fits {
        for trace in &fit.traces {
            assert!(trace.windows(2).all(|pair| pair[1] < pair[0]), "{trace:?}");
            assert!(trace.iter().all(|objective| objective.is_finite()));
        }
    }
    // A microfacet model with Smith's masking: eq. 3 holds it but for the resolution of the grid.
    for c in 0..3 {
        let [independent, from_d, naive, _] = fits.each_ref().map(|fit| last(&fit.traces[c]));
        assert!(independent <= from_d && from_d < naive, "{independent} {from_d} {naive}");
    }
}

#[test]
fn a_material_of_factors_comes_back() {
    let curve = |at: fn(f32) -> f32| [std::array::from_fn(|i| at((i as f32 + 0.5) / 90.0)); 3];
    let product = Product {
        diffuse: [0.1, 0.05, 0.02],
        specular: [1.0, 0.8, 0.6],
        ndf: curve(|x| (-6.0 * x * x).exp().min(1.0)),
        fresnel: curve(|x| 0.2 + 0.8 * x.powi(5)),
    };
    let truth = Factor::new(Factors::GFromD(product), Interpolation::Nearest).unwrap();
    let fit = fit_factor(&truth, &options(Variant::GFromD, 0));
    for i in 0..200 {
        let direction = |i: usize| {
            let (z, phi) = (0.2 + 0.8 * (i as f32 * 0.754_877_7).fract(), i as f32 * 2.399);
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * phi.cos(), r * phi.sin(), z)
        };
        let (light, view) = (direction(i), direction(7 * i + 3));
        let (f, expected) = (fit.factor.eval(light, view), truth.eval(light, view));
        assert!((f - expected).abs().max_element() < 0.03 * expected.max_element(), "{f} for {expected}");
    }
}

#[test]
fn seeds_end_alike_and_the_same_seed_ends_the_same() {
    let brdf = glossy();
    let ends =
        |seed| fit_factor(&brdf, &options(Variant::IndependentG, seed)).traces.map(|trace| last(&trace));
    let (first, again, other) = (ends(1), ends(1), ends(2));
    assert_eq!(first, again);
    for (a, b) in first.into_iter().zip(other) {
        assert!((a / b - 1.0).abs() < 0.05, "{a} {b}");
    }
}

#[test]
fn black_and_values_that_are_not_finite_make_a_material() {
    struct Odd(Vec3);
    impl Brdf for Odd {
        fn eval(&self, _: Vec3, _: Vec3) -> Vec3 {
            self.0
        }
    }
    for value in [Vec3::ZERO, Vec3::new(f32::NAN, f32::INFINITY, -1.0), Vec3::ONE] {
        for variant in [Variant::GFromD, Variant::Naive, Variant::Bivariate] {
            let f = fit_factor(&Odd(value), &options(variant, 0)).factor.eval(Vec3::Z, Vec3::Z);
            assert!(f.is_finite() && f.min_element() >= 0.0);
            if value == Vec3::ONE {
                assert!((f - Vec3::ONE).abs().max_element() < 1e-3, "{variant:?}: {f}");
            }
        }
    }
}

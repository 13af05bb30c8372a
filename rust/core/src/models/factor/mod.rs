//! `factor`: Bagher, Snyder, Nowrouzezahrai 2016, *A Non-Parametric Factor Microfacet Model for
//! Isotropic BRDFs*: tables over single angles in place of the formulas of a microfacet model.
//!
//! f = ρ_d + ρ_s D(θ_h) F(θ_d) G(θ_l) G(θ_v) / (cosθ_l cosθ_v) per colour channel (eq. 3), and what the
//! paper compares it with: a product without microfacets (eq. 4) and a table over (θ_h, θ_d) (eq. 5).
//! Isotropic and reciprocal by construction.
//!
//! The tables stand on the grid of the MERL database: 90 bins of √θ_h, 90 of θ_d, 180 of φ_d, with
//! the values at their centres; G stands at whole degrees, 0° to 89°. Beyond 89°, where the fit has seen
//! nothing, G and the cosine keep their values of 89°, so that f stays finite.

mod bins;
mod lookup;
pub mod reference;
pub mod smith;

use std::f32::consts::FRAC_PI_2;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::error::Invalid;
use crate::models::{Model, spelled};
pub use bins::{AZIMUTH_BINS, DIFF_BINS, HALF_BINS, MASKING_KNOTS};
use lookup::Tables;

/// The largest elevation that a fit sees (the paper, §4.1), and the last knot of G: 89°.
pub const MAX_THETA: f32 = 89.0 / 90.0 * FRAC_PI_2;
/// cos 89°.
const MIN_COS: f32 = 0.017_452_406;

/// Largest ρ_d, ρ_s and value of a bivariate table: with the cosines at 89° f stays far inside float32.
pub const MAX_SCALE: f32 = 1e12;

/// How the factors are multiplied, and which there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Variant {
    /// Eq. 3, with a G that was fitted.
    IndependentG,
    /// Eq. 3, with the G that Smith's model derives from D.
    GFromD,
    /// Eq. 4: D(θ_h) F(θ_d) H(φ_d), no microfacets.
    Naive,
    /// Eq. 5: one table over θ_h and θ_d.
    Bivariate,
}

/// How D, F and the bivariate table answer between the centres of their bins. G is always linear.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Interpolation {
    /// The value of the bin, as in the paper: piecewise constant.
    Nearest,
    /// Linear in √θ_h and θ_d.
    #[default]
    Linear,
}

/// What the libraries of `factor` materials have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Form {
    /// The factors.
    pub variant: Variant,
    /// Between the bins.
    pub interpolation: Interpolation,
}

/// A table over one angle, per colour channel.
pub type Curve<const N: usize> = [[f32; N]; 3];

/// The factors that all products have.
#[derive(Clone, Debug, PartialEq)]
pub struct Product {
    /// ρ_d in sr⁻¹: the paper absorbs the division by π.
    pub diffuse: [f32; 3],
    /// ρ_s.
    pub specular: [f32; 3],
    /// D over √θ_h, at most 1.
    pub ndf: Curve<HALF_BINS>,
    /// F over θ_d, at most 1.
    pub fresnel: Curve<DIFF_BINS>,
}

/// The numbers of a material, by variant.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a material holds one of them behind a pointer")]
pub enum Factors {
    /// [`Variant::IndependentG`]: 3,264 bytes.
    IndependentG {
        /// ρ_d, ρ_s, D and F.
        product: Product,
        /// G at whole degrees, at most 1.
        masking: Curve<MASKING_KNOTS>,
    },
    /// [`Variant::GFromD`]: G follows from D, 2,184 bytes.
    GFromD(Product),
    /// [`Variant::Naive`]: 4,344 bytes.
    Naive {
        /// ρ_d, ρ_s, D and F.
        product: Product,
        /// H over φ_d, at most 1.
        azimuth: Curve<AZIMUTH_BINS>,
    },
    /// [`Variant::Bivariate`]: f by θ_h and θ_d, the latter fastest; 97,200 bytes.
    Bivariate(Vec<[f32; 3]>),
}

impl Factors {
    /// Which they are.
    #[must_use]
    pub fn variant(&self) -> Variant {
        match self {
            Factors::IndependentG { .. } => Variant::IndependentG,
            Factors::GFromD(_) => Variant::GFromD,
            Factors::Naive { .. } => Variant::Naive,
            Factors::Bivariate(_) => Variant::Bivariate,
        }
    }

    fn validate(&self) -> Result<(), Invalid> {
        let (product, third) = match self {
            Factors::IndependentG { product, masking } => (product, ("masking", masking.as_flattened())),
            Factors::GFromD(product) => (product, ("masking", &[][..])),
            Factors::Naive { product, azimuth } => (product, ("azimuth", azimuth.as_flattened())),
            Factors::Bivariate(table) => {
                if table.len() != HALF_BINS * DIFF_BINS {
                    return Err(format!("the table has {} bins, expected 90 times 90", table.len()).into());
                }
                return in_range("bivariate", table.as_flattened(), MAX_SCALE);
            }
        };
        in_range("diffuse", &product.diffuse, MAX_SCALE)?;
        in_range("specular", &product.specular, MAX_SCALE)?;
        in_range("ndf", product.ndf.as_flattened(), 1.0)?;
        in_range("fresnel", product.fresnel.as_flattened(), 1.0)?;
        in_range(third.0, third.1, 1.0)
    }
}

fn in_range(name: &str, values: &[f32], most: f32) -> Result<(), Invalid> {
    match values.iter().position(|x| !(0.0..=most).contains(x)) {
        Some(at) => {
            Err(format!("{name} holds {} at index {at}, expected numbers from 0 to {most:e}", values[at])
                .into())
        }
        None => Ok(()),
    }
}

/// One material.
#[derive(Clone, Debug)]
pub struct Factor {
    factors: Arc<Factors>,
    interpolation: Interpolation,
    tables: Arc<Tables>,
}

impl Factor {
    /// The material with these factors.
    ///
    /// # Errors
    /// In words, a number out of its range or a table of another size.
    pub fn new(factors: Factors, interpolation: Interpolation) -> Result<Self, Invalid> {
        factors.validate()?;
        let tables = Arc::new(Tables::new(&factors));
        Ok(Factor { factors: Arc::new(factors), interpolation, tables })
    }

    /// The material's numbers.
    #[must_use]
    pub fn factors(&self) -> &Factors {
        &self.factors
    }

    /// Variant and interpolation.
    #[must_use]
    pub fn form(&self) -> Form {
        Form { variant: self.factors.variant(), interpolation: self.interpolation }
    }

    /// The same numbers, answered with another interpolation.
    #[must_use]
    pub fn with_interpolation(&self, interpolation: Interpolation) -> Factor {
        Factor { interpolation, ..self.clone() }
    }
}

impl Model for Factor {
    const KIND: &'static str = "factor";

    fn describe(&self) -> String {
        let Form { variant, interpolation } = self.form();
        format!("{}, {} in {HALF_BINS} × {DIFF_BINS} bins", spelled(&variant), spelled(&interpolation))
    }

    fn is_isotropic(&self) -> bool {
        true
    }

    fn is_reciprocal(&self) -> bool {
        true
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::brdf::Brdf;
    use glam::{DVec3, Vec3};
    use proptest::prelude::*;
    use std::f32::consts::PI;
    use std::sync::LazyLock;

    fn curve<const N: usize>(at: impl Fn(f32) -> f32) -> Curve<N> {
        std::array::from_fn(|c| {
            std::array::from_fn(|i| at((i as f32 + 0.5) / N as f32) / (1.0 + 0.2 * c as f32))
        })
    }

    /// A glossy material in every variant.
    pub(crate) fn patterned_factors() -> [Factors; 4] {
        let product = Product {
            diffuse: [0.05, 0.04, 0.03],
            specular: [2.0, 1.5, 1.0],
            ndf: curve(|x| (-20.0 * x.powi(4)).exp()),
            fresnel: curve(|x| 0.1 + 0.9 * x.powi(5)),
        };
        let masking = curve(|x| 1.0 - x.powi(4));
        let azimuth = curve(|x| 0.8 + 0.2 * (PI * x).cos());
        let bins = (0..HALF_BINS * DIFF_BINS).map(|i| {
            let (h, d) = ((i / DIFF_BINS) as f32 / 90.0, (i % DIFF_BINS) as f32 / 90.0);
            [0.1 + (-9.0 * h).exp(), 0.1 * d + 0.02, 0.3 * h]
        });
        [
            Factors::IndependentG { product: product.clone(), masking },
            Factors::GFromD(product.clone()),
            Factors::Naive { product, azimuth },
            Factors::Bivariate(bins.collect()),
        ]
    }

    /// [`patterned_factors`] with either interpolation.
    static MATERIALS: LazyLock<Vec<Factor>> = LazyLock::new(|| {
        let nearest =
            patterned_factors().map(|factors| Factor::new(factors, Interpolation::Nearest).unwrap());
        let linear = nearest.each_ref().map(|material| material.with_interpolation(Interpolation::Linear));
        nearest.into_iter().chain(linear).collect()
    });

    fn direction() -> impl Strategy<Value = Vec3> {
        (0.0..1.0f32, 0.0..std::f32::consts::TAU).prop_map(|(z, phi)| {
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * phi.cos(), r * phi.sin(), z)
        })
    }

    /// Whether rounding may move a pair over the edge of a bin.
    fn near_an_edge(light: DVec3, view: DVec3) -> bool {
        reference::position(light, view).iter().any(|x| (x - x.round()).abs() < 2e-3)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn eval_is_the_reference_in_every_kernel(pairs in prop::collection::vec((direction(), direction()), 1..20)) {
            for material in &*MATERIALS {
                let (light, view): (Vec<_>, Vec<_>) = pairs.iter().copied().unzip();
                let mut batch = vec![Vec3::ONE; light.len()];
                material.eval_batch(&light, &view, &mut batch);
                for ((&light, &view), f) in light.iter().zip(&view).zip(batch) {
                    prop_assert_eq!(f, material.eval(light, view));
                    let (l, v) = (light.as_dvec3().normalize(), view.as_dvec3().normalize());
                    if f == Vec3::ZERO || near_an_edge(l, v) || l.z.min(v.z) < 1e-3 {
                        continue;
                    }
                    for (f, truth) in f.to_array().into_iter().zip(reference::eval(material, l, v)) {
                        let error = (f64::from(f) - truth).abs();
                        prop_assert!(error <= 2e-3 * truth, "{:?}: {f} against {truth}", material.form());
                    }
                }
            }
        }

        #[test]
        fn eval_is_reciprocal_and_the_same_in_every_azimuth(light in direction(), view in direction(), turn in 0.0..6.3f64) {
            let turned = |v: Vec3| (glam::DMat3::from_rotation_z(turn) * v.as_dvec3()).as_vec3();
            for material in &*MATERIALS {
                let f = material.eval(light, view);
                prop_assert_eq!(f, material.eval(view, light));
                if !near_an_edge(light.as_dvec3(), view.as_dvec3()) {
                    let other = material.eval(turned(light), turned(view));
                    prop_assert!((f - other).abs().max_element() <= 2e-3 * f.max_element(), "{f} {other}");
                }
            }
        }

        #[test]
        fn eval_is_finite_and_not_negative_for_any_numbers(
            light in prop::array::uniform3(prop::num::f32::ANY), view in prop::array::uniform3(prop::num::f32::ANY),
            x in -1.0..1.0f32, zl in 0.0..1e-30f32, zv in 0.0..1e-30f32,
        ) {
            let y = (1.0 - x * x).sqrt();
            let grazing = (Vec3::new(x, y, zl), Vec3::new(-x, -y, zv));
            for material in &*MATERIALS {
                for (light, view) in [(light.into(), view.into()), grazing, (grazing.0, grazing.0)] {
                    let f = material.eval(light, view);
                    prop_assert!(f.is_finite() && f.min_element() >= 0.0);
                }
            }
        }
    }

    #[test]
    fn sizes_are_those_of_the_paper() {
        let product = 4 * 3 * (2 + HALF_BINS + DIFF_BINS);
        assert_eq!(product + 4 * 3 * MASKING_KNOTS, 3264);
        assert_eq!(product + 4 * 3 * AZIMUTH_BINS, 4344);
        assert_eq!(4 * 3 * HALF_BINS * DIFF_BINS, 97200);
    }

    #[test]
    fn smooth_tables_answer_alike_with_either_interpolation() {
        let (light, view) = (Vec3::new(0.36, 0.48, 0.8), Vec3::new(-0.6, 0.0, 0.8));
        for factors in patterned_factors() {
            let nearest = Factor::new(factors, Interpolation::Nearest).unwrap();
            let linear = nearest.with_interpolation(Interpolation::Linear);
            let (a, b) = (nearest.eval(light, view), linear.eval(light, view));
            assert!(a != b && (a - b).abs().max_element() < 0.1 * a.max_element(), "{a} {b}");
        }
    }

    #[test]
    fn numbers_out_of_range_are_named() {
        let [Factors::IndependentG { product, masking }, _, _, Factors::Bivariate(mut table)] =
            patterned_factors()
        else {
            unreachable!("the order of the variants")
        };
        let refused = |factors| Factor::new(factors, Interpolation::Nearest).unwrap_err();
        let mut broken = product.clone();
        broken.ndf[1][3] = 1.5;
        assert!(refused(Factors::GFromD(broken)).to_string().contains("ndf holds 1.5 at index 93"));
        let mut broken = product.clone();
        broken.diffuse[2] = -0.1;
        assert!(refused(Factors::GFromD(broken)).to_string().contains("diffuse holds -0.1 at index 2"));
        let mut broken = masking;
        broken[0][0] = f32::NAN;
        assert!(
            refused(Factors::IndependentG { product, masking: broken })
                .to_string()
                .contains("masking holds NaN")
        );
        table.pop();
        assert!(refused(Factors::Bivariate(table)).to_string().contains("8099 bins, expected 90 times 90"));
    }
}

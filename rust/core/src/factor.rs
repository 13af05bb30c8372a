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

use std::f32::consts::{FRAC_2_PI, FRAC_PI_2, PI};
use std::sync::Arc;

use glam::{Vec3, Vec4};
use serde::{Deserialize, Serialize};

use crate::brdf::{Brdf, is_lit, mask_unlit};
use crate::dispatch;
use crate::lobes::{Lobes, PROXY_ALPHAS};
use crate::math::angle;
use crate::microfacet::Half;
use crate::model::Model;
use crate::sampler::Sampler;
use crate::simd::{LANES, Lane3};
use crate::smith;

/// Bins of √θ_h over 0° to 90°.
pub const HALF_BINS: usize = 90;
/// Bins of θ_d over 0° to 90°.
pub const DIFF_BINS: usize = 90;
/// Bins of φ_d over 0° to 180°.
pub const AZIMUTH_BINS: usize = 180;
/// Knots of G: whole degrees from 0° on.
pub const MASKING_KNOTS: usize = 90;

/// The largest elevation that a fit sees (the paper, §4.1), and the last knot of G: 89°.
pub const MAX_THETA: f32 = 89.0 / 90.0 * FRAC_PI_2;
/// cos 89°.
const MIN_COS: f32 = 0.017_452_406;

/// Largest ρ_s and largest value of a bivariate table: with the cosines at 89° f stays far inside float32.
const MAX_SCALE: f32 = 1e12;

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

    fn validate(&self) -> Result<(), String> {
        let (product, third) = match self {
            Factors::IndependentG { product, masking } => (product, ("masking", masking.as_flattened())),
            Factors::GFromD(product) => (product, ("masking", &[][..])),
            Factors::Naive { product, azimuth } => (product, ("azimuth", azimuth.as_flattened())),
            Factors::Bivariate(table) => {
                if table.len() != HALF_BINS * DIFF_BINS {
                    return Err(format!("the table has {} bins, expected 90 times 90", table.len()));
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

fn in_range(name: &str, values: &[f32], most: f32) -> Result<(), String> {
    match values.iter().position(|x| !(0.0..=most).contains(x)) {
        Some(at) => {
            Err(format!("{name} holds {} at index {at}, expected numbers from 0 to {most:e}", values[at]))
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
    sampler: Sampler,
}

impl Factor {
    /// The material with these factors.
    ///
    /// # Errors
    /// In words, a number out of its range or a table of another size.
    pub fn new(factors: Factors, interpolation: Interpolation) -> Result<Self, String> {
        factors.validate()?;
        let tables = Arc::new(Tables::new(&factors));
        let lobes = Lobes { alpha: PROXY_ALPHAS[0], specular_weight: 0.5 };
        let mut factor = Factor { factors: Arc::new(factors), interpolation, tables, sampler: lobes.into() };
        factor.sampler = Lobes::fit(&factor, &PROXY_ALPHAS).into();
        Ok(factor)
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

    /// A proxy that was fitted to the tables.
    fn sampler(&self) -> &Sampler {
        &self.sampler
    }

    fn set_sampler(&mut self, sampler: Sampler) {
        self.sampler = sampler;
    }

    fn is_isotropic(&self) -> bool {
        true
    }

    fn is_reciprocal(&self) -> bool {
        true
    }
}

/// `$body` with `$lookup` bound to the [`Lookup`] of a material's variant and interpolation.
macro_rules! with_lookup {
    ($material:expr, $lookup:ident => $body:expr) => {{
        let linear = $material.interpolation == Interpolation::Linear;
        match &*$material.tables {
            Tables::Microfacet(t) if linear => with_lookup!(@ Microfacet::<true>(t), $lookup => $body),
            Tables::Microfacet(t) => with_lookup!(@ Microfacet::<false>(t), $lookup => $body),
            Tables::Naive(t) if linear => with_lookup!(@ Naive::<true>(t), $lookup => $body),
            Tables::Naive(t) => with_lookup!(@ Naive::<false>(t), $lookup => $body),
            Tables::Bivariate(t) if linear => with_lookup!(@ Bivariate::<true>(t), $lookup => $body),
            Tables::Bivariate(t) => with_lookup!(@ Bivariate::<false>(t), $lookup => $body),
        }
    }};
    (@ $value:expr, $lookup:ident => $body:expr) => {{
        let $lookup = $value;
        $body
    }};
}

impl Brdf for Factor {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        if !is_lit(light, view) {
            return Vec3::ZERO;
        }
        let f = with_lookup!(self, lookup => one(lookup, light.to_array(), view.to_array()));
        Vec3::new(f.x, f.y, f.z)
    }

    fn eval_tile(&self, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        eval_tile(self, light, view, out);
        mask_unlit(light, view, out);
    }
}

dispatch! {
    fn eval_tile(_isa, material: &Factor, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        with_lookup!(material, lookup => each_lane(lookup, light, view, out));
    }
}

/// A material's tables as they are looked up: the colour channels side by side, ρ_s in D.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "a material holds one of them behind a pointer")]
enum Tables {
    Microfacet(MicrofacetTables),
    Naive(NaiveTables),
    Bivariate(Vec<Vec4>),
}

#[derive(Debug)]
struct ProductTables {
    diffuse: Vec4,
    ndf: [Vec4; HALF_BINS],
    fresnel: [Vec4; DIFF_BINS],
}

#[derive(Debug)]
struct MicrofacetTables {
    product: ProductTables,
    masking: [Vec4; MASKING_KNOTS],
}

#[derive(Debug)]
struct NaiveTables {
    product: ProductTables,
    azimuth: [Vec4; AZIMUTH_BINS],
}

impl Tables {
    fn new(factors: &Factors) -> Tables {
        match factors {
            Factors::IndependentG { product, masking } => Tables::microfacet(product, masking),
            Factors::GFromD(product) => {
                let masking = product.ndf.each_ref().map(|ndf| smith::masking(ndf).map(|g| g as f32));
                Tables::microfacet(product, &masking)
            }
            Factors::Naive { product, azimuth } => {
                let (product, azimuth) = (ProductTables::new(product), interleave(azimuth, [1.0; 3]));
                Tables::Naive(NaiveTables { product, azimuth })
            }
            Factors::Bivariate(table) => {
                Tables::Bivariate(table.iter().map(|&f| Vec3::from(f).extend(0.0)).collect())
            }
        }
    }

    fn microfacet(product: &Product, masking: &Curve<MASKING_KNOTS>) -> Tables {
        let (product, masking) = (ProductTables::new(product), interleave(masking, [1.0; 3]));
        Tables::Microfacet(MicrofacetTables { product, masking })
    }
}

impl ProductTables {
    fn new(product: &Product) -> ProductTables {
        ProductTables {
            diffuse: Vec3::from(product.diffuse).extend(0.0),
            ndf: interleave(&product.ndf, product.specular),
            fresnel: interleave(&product.fresnel, [1.0; 3]),
        }
    }

    /// D(θ_h) F(θ_d).
    #[inline(always)]
    fn product<const LINEAR: bool>(&self, half: f32, diff: f32) -> Vec4 {
        bin::<LINEAR>(&self.ndf, half) * bin::<LINEAR>(&self.fresnel, diff)
    }
}

/// The channels side by side, each times a number.
fn interleave<const N: usize>(curve: &Curve<N>, scale: [f32; 3]) -> [Vec4; N] {
    std::array::from_fn(|i| {
        Vec4::new(scale[0] * curve[0][i], scale[1] * curve[1][i], scale[2] * curve[2][i], 0.0)
    })
}

/// The value of bins at a position in units of bins, which is not negative: that of the bin, or linear
/// between the bins' centres.
#[inline(always)]
fn bin<const LINEAR: bool>(bins: &[Vec4], position: f32) -> Vec4 {
    if LINEAR { knot(bins, (position - 0.5).max(0.0)) } else { bins[(position as usize).min(bins.len() - 1)] }
}

/// Linear between knots at 0, 1, 2 …; the last one beyond it.
#[inline(always)]
fn knot(knots: &[Vec4], position: f32) -> Vec4 {
    let low = (position as usize).min(knots.len() - 2);
    let t = (position - low as f32).min(1.0);
    knots[low] + (knots[low + 1] - knots[low]) * t
}

/// Numbers that say where in its tables a pair of directions lies.
const PLACES: usize = 5;

/// A variant's way from directions to f: first where to look, then the look.
trait Lookup: Copy {
    fn place(light: [f32; 3], view: [f32; 3]) -> [f32; PLACES];
    fn value(self, place: [f32; PLACES]) -> Vec4;
}

#[inline(always)]
fn one<L: Lookup>(lookup: L, light: [f32; 3], view: [f32; 3]) -> Vec4 {
    lookup.value(L::place(light, view))
}

/// The angles of all lanes come before the lookups, so that they are computed side by side.
#[inline(always)]
fn each_lane<L: Lookup>(lookup: L, light: &Lane3, view: &Lane3, out: &mut Lane3) {
    let mut places = [[0.0; LANES]; PLACES];
    for lane in 0..LANES {
        let place = L::place(
            [light[0][lane], light[1][lane], light[2][lane]],
            [view[0][lane], view[1][lane], view[2][lane]],
        );
        for (places, place) in places.iter_mut().zip(place) {
            places[lane] = place;
        }
    }
    for lane in 0..LANES {
        let [a, b, c, d, e] = &places;
        let f = lookup.value([a[lane], b[lane], c[lane], d[lane], e[lane]]);
        [out[0][lane], out[1][lane], out[2][lane]] = [f.x, f.y, f.z];
    }
}

/// Eq. 3.
#[derive(Clone, Copy)]
struct Microfacet<'a, const LINEAR: bool>(&'a MicrofacetTables);

impl<const LINEAR: bool> Lookup for Microfacet<'_, LINEAR> {
    #[inline(always)]
    fn place(light: [f32; 3], view: [f32; 3]) -> [f32; PLACES] {
        let [half, diff] = half_diff(light, view);
        let theta = |v: [f32; 3]| angle((v[0] * v[0] + v[1] * v[1]).sqrt(), v[2]) * (90.0 * FRAC_2_PI);
        let cosines = light[2].max(MIN_COS) * view[2].max(MIN_COS);
        [half, diff, theta(light), theta(view), 1.0 / cosines]
    }

    #[inline(always)]
    fn value(self, [half, diff, light, view, scale]: [f32; PLACES]) -> Vec4 {
        let MicrofacetTables { product, masking } = self.0;
        let masking = knot(masking, light) * knot(masking, view);
        product.diffuse + product.product::<LINEAR>(half, diff) * masking * scale
    }
}

/// Eq. 4.
#[derive(Clone, Copy)]
struct Naive<'a, const LINEAR: bool>(&'a NaiveTables);

impl<const LINEAR: bool> Lookup for Naive<'_, LINEAR> {
    #[inline(always)]
    fn place(light: [f32; 3], view: [f32; 3]) -> [f32; PLACES] {
        let [half, diff] = half_diff(light, view);
        [half, diff, azimuth(light, view), 0.0, 0.0]
    }

    #[inline(always)]
    fn value(self, [half, diff, azimuth, ..]: [f32; PLACES]) -> Vec4 {
        let NaiveTables { product, azimuth: bins } = self.0;
        product.diffuse + product.product::<LINEAR>(half, diff) * bin::<false>(bins, azimuth)
    }
}

/// Eq. 5.
#[derive(Clone, Copy)]
struct Bivariate<'a, const LINEAR: bool>(&'a [Vec4]);

impl<const LINEAR: bool> Lookup for Bivariate<'_, LINEAR> {
    #[inline(always)]
    fn place(light: [f32; 3], view: [f32; 3]) -> [f32; PLACES] {
        let [half, diff] = half_diff(light, view);
        [half, diff, 0.0, 0.0, 0.0]
    }

    #[inline(always)]
    fn value(self, [half, diff, ..]: [f32; PLACES]) -> Vec4 {
        let row = |half: usize| &self.0[half * DIFF_BINS..][..DIFF_BINS];
        if LINEAR {
            let half = (half - 0.5).max(0.0);
            let low = (half as usize).min(HALF_BINS - 2);
            let [near, far] = [low, low + 1].map(|half| bin::<true>(row(half), diff));
            near + (far - near) * (half - low as f32).min(1.0)
        } else {
            bin::<false>(row((half as usize).min(HALF_BINS - 1)), diff)
        }
    }
}

/// √θ_h and θ_d in units of bins.
#[inline(always)]
fn half_diff(light: [f32; 3], view: [f32; 3]) -> [f32; 2] {
    let h = Half::new(light, view).vector;
    let d = [light[0] - view[0], light[1] - view[1], light[2] - view[2]];
    let across = (h[0] * h[0] + h[1] * h[1]).sqrt();
    let along = (across * across + h[2] * h[2]).sqrt();
    let apart = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    // |l − v| = 2 sinθ_d and |l + v| = 2 cosθ_d: accurate at small and at large θ_d.
    let (theta_h, theta_d) = (angle(across, h[2]), angle(apart, along));
    [(theta_h * FRAC_2_PI).sqrt() * HALF_BINS as f32, theta_d * (FRAC_2_PI * DIFF_BINS as f32)]
}

/// φ_d in units of bins: the light's azimuth about the half vector, from the plane of that and the normal,
/// modulo 180°. The very same number for both orders of light and view.
#[inline(always)]
fn azimuth(light: [f32; 3], view: [f32; 3]) -> f32 {
    let h = Half::new(light, view).vector;
    let d = [light[0] - view[0], light[1] - view[1], light[2] - view[2]];
    // Twice the light's components along the tangent (in the plane) and the bitangent, times sinθ_h.
    let across = h[0] * h[0] + h[1] * h[1];
    // Squares below the normal numbers have no digits; where they count as 0, h = n.
    let (along, beside) = if across >= f32::MIN_POSITIVE {
        // The first is −d_z |h| too, but that takes lengths of exactly 1.
        let outward = d[0] * h[0] + d[1] * h[1];
        let along = (h[2] * outward - across * d[2]) / (across + h[2] * h[2]).sqrt();
        (along, d[1] * h[0] - d[0] * h[1])
    } else {
        (d[0], d[1])
    };
    let phi = angle(beside.abs(), along.abs());
    // The second and the fourth quadrant are one modulo 180°. The sign of the product would vanish with it.
    let opposite = (along < 0.0 && beside > 0.0) || (along > 0.0 && beside < 0.0);
    let phi = if opposite { PI - phi } else { phi };
    (phi * (AZIMUTH_BINS as f32 / PI)).min(AZIMUTH_BINS as f32 - 0.5)
}

/// The same model in float64 by its definition. What tests compare against.
pub mod reference {
    use super::{AZIMUTH_BINS, DIFF_BINS, Factor, Factors, HALF_BINS, Interpolation, MIN_COS, Product};
    use crate::smith;
    use glam::{DMat3, DVec3};
    use std::f64::consts::{FRAC_PI_2, PI};

    /// √θ_h, θ_d and φ_d in units of bins, by Rusinkiewicz' rotations.
    #[must_use]
    pub fn position(light: DVec3, view: DVec3) -> [f64; 3] {
        let half = (light + view).normalize();
        let (theta_h, phi_h) = (half.truncate().length().atan2(half.z), half.y.atan2(half.x));
        let d = DMat3::from_rotation_y(-theta_h) * (DMat3::from_rotation_z(-phi_h) * light);
        let theta_d = (light - view).length().atan2((light + view).length());
        let phi_d = d.y.atan2(d.x).rem_euclid(PI);
        [
            (theta_h / FRAC_PI_2).sqrt() * HALF_BINS as f64,
            theta_d / FRAC_PI_2 * DIFF_BINS as f64,
            phi_d / PI * AZIMUTH_BINS as f64,
        ]
    }

    /// f for directions above the horizon.
    #[must_use]
    pub fn eval(material: &Factor, light: DVec3, view: DVec3) -> [f64; 3] {
        let [half, diff, azimuth] = position(light, view);
        let bin = |bins: &[f32], position: f64| match material.interpolation {
            Interpolation::Nearest => f64::from(bins[(position as usize).min(bins.len() - 1)]),
            Interpolation::Linear => {
                knot(&bins.iter().map(|&x| x.into()).collect::<Vec<_>>(), position - 0.5)
            }
        };
        let product = |p: &Product, c: usize, rest: f64| {
            let specular = f64::from(p.specular[c]) * bin(&p.ndf[c], half) * bin(&p.fresnel[c], diff);
            f64::from(p.diffuse[c]) + specular * rest
        };
        let masking = |knots: &[f64], direction: DVec3| {
            let theta = direction.truncate().length().atan2(direction.z).min(89f64.to_radians());
            knot(knots, theta.to_degrees()) / direction.z.max(MIN_COS.into())
        };
        std::array::from_fn(|c| match &*material.factors {
            Factors::IndependentG { product: p, masking: g } => {
                let g = g[c].map(f64::from);
                product(p, c, masking(&g, light) * masking(&g, view))
            }
            Factors::GFromD(p) => {
                let g = smith::masking(&p.ndf[c]);
                product(p, c, masking(&g, light) * masking(&g, view))
            }
            Factors::Naive { product: p, azimuth: h } => {
                product(p, c, h[c][(azimuth as usize).min(AZIMUTH_BINS - 1)].into())
            }
            Factors::Bivariate(table) => {
                let rows: Vec<f32> = (0..HALF_BINS)
                    .map(|h| {
                        let row: Vec<f32> =
                            table[h * DIFF_BINS..][..DIFF_BINS].iter().map(|f| f[c]).collect();
                        bin(&row, diff) as f32
                    })
                    .collect();
                bin(&rows, half)
            }
        })
    }

    /// Linear between knots at 0, 1, 2 …, the ends beyond them.
    fn knot(knots: &[f64], position: f64) -> f64 {
        let position = position.clamp(0.0, (knots.len() - 1) as f64);
        let low = (position as usize).min(knots.len() - 2);
        let t = position - low as f64;
        knots[low] * (1.0 - t) + knots[low + 1] * t
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;
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
        assert!(refused(Factors::GFromD(broken)).contains("ndf holds 1.5 at index 93"));
        let mut broken = product.clone();
        broken.diffuse[2] = -0.1;
        assert!(refused(Factors::GFromD(broken)).contains("diffuse holds -0.1 at index 2"));
        let mut broken = masking;
        broken[0][0] = f32::NAN;
        assert!(refused(Factors::IndependentG { product, masking: broken }).contains("masking holds NaN"));
        table.pop();
        assert!(refused(Factors::Bivariate(table)).contains("8099 bins, expected 90 times 90"));
    }
}

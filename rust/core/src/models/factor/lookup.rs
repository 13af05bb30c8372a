//! Looking f up: a material's tables side by side by colour channel, and the way from two directions to their
//! places in them.

use std::f32::consts::{FRAC_2_PI, PI};

use glam::{Vec3, Vec4};

use super::{
    AZIMUTH_BINS, Curve, DIFF_BINS, Factor, Factors, HALF_BINS, Interpolation, MASKING_KNOTS, MIN_COS,
    Product,
};
use crate::brdf::{Brdf, is_lit, mask_unlit};
use crate::dispatch;
use crate::microfacet::Half;
use crate::models::factor::smith;
use crate::simd::math::angle;
use crate::simd::{LANES, Lane3};

/// A material's tables as they are looked up: the colour channels side by side, ρ_s in D.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "a material holds one of them behind a pointer")]
pub(super) enum Tables {
    Microfacet(MicrofacetTables),
    Naive(NaiveTables),
    Bivariate(Vec<Vec4>),
}

#[derive(Debug)]
pub(super) struct ProductTables {
    diffuse: Vec4,
    ndf: [Vec4; HALF_BINS],
    fresnel: [Vec4; DIFF_BINS],
}

#[derive(Debug)]
pub(super) struct MicrofacetTables {
    product: ProductTables,
    masking: [Vec4; MASKING_KNOTS],
}

#[derive(Debug)]
pub(super) struct NaiveTables {
    product: ProductTables,
    azimuth: [Vec4; AZIMUTH_BINS],
}

impl Tables {
    pub(super) fn new(factors: &Factors) -> Tables {
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

//! `maps`: a spatially varying material as texture maps have it, a GGX facet under Lambert at every place.
//!
//! The maps are k_d, F₀, α and the slope of the normal. Seen from afar their averages are too smooth: normals that
//! differ within a pixel make a rougher surface. With [`Filter::Moments`] the mips hold the second moments of the
//! slopes as well, whose variance is added to the roughness (Olano & Baker 2010, *LEAN Mapping*, §3):
//! Σ = E[s sᵀ] − E[s] E[s]ᵀ, and α²/2 + Σ per axis is α² of the lobe that is seen.
//!
//! A surface at a place is a BRDF, [`Maps::at`]: f_a in the frame of the facet, times its own cosine over that of the
//! surface. It has no reciprocity, as normal maps have none. Without a place a surface is what it is from afar.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::brdf::{Sample, SampleBrdf, is_lit};
use crate::error::Invalid;
use crate::kernels::Kernel;
use crate::microfacet::{MIN_ALPHA, Microfacet, Terms, fresnel};
use crate::models::Model;
use crate::sampling::lobes::{sample_cosine, sample_visible_normal, visible_normal_pdf};
use crate::simd::{Lanes, Real, Vector};
use crate::surface::{Place, Pyramid};

/// How mips are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Filter {
    /// Averages of the maps.
    Average,
    /// Averages, and the variance of the slopes as roughness.
    Moments,
}

/// One texel of the maps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texel {
    /// Diffuse albedo, linear sRGB, in [0, 1].
    pub kd: [f32; 3],
    /// Reflectance at normal incidence, linear sRGB, in [0, 1].
    pub f0: [f32; 3],
    /// GGX roughness, in [[`MIN_ALPHA`], 1].
    pub alpha: f32,
    /// The normal's slope, −n_x/n_z and −n_y/n_z: that of the height along u and v.
    pub slope: [f32; 2],
}

/// Numbers of a texel: those of [`Texel`], and the products of slopes.
const CHANNELS: usize = 12;

/// Largest F₀: that of silver, .97, has an η of 132; 1 has none.
const MAX_F0: f32 = 0.98;

/// Steepest slope, 87°. A texel's normal cannot be flatter than the surface of a sphere's edge.
pub const MAX_SLOPE: f32 = 20.0;

impl Texel {
    /// Every number in its range.
    fn limited(self) -> Texel {
        let within = |x: f32, low: f32, high: f32| if x.is_nan() { low } else { x.clamp(low, high) };
        Texel {
            kd: self.kd.map(|kd| within(kd, 0.0, 1.0)),
            f0: self.f0.map(|f0| within(f0, 0.0, MAX_F0)),
            alpha: within(self.alpha, MIN_ALPHA, 1.0),
            slope: self.slope.map(|s| if s.is_nan() { 0.0 } else { s.clamp(-MAX_SLOPE, MAX_SLOPE) }),
        }
    }

    fn to_row(self) -> [f32; CHANNELS] {
        let Texel { kd: [r, g, b], f0: [f, g0, b0], alpha, slope: [x, y] } = self;
        [r, g, b, f, g0, b0, alpha, x, y, x * x, x * y, y * y]
    }
}

/// Texture maps of one material.
#[derive(Clone, Debug)]
pub struct Maps {
    pyramid: Pyramid<CHANNELS>,
    filter: Filter,
    /// The surface from afar.
    far: Facet,
}

impl Maps {
    /// Of maps of one size, row by row from the bottom; numbers out of their ranges are limited.
    ///
    /// # Errors
    /// [`Invalid::Parts`] for no texels, or rows that differ.
    pub fn new(
        width: usize,
        texels: impl IntoIterator<Item = Texel>,
        wrap: crate::surface::Wrap,
        filter: Filter,
    ) -> Result<Maps, Invalid> {
        let rows = texels.into_iter().map(|texel| texel.limited().to_row()).collect();
        let pyramid = Pyramid::new(width, rows, wrap)?;
        let far = Facet::of(pyramid.mean(), filter);
        Ok(Maps { pyramid, filter, far })
    }

    /// The texel of a column and a row from the bottom.
    ///
    /// # Panics
    /// If there is none.
    #[must_use]
    pub fn texel(&self, column: usize, row: usize) -> Texel {
        let [r, g, b, f, g0, b0, alpha, x, y, ..] = self.pyramid.texels()[row * self.size()[0] + column];
        Texel { kd: [r, g, b], f0: [f, g0, b0], alpha, slope: [x, y] }
    }

    /// Width and height in texels.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        self.pyramid.size()
    }

    /// Width and height of every level, from the finest.
    pub fn sizes(&self) -> impl Iterator<Item = [usize; 2]> {
        self.pyramid.sizes()
    }

    /// What lies beyond the edges.
    #[must_use]
    pub fn wrap(&self) -> crate::surface::Wrap {
        self.pyramid.wrap()
    }

    /// How mips are made.
    #[must_use]
    pub fn filter(&self) -> Filter {
        self.filter
    }

    /// What the surface reflects at a place.
    #[must_use]
    pub fn at(&self, place: &Place) -> Facet {
        Facet::of(&self.pyramid.fetch(place), self.filter)
    }
}

impl Model for Maps {
    const KIND: &'static str = "maps";

    fn describe(&self) -> String {
        let [width, height] = self.size();
        let levels = self.sizes().count();
        let filter = match self.filter {
            Filter::Average => "averages",
            Filter::Moments => "moments of slopes",
        };
        format!("{width}×{height} texels, {levels} levels by {filter}")
    }

    fn is_isotropic(&self) -> bool {
        false
    }

    fn at(&self, place: &Place) -> Option<Facet> {
        Some(Maps::at(self, place))
    }
}

impl Kernel for Maps {
    #[inline(always)]
    fn eval_lanes<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        self.far.eval_lanes(isa, light, view)
    }
}

/// A GGX lobe over a Lambertian one, in a frame that is inclined to that of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facet {
    terms: Terms,
    /// Tangent, bitangent and normal of the facet; the tangent is the longer axis of the lobe.
    frame: [Vec3; 3],
}

impl Facet {
    fn of(numbers: &[f32; CHANNELS], filter: Filter) -> Facet {
        let [kd_r, kd_g, kd_b, f0_r, f0_g, f0_b, alpha, x, y, xx, xy, yy] = *numbers;
        let normal = if x == 0.0 && y == 0.0 { Vec3::Z } else { Vec3::new(-x, -y, 1.0).normalize() };
        // Of slopes: what of them varies within the footprint.
        let [xx, xy, yy] = match filter {
            Filter::Average => [0.0; 3],
            Filter::Moments => [(xx - x * x).max(0.0), xy - x * y, (yy - y * y).max(0.0)],
        };
        let (middle, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
        let spread = half.hypot(xy).min(middle);
        let rougher = |variance: f32| {
            if variance > 0.0 { (alpha * alpha + 2.0 * variance).sqrt().min(1.0) } else { alpha }
        };
        let alpha = [rougher(middle + spread), rougher(middle - spread)];
        let (sin, cos) = if spread > 0.0 { (0.5 * xy.atan2(half)).sin_cos() } else { (0.0, 1.0) };
        let along = Vec3::new(cos, sin, 0.0);
        let tangent =
            if normal == Vec3::Z { along } else { (along - normal * normal.dot(along)).normalize() };
        let p = Microfacet { kd: [kd_r, kd_g, kd_b], eta: [f0_r, f0_g, f0_b].map(eta), alpha };
        Facet { terms: p.terms(), frame: [tangent, normal.cross(tangent), normal] }
    }

    /// α along the facet's tangent and bitangent.
    #[must_use]
    pub fn alpha(&self) -> [f32; 2] {
        self.terms.roughness.alpha
    }

    /// The facet's normal.
    #[must_use]
    pub fn normal(&self) -> Vec3 {
        self.frame[2]
    }

    /// A direction in the facet's frame.
    fn within(&self, v: Vec3) -> Vec3 {
        Vec3::from(self.frame.map(|axis| axis.dot(v)))
    }

    /// A direction in the surface's frame, of one in the facet's.
    fn outside(&self, v: Vec3) -> Vec3 {
        self.frame[0] * v.x + self.frame[1] * v.y + self.frame[2] * v.z
    }

    /// Share of the GGX lobe among samples: that of what it reflects, as far as the view tells.
    fn specular_share(&self, view: Vec3) -> f32 {
        const LIMITS: [f32; 2] = [0.1, 0.9];
        if !is_lit(view, view) {
            return 0.0;
        }
        let reflected: f32 = self.terms.eta.iter().map(|&eta| fresnel(view.z, eta)).sum();
        let diffuse: f32 = std::f32::consts::PI * self.terms.diffuse.iter().sum::<f32>();
        // A little more than nothing, so that a black facet has a share.
        (reflected / (reflected + diffuse + f32::MIN_POSITIVE)).clamp(LIMITS[0], LIMITS[1])
    }
}

/// η of a reflectance at normal incidence.
fn eta(f0: f32) -> f32 {
    let root = f0.max(0.0).sqrt();
    (1.0 + root) / (1.0 - root)
}

impl Kernel for Facet {
    #[inline(always)]
    fn eval_lanes<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        let (zero, one) = (Vector::new(isa, 0.0), Vector::new(isa, 1.0));
        let [l, v] = [turned(&self.frame, light), turned(&self.frame, view)];
        let faces = zero.and(zero.lt(l[2]), zero.lt(v[2]));
        // Where the facet is turned away, any directions above it do.
        let up = [zero, zero, one];
        let above = |w: [Vector<I, L>; 3]| {
            [
                Real::select(faces, w[0], up[0]),
                Real::select(faces, w[1], up[1]),
                Real::select(faces, w[2], up[2]),
            ]
        };
        let f = self.terms.eval(above(l), above(v));
        // A grazing light on an inclined facet is beyond float32 where the surface's own cosine vanishes. Infinity
        // times the 0 of a black facet would be no number.
        let cosines = Real::select(faces, (l[2] / light[2]).at_most(f32::MAX), zero);
        let mut seen = f;
        for c in 0..3 {
            seen[c] = (f[c] * cosines).at_most(f32::MAX);
        }
        seen
    }
}

/// A direction in a frame.
#[inline(always)]
fn turned<F: Real>(frame: &[Vec3; 3], v: [F; 3]) -> [F; 3] {
    let mut turned = v;
    for i in 0..3 {
        let axis = frame[i];
        turned[i] = v[0] * axis.x + v[1] * axis.y + v[2] * axis.z;
    }
    turned
}

impl SampleBrdf for Facet {
    fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        let [l, v] = [self.within(light), self.within(view)];
        // What the facet is turned away from carries nothing: samples of it have failed.
        if !is_lit(light, view) || !is_lit(l, v) {
            return 0.0;
        }
        let share = self.specular_share(v);
        let specular = visible_normal_pdf(self.alpha(), l, v);
        share * specular + (1.0 - share) * light.z * std::f32::consts::FRAC_1_PI
    }

    fn sample(&self, view: Vec3, u: Vec3) -> Sample {
        use crate::brdf::Brdf;
        if !is_lit(view, view) || !u.is_finite() {
            return Sample::FAILED;
        }
        let v = self.within(view);
        let light = if u.x < self.specular_share(v) {
            self.outside(sample_visible_normal(self.alpha(), v, u.y, u.z))
        } else {
            sample_cosine(u.y, u.z)
        };
        let pdf = self.pdf(light, view);
        let weight = self.eval(light, view) * (light.z / pdf);
        if pdf > 0.0 && weight.is_finite() { Sample { light, pdf, weight } } else { Sample::FAILED }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::brdf::Brdf;
    use crate::models::ggx::Ggx;
    use crate::surface::{Footprint, Wrap};
    use proptest::prelude::*;

    /// Maps without a pattern, metal here and plastic there.
    pub fn patterned(width: usize, height: usize, filter: Filter) -> Maps {
        let number = |i: usize, k: usize| ((i * i * 3 + 11 * i + 5 * k * k + k) as f32 * 0.618_034).fract();
        let texel = |i: usize| Texel {
            kd: std::array::from_fn(|c| 0.6 * number(i, c)),
            f0: std::array::from_fn(|c| if number(i, 9) > 0.5 { 0.04 } else { 0.5 + 0.4 * number(i, 3 + c) }),
            alpha: 0.1 + 0.5 * number(i, 6),
            slope: [number(i, 7) - 0.5, 0.5 * number(i, 8) - 0.25],
        };
        Maps::new(width, (0..width * height).map(texel), Wrap::Repeat, filter).unwrap()
    }

    fn direction() -> impl Strategy<Value = Vec3> {
        (1e-3..1.0f32, 0.0..std::f32::consts::TAU).prop_map(|(z, phi)| {
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * phi.cos(), r * phi.sin(), z)
        })
    }

    fn place() -> impl Strategy<Value = Place> {
        ((0.0..1.0f32, 0.0..1.0f32), 0.0..0.4f32)
            .prop_map(|((u, v), sigma)| Place { uv: [u, v], footprint: Footprint::Isotropic(sigma) })
    }

    proptest! {
        #[test]
        fn constant_maps_are_the_homogeneous_material_to_the_bit(
            light in direction(), view in direction(), place in place()
        ) {
            let texel = Texel { kd: [0.3, 0.2, 0.1], f0: [0.04, 0.2, 0.6], alpha: 0.25, slope: [0.0; 2] };
            let maps = Maps::new(3, [texel; 6], Wrap::Repeat, Filter::Moments).unwrap();
            let p = Microfacet { kd: texel.kd, eta: texel.f0.map(eta), alpha: [texel.alpha; 2] };
            let ggx = Ggx::new(p).unwrap();
            prop_assert_eq!(maps.at(&place).eval(light, view), ggx.eval(light, view));
            prop_assert_eq!(maps.eval(light, view), ggx.eval(light, view));
        }

        #[test]
        fn f_is_finite_and_not_negative_and_weights_are_f_cos_over_pdf(
            view in direction(), u in prop::array::uniform3(0.0..1.0f32), place in place()
        ) {
            let facet = patterned(8, 8, Filter::Moments).at(&place);
            let sample = facet.sample(view, u.into());
            prop_assert!(sample.weight.is_finite() && sample.weight.min_element() >= 0.0);
            if sample.pdf > 0.0 {
                prop_assert!(sample.light.z > 0.0);
                prop_assert_eq!(sample.pdf, facet.pdf(sample.light, view));
                let f = facet.eval(sample.light, view) * (sample.light.z / sample.pdf);
                prop_assert!((f - sample.weight).abs().max_element() <= 1e-6 * f.max_element());
            }
        }
    }

    /// ∫ pdf over the hemisphere and the share of samples that failed are 1.
    #[test]
    fn density_and_failures_add_up_to_one() {
        let maps = patterned(8, 8, Filter::Moments);
        for (i, view) in
            [Vec3::Z, Vec3::new(0.6, 0.0, 0.8), Vec3::new(-0.9, 0.3, 0.316)].into_iter().enumerate()
        {
            let view = view.normalize();
            let facet =
                maps.at(&Place { uv: [0.1 + 0.3 * i as f32, 0.4], footprint: Footprint::Isotropic(0.05) });
            let (mut integral, mut failed) = (0.0, 0.0);
            let n = 400;
            for a in 0..n {
                for b in 0..n {
                    let (z, phi) =
                        ((a as f32 + 0.5) / n as f32, (b as f32 + 0.5) / n as f32 * std::f32::consts::TAU);
                    let r = (1.0 - z * z).sqrt();
                    integral += facet.pdf(Vec3::new(r * phi.cos(), r * phi.sin(), z), view);
                }
            }
            let integral = integral * std::f32::consts::TAU / (n * n) as f32;
            for k in 0..20_000 {
                let u =
                    [0.618_034f64, 0.754_877_67, 0.569_840_3].map(|step| (k as f64 * step).fract() as f32);
                failed += f32::from(facet.sample(view, u.into()).pdf == 0.0) / 20_000.0;
            }
            assert!((integral + failed - 1.0).abs() < 0.02, "{integral} {failed}");
        }
    }

    /// The moments see what the normals of a footprint do: against the mean of its facets.
    #[test]
    fn moments_are_closer_to_the_mean_of_the_facets_than_averages() {
        let (view, lights) = (Vec3::new(0.3, 0.1, 0.95).normalize(), 64);
        let sum = |filter: Filter| {
            let maps = patterned(16, 16, filter);
            let [width, height] = maps.size();
            let far = maps.at(&Place::far());
            let mut error = 0.0;
            for i in 0..lights {
                let (r, phi) = (0.9 * (i as f32 / lights as f32).sqrt(), i as f32 * 2.4);
                let light = Vec3::new(r * phi.cos(), r * phi.sin(), (1.0 - r * r).sqrt());
                let mut mean = Vec3::ZERO;
                for texel in 0..width * height {
                    let uv = [(texel % width) as f32 + 0.5, (texel / width) as f32 + 0.5];
                    let uv = [uv[0] / width as f32, uv[1] / height as f32];
                    mean += maps.at(&Place::point(uv)).eval(light, view) / (width * height) as f32;
                }
                error += (far.eval(light, view) - mean).abs().element_sum();
            }
            error
        };
        let [average, moments] = [Filter::Average, Filter::Moments].map(sum);
        assert!(moments < 0.8 * average, "{moments} against {average}");
    }

    /// The facet faces a light whose cosine on the surface is next to nothing.
    #[test]
    fn a_black_channel_stays_black_at_the_horizon() {
        let black = Texel { kd: [0.0, 0.5, 0.5], f0: [0.0, 0.5, 0.0], alpha: 0.1, slope: [20.0, -20.0] };
        let maps = Maps::new(1, [black], Wrap::Clamp, Filter::Average).unwrap();
        let grazing = Vec3::new(0.0, 1.0, 1e-42);
        let f = maps.eval(grazing, grazing);
        assert!(f.is_finite() && f.x == 0.0 && f.y > 0.0, "{f}");
    }

    #[test]
    fn numbers_out_of_their_ranges_are_limited() {
        let wild =
            Texel { kd: [f32::NAN, 2.0, -1.0], f0: [1.0; 3], alpha: 0.0, slope: [f32::INFINITY, f32::NAN] };
        let maps = Maps::new(1, [wild], Wrap::Clamp, Filter::Moments).unwrap();
        let expected =
            Texel { kd: [0.0, 1.0, 0.0], f0: [MAX_F0; 3], alpha: MIN_ALPHA, slope: [MAX_SLOPE, 0.0] };
        assert_eq!(maps.texel(0, 0), expected);
        assert!(maps.eval(Vec3::Z, Vec3::new(0.6, 0.0, 0.8)).is_finite());
    }
}

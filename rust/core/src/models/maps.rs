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

use crate::brdf::{Brdf, Sample, SampleBrdf, check_lengths, is_lit};
use crate::error::Invalid;
use crate::kernels::Kernel;
use crate::kernels::placed::{self, PlacedKernel};
use crate::microfacet::{MIN_ALPHA, Microfacet, Terms, fresnel};
use crate::models::{Local, Model};
use crate::sampling::lobes::{sample_cosine, sample_visible_normal, visible_normal_pdf};
use crate::simd::{Lanes, Real, Spread, Vector};
use crate::surface::place::halved;
use crate::surface::{Layout, Place, Precision, Pyramid};

/// How mips are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Filter {
    /// Averages of the maps.
    Average,
    /// Averages, and the variance of the slopes as roughness.
    Moments,
    /// Every level as it is given: fitted to what is seen of the finest one.
    Fitted,
}

/// One texel of the maps, in any number of lanes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texel<F = f32> {
    /// Diffuse albedo, linear sRGB, in [0, 1].
    pub kd: [F; 3],
    /// Reflectance at normal incidence, linear sRGB, in [0, 1].
    pub f0: [F; 3],
    /// GGX roughness, in [[`MIN_ALPHA`], 1].
    pub alpha: F,
    /// The normal's slope, −n_x/n_z and −n_y/n_z: that of the height along u and v.
    pub slope: [F; 2],
}

/// Numbers of a texel in a file.
pub(crate) const FILED: usize = 9;

/// Numbers of a texel: those of [`Texel`], and the products of slopes.
const CHANNELS: usize = 12;

/// Largest F₀: that of silver, .97, has an η of 132; 1 has none.
pub const MAX_F0: f32 = 0.98;

/// Steepest slope, 87°. A texel's normal cannot be flatter than the surface of a sphere's edge.
pub const MAX_SLOPE: f32 = 20.0;

/// Slopes count as no steeper where their variance becomes roughness: a few steep edges, whose facets most pairs do not
/// see, would make all of a surface rough.
const STEEPEST: f32 = 1.0;

impl Texel {
    /// Every number in its range.
    #[must_use]
    pub fn limited(self) -> Texel {
        let within = |x: f32, low: f32, high: f32| if x.is_nan() { low } else { x.clamp(low, high) };
        Texel {
            kd: self.kd.map(|kd| within(kd, 0.0, 1.0)),
            f0: self.f0.map(|f0| within(f0, 0.0, MAX_F0)),
            alpha: within(self.alpha, MIN_ALPHA, 1.0),
            slope: self.slope.map(|s| if s.is_nan() { 0.0 } else { s.clamp(-MAX_SLOPE, MAX_SLOPE) }),
        }
    }

    /// As a row of a file. Where steps are few, they are those of roots, as darker colours, smoother lobes and
    /// flatter slopes need finer ones. The root of a square is exact: what was rounded stays as it is.
    fn to_file(self, precision: Precision) -> [f32; FILED] {
        let Texel { kd: [r, g, b], f0: [f_r, f_g, f_b], alpha, slope: [x, y] } = self;
        let row = [r, g, b, f_r, f_g, f_b, alpha, x, y];
        match precision {
            Precision::F32 => row,
            Precision::F16 | Precision::U8 => row.map(|x| x.abs().sqrt().copysign(x)),
        }
    }

    /// Of [`Texel::to_file`]; numbers out of their ranges are limited.
    pub(crate) fn from_file(row: [f32; FILED], precision: Precision) -> Texel {
        let [r, g, b, f_r, f_g, f_b, alpha, x, y] = match precision {
            Precision::F32 => row,
            Precision::F16 | Precision::U8 => row.map(|root| root * root.abs()),
        };
        Texel { kd: [r, g, b], f0: [f_r, f_g, f_b], alpha, slope: [x, y] }.limited()
    }

    fn to_row(self) -> [f32; CHANNELS] {
        let Texel { kd: [r, g, b], f0: [f, g0, b0], alpha, slope: [x, y] } = self;
        let [p, q] = self.slope.map(|s| s.clamp(-STEEPEST, STEEPEST));
        [r, g, b, f, g0, b0, alpha, x, y, p * p, p * q, q * q]
    }

    fn from_row(row: &[f32; CHANNELS]) -> Texel {
        let [r, g, b, f, g0, b0, alpha, x, y, ..] = *row;
        Texel { kd: [r, g, b], f0: [f, g0, b0], alpha, slope: [x, y] }
    }
}

/// Texture maps of one material.
#[derive(Clone, Debug)]
pub struct Maps {
    pyramid: Pyramid<CHANNELS>,
    filter: Filter,
    /// In how many bits files keep it.
    precision: Precision,
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
        Ok(Maps::of(Pyramid::new(width, rows, wrap)?, filter))
    }

    /// Of the texels of all levels, with [`Filter::Fitted`]; numbers out of their ranges are limited.
    ///
    /// # Errors
    /// [`Invalid::Parts`] if they are more or less than the layout has.
    pub fn of_levels(layout: Layout, texels: impl IntoIterator<Item = Texel>) -> Result<Maps, Invalid> {
        let rows = texels.into_iter().map(|texel| texel.limited().to_row()).collect();
        Ok(Maps::of(Pyramid::of_levels(layout, rows)?, Filter::Fitted))
    }

    fn of(pyramid: Pyramid<CHANNELS>, filter: Filter) -> Maps {
        let far = Facet::of(*pyramid.mean(), filter);
        Maps { pyramid, filter, precision: Precision::F32, far }
    }

    /// As files of this precision give it back.
    #[must_use]
    pub fn rounded(&self, precision: Precision) -> Maps {
        let rows = precision.rounded(&self.rows(precision).collect::<Vec<_>>());
        let maps = Maps::of_file(self.layout(), rows, self.filter, precision);
        maps.expect("as many texels as before")
    }

    /// Of rows as [`Maps::rows`] yields them.
    ///
    /// # Errors
    /// [`Invalid::Parts`] if they are more or less than the layout has.
    pub(crate) fn of_file(
        layout: &Layout,
        rows: Vec<[f32; FILED]>,
        filter: Filter,
        precision: Precision,
    ) -> Result<Maps, Invalid> {
        let texels = rows.into_iter().map(|row| Texel::from_file(row, precision));
        let maps = match filter {
            Filter::Average | Filter::Moments => Maps::new(layout.size()[0], texels, layout.wrap(), filter)?,
            Filter::Fitted => Maps::of_levels(layout.clone(), texels)?,
        };
        Ok(Maps { precision, ..maps })
    }

    /// Where its texels are.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        self.pyramid.layout()
    }

    /// The same maps with other mips.
    #[must_use]
    pub fn filtered(&self, filter: Filter) -> Maps {
        Maps { filter, far: Facet::of(*self.pyramid.mean(), filter), ..self.clone() }
    }

    /// The maps of a level as maps of their own; α takes the variance of the slopes below it. Of a level that there is
    /// not, the coarsest.
    #[must_use]
    pub fn coarser(&self, level: usize) -> Maps {
        let layout = self.pyramid.layout();
        let level = level.min(layout.sizes().len() - 1);
        let [width, _] = layout.sizes().nth(level).expect("a level that there is");
        let rows = &self.pyramid.all_texels()[layout.texels_of(level)];
        let texels = rows.iter().map(|&[r, g, b, f, g0, b0, alpha, x, y, xx, _, yy]| {
            let variance = (xx - x * x).max(0.0) + (yy - y * y).max(0.0);
            Texel { kd: [r, g, b], f0: [f, g0, b0], alpha: rougher(alpha, 0.5 * variance), slope: [x, y] }
        });
        let filter = if self.filter == Filter::Fitted { Filter::Average } else { self.filter };
        let maps = Maps::new(width, texels, self.wrap(), filter).expect("a level has texels");
        Maps { precision: self.precision, ..maps }
    }

    /// In how many bits files keep it.
    #[must_use]
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// The texels as files have them, row by row from the bottom: those of level 0, from which the others follow, or
    /// of all levels where they do not.
    pub(crate) fn rows(&self, precision: Precision) -> impl Iterator<Item = [f32; FILED]> {
        let rows = match self.filter {
            Filter::Average | Filter::Moments => self.pyramid.texels(),
            Filter::Fitted => self.pyramid.all_texels(),
        };
        rows.iter().map(move |row| Texel::from_row(row).to_file(precision))
    }

    /// The texel of a column and a row from the bottom.
    ///
    /// # Panics
    /// If there is none.
    #[must_use]
    pub fn texel(&self, column: usize, row: usize) -> Texel {
        Texel::from_row(&self.pyramid.texels()[row * self.size()[0] + column])
    }

    /// The texels of all levels, in the order of the layout.
    pub fn all_texels(&self) -> impl Iterator<Item = Texel> {
        self.pyramid.all_texels().iter().map(Texel::from_row)
    }

    /// The mean of all texels. What of the slopes varies is not in its α, but in that of the surface from afar.
    #[must_use]
    pub fn mean(&self) -> Texel {
        Texel::from_row(self.pyramid.mean())
    }

    /// Width and height in texels.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        self.pyramid.layout().size()
    }

    /// Width and height of every level, from the finest.
    pub fn sizes(&self) -> impl Iterator<Item = [usize; 2]> {
        self.pyramid.layout().sizes()
    }

    /// Bytes of all levels in memory.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.sizes().map(|[width, height]| width * height * CHANNELS * size_of::<f32>()).sum()
    }

    /// What lies beyond the edges.
    #[must_use]
    pub fn wrap(&self) -> crate::surface::Wrap {
        self.pyramid.layout().wrap()
    }

    /// How mips are made.
    #[must_use]
    pub fn filter(&self) -> Filter {
        self.filter
    }

    /// What the surface reflects from afar.
    pub(crate) fn far(&self) -> &Facet {
        &self.far
    }

    /// What the surface reflects at a place.
    #[must_use]
    pub fn at(&self, place: &Place) -> Facet {
        Facet::of(self.pyramid.fetch(place), self.filter)
    }
}

impl Model for Maps {
    const KIND: &'static str = "maps";

    fn describe(&self) -> String {
        let [width, height] = self.size();
        let levels = self.sizes().count();
        let filter = match self.filter {
            Filter::Average => "averages",
            Filter::Fitted => "a fit",
            Filter::Moments => "moments of slopes",
        };
        format!("{width}×{height} texels, {levels} levels by {filter}")
    }

    fn is_isotropic(&self) -> bool {
        false
    }

    fn at(&self, place: &Place) -> Option<Local<'_>> {
        Some(Local::Facet(Maps::at(self, place)))
    }

    fn eval_packet_at(&self, places: &[Place], light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]) {
        placed::eval_packet(self, places, light, view, out);
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

impl Maps {
    /// The facets that places see, side by side.
    #[inline(always)]
    pub(crate) fn facets<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        places: &[Place; L],
    ) -> Facet<Vector<I, L>> {
        let mut rows = [[0.0; CHANNELS]; L];
        for lane in 0..L {
            rows[lane] = self.pyramid.fetch(&places[lane]);
        }
        Facet::of(Vector::transpose(isa, &rows), self.filter)
    }
}

/// The surface itself, at points: what every footprint sees a mean of. Between the texels of the finest level, maps are
/// linear.
struct Points<'a>(&'a Maps);

impl PlacedKernel for Points<'_> {
    #[inline(always)]
    fn eval_placed<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        places: &[Place; L],
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        let mut rows = [[0.0; CHANNELS]; L];
        for lane in 0..L {
            rows[lane] = self.0.pyramid.at_point(places[lane].uv);
        }
        Facet::of(Vector::transpose(isa, &rows), Filter::Average).eval_real(light, view)
    }
}

impl Maps {
    /// f_r of every pair at its place; see [`Maps::at`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn eval_places(&self, places: &[Place], light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]) {
        check_lengths(&light, &view, &out);
        assert!(places.len() == out[0].len(), "as many places as results");
        placed::eval_packet(self, places, light, view, out);
    }

    /// f_r of every pair at a point, between the texels of the maps themselves. Footprints are not looked at: means of
    /// this are what they see.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn eval_points(&self, points: &[Place], light: [&[f32]; 3], view: [&[f32]; 3], out: [&mut [f32]; 3]) {
        check_lengths(&light, &view, &out);
        assert!(points.len() == out[0].len(), "as many points as results");
        placed::eval_packet(&Points(self), points, light, view, out);
    }
}

impl PlacedKernel for Maps {
    #[inline(always)]
    fn eval_placed<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        places: &[Place; L],
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        self.facets(isa, places).eval_real(light, view)
    }
}

/// A GGX lobe over a Lambertian one, in a frame that is inclined to that of the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facet<F = f32> {
    terms: Terms<F>,
    /// Tangent, bitangent and normal of the facet; the tangent is the longer axis of the lobe.
    frame: [[F; 3]; 3],
}

impl<F: Real> Facet<F> {
    /// Of a texel in which no slope varies.
    #[inline(always)]
    #[must_use]
    pub fn of_texel(Texel { kd: [r, g, b], f0: [f, g0, b0], alpha, slope: [x, y] }: Texel<F>) -> Self {
        Facet::of([r, g, b, f, g0, b0, alpha, x, y, x * x, x * y, y * y], Filter::Fitted)
    }

    /// Of the numbers of a texel.
    #[inline(always)]
    fn of(numbers: [F; CHANNELS], filter: Filter) -> Self {
        let [kd_r, kd_g, kd_b, f0_r, f0_g, f0_b, alpha, x, y, xx, xy, yy] = numbers;
        let (zero, one) = (alpha.splat(0.0), alpha.splat(1.0));
        let eta = [eta(f0_r), eta(f0_g), eta(f0_b)];
        let kd = [kd_r, kd_g, kd_b];
        let normal = normalized([-x, -y, one]);
        let (alpha, along) = match filter {
            Filter::Average | Filter::Fitted => ([alpha, alpha], [one, zero]),
            Filter::Moments => {
                // Of slopes: what of them varies within the footprint.
                let [xx, xy, yy] = [(xx - x * x).max(zero), xy - x * y, (yy - y * y).max(zero)];
                let (middle, half) = ((xx + yy) * 0.5, (xx - yy) * 0.5);
                let spread = (half * half + xy * xy).sqrt().min(middle);
                let [major, minor] = [rougher(alpha, middle + spread), rougher(alpha, middle - spread)];
                let varies = F::lt(zero.splat(f32::MIN_POSITIVE), spread);
                let inverse = F::select(varies, spread, one).reciprocal();
                let twice = [F::select(varies, half, one) * inverse, F::select(varies, xy, zero) * inverse];
                ([major, minor], halved([twice[0].clamped(-1.0, 1.0), twice[1].clamped(-1.0, 1.0)]))
            }
        };
        let lean = normal[0] * along[0] + normal[1] * along[1];
        let tangent =
            normalized([along[0] - normal[0] * lean, along[1] - normal[1] * lean, -(normal[2] * lean)]);
        let frame = [tangent, cross(normal, tangent), normal];
        Facet { terms: Microfacet { kd, eta, alpha }.terms(), frame }
    }
}

impl<S: Copy> Facet<S> {
    /// f of pairs above the horizon of the surface.
    #[inline(always)]
    #[must_use]
    pub fn eval_real<R: Real>(&self, light: [R; 3], view: [R; 3]) -> [R; 3]
    where
        S: Spread<R>,
    {
        let (zero, one) = (light[0].splat(0.0), light[0].splat(1.0));
        let [l, v] = [turned(&self.frame, light), turned(&self.frame, view)];
        let faces = zero.and(zero.lt(l[2]), zero.lt(v[2]));
        // Where the facet is turned away, any directions above it do.
        let f = self.terms.eval(above(faces, l, [zero, zero, one]), above(faces, v, [zero, zero, one]));
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

impl Facet {
    /// α along the facet's tangent and bitangent.
    #[must_use]
    pub fn alpha(&self) -> [f32; 2] {
        self.terms.roughness.alpha
    }

    /// The facet's normal.
    #[must_use]
    pub fn normal(&self) -> Vec3 {
        self.frame[2].into()
    }

    /// A direction in the facet's frame.
    fn within(&self, v: Vec3) -> Vec3 {
        turned(&self.frame, v.to_array()).into()
    }

    /// A direction in the surface's frame, of one in the facet's.
    fn outside(&self, v: Vec3) -> Vec3 {
        let [tangent, bitangent, normal] = self.frame.map(Vec3::from);
        tangent * v.x + bitangent * v.y + normal * v.z
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
#[inline(always)]
fn eta<F: Real>(f0: F) -> F {
    let root = f0.max(f0.splat(0.0)).sqrt();
    (root + 1.0) / (-root + 1.0)
}

/// α of a facet whose slopes vary.
#[inline(always)]
fn rougher<F: Real>(alpha: F, variance: F) -> F {
    let zero = alpha.splat(0.0);
    // Where nothing varies, α stays to the bit.
    let wider = (variance * 2.0 + alpha * alpha).sqrt().at_most(1.0);
    F::select(zero.lt(variance), wider, alpha)
}

#[inline(always)]
fn normalized<F: Real>(v: [F; 3]) -> [F; 3] {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    [v[0] / length, v[1] / length, v[2] / length]
}

#[inline(always)]
fn cross<F: Real>(a: [F; 3], b: [F; 3]) -> [F; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// A direction where the mask holds, else another.
#[inline(always)]
fn above<F: Real>(mask: F::Mask, w: [F; 3], other: [F; 3]) -> [F; 3] {
    [F::select(mask, w[0], other[0]), F::select(mask, w[1], other[1]), F::select(mask, w[2], other[2])]
}

/// A direction in a frame.
#[inline(always)]
fn turned<F: Real>(frame: &[[impl Spread<F>; 3]; 3], v: [F; 3]) -> [F; 3] {
    let mut turned = v;
    for i in 0..3 {
        let [x, y, z] = frame[i];
        turned[i] = v[0] * x.spread(v[0]) + v[1] * y.spread(v[0]) + v[2] * z.spread(v[0]);
    }
    turned
}

impl Kernel for Facet {
    #[inline(always)]
    fn eval_lanes<I: Lanes<L>, const L: usize>(
        &self,
        _isa: I,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        self.eval_real(light, view)
    }
}

impl SampleBrdf for Facet {
    fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        if !is_lit(light, view) {
            return 0.0;
        }
        let v = self.within(view);
        self.density(light, v, self.specular_share(v))
    }

    fn sample(&self, view: Vec3, u: Vec3) -> Sample {
        self.draw(self, view, u)
    }
}

impl Facet {
    /// The density of a light for a view within the facet, of which the GGX lobe has a share.
    fn density(&self, light: Vec3, v: Vec3, share: f32) -> f32 {
        let l = self.within(light);
        let specular = if is_lit(l, v) { visible_normal_pdf(self.alpha(), l, v) } else { 0.0 };
        share * specular + (1.0 - share) * light.z * std::f32::consts::FRAC_1_PI
    }

    /// A light, with the density of [`Facet::pdf`](SampleBrdf::pdf).
    pub(crate) fn sample_direction(&self, view: Vec3, u: Vec3) -> Option<(Vec3, f32)> {
        if !is_lit(view, view) || !u.is_finite() {
            return None;
        }
        let v = self.within(view);
        let share = self.specular_share(v);
        let light = if u.x < share {
            let light = sample_visible_normal(self.alpha(), v, u.y, u.z);
            // What a facet reflects below itself may be above the surface, where the lobe's density is 0.
            if !is_lit(light, v) {
                return None;
            }
            self.outside(light)
        } else {
            sample_cosine(u.y, u.z)
        };
        is_lit(light, view).then(|| (light, self.density(light, v, share)))
    }

    /// A light for a BRDF that is much like this one, with the density of [`Facet::pdf`](SampleBrdf::pdf).
    pub(crate) fn draw(&self, brdf: &impl Brdf, view: Vec3, u: Vec3) -> Sample {
        let Some((light, pdf)) = self.sample_direction(view, u) else { return Sample::FAILED };
        let weight = brdf.eval(light, view) * (light.z / pdf);
        if pdf > 0.0 && weight.is_finite() { Sample { light, pdf, weight } } else { Sample::FAILED }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
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

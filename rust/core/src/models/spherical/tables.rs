//! The tables that features lie in, and where a pair of directions falls into each.

use std::collections::HashMap;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::pixelation::{Hemisphere, Pixelation, inverse_distances};
use crate::directions::healpix::{Healpix, Pixels, limit};
use crate::simd::math::floor;
use crate::simd::{Lanes, Real, Task, Vector};

/// What the tables are laid over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Grids {
    /// A hemisphere of lights and one of views: the paper's.
    Lv,
    /// A hemisphere of half vectors h, drawn towards the pole so that equal steps are steps of about
    /// √θ_h, and one of lights in the frame that the shortest rotation of n to h carries along.
    Hd,
    /// For isotropic, mirror-symmetric materials: three lists along √θ_h, θ_l and θ_v, and a hemisphere of
    /// lights in Rusinkiewicz's frame about h, folded at its plane of symmetry.
    Iso,
}

impl Grids {
    /// As files and commands spell it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Grids::Lv => "lv",
            Grids::Hd => "hd",
            Grids::Iso => "iso",
        }
    }

    /// Number of tables.
    #[must_use]
    pub fn tables(self) -> usize {
        self.axes() + self.hemispheres()
    }

    /// Number of tables that are lists; they come first.
    #[must_use]
    pub fn axes(self) -> usize {
        match self {
            Grids::Lv | Grids::Hd => 0,
            Grids::Iso => 3,
        }
    }

    fn hemispheres(self) -> usize {
        match self {
            Grids::Lv | Grids::Hd => 2,
            Grids::Iso => 1,
        }
    }
}

/// Most tables that any choice of grids has.
pub const MAX_TABLES: usize = 4;

/// How the features of a pixel's four corners become one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Interpolation {
    /// Bilinear in the pixel's own two coordinates: continuous across pixels.
    #[default]
    Bilinear,
    /// By the inverse of the great-circle distance to each corner: the paper's in training.
    InverseDistance,
    /// A quarter each: the paper's at run time. Constant within a pixel.
    Constant,
}

/// The shape of a material's tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Form {
    /// What the tables are laid over.
    pub grids: Grids,
    /// How points are laid on hemispheres.
    pub pixelation: Pixelation,
    /// N_side, or for other pixelations that of the HEALPix grid with as many points.
    pub nside: Healpix,
    /// Nodes of each list, of grids that have lists.
    pub nodes: u16,
    /// Features of a point, k.
    pub features: u8,
    /// How corners are weighted.
    pub interpolation: Interpolation,
}

/// Numbers of features for which kernels are compiled.
pub const FEATURE_COUNTS: [u8; 3] = [4, 8, 16];
/// Most nodes of a list.
pub const MAX_NODES: u16 = 1024;

impl Form {
    /// Whether tables of this form can be made and evaluated.
    ///
    /// # Errors
    /// In words, why not.
    pub fn validate(&self) -> Result<(), String> {
        if !FEATURE_COUNTS.contains(&self.features) {
            return Err(format!("a point has {} features, expected 4, 8 or 16", self.features));
        }
        if self.grids.axes() > 0 && !(2..=MAX_NODES).contains(&self.nodes) {
            return Err(format!("a list has {} nodes, expected 2 to {MAX_NODES}", self.nodes));
        }
        if self.pixelation == Pixelation::Fibonacci && self.interpolation == Interpolation::Bilinear {
            return Err(
                "a Fibonacci lattice has no pixels to be bilinear in; interpolate by inverse-distance \
                        or constant"
                    .into(),
            );
        }
        Ok(())
    }

    /// Features that the network sees.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.grids.tables() * usize::from(self.features)
    }
}

/// Where pairs of directions fall into one table: points and their weights, `[tap][lane]`. Lists use
/// the first two taps.
#[derive(Clone, Copy, Debug)]
pub struct Taps<const N: usize> {
    /// Numbers of points among those of all tables.
    pub points: [[u32; N]; 4],
    /// Their weights, which add up to 1.
    pub weights: [[f32; N]; 4],
}

impl<const N: usize> Taps<N> {
    /// Nothing yet.
    pub const EMPTY: Taps<N> = Taps { points: [[0; N]; 4], weights: [[0.0; N]; 4] };

    #[inline(always)]
    fn set<F: Real<Array = [f32; N]>, const TAPS: usize>(&mut self, taps: [(F, F); TAPS]) {
        for (tap, (point, weight)) in taps.into_iter().enumerate() {
            // From 2²³ on, the lowest bits of a float are those of the whole number.
            let bits = (point + 8_388_608.0).array();
            for lane in 0..N {
                self.points[tap][lane] = bits[lane].to_bits() & 0x7f_ffff;
            }
            self.weights[tap] = weight.array();
        }
    }
}

/// Tables of one form: their points, and the row of features that each point has.
#[derive(Clone, Debug)]
pub struct Layout {
    form: Form,
    hemisphere: Hemisphere,
    /// Where the hemisphere's points are, for inverse distances.
    directions: Vec<[f32; 3]>,
    /// The row of every point, table after table.
    rows: Vec<u32>,
    /// Where every row is: its table, and its place in it, a direction or (x, 0, 0) on a list.
    places: Vec<(usize, DVec3)>,
}

impl Layout {
    /// The tables of a form.
    ///
    /// # Errors
    /// As [`Form::validate`].
    pub fn new(form: Form) -> Result<Layout, String> {
        form.validate()?;
        let hemisphere = Hemisphere::new(form.pixelation, form.nside);
        let points: Vec<DVec3> = (0..hemisphere.points()).map(|i| hemisphere.direction(i)).collect();
        let (mut rows, mut places) = (Vec::new(), Vec::new());
        for table in 0..form.grids.axes() {
            for node in 0..form.nodes {
                rows.push(places.len() as u32);
                places.push((table, DVec3::X * f64::from(node) / f64::from(form.nodes - 1)));
            }
        }
        let folded = form.grids == Grids::Iso && form.pixelation != Pixelation::Fibonacci;
        for table in form.grids.axes()..form.grids.tables() {
            let mut known = HashMap::new();
            for &point in &points {
                let place = if folded { point.with_y(point.y.abs()) } else { point };
                // Far finer than any grid, far coarser than rounding.
                let key = (place * 1e6).round().as_i64vec3();
                rows.push(*known.entry(key).or_insert_with(|| {
                    places.push((table, place));
                    places.len() as u32 - 1
                }));
            }
        }
        let directions = match form.interpolation {
            Interpolation::InverseDistance => points.iter().map(|p| p.as_vec3().to_array()).collect(),
            Interpolation::Bilinear | Interpolation::Constant => Vec::new(),
        };
        Ok(Layout { form, hemisphere, directions, rows, places })
    }

    /// The form.
    #[must_use]
    pub fn form(&self) -> Form {
        self.form
    }

    /// The hemispheres' points.
    #[must_use]
    pub fn hemisphere(&self) -> &Hemisphere {
        &self.hemisphere
    }

    /// The row of every point, table after table: most points have one of their own, and those that
    /// are mirror images share one.
    #[must_use]
    pub fn rows(&self) -> &[u32] {
        &self.rows
    }

    /// Where every row is: the table, and a direction or, on a list, (x, 0, 0) with x from 0 to 1.
    #[must_use]
    pub fn places(&self) -> &[(usize, DVec3)] {
        &self.places
    }

    /// First point of a table.
    fn first_point(&self, table: usize) -> usize {
        let axes = self.form.grids.axes();
        table.min(axes) * usize::from(self.form.nodes) + table.saturating_sub(axes) * self.hemisphere.points()
    }

    /// The table that a point belongs to.
    pub(super) fn table(&self, point: usize) -> usize {
        self.places[self.rows[point] as usize].0
    }

    /// Taps of a table: two for a list, four for a hemisphere.
    #[inline(always)]
    #[must_use]
    pub fn tap_count(&self, table: usize) -> usize {
        if table < self.form.grids.axes() { 2 } else { 4 }
    }

    /// Where pairs of directions fall into each table. Whatever the numbers are, the points exist.
    #[inline(always)]
    pub fn taps<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
        taps: &mut [Taps<L>; MAX_TABLES],
    ) {
        match self.form.grids {
            Grids::Lv => self.two_hemispheres(isa, [light, view], taps),
            Grids::Hd => self.two_hemispheres(isa, half_difference(light, view), taps),
            Grids::Iso => {
                let (axes, difference) = isotropic(light, view);
                let [half, light, view, on_hemisphere] = taps;
                half.set(self.list_taps(0, axes[0]));
                light.set(self.list_taps(1, axes[1]));
                view.set(self.list_taps(2, axes[2]));
                isa.run(HemisphereTaps {
                    layout: self,
                    table: 3,
                    d: arrays(difference),
                    taps: on_hemisphere,
                });
            }
        }
    }

    #[inline(always)]
    fn two_hemispheres<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        directions: [[Vector<I, L>; 3]; 2],
        taps: &mut [Taps<L>; MAX_TABLES],
    ) {
        for table in 0..2 {
            let d = arrays(directions[table]);
            isa.run(HemisphereTaps { layout: self, table, d, taps: &mut taps[table] });
        }
    }

    /// Two nodes of a list, and their weights.
    #[inline(always)]
    fn list_taps<F: Real>(&self, table: usize, x: F) -> [(F, F); 2] {
        let nodes = f32::from(self.form.nodes);
        let one = x.splat(1.0);
        let place = x * (nodes - 1.0);
        let node = limit(floor(place), x.splat(nodes - 2.0));
        let after = limit(place - node, one);
        let first = node + self.first_point(table) as f32;
        [(first, one - after), (first + 1.0, after)]
    }

    /// Four points of a hemisphere, and their weights.
    #[inline(always)]
    fn hemisphere_taps<F: Real>(&self, table: usize, d: [F; 3]) -> [(F, F); 4] {
        let Pixels { corners: [a, b, c, e], at: [p, m] } = self.hemisphere.pixels(d);
        let weights = match self.form.interpolation {
            Interpolation::Bilinear => {
                let [before_p, before_m] = [p.splat(1.0) - p, p.splat(1.0) - m];
                [before_p * before_m, p * before_m, before_p * m, p * m]
            }
            Interpolation::InverseDistance => inverse_distances(&self.directions, d, [a, b, c, e]),
            Interpolation::Constant => [p.splat(0.25); 4],
        };
        let first = self.first_point(table) as f32;
        [(a + first, weights[0]), (b + first, weights[1]), (c + first, weights[2]), (e + first, weights[3])]
    }
}

/// Directions' taps of one hemisphere: the largest part of a look-up, and a function of its own, so that it
/// is not compiled for every table and model that it stands in.
struct HemisphereTaps<'a, const L: usize> {
    layout: &'a Layout,
    table: usize,
    d: [[f32; L]; 3],
    taps: &'a mut Taps<L>,
}

impl<const L: usize> Task<L> for HemisphereTaps<'_, L> {
    #[inline(always)]
    fn run<I: Lanes<L>>(self, isa: I) {
        let HemisphereTaps { layout, table, d, taps } = self;
        taps.set(layout.hemisphere_taps(table, Vector::load3(isa, &d)));
    }
}

#[inline(always)]
fn arrays<I: Lanes<L>, const L: usize>(d: [Vector<I, L>; 3]) -> [[f32; L]; 3] {
    [d[0].to_array(), d[1].to_array(), d[2].to_array()]
}

/// Below this a vector's azimuth is rounding noise.
const NOISE: f32 = 1e-7;

/// Half vector, drawn towards the pole, and the light in the frame about it, of [`Grids::Hd`].
#[inline(always)]
fn half_difference<F: Real>(light: [F; 3], view: [F; 3]) -> [[F; 3]; 2] {
    let [zero, least] = [light[0].splat(0.0), light[0].splat(f32::MIN_POSITIVE)];
    let sum = [light[0] + view[0], light[1] + view[1], light[2] + view[2]];
    let across = sum[0] * sum[0] + sum[1] * sum[1];
    let length = (across + sum[2] * sum[2]).sqrt().max(least);
    let inverse = length.reciprocal();
    let h = [sum[0] * inverse, sum[1] * inverse, sum[2] * inverse];
    // q = (1 − cosθ_h)^½ ∝ θ_h becomes 1 − z: a step of it is one of θ_h² of the half vector's grid.
    let q = (across / (length * (length + sum[2]).max(least))).sqrt();
    let draw = (q * (q.splat(2.0) - q)).max(zero).sqrt() / across.sqrt().max(zero.splat(NOISE));
    let drawn = [sum[0] * draw, sum[1] * draw, q.splat(1.0) - q];
    // The shortest rotation of h to n, applied to the light.
    let along = h[0] * light[0] + h[1] * light[1] + h[2] * light[2];
    let turn = (along + light[2]) / (h[2] + 1.0);
    [drawn, [light[0] - turn * h[0], light[1] - turn * h[1], along]]
}

/// (1 − cosθ_h)^¼ ∝ √θ_h and √2 sin(θ/2) of light and view, each from 0 at the normal to 1 at the
/// horizon, and the light in Rusinkiewicz's frame about the half vector, of [`Grids::Iso`]; folded to
/// y ≥ 0.
#[inline(always)]
fn isotropic<F: Real>(light: [F; 3], view: [F; 3]) -> ([F; 3], [F; 3]) {
    let [zero, one, least] = [light[0].splat(0.0), light[0].splat(1.0), light[0].splat(f32::MIN_POSITIVE)];
    let h = [light[0] + view[0], light[1] + view[1], light[2] + view[2]];
    let d = [light[0] - view[0], light[1] - view[1], light[2] - view[2]];
    let across = h[0] * h[0] + h[1] * h[1];
    let length = (across + h[2] * h[2]).sqrt().max(least);
    let one_minus_cos = across / (length * (length + h[2]).max(least));
    let axes = [one_minus_cos.sqrt().sqrt(), from_normal(light).min(one), from_normal(view).min(one)];
    // d/2 has length sinθ_d and stands at right angles to h: −d_z/sinθ_h of d lies in the plane of n
    // and h, and d·(n × h)/|n × h| beside it. At h = n every azimuth is as good: the plane's.
    let width = across.sqrt();
    let noise = zero.splat(NOISE);
    let has_azimuth = noise.lt(width);
    let inverse = width.max(noise).reciprocal();
    let flat = (d[0] * d[0] + d[1] * d[1]).sqrt();
    let along = Real::select(has_azimuth, -d[2] * length * inverse, flat);
    let beside = Real::select(has_azimuth, (d[1] * h[0] - d[0] * h[1]) * inverse, zero);
    (axes, [along * 0.5, beside.abs() * 0.5, (length * 0.5).min(one)])
}

/// √2 sin(θ/2) of a direction.
#[inline(always)]
fn from_normal<F: Real>(w: [F; 3]) -> F {
    ((w[0] * w[0] + w[1] * w[1]) / (w[2].abs() + 1.0)).sqrt()
}

/// [`Layout::taps`] of one pair, one number at a time. What tests compare lanes against.
#[cfg(test)]
pub(super) fn scalar_taps(layout: &Layout, light: [f32; 3], view: [f32; 3]) -> Vec<Vec<(f32, f32)>> {
    let hemispheres = |directions: [[f32; 3]; 2]| {
        let taps = |table: usize| layout.hemisphere_taps(table, directions[table]).to_vec();
        vec![taps(0), taps(1)]
    };
    match layout.form.grids {
        Grids::Lv => hemispheres([light, view]),
        Grids::Hd => hemispheres(half_difference(light, view)),
        Grids::Iso => {
            let (axes, difference) = isotropic(light, view);
            let list = |table: usize| layout.list_taps(table, axes[table]).to_vec();
            vec![list(0), list(1), list(2), layout.hemisphere_taps(3, difference).to_vec()]
        }
    }
}

/// Where a pair falls in float64, by the definitions. What tests compare against.
pub(super) mod reference {
    use super::{Grids, Interpolation, Layout, Pixelation};
    use glam::{DMat3, DQuat, DVec3};
    use std::f64::consts::{FRAC_PI_2, TAU};

    /// Points and weights of each table.
    pub fn taps(layout: &Layout, light: DVec3, view: DVec3) -> Vec<Vec<(usize, f64)>> {
        let h = (light + view).normalize();
        // Of the arc functions the tangent's alone keeps the digits of small angles.
        let theta = |w: DVec3| w.truncate().length().atan2(w.z);
        let root = |theta: f64| 2.0f64.sqrt() * (theta / 2.0).sin();
        let (axes, directions) = match layout.form.grids {
            Grids::Lv => (vec![], vec![light, view]),
            Grids::Hd => {
                let q = root(theta(h));
                let flat = h.truncate().normalize_or_zero() * (1.0 - (1.0 - q).powi(2)).sqrt();
                (vec![], vec![flat.extend(1.0 - q), DQuat::from_rotation_arc(h, DVec3::Z) * light])
            }
            Grids::Iso => {
                let turn = DMat3::from_rotation_z(-h.y.atan2(h.x));
                let d = DMat3::from_rotation_y(-theta(h)) * (turn * light);
                let axes = vec![root(theta(h)).sqrt(), root(theta(light)), root(theta(view))];
                (axes, vec![d.with_y(d.y.abs())])
            }
        };
        let axes = axes.into_iter().enumerate().map(|(table, x)| {
            let place = x * f64::from(layout.form.nodes - 1);
            let node = place.floor().min(f64::from(layout.form.nodes - 2));
            let first = layout.first_point(table) + node as usize;
            vec![(first, 1.0 - (place - node)), (first + 1, place - node)]
        });
        let first = layout.form.grids.axes();
        let hemispheres = directions.into_iter().enumerate().map(|(i, d)| {
            let corners =
                layout.hemisphere.pixels(d.as_vec3().to_array()).corners.map(|corner| corner as u32);
            let first = layout.first_point(first + i);
            corners.map(|c| first + c as usize).into_iter().zip(weights(layout, d, corners)).collect()
        });
        axes.chain(hemispheres).collect()
    }

    fn weights(layout: &Layout, d: DVec3, corners: [u32; 4]) -> [f64; 4] {
        match layout.form.interpolation {
            Interpolation::Constant => [0.25; 4],
            Interpolation::InverseDistance => {
                let near = corners
                    .map(|c| 1.0 / layout.hemisphere.direction(c as usize).angle_between(d).max(1e-12));
                near.map(|x| x / near.iter().sum::<f64>())
            }
            Interpolation::Bilinear => {
                let theta = d.truncate().length().atan2(d.z);
                let t = (d.y.atan2(d.x).rem_euclid(TAU) / FRAC_PI_2) % 4.0;
                // An axis belongs to the quarter that its signs say, as in float32.
                let quarter = match (d.x < 0.0, d.y < 0.0) {
                    (false, false) => 0.0,
                    (true, false) => 1.0,
                    (true, true) => 2.0,
                    (false, true) => 3.0,
                };
                let n = f64::from(layout.form.nside.nside());
                let in_quarter = t - quarter;
                let [p, m] = match layout.form.pixelation {
                    Pixelation::Healpix if d.z > 2.0 / 3.0 => {
                        let sigma = 6.0f64.sqrt() * (theta / 2.0).sin();
                        [n * in_quarter * sigma, n * (1.0 - in_quarter) * sigma]
                    }
                    Pixelation::Healpix => {
                        [n * (in_quarter + 0.5 - 0.75 * d.z), n * (1.5 - in_quarter - 0.75 * d.z)]
                    }
                    Pixelation::LatLong => {
                        let rows = (0..).find(|r| 4 * (r + 1) * r > layout.hemisphere.points()).unwrap();
                        let rows = if 4 * rows * (rows - 1) == layout.hemisphere.points() {
                            rows as f64
                        } else {
                            unreachable!("the columns follow from the rows")
                        };
                        [theta / FRAC_PI_2 * (rows - 1.0), t * (rows - 1.0)]
                    }
                    Pixelation::Fibonacci => unreachable!("a layout refuses it"),
                };
                // The pixel's own origin is a whole number away from what float32 says.
                let pixel = layout.hemisphere.pixels(d.as_vec3().to_array()).at;
                let within = |x: f64, at: f32| x - (x - f64::from(at)).round();
                let (p, m) = (within(p, pixel[0]), within(m, pixel[1]));
                [(1.0 - p) * (1.0 - m), p * (1.0 - m), (1.0 - p) * m, p * m]
            }
        }
    }
}

//! A sampler made of tables of the reflectance itself.
//!
//! For a number of view directions the table holds how much light comes from every cell of the
//! hemisphere, as a marginal distribution over rings and a conditional one over the sectors of each
//! ring. Inside a cell the density is constant over the solid angle of the charted vector, and between
//! the views the densities are blended linearly: a slice is chosen with the probability of its weight.
//! A share of cosine-distributed samples bounds every weight. The density is therefore exact; the table
//! decides about variance only.
//!
//! Two charts are offered. [`Chart::Half`] divides the half vectors, in rings that narrow towards the
//! normal as √θ_h (the spacing of the MERL tables and of Dupuy & Jakob 2018): a highlight stays where it
//! is when the view moves, so that few views suffice. [`Chart::Light`] divides the light directions in
//! rings of equal θ, as pbrt does for the tables of Bagher et al., *A Non-Parametric Factor Microfacet
//! Model for Isotropic BRDFs*, 2016 (appendix: 90 views × 90 × 360 directions, 1° apart).

use std::f32::consts::{FRAC_1_PI, FRAC_2_PI, FRAC_PI_2, PI, TAU};
use std::fmt;
use std::str::FromStr;

use glam::{Vec2, Vec3};

use crate::brdf::{Brdf, is_lit};
use crate::microfacet::MIN_SUM_Z;
use crate::sampling::lobes::sample_cosine;

/// What the cells divide.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chart {
    /// Half vectors, rings ∝ √θ.
    Half,
    /// Light directions, rings ∝ θ.
    Light,
}

/// The number of views and cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resolution {
    /// What the cells divide.
    pub chart: Chart,
    /// Elevations of the view from 0° to 90°.
    pub views: usize,
    /// Azimuths of the view around the circle; a material that is isotropic needs one.
    pub view_azimuths: usize,
    /// Rings around the normal.
    pub rings: usize,
    /// Sectors of a ring: of the half circle where the material is isotropic and both halves are the
    /// same, else of the whole one.
    pub sectors: usize,
}

impl Resolution {
    /// Half a megabyte for an isotropic material.
    pub const DEFAULT: Resolution =
        Resolution { chart: Chart::Half, views: 32, view_azimuths: 16, rings: 64, sectors: 32 };
    /// The 1° tables of Bagher et al.; the half circle has 180 sectors.
    pub const PAPER: Resolution =
        Resolution { chart: Chart::Light, views: 90, view_azimuths: 16, rings: 90, sectors: 180 };
    /// Most cells of all slices: half a gigabyte.
    const MOST_CELLS: usize = 1 << 26;

    /// Bytes of a table that is made like this.
    #[must_use]
    pub fn bytes(&self, isotropic: bool) -> usize {
        let (cells, distributions) = (self.rings + self.rings * self.sectors, 1 + self.rings);
        let slice = (cells + distributions) * size_of::<f32>() + cells * size_of::<u16>();
        (self.rings + 1) * size_of::<f32>() + self.slices(isotropic) * slice
    }

    /// Directions of the view.
    fn slices(&self, isotropic: bool) -> usize {
        self.views * if isotropic { 1 } else { self.view_azimuths }
    }
}

/// As [`Resolution::from_str`] reads it; azimuths of the view and the chart follow from the rest.
impl fmt::Display for Resolution {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if *self == Resolution::PAPER {
            return f.write_str("paper");
        }
        write!(f, "{}x{}x{}", self.views, self.rings, self.sectors)
    }
}

impl FromStr for Resolution {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "paper" {
            return Ok(Resolution::PAPER);
        }
        let numbers: Result<Vec<usize>, _> = text.split('x').map(usize::from_str).collect();
        let Ok([views, rings, sectors]) = numbers.as_deref() else {
            return Err(format!("\"{text}\" is no resolution, expected VIEWSxRINGSxSECTORS as in 32x64x32"));
        };
        let resolution =
            Resolution { views: *views, rings: *rings, sectors: *sectors, ..Resolution::DEFAULT };
        let cells = [rings, sectors, &resolution.view_azimuths]
            .into_iter()
            .try_fold(*views, |cells, &factor| cells.checked_mul(factor));
        // Guides are numbers of 16 bits.
        let fits = *rings <= usize::from(u16::MAX) && *sectors <= usize::from(u16::MAX);
        match cells {
            Some(1..=Resolution::MOST_CELLS) if *views >= 2 && fits => Ok(resolution),
            _ => Err(format!(
                "a table of {text} is not possible, expected at least 2 views, 1 ring and 1 sector, and at \
                 most {} cells",
                Resolution::MOST_CELLS
            )),
        }
    }
}

/// Share of cosine-distributed samples: no weight exceeds π f over this.
const COSINE_SHARE: f32 = 1.0 / 16.0;
/// Points along either axis of a cell at which the reflectance is averaged.
const POINTS: usize = 2;
/// The view of the last elevation, where 90° would show nothing.
const LAST_COS: f32 = 2e-3;
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// Tables from which light directions are drawn for any view.
#[derive(Clone, Debug)]
pub struct TableSampler {
    resolution: Resolution,
    isotropic: bool,
    /// Edges of the rings as sin²(θ/2), which keeps its digits near the normal.
    edges: Vec<f32>,
    /// Over the rings, one for each slice.
    rings: Distributions,
    /// Over the sectors, one for each slice and ring.
    sectors: Distributions,
}

impl TableSampler {
    /// The table of `brdf`; `isotropic` says whether only the difference of azimuths counts.
    ///
    /// A cell has the probability that gives the least variance there is for its size: its solid angle
    /// times the root mean square of f cosθ (mean of the channels) at four points.
    #[must_use]
    pub fn new(brdf: &dyn Brdf, isotropic: bool, resolution: Resolution) -> TableSampler {
        let Resolution { rings, sectors, .. } = resolution;
        let slices = resolution.slices(isotropic);
        let mut table = TableSampler {
            resolution,
            isotropic,
            edges: (0..=rings).map(|k| ring_edge(resolution.chart, k as f32 / rings as f32)).collect(),
            rings: Distributions::new(rings, slices),
            sectors: Distributions::new(sectors, slices * rings),
        };
        for slice in 0..slices {
            let cells = table.cells(brdf, table.slice_view(slice));
            let mut totals = Vec::with_capacity(rings);
            for ring in cells.chunks_exact(sectors) {
                totals.push(ring.iter().sum());
                table.sectors.push(ring);
            }
            table.rings.push(&totals);
        }
        table
    }

    /// Its resolution.
    #[must_use]
    pub fn resolution(&self) -> Resolution {
        self.resolution
    }

    /// Bytes of its tables.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.edges.len() * size_of::<f32>() + self.rings.bytes() + self.sectors.bytes()
    }

    /// Density (sr⁻¹) of `light` given `view`.
    #[must_use]
    pub fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        if is_lit(light, view) { self.pdf_lit(light, view, &self.blend(view)) } else { 0.0 }
    }

    /// Chooses a light direction, and says its density; `None` where it falls below the horizon.
    /// Arguments as in [`SampleBrdf::sample`](crate::SampleBrdf::sample).
    #[must_use]
    pub fn sample_direction(&self, view: Vec3, u: Vec3) -> Option<(Vec3, f32)> {
        if !is_lit(view, view) || !u.is_finite() {
            return None;
        }
        let blend = self.blend(view);
        let light = if u.x < COSINE_SHARE {
            sample_cosine(u.y, u.z)
        } else {
            let slice = blend.choose((u.x - COSINE_SHARE) / (1.0 - COSINE_SHARE));
            let charted = self.sample_cell(slice, view, u.y, u.z);
            match self.resolution.chart {
                Chart::Half => 2.0 * view.dot(charted) * charted - view,
                Chart::Light => charted,
            }
        };
        // The density of what was chosen, not of what was meant: rounding may cross the edge of a cell.
        is_lit(light, view)
            .then(|| (light, self.pdf_lit(light, view, &blend)))
            .filter(|&(_, pdf)| pdf > 0.0 && pdf.is_finite())
    }

    fn pdf_lit(&self, light: Vec3, view: Vec3, blend: &Blend) -> f32 {
        let (charted, jacobian) = match self.resolution.chart {
            Chart::Half => {
                let sum = light + view;
                let half = sum.with_z(sum.z.max(MIN_SUM_Z)).normalize();
                (half, 0.25 / view.dot(half).max(f32::MIN_POSITIVE))
            }
            Chart::Light => (light, 1.0),
        };
        let (ring, sector) = self.cell(charted, view);
        let solid_angle =
            2.0 * TAU * (self.edges[ring + 1] - self.edges[ring]) / self.resolution.sectors as f32;
        let probability: f32 = blend
            .slices
            .iter()
            .map(|&(slice, weight)| {
                let row = slice * self.resolution.rings + ring;
                weight * self.rings.probability(slice, ring) * self.sectors.probability(row, sector)
            })
            .sum();
        let table = probability / solid_angle * jacobian;
        // At the horizon the one can be less than float32 holds, which must not be 0 where f is not, and between
        // opposite directions the other more.
        let cosine = (COSINE_SHARE * light.z * FRAC_1_PI).max(f32::MIN_POSITIVE);
        (cosine + (1.0 - COSINE_SHARE) * table).min(f32::MAX)
    }

    /// Ring and sector of a vector.
    fn cell(&self, charted: Vec3, view: Vec3) -> (usize, usize) {
        let Resolution { chart, rings, sectors, .. } = self.resolution;
        let square = charted.truncate().length_squared();
        let s = 0.5 * square / (1.0 + charted.z);
        let ring = (ring_of(chart, s) * rings as f32) as usize;

        let turned = self.axis(view).perp_dot(charted.truncate());
        let along = self.axis(view).dot(charted.truncate());
        let phi = turned.atan2(along);
        let turn = if self.isotropic { phi.abs() / PI } else { (phi + PI) / TAU };
        (ring.min(rings - 1), ((turn * sectors as f32) as usize).min(sectors - 1))
    }

    /// A vector of a slice from two random numbers.
    fn sample_cell(&self, slice: usize, view: Vec3, u_ring: f32, u_sector: f32) -> Vec3 {
        let Resolution { rings, sectors, .. } = self.resolution;
        let (ring, t) = self.rings.invert(slice, u_ring);
        // Where the halves of the circle are the same, the first binary digit chooses the side.
        let (side, u_sector) = match self.isotropic {
            true if u_sector < 0.5 => (1.0, 2.0 * u_sector),
            true => (-1.0, 2.0 * u_sector - 1.0),
            false => (1.0, u_sector),
        };
        let (sector, along) = self.sectors.invert(slice * rings + ring, u_sector);
        self.vector(view, ring, t, side, (sector as f32 + along) / sectors as f32)
    }

    /// The vector at position `t` of a ring, and at `turn` of the (half) circle on a `side`.
    fn vector(&self, view: Vec3, ring: usize, t: f32, side: f32, turn: f32) -> Vec3 {
        let s = self.edges[ring] + t * (self.edges[ring + 1] - self.edges[ring]);
        let phi = if self.isotropic { side * PI * turn } else { TAU * turn - PI };
        let (sin, cos) = phi.sin_cos();
        let in_plane = self.axis(view).rotate(Vec2::new(cos, sin)) * (2.0 * (s * (1.0 - s)).sqrt());
        in_plane.extend(1.0 - 2.0 * s)
    }

    /// Where azimuths are counted from.
    fn axis(&self, view: Vec3) -> Vec2 {
        if self.isotropic { view.truncate().try_normalize().unwrap_or(Vec2::X) } else { Vec2::X }
    }

    /// The view of a slice; elevations fastest.
    fn slice_view(&self, slice: usize) -> Vec3 {
        let Resolution { views, view_azimuths, .. } = self.resolution;
        let theta = (slice % views) as f32 / (views - 1) as f32 * FRAC_PI_2;
        let phi = (slice / views) as f32 / view_azimuths as f32 * TAU;
        let cos = theta.cos().max(LAST_COS);
        let sin = (1.0 - cos * cos).sqrt();
        Vec3::new(sin * phi.cos(), sin * phi.sin(), cos)
    }

    /// The slices around a view.
    fn blend(&self, view: Vec3) -> Blend {
        let Resolution { views, view_azimuths, .. } = self.resolution;
        let theta = view.z.clamp(0.0, 1.0).acos() * FRAC_2_PI * (views - 1) as f32;
        let low = (theta as usize).min(views - 2);
        let t = (theta - low as f32).min(1.0);
        if self.isotropic {
            return Blend { slices: [(low, 1.0 - t), (low + 1, t), (0, 0.0), (0, 0.0)] };
        }
        let phi = (view.y.atan2(view.x) / TAU).rem_euclid(1.0) * view_azimuths as f32;
        let column = (phi as usize).min(view_azimuths - 1);
        let s = (phi - column as f32).min(1.0);
        let (first, second) = (column * views + low, (column + 1) % view_azimuths * views + low);
        Blend {
            slices: [
                (first, (1.0 - s) * (1.0 - t)),
                (first + 1, (1.0 - s) * t),
                (second, s * (1.0 - t)),
                (second + 1, s * t),
            ],
        }
    }

    /// The weight of every cell for a view, sectors fastest.
    fn cells(&self, brdf: &dyn Brdf, view: Vec3) -> Vec<f64> {
        let Resolution { chart, rings, sectors, .. } = self.resolution;
        let sides: &[f32] = if self.isotropic { &[1.0, -1.0] } else { &[1.0] };
        let per_cell = POINTS * POINTS * sides.len();
        let point = |i: usize| (i as f32 + 0.5) / POINTS as f32;
        let mut lights = Vec::with_capacity(rings * sectors * per_cell);
        let mut scales = Vec::with_capacity(lights.capacity());
        for cell in 0..rings * sectors {
            let (ring, sector) = (cell / sectors, cell % sectors);
            for (i, &side) in (0..POINTS * POINTS).flat_map(|i| sides.iter().map(move |side| (i, side))) {
                let turn = (sector as f32 + point(i % POINTS)) / sectors as f32;
                let charted = self.vector(view, ring, point(i / POINTS), side, turn);
                let (light, jacobian) = match chart {
                    Chart::Half => {
                        let cos = view.dot(charted);
                        (2.0 * cos * charted - view, 4.0 * cos)
                    }
                    Chart::Light => (charted, 1.0),
                };
                lights.push(light);
                scales.push(light.z.max(0.0) * jacobian.max(0.0));
            }
        }
        let mut f = vec![Vec3::ZERO; lights.len()];
        brdf.eval_batch(&lights, &vec![view; lights.len()], &mut f);
        let responses: Vec<f64> =
            f.iter().zip(&scales).map(|(f, &scale)| f64::from(f.element_sum()) * f64::from(scale)).collect();
        let cells = responses.chunks_exact(per_cell).enumerate();
        cells
            .map(|(cell, responses)| {
                let ring = cell / sectors;
                let solid_angle = f64::from(self.edges[ring + 1] - self.edges[ring]);
                let squares: f64 = responses.iter().map(|response| response * response).sum();
                solid_angle * (squares / per_cell as f64).sqrt()
            })
            .collect()
    }
}

/// sin²(θ/2) at a fraction `x` of the rings.
fn ring_edge(chart: Chart, x: f32) -> f32 {
    match chart {
        // θ ≈ 2 √s near the normal, so that x ∝ √θ; s is ½ at 90°.
        Chart::Half => 0.5 * x.powi(4),
        Chart::Light => (0.5 * FRAC_PI_2 * x).sin().powi(2),
    }
}

/// The inverse of [`ring_edge`].
fn ring_of(chart: Chart, s: f32) -> f32 {
    match chart {
        Chart::Half => (2.0 * s).sqrt().sqrt(),
        Chart::Light => s.sqrt().min(1.0).asin() * 2.0 * FRAC_2_PI,
    }
}

/// The slices around a view and their weights, which sum to 1.
struct Blend {
    slices: [(usize, f32); 4],
}

impl Blend {
    /// A slice, with the probability of its weight.
    fn choose(&self, mut u: f32) -> usize {
        for &(slice, weight) in &self.slices {
            if u < weight {
                return slice;
            }
            u -= weight;
        }
        // Rounding: the sum of the weights may miss 1.
        self.slices.iter().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |&(slice, _)| slice)
    }
}

/// Discrete distributions of equal length, each with a guide to where its inversion starts.
#[derive(Clone, Debug)]
struct Distributions {
    len: usize,
    /// Cumulative probabilities, `len` + 1 each, from 0 to 1.
    cumulative: Vec<f32>,
    /// For each i in 0..`len`, the last event that begins at or before i/`len`.
    guide: Vec<u16>,
}

impl Distributions {
    fn new(len: usize, count: usize) -> Distributions {
        Distributions {
            len,
            cumulative: Vec::with_capacity((len + 1) * count),
            guide: Vec::with_capacity(len * count),
        }
    }

    fn bytes(&self) -> usize {
        self.cumulative.len() * size_of::<f32>() + self.guide.len() * size_of::<u16>()
    }

    /// Adds a distribution; without any weight it is uniform.
    fn push(&mut self, weights: &[f64]) {
        let total: f64 = weights.iter().sum();
        let is_usable = total > 0.0 && total.is_finite();
        let first = self.cumulative.len();
        let mut sum = 0.0;
        self.cumulative.push(0.0);
        for (i, weight) in weights.iter().enumerate() {
            sum += weight;
            let share = if is_usable { sum / total } else { (i + 1) as f64 / self.len as f64 };
            self.cumulative.push(share as f32);
        }
        let mut event = 0;
        for i in 0..self.len {
            let start = i as f32 / self.len as f32;
            while event + 1 < self.len && self.cumulative[first + event + 1] <= start {
                event += 1;
            }
            self.guide.push(event as u16);
        }
    }

    fn probability(&self, distribution: usize, event: usize) -> f32 {
        let at = distribution * (self.len + 1) + event;
        self.cumulative[at + 1] - self.cumulative[at]
    }

    /// The event in which `u` falls, and where in it, both in [0, 1).
    fn invert(&self, distribution: usize, u: f32) -> (usize, f32) {
        let u = u.clamp(0.0, BELOW_ONE);
        let cumulative = &self.cumulative[distribution * (self.len + 1)..][..=self.len];
        let start = ((u * self.len as f32) as usize).min(self.len - 1);
        let mut event = usize::from(self.guide[distribution * self.len + start]);
        while event + 1 < self.len && cumulative[event + 1] <= u {
            event += 1;
        }
        let (low, high) = (cumulative[event], cumulative[event + 1]);
        let t = if high > low { (u - low) / (high - low) } else { 0.5 };
        (event, t.clamp(0.0, BELOW_ONE))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::microfacet::Microfacet;

    struct Lobe(Microfacet);

    impl Brdf for Lobe {
        fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
            if is_lit(light, view) { self.0.eval(light.into(), view.into()).into() } else { Vec3::ZERO }
        }
    }

    const SMALL: Resolution =
        Resolution { chart: Chart::Half, views: 12, view_azimuths: 8, rings: 24, sectors: 16 };

    fn lobe(alpha: [f32; 2]) -> Lobe {
        Lobe(Microfacet { kd: [0.2, 0.3, 0.1], eta: [1.8; 3], alpha })
    }

    fn tables() -> [TableSampler; 3] {
        [
            TableSampler::new(&lobe([0.2; 2]), true, SMALL),
            TableSampler::new(&lobe([0.2; 2]), true, Resolution { chart: Chart::Light, ..SMALL }),
            TableSampler::new(&lobe([0.15, 0.4]), false, SMALL),
        ]
    }

    const VIEWS: [Vec3; 4] = [
        Vec3::Z,
        Vec3::new(0.36, 0.48, 0.8),
        Vec3::new(-0.8, 0.0, 0.6),
        Vec3::new(0.69, -0.69, 0.218_632_11),
    ];

    /// Three numbers in [0, 1) that fill the cube evenly (Roberts 2018).
    fn point(i: usize) -> Vec3 {
        let [x, y, z] = [0.819_172_513_4_f64, 0.671_043_606_7, 0.549_700_477_9];
        let at = |step: f64| (i as f64 * step).fract() as f32;
        Vec3::new(at(x), at(y), at(z)).min(Vec3::splat(BELOW_ONE))
    }

    /// ∫ pdf over bands of the hemisphere, 8 in cosθ and 16 in φ.
    fn integrate(table: &TableSampler, view: Vec3) -> Vec<f64> {
        let (fine_cos, fine_phi) = (64, 64);
        let mut cells = vec![0.0; 8 * 16];
        for i in 0..8 * fine_cos {
            let z = (i as f32 + 0.5) / (8 * fine_cos) as f32;
            for j in 0..16 * fine_phi {
                let phi = (j as f32 + 0.5) / (16 * fine_phi) as f32 * TAU;
                let r = (1.0 - z * z).sqrt();
                let pdf = table.pdf(Vec3::new(r * phi.cos(), r * phi.sin(), z), view);
                cells[i / fine_cos * 16 + j / fine_phi] += f64::from(pdf);
            }
        }
        let solid_angle = f64::from(TAU) / (8 * fine_cos * 16 * fine_phi) as f64;
        cells.iter().map(|cell| cell * solid_angle).collect()
    }

    #[test]
    fn samples_follow_the_density_and_with_the_failures_add_up_to_one() {
        let n = 200_000;
        for table in tables() {
            for view in VIEWS {
                let mut counts = vec![0.0; 8 * 16];
                let mut failed = 0.0;
                for i in 0..n {
                    let Some((light, pdf)) = table.sample_direction(view, point(i)) else {
                        failed += 1.0 / n as f64;
                        continue;
                    };
                    assert_eq!(pdf, table.pdf(light, view));
                    assert!((light.length() - 1.0).abs() < 1e-5);
                    let phi = light.y.atan2(light.x).rem_euclid(TAU) / TAU;
                    let cell = ((light.z * 8.0) as usize).min(7) * 16 + ((phi * 16.0) as usize).min(15);
                    counts[cell] += 1.0 / n as f64;
                }
                let expected = integrate(&table, view);
                let total = expected.iter().sum::<f64>() + failed;
                assert!((total - 1.0).abs() < 3e-3, "{view}: {total}");
                for (cell, (count, expected)) in counts.iter().zip(&expected).enumerate() {
                    // Five standard deviations of a count, and the quadrature over steps of the density.
                    let tolerance = 5.0 * (expected / n as f64).sqrt() + 0.02 * expected + 1e-4;
                    assert!((count - expected).abs() < tolerance, "{view} {cell}: {count} for {expected}");
                }
            }
        }
    }

    /// The variance of f cosθ / pdf over the square of its mean.
    fn relative_variance(brdf: &dyn Brdf, table: &TableSampler, view: Vec3) -> f64 {
        let n = 20_000;
        let (mut sum, mut squares) = (0.0, 0.0);
        for i in 0..n {
            let weight = table
                .sample_direction(view, point(i))
                .map_or(0.0, |(light, pdf)| f64::from(brdf.eval(light, view).element_sum() * light.z / pdf));
            sum += weight;
            squares += weight * weight;
        }
        squares * f64::from(n as u32) / (sum * sum) - 1.0
    }

    #[test]
    fn a_finer_table_has_less_variance() {
        let brdf = lobe([0.1; 2]);
        let variance = |resolution| {
            relative_variance(&brdf, &TableSampler::new(&brdf, true, resolution), Vec3::new(0.6, 0.0, 0.8))
        };
        let coarse = variance(Resolution { views: 6, rings: 12, sectors: 8, ..SMALL });
        let fine = variance(Resolution::DEFAULT);
        assert!(fine < 0.3 * coarse && fine < 0.15, "{fine} against {coarse}");
    }

    #[test]
    fn what_is_dark_is_sampled_evenly_and_what_is_no_direction_not_at_all() {
        struct Black;
        impl Brdf for Black {
            fn eval(&self, _: Vec3, _: Vec3) -> Vec3 {
                Vec3::ZERO
            }
        }
        let table = TableSampler::new(&Black, true, SMALL);
        assert!(table.pdf(Vec3::new(0.6, 0.0, 0.8), VIEWS[1]) > 0.0);
        for (light, view) in
            [(-Vec3::Z, Vec3::Z), (Vec3::Z, -Vec3::Z), (Vec3::NAN, Vec3::Z), (Vec3::Z, Vec3::NAN)]
        {
            assert_eq!(table.pdf(light, view), 0.0);
        }
        assert_eq!(table.sample_direction(-Vec3::Z, Vec3::splat(0.5)), None);
        assert_eq!(table.sample_direction(Vec3::Z, Vec3::splat(f32::NAN)), None);
        for u in [Vec3::ZERO, Vec3::splat(BELOW_ONE)] {
            assert!(table.sample_direction(Vec3::Z, u).is_none_or(|(_, pdf)| pdf > 0.0 && pdf.is_finite()));
        }
    }

    #[test]
    fn bytes_are_those_of_the_tables() {
        let [isotropic, _, anisotropic] = tables();
        let slice = (25 + 24 * 17) * 4 + (24 + 24 * 16) * 2;
        assert_eq!(isotropic.bytes(), 25 * 4 + 12 * slice);
        assert_eq!(anisotropic.bytes(), 25 * 4 + 12 * 8 * slice);
        assert_eq!([true, false].map(|i| SMALL.bytes(i)), [isotropic.bytes(), anisotropic.bytes()]);
    }
}

//! The sphere of light directions cut into cells, finer where the density, the response or the samples are.
//!
//! One partition serves several tests: a cell knows the integrals of density and response over it, by Gauss
//! quadrature, and the samples that fell into it. A cell is a rectangle in (θ, φ), and is cut in four as
//! long as its quadrature has not settled, as it holds a notable share of the density, or as samples and
//! density disagree in it, which may be the quadrature's fault.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::{DVec3, Vec3};

use crate::subject::{Answer, Part, Subject};
use crate::views::{direction, mirror};

/// How finely the sphere is cut.
#[derive(Clone, Copy, Debug)]
pub struct Resolution {
    /// Rows of cells from pole to horizon at the start; columns are twice as many.
    pub rows: usize,
    /// Most directions at which one partition asks its subject.
    pub evaluations: usize,
}

/// Integrals over a cell.
#[derive(Clone, Copy, Debug, Default)]
pub struct Integral {
    /// Of the density.
    pub pdf: f64,
    /// Of the response.
    pub response: DVec3,
    /// Of response²/pdf where there is a density: the second moment of the weight.
    pub square: DVec3,
    /// Of the mean response where the density is 0.
    pub uncovered: f64,
}

impl std::ops::AddAssign for Integral {
    fn add_assign(&mut self, other: Self) {
        self.pdf += other.pdf;
        self.response += other.response;
        self.square += other.square;
        self.uncovered += other.uncovered;
    }
}

/// A rectangle in (θ, φ).
#[derive(Clone, Debug)]
pub struct Cell {
    theta: [f64; 2],
    phi: [f64; 2],
    depth: u8,
    /// The first of its four parts.
    children: Option<usize>,
    /// By 3 × 3 points.
    pub integral: Integral,
    /// Difference to the midpoint rule, relative to the integral: of density and mean response.
    disagreement: [f64; 2],
    /// Indices of the samples that fell into it; empty for a cell that was cut.
    members: Vec<u32>,
    /// Number of samples that fell into it.
    pub observed: usize,
}

impl Cell {
    fn new(theta: [f64; 2], phi: [f64; 2], depth: u8) -> Cell {
        Cell {
            theta,
            phi,
            depth,
            children: None,
            integral: Integral::default(),
            disagreement: [0.0; 2],
            members: Vec::new(),
            observed: 0,
        }
    }

    fn contains(&self, [theta, phi]: [f64; 2]) -> bool {
        (self.theta[0]..=self.theta[1]).contains(&theta) && (self.phi[0]..=self.phi[1]).contains(&phi)
    }

    fn quarters(&self) -> [Cell; 4] {
        let [t0, t1] = self.theta;
        let [p0, p1] = self.phi;
        let (t, p) = (0.5 * (t0 + t1), 0.5 * (p0 + p1));
        // In the order of `quarter_of`.
        [([t0, t], [p0, p]), ([t0, t], [p, p1]), ([t, t1], [p0, p]), ([t, t1], [p, p1])]
            .map(|(theta, phi)| Cell::new(theta, phi, self.depth + 1))
    }

    fn quarter_of(&self, [theta, phi]: [f64; 2]) -> usize {
        let low = |range: [f64; 2], x: f64| usize::from(x >= 0.5 * (range[0] + range[1]));
        2 * low(self.theta, theta) + low(self.phi, phi)
    }
}

/// Cells of one view.
#[derive(Clone, Debug)]
pub struct Cells {
    cells: Vec<Cell>,
    rows: usize,
    /// θ at which the first row begins: 0, or π/2 for the lower half alone.
    start: f64,
    /// Rows in all: one half of the sphere or both.
    total_rows: usize,
    /// Samples outside of the half of the sphere that is cut.
    pub outside: usize,
    /// Whether every cell's quadrature settled within the budget.
    pub settled: bool,
}

/// Gauss-Legendre nodes and weights on [−1, 1], three points.
const NODES: [f64; 3] = [-0.774_596_669_241_483_4, 0.0, 0.774_596_669_241_483_4];
const WEIGHTS: [f64; 3] = [5.0 / 9.0, 8.0 / 9.0, 5.0 / 9.0];
/// Cuts after which a cell is left as it is: 90°/32/2¹² is 2·10⁻⁵ radians times two.
const MAX_DEPTH: u8 = 12;
/// Cuts around the directions where lobes usually are.
const SEED_DEPTH: u8 = 4;
/// A cell that holds more of the density, or of the response, than this share is cut.
const NOTABLE_SHARE: f64 = 1.0 / 400.0;
/// Relative difference between 9 points and 1 below which the former is taken as exact …
const SETTLED: f64 = 0.02;
/// … and share of the whole below which it does not matter.
const NEGLIGIBLE: f64 = 2e-6;
/// Standard deviations between samples and density at which the quadrature is doubted.
const DOUBT: f64 = 4.0;
/// Directions in one question to the subject.
const BATCH: usize = 1 << 16;

impl Cells {
    /// Cuts the sphere of lights for `view`, given the sampled `lights`.
    ///
    /// # Errors
    /// The subject's.
    pub fn new(
        subject: &dyn Subject,
        part: Part,
        view: Vec3,
        lights: &[Vec3],
        draws: usize,
        resolution: Resolution,
    ) -> Answer<Cells> {
        let transmits = subject.claims().transmits;
        let mut cells = Cells::base(resolution.rows, transmits, view.z < 0.0);
        let angles: Vec<[f64; 2]> = lights.iter().map(|&light| angles(light)).collect();
        for (i, &angle) in angles.iter().enumerate() {
            match cells.base_cell(angle) {
                Some(cell) => cells.cells[cell].members.push(i as u32),
                None => cells.outside += 1,
            }
        }
        let seeds = [mirror(view), view, -view].map(self::angles);
        let mut fresh = 0..cells.cells.len();
        let mut evaluations = 0;
        loop {
            evaluations += cells.integrate(subject, part, view, fresh.clone())?;
            let total = cells.total();
            let can_be_cut =
                |&i: &usize| cells.cells[i].children.is_none() && cells.cells[i].depth < MAX_DEPTH;
            let (mut wanting, others): (Vec<usize>, Vec<usize>) =
                (0..cells.cells.len()).filter(can_be_cut).partition(|&i| !cells.cells[i].is_settled(&total));
            let affordable = resolution.evaluations.saturating_sub(evaluations) / (4 * NODES.len().pow(2));
            cells.settled = wanting.len() <= affordable;
            wanting.extend(others.into_iter().filter(|&i| cells.cells[i].is_notable(&total, draws, &seeds)));
            wanting.truncate(affordable);
            if wanting.is_empty() {
                break;
            }
            let start = cells.cells.len();
            for parent in wanting {
                cells.cut(parent, &angles);
            }
            fresh = start..cells.cells.len();
        }
        for i in (0..cells.cells.len()).rev() {
            cells.cells[i].observed = match cells.cells[i].children {
                Some(first) => (first..first + 4).map(|child| cells.cells[child].observed).sum(),
                None => cells.cells[i].members.len(),
            };
        }
        Ok(cells)
    }

    fn base(rows: usize, both: bool, lower: bool) -> Cells {
        let start = if !both && lower { FRAC_PI_2 } else { 0.0 };
        let total_rows = if both { 2 * rows } else { rows };
        let (height, width) = (FRAC_PI_2 / rows as f64, PI / rows as f64);
        let cell = |i: usize| {
            let (row, column) = ((i / (2 * rows)) as f64, (i % (2 * rows)) as f64);
            let theta = [start + row * height, start + (row + 1.0) * height];
            Cell::new(theta, [column * width, (column + 1.0) * width], 0)
        };
        let cells = (0..total_rows * 2 * rows).map(cell).collect();
        Cells { cells, rows, start, total_rows, outside: 0, settled: true }
    }

    fn base_cell(&self, [theta, phi]: [f64; 2]) -> Option<usize> {
        let row = ((theta - self.start) / (FRAC_PI_2 / self.rows as f64)).floor();
        if row < 0.0 || row >= self.total_rows as f64 {
            return None;
        }
        let columns = 2 * self.rows;
        let column = (phi / TAU * columns as f64) as usize;
        Some(row as usize * columns + column.min(columns - 1))
    }

    fn cut(&mut self, parent: usize, angles: &[[f64; 2]]) {
        let first = self.cells.len();
        let mut quarters = self.cells[parent].quarters();
        for member in std::mem::take(&mut self.cells[parent].members) {
            quarters[self.cells[parent].quarter_of(angles[member as usize])].members.push(member);
        }
        self.cells[parent].children = Some(first);
        self.cells.extend(quarters);
    }

    /// Integrates the cells of a range; returns the number of directions that it took.
    fn integrate(
        &mut self,
        subject: &dyn Subject,
        part: Part,
        view: Vec3,
        range: std::ops::Range<usize>,
    ) -> Answer<usize> {
        let points_per_cell = NODES.len().pow(2);
        for cells in self.cells[range.clone()].chunks_mut(BATCH / points_per_cell) {
            let mut lights = Vec::with_capacity(cells.len() * points_per_cell);
            for cell in cells.iter() {
                lights.extend(cell.points().map(|(theta, phi, _)| direction(theta, phi)));
            }
            let views = vec![view; lights.len()];
            let (response, pdf) = subject.response_and_pdf(part, &lights, &views)?;
            let answers = response.chunks_exact(points_per_cell).zip(pdf.chunks_exact(points_per_cell));
            for (cell, (response, pdf)) in cells.iter_mut().zip(answers) {
                cell.sum(response, pdf);
            }
        }
        Ok(range.len() * points_per_cell)
    }

    /// The integrals over all cells.
    #[must_use]
    pub fn total(&self) -> Integral {
        let mut total = Integral::default();
        for cell in self.leaves() {
            total += cell.integral;
        }
        total
    }

    /// The cells that were not cut.
    pub fn leaves(&self) -> impl Iterator<Item = &Cell> {
        self.cells.iter().filter(|cell| cell.children.is_none())
    }

    /// The cells that hold a direction, the largest first.
    pub fn path(&self, light: Vec3) -> impl Iterator<Item = &Cell> {
        let angles = angles(light);
        let mut next = self.base_cell(angles);
        std::iter::from_fn(move || {
            let cell = &self.cells[next?];
            next = cell.children.map(|first| first + cell.quarter_of(angles));
            Some(cell)
        })
    }
}

impl Cell {
    /// (θ, φ, weight) of its quadrature points; the weight holds the sine.
    fn points(&self) -> impl Iterator<Item = (f64, f64, f64)> + use<> {
        let ([t0, t1], [p0, p1]) = (self.theta, self.phi);
        let (half_t, half_p) = (0.5 * (t1 - t0), 0.5 * (p1 - p0));
        (0..9).map(move |i| {
            let (row, column) = (i / 3, i % 3);
            let theta = t0 + half_t * (1.0 + NODES[row]);
            let phi = p0 + half_p * (1.0 + NODES[column]);
            (theta, phi, WEIGHTS[row] * WEIGHTS[column] * half_t * half_p * theta.sin())
        })
    }

    /// Solid angle.
    #[must_use]
    pub fn solid_angle(&self) -> f64 {
        (self.theta[0].cos() - self.theta[1].cos()) * (self.phi[1] - self.phi[0])
    }

    fn sum(&mut self, response: &[Vec3], pdf: &[f32]) {
        let mut integral = Integral::default();
        let mut middle = [0.0; 2];
        for (i, (_, _, weight)) in self.points().enumerate() {
            let (response, pdf) = (response[i].as_dvec3(), f64::from(pdf[i]));
            let mean = response.element_sum() / 3.0;
            let covered = pdf > 0.0;
            integral += Integral {
                pdf: pdf * weight,
                response: response * weight,
                square: if covered { response * response * (weight / pdf) } else { DVec3::ZERO },
                uncovered: if covered { 0.0 } else { mean * weight },
            };
            if i == 4 {
                middle = [pdf, mean];
            }
        }
        let mean = integral.response.element_sum() / 3.0;
        let solid_angle = self.solid_angle();
        self.disagreement =
            [(integral.pdf - middle[0] * solid_angle).abs(), (mean - middle[1] * solid_angle).abs()];
        self.integral = integral;
    }

    /// Density and mean response with their totals, and how sure the quadrature is of them.
    fn shares(&self, total: &Integral) -> [(f64, f64, f64); 2] {
        let mean = |integral: &Integral| integral.response.element_sum() / 3.0;
        [
            (self.integral.pdf, total.pdf.max(1.0), self.disagreement[0]),
            (mean(&self.integral), mean(total), self.disagreement[1]),
        ]
    }

    /// Whether more points would not change the integrals.
    fn is_settled(&self, total: &Integral) -> bool {
        let is_settled = |(value, whole, disagreement): (f64, f64, f64)| {
            disagreement <= SETTLED * value || disagreement <= NEGLIGIBLE * whole
        };
        self.shares(total).into_iter().all(is_settled)
    }

    /// Whether there is something to be seen in it.
    fn is_notable(&self, total: &Integral, draws: usize, seeds: &[[f64; 2]]) -> bool {
        let is_large = |(value, whole, _): (f64, f64, f64)| value > NOTABLE_SHARE * whole;
        let is_seed = self.depth < SEED_DEPTH && seeds.iter().any(|&seed| self.contains(seed));
        let (expected, observed) = (self.integral.pdf * draws as f64, self.members.len() as f64);
        let is_doubtful = (observed - expected).abs() > DOUBT * expected.max(5.0).sqrt();
        is_seed || is_doubtful || self.shares(total).into_iter().any(is_large)
    }
}

/// θ in [0, π] and φ in [0, 2π) of a direction.
fn angles(light: Vec3) -> [f64; 2] {
    let light = light.as_dvec3();
    let theta = light.x.hypot(light.y).atan2(light.z);
    // −0.0 for the tiniest negative angles rounds to 2π.
    [theta, light.y.atan2(light.x).rem_euclid(TAU).min(TAU.next_down())]
}

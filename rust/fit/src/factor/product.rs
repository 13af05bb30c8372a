//! ρ_d, ρ_s, D and F by alternating weighted least squares, for a third factor that is held.
//!
//! Under a factor g of every sample (masking over cosines, or H) the objective needs the samples only
//! through their sums over φ_d. These are formed once per g; the many steps of D, F, ρ_d and ρ_s
//! then cost 8,100 rows each instead of 1.46 million samples.

use glimt_core::dispatch;
use glimt_core::models::factor::{DIFF_BINS, HALF_BINS, MAX_SCALE};

/// Numbers from one θ_h to the next: the bins of θ_d and zeros that fill whole vectors.
pub const STRIDE: usize = 96;
/// Length of a table over θ_h and θ_d.
pub const TABLE: usize = HALF_BINS * STRIDE;
const LANES: usize = 8;

/// Sums over φ_d, by θ_h and θ_d, that no factor changes.
#[derive(Clone, Debug)]
pub struct FixedSums {
    /// Σ w.
    pub weight: f64,
    /// Σ w ρ*.
    pub value: f64,
    /// Σ w ρ*².
    pub square: f64,
}

/// Sums over φ_d, by θ_h and θ_d, for one g.
#[derive(Clone, Debug)]
pub struct Sums {
    /// Σ w g.
    pub g: Vec<f64>,
    /// Σ w g².
    pub gg: Vec<f64>,
    /// Σ w g ρ*.
    pub gz: Vec<f64>,
}

impl Sums {
    pub fn new() -> Sums {
        Sums { g: vec![0.0; TABLE], gg: vec![0.0; TABLE], gz: vec![0.0; TABLE] }
    }
}

/// ρ_d, ρ_s, D and F of one colour channel.
#[derive(Clone, Debug)]
pub struct State {
    pub diffuse: f64,
    pub specular: f64,
    pub ndf: [f64; HALF_BINS],
    /// Zero beyond its bins.
    pub fresnel: [f64; STRIDE],
}

/// How a factor is kept in its range: its largest component is 1 and the others are no less than this.
#[derive(Clone, Copy, Debug)]
pub struct Floor(pub f64);

impl Floor {
    /// Dynamic-range clamping (the paper, §4.3), for independent G.
    pub const DYNAMIC_RANGE: Floor = Floor(1e-6);
    /// No less than 0, for the variants that need no more.
    pub const ZERO: Floor = Floor(0.0);

    /// Scales `factor` so that its largest component is 1, clamps it, and returns the scale that it lost.
    pub fn normalize(self, factor: &mut [f64]) -> f64 {
        let largest = factor.iter().copied().fold(0.0, f64::max);
        if largest > 0.0 {
            for x in factor.iter_mut() {
                *x = (*x / largest).max(self.0);
            }
        }
        largest
    }
}

/// One of the sums that an update divides, and the result where it is 0: the component keeps its value.
fn quotient(numerator: f64, denominator: f64, before: f64) -> f64 {
    if denominator > 0.0 { numerator / denominator } else { before }
}

impl State {
    /// One step of every unknown but the third factor: D (eq. 14), F, then ρ_d and ρ_s (eq. 16 to 18).
    /// Returns the objective.
    pub fn step(&mut self, sums: &Sums, fixed: &FixedSums, floor: Floor) -> f64 {
        self.step_ndf(sums, floor);
        self.step_fresnel(sums, floor);
        self.step_scales(sums, fixed)
    }

    fn step_ndf(&mut self, sums: &Sums, floor: Floor) {
        let mut fractions = [[0.0; 2]; HALF_BINS];
        along_rows(sums, &self.fresnel, self.diffuse, &mut fractions);
        for (ndf, [numerator, denominator]) in self.ndf.iter_mut().zip(fractions) {
            *ndf = quotient(numerator, self.specular * denominator, *ndf);
        }
        self.specular *= floor.normalize(&mut self.ndf);
    }

    pub fn step_fresnel(&mut self, sums: &Sums, floor: Floor) {
        let mut fractions = [[0.0; STRIDE]; 2];
        along_columns(sums, &self.ndf, self.diffuse, &mut fractions);
        let fresnel = &mut self.fresnel[..DIFF_BINS];
        for (i, fresnel) in fresnel.iter_mut().enumerate() {
            *fresnel = quotient(fractions[0][i], self.specular * fractions[1][i], *fresnel);
        }
        self.specular *= floor.normalize(fresnel);
    }

    /// Sets ρ_d and ρ_s to their best, and returns the objective.
    pub fn step_scales(&mut self, sums: &Sums, fixed: &FixedSums) -> f64 {
        let mut totals = [0.0; 3];
        total(sums, &self.ndf, &self.fresnel, &mut totals);
        let [x, xx, xz] = totals;
        let determinant = fixed.weight * xx - x * x;
        // Rounding decides where the product is the same in all samples.
        let is_regular = determinant > 1e-12 * fixed.weight * xx;
        let (mut a, mut b) = (self.diffuse, self.specular);
        if is_regular {
            a = (fixed.value * xx - x * xz) / determinant;
            b = (fixed.weight * xz - x * fixed.value) / determinant;
        }
        if a < 0.0 || !is_regular {
            a = 0.0;
            b = quotient(xz, xx, b);
        }
        if b <= 0.0 {
            // A lobe that lowers f: there is none, but its scale stays positive so that it can return.
            b = f64::MIN_POSITIVE.sqrt();
            a = quotient(fixed.value - b * x, fixed.weight, a).max(0.0);
        }
        // Where D and F have their maxima at angles that no pair of directions has together, ρ_s makes up for
        // both, and a few fits would go beyond what a material takes.
        if b > f64::from(MAX_SCALE) {
            b = MAX_SCALE.into();
            a = quotient(fixed.value - b * x, fixed.weight, a).max(0.0);
        }
        (self.diffuse, self.specular) = (a, b);
        a * a * fixed.weight + 2.0 * a * b * x + b * b * xx - 2.0 * a * fixed.value - 2.0 * b * xz
            + fixed.square
    }

    /// Steps until the objective falls by less than `tolerance` of itself; returns it.
    pub fn relax(
        &mut self,
        sums: &Sums,
        fixed: &FixedSums,
        floor: Floor,
        tolerance: f64,
        most: usize,
    ) -> f64 {
        let mut objective = self.step_scales(sums, fixed);
        for _ in 0..most {
            let mut next = self.clone();
            let lower = next.step(sums, fixed, floor);
            // Clamping may raise it by a hair, which ends the steps.
            if lower >= objective {
                break;
            }
            let fell = objective - lower;
            (*self, objective) = (next, lower);
            if fell < tolerance * objective {
                break;
            }
        }
        objective
    }
}

dispatch! {
    /// For every θ_h: Σ over θ_d of F (Σ w g ρ* − ρ_d Σ w g), and of F² Σ w g².
    fn along_rows(_isa, sums: &Sums, fresnel: &[f64; STRIDE], diffuse: f64, out: &mut [[f64; 2]; HALF_BINS]) {
        for (half, out) in out.iter_mut().enumerate() {
            let row = half * STRIDE;
            let (g, gg, gz) =
                (&sums.g[row..row + STRIDE], &sums.gg[row..row + STRIDE], &sums.gz[row..row + STRIDE]);
            let mut lanes = [[0.0; LANES]; 2];
            for at in (0..STRIDE).step_by(LANES) {
                for lane in 0..LANES {
                    let i = at + lane;
                    lanes[0][lane] += fresnel[i] * (gz[i] - diffuse * g[i]);
                    lanes[1][lane] += fresnel[i] * fresnel[i] * gg[i];
                }
            }
            *out = [lanes[0].iter().sum(), lanes[1].iter().sum()];
        }
    }
}

dispatch! {
    /// For every θ_d: Σ over θ_h of D (Σ w g ρ* − ρ_d Σ w g), and of D² Σ w g².
    fn along_columns(_isa, sums: &Sums, ndf: &[f64; HALF_BINS], diffuse: f64, out: &mut [[f64; STRIDE]; 2]) {
        let [numerator, denominator] = out;
        for (half, &d) in ndf.iter().enumerate() {
            let row = half * STRIDE;
            let (g, gg, gz) =
                (&sums.g[row..row + STRIDE], &sums.gg[row..row + STRIDE], &sums.gz[row..row + STRIDE]);
            for i in 0..STRIDE {
                numerator[i] += d * (gz[i] - diffuse * g[i]);
                denominator[i] += d * d * gg[i];
            }
        }
    }
}

dispatch! {
    /// Σ D F Σ w g, Σ D² F² Σ w g² and Σ D F Σ w g ρ*.
    fn total(_isa, sums: &Sums, ndf: &[f64; HALF_BINS], fresnel: &[f64; STRIDE], out: &mut [f64; 3]) {
        let mut lanes = [[0.0; LANES]; 3];
        for (half, &d) in ndf.iter().enumerate() {
            let row = half * STRIDE;
            let (g, gg, gz) =
                (&sums.g[row..row + STRIDE], &sums.gg[row..row + STRIDE], &sums.gz[row..row + STRIDE]);
            for at in (0..STRIDE).step_by(LANES) {
                for lane in 0..LANES {
                    let i = at + lane;
                    let product = d * fresnel[i];
                    lanes[0][lane] += product * g[i];
                    lanes[1][lane] += product * product * gg[i];
                    lanes[2][lane] += product * gz[i];
                }
            }
        }
        for (out, lanes) in out.iter_mut().zip(lanes) {
            *out = lanes.iter().sum();
        }
    }
}

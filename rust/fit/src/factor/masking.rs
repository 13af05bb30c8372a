//! The third factor of eq. 3: G(θ_l) G(θ_v) / (cosθ_l cosθ_v), its sums, and the step of an independent G.

use std::sync::LazyLock;

use glimt_core::dispatch;
use glimt_core::models::factor::{AZIMUTH_BINS, DIFF_BINS, HALF_BINS, MASKING_KNOTS};

use super::grid::{self, ROWS};
use super::product::{FixedSums, STRIDE, State, Sums};

/// G at whole degrees.
pub type Masking = [f64; MASKING_KNOTS];

/// Samples of a row: φ_d and 180° − φ_d exchange θ_l and θ_v, which leaves G(θ_l) G(θ_v) as it is, so that
/// both are one sample.
const FOLDED: usize = AZIMUTH_BINS / 2;

/// Where the included samples lie, row by row, φ_d fastest.
struct Geometry {
    /// From one sample's φ_d to the next, in bins.
    step: usize,
    /// First sample of each row of (θ_h, θ_d), and the end.
    starts: Vec<u32>,
    light: Vec<Knot>,
    view: Vec<Knot>,
    /// 1/(cosθ_l cosθ_v).
    scale: Vec<f32>,
}

/// A place between two knots of G.
#[derive(Clone, Copy)]
struct Knot {
    low: u16,
    t: f32,
}

/// All samples.
static FINE: LazyLock<Geometry> = LazyLock::new(|| Geometry::new(1));
/// Those of every third φ_d: enough to tell good starts from bad ones.
static COARSE: LazyLock<Geometry> = LazyLock::new(|| Geometry::new(3));

impl Geometry {
    fn new(step: usize) -> Geometry {
        let mut geometry =
            Geometry { step, starts: vec![0], light: Vec::new(), view: Vec::new(), scale: Vec::new() };
        for row in 0..ROWS {
            for azimuth in geometry.azimuths(row) {
                let cosines = grid::cosines(row / DIFF_BINS, row % DIFF_BINS, azimuth);
                geometry.light.push(Knot::at(cosines[0]));
                geometry.view.push(Knot::at(cosines[1]));
                geometry.scale.push((1.0 / (cosines[0] * cosines[1])) as f32);
            }
            geometry.starts.push(geometry.scale.len() as u32);
        }
        geometry
    }

    /// The bins of φ_d of a row's samples.
    fn azimuths(&self, row: usize) -> Vec<usize> {
        let is_included =
            |azimuth: &usize| grid::is_included(grid::cosines(row / DIFF_BINS, row % DIFF_BINS, *azimuth));
        (self.step / 2..FOLDED).step_by(self.step).filter(is_included).collect()
    }
}

impl Knot {
    fn at(cos: f64) -> Knot {
        let degrees = cos.acos().to_degrees();
        let low = (degrees as usize).min(MASKING_KNOTS - 2);
        Knot { low: low as u16, t: (degrees - low as f64).min(1.0) as f32 }
    }

    #[inline(always)]
    fn of(self, masking: &[f32; MASKING_KNOTS]) -> f32 {
        let low = usize::from(self.low);
        let (a, b) = (masking[low], masking[low + 1]);
        a + (b - a) * self.t
    }
}

/// One colour channel's samples, folded, in the order of [`Geometry`].
pub struct Folded {
    geometry: &'static Geometry,
    /// Σ w over both halves.
    weight: Vec<f32>,
    /// Σ w ρ* over both halves.
    value: Vec<f32>,
    pub fixed: FixedSums,
}

impl Folded {
    /// From samples and their weights on the whole grid.
    #[must_use]
    pub fn fine(values: &[f32], weights: &[f32]) -> Folded {
        Folded::new(&FINE, values, weights)
    }

    /// The same from every third φ_d.
    #[must_use]
    pub fn coarse(values: &[f32], weights: &[f32]) -> Folded {
        Folded::new(&COARSE, values, weights)
    }

    fn new(geometry: &'static Geometry, values: &[f32], weights: &[f32]) -> Folded {
        let samples = geometry.scale.len();
        let (mut weight, mut value) = (Vec::with_capacity(samples), Vec::with_capacity(samples));
        let mut fixed = FixedSums { weight: 0.0, value: 0.0, square: 0.0 };
        for row in 0..ROWS {
            let at = row * AZIMUTH_BINS;
            for azimuth in geometry.azimuths(row) {
                let both = [at + azimuth, at + AZIMUTH_BINS - 1 - azimuth];
                let w = both.map(|i| f64::from(weights[i]));
                let z = both.map(|i| f64::from(values[i]));
                let (sum, product) = (w[0] + w[1], w[0] * z[0] + w[1] * z[1]);
                weight.push(sum as f32);
                value.push(product as f32);
                fixed.weight += sum;
                fixed.value += product;
                fixed.square += w[0] * z[0] * z[0] + w[1] * z[1] * z[1];
            }
        }
        Folded { geometry, weight, value, fixed }
    }

    /// The sums over φ_d under `masking`.
    pub fn sum(&self, masking: &Masking, sums: &mut Sums) {
        sum_rows(self.geometry, self, &masking.map(|g| g as f32), sums);
    }

    /// The G that fits best while the G of the other direction stays `masking`, the mean over both
    /// directions. It is linear between its knots, so that its normal equations are tridiagonal.
    #[must_use]
    pub fn solve(&self, state: &State, masking: &Masking) -> Masking {
        let mut equations = Equations::default();
        accumulate(self.geometry, self, state, &masking.map(|g| g as f32), &mut equations);
        equations.solve(masking)
    }
}

dispatch! {
    fn sum_rows(_isa, geometry: &Geometry, folded: &Folded, masking: &[f32; MASKING_KNOTS], sums: &mut Sums) {
        let mut factor = [0.0f32; FOLDED];
        for row in 0..ROWS {
            let (start, end) = (geometry.starts[row] as usize, geometry.starts[row + 1] as usize);
            let (light, view) = (&geometry.light[start..end], &geometry.view[start..end]);
            let scale = &geometry.scale[start..end];
            let factor = &mut factor[..end - start];
            for i in 0..factor.len() {
                factor[i] = light[i].of(masking) * view[i].of(masking) * scale[i];
            }
            let (weight, value) = (&folded.weight[start..end], &folded.value[start..end]);
            let to = row / DIFF_BINS * STRIDE + row % DIFF_BINS;
            [sums.g[to], sums.gg[to], sums.gz[to]] = row_sums(factor, weight, value);
        }
    }
}

/// Σ w g, Σ w g² and Σ w g ρ*, in float64: the objective is a small difference of such sums.
#[inline(always)]
pub fn row_sums(factor: &[f32], weight: &[f32], value: &[f32]) -> [f64; 3] {
    const LANES: usize = 8;
    let mut lanes = [[0.0f64; LANES]; 3];
    let whole = factor.len() / LANES * LANES;
    let mut add = |i: usize, lane: usize| {
        let (g, w, z) = (f64::from(factor[i]), f64::from(weight[i]), f64::from(value[i]));
        lanes[0][lane] += w * g;
        lanes[1][lane] += w * g * g;
        lanes[2][lane] += z * g;
    };
    for at in (0..whole).step_by(LANES) {
        for lane in 0..LANES {
            add(at + lane, lane);
        }
    }
    for i in whole..factor.len() {
        add(i, 0);
    }
    lanes.map(|lanes| lanes.iter().sum())
}

/// Normal equations of the knots of G.
struct Equations {
    diagonal: [f64; MASKING_KNOTS],
    /// Between a knot and the next.
    beside: [f64; MASKING_KNOTS],
    right: [f64; MASKING_KNOTS],
}

impl Default for Equations {
    fn default() -> Self {
        let zero = [0.0; MASKING_KNOTS];
        Equations { diagonal: zero, beside: zero, right: zero }
    }
}

impl Equations {
    /// Adds w (z − y G)², where G stands at `knot`.
    #[inline(always)]
    fn add(&mut self, knot: Knot, wyy: f64, wyz: f64) {
        let (low, t) = (usize::from(knot.low), f64::from(knot.t));
        let (near, far) = (1.0 - t, t);
        self.diagonal[low] += wyy * near * near;
        self.beside[low] += wyy * near * far;
        self.diagonal[low + 1] += wyy * far * far;
        self.right[low] += wyz * near;
        self.right[low + 1] += wyz * far;
    }

    /// Thomas' algorithm. Knots that no sample sees keep their value.
    fn solve(mut self, before: &Masking) -> Masking {
        for i in 0..MASKING_KNOTS {
            if self.diagonal[i] <= 0.0 {
                (self.diagonal[i], self.right[i]) = (1.0, before[i]);
            }
        }
        for i in 1..MASKING_KNOTS {
            let factor = self.beside[i - 1] / self.diagonal[i - 1];
            self.diagonal[i] -= factor * self.beside[i - 1];
            self.right[i] -= factor * self.right[i - 1];
        }
        let mut masking = *before;
        for i in (0..MASKING_KNOTS).rev() {
            let next = if i + 1 < MASKING_KNOTS { self.beside[i] * masking[i + 1] } else { 0.0 };
            masking[i] = (self.right[i] - next) / self.diagonal[i];
        }
        masking
    }
}

dispatch! {
    fn accumulate(_isa, geometry: &Geometry, folded: &Folded, state: &State, masking: &[f32; MASKING_KNOTS], equations: &mut Equations) {
        for half in 0..HALF_BINS {
            for diff in 0..DIFF_BINS {
                let row = half * DIFF_BINS + diff;
                let product = state.specular * state.ndf[half] * state.fresnel[diff];
                for i in geometry.starts[row] as usize..geometry.starts[row + 1] as usize {
                    let (light, view) = (geometry.light[i], geometry.view[i]);
                    let p = product * f64::from(geometry.scale[i]);
                    let (weight, value) = (f64::from(folded.weight[i]), f64::from(folded.value[i]));
                    let (of_light, of_view) = (p * f64::from(view.of(masking)), p * f64::from(light.of(masking)));
                    let residual = value - weight * state.diffuse;
                    equations.add(light, weight * of_light * of_light, of_light * residual);
                    equations.add(view, weight * of_view * of_view, of_view * residual);
                }
            }
        }
    }
}

/// Gaussian smoothing (the paper, §4.3: it removes oscillations), with a deviation of one knot. The ends
/// see the knots that there are.
#[must_use]
pub fn smooth(masking: &Masking) -> Masking {
    const REACH: usize = 3;
    std::array::from_fn(|i| {
        let (mut sum, mut total) = (0.0, 0.0);
        for j in i.saturating_sub(REACH)..(i + REACH + 1).min(MASKING_KNOTS) {
            let weight = (-0.5 * (j as f64 - i as f64).powi(2)).exp();
            sum += weight * masking[j];
            total += weight;
        }
        sum / total
    })
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use crate::factor::grid::SAMPLES;
    use crate::factor::product::Floor;

    /// The sums do not depend on D, F, ρ_d and ρ_s; how much that saves is printed.
    #[test]
    fn steps_with_sums_formed_once_are_those_with_sums_formed_anew() {
        const STEPS: u32 = 20;
        let values: Vec<f32> = (0..SAMPLES).map(|i| 0.1 + 0.05 * (i as f32 * 1e-3).sin()).collect();
        let folded = Folded::fine(&values, &grid::weights(&values, &vec![1.0; values.len()]));
        let masking = [0.9; MASKING_KNOTS];
        let run = |anew: bool| {
            let (mut state, mut sums, mut objective) = (State::constant(), Sums::new(), 0.0);
            folded.sum(&masking, &mut sums);
            let start = Instant::now();
            for _ in 0..STEPS {
                if anew {
                    folded.sum(&masking, &mut sums);
                }
                objective = state.step(&sums, &folded.fixed, Floor::DYNAMIC_RANGE);
            }
            println!(
                "{:?} a step, sums formed {}",
                start.elapsed() / STEPS,
                if anew { "anew" } else { "once" }
            );
            objective
        };
        assert_eq!(run(false), run(true));
    }
}

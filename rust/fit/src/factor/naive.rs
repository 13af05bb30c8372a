//! The third factor of eq. 4: H(φ_d).

use glimt_core::dispatch;
use glimt_core::models::factor::{AZIMUTH_BINS, DIFF_BINS};

use super::grid::ROWS;
use super::masking::row_sums;
use super::product::{FixedSums, STRIDE, State, Sums};

/// H at the centres of the bins of φ_d.
pub type Azimuth = [f64; AZIMUTH_BINS];

/// One colour channel's samples on the whole grid.
pub struct Whole {
    weight: Vec<f32>,
    /// w ρ*.
    value: Vec<f32>,
    pub fixed: FixedSums,
}

impl Whole {
    #[must_use]
    pub fn new(values: &[f32], weights: &[f32]) -> Whole {
        let value: Vec<f32> = values.iter().zip(weights).map(|(&z, &w)| w * z).collect();
        let mut fixed = FixedSums { weight: 0.0, value: 0.0, square: 0.0 };
        for (&z, &w) in values.iter().zip(weights) {
            let (z, w) = (f64::from(z), f64::from(w));
            fixed.weight += w;
            fixed.value += w * z;
            fixed.square += w * z * z;
        }
        Whole { weight: weights.to_vec(), value, fixed }
    }

    /// The sums over φ_d under `azimuth`.
    pub fn sum(&self, azimuth: &Azimuth, sums: &mut Sums) {
        sum_rows(self, &azimuth.map(|h| h as f32), sums);
    }

    /// The H that fits best (eq. 14).
    #[must_use]
    pub fn solve(&self, state: &State, azimuth: &Azimuth) -> Azimuth {
        let mut fractions = [[0.0; AZIMUTH_BINS]; 2];
        accumulate(self, state, &mut fractions);
        std::array::from_fn(|i| {
            let [numerator, denominator] = [fractions[0][i], fractions[1][i]];
            if denominator > 0.0 { numerator / denominator } else { azimuth[i] }
        })
    }
}

dispatch! {
    fn sum_rows(_isa, whole: &Whole, azimuth: &[f32; AZIMUTH_BINS], sums: &mut Sums) {
        for row in 0..ROWS {
            let at = row * AZIMUTH_BINS;
            let (weight, value) = (&whole.weight[at..at + AZIMUTH_BINS], &whole.value[at..at + AZIMUTH_BINS]);
            let to = row / DIFF_BINS * STRIDE + row % DIFF_BINS;
            [sums.g[to], sums.gg[to], sums.gz[to]] = row_sums(azimuth, weight, value);
        }
    }
}

dispatch! {
    /// For every φ_d: Σ P (w ρ* − w ρ_d) and Σ P² w, with P = ρ_s D F.
    fn accumulate(_isa, whole: &Whole, state: &State, out: &mut [[f64; AZIMUTH_BINS]; 2]) {
        let [numerator, denominator] = out;
        for row in 0..ROWS {
            let at = row * AZIMUTH_BINS;
            let (weight, value) = (&whole.weight[at..at + AZIMUTH_BINS], &whole.value[at..at + AZIMUTH_BINS]);
            let product = state.specular * state.ndf[row / DIFF_BINS] * state.fresnel[row % DIFF_BINS];
            for i in 0..AZIMUTH_BINS {
                let (w, z) = (f64::from(weight[i]), f64::from(value[i]));
                numerator[i] += product * (z - w * state.diffuse);
                denominator[i] += product * product * w;
            }
        }
    }
}

//! The analytic BRDF as an objective: `glimt fit --model ggx`, and where every hybrid fit starts.

use glimt_core::dispatch;
use glimt_core::microfacet::Microfacet;
use glimt_core::simd::LANES;

use crate::analytic::{self, Derivatives};
use crate::backprop::{COLUMNS, Row, ZERO_ROW};
use crate::loss::Loss;
use crate::objective::Objective;
use crate::pairs::{PairBlock, TargetBlock};

/// Fits k_d, η and α alone.
#[derive(Clone, Copy, Debug)]
pub struct GgxObjective {
    /// What is minimised.
    pub loss: Loss,
    /// Whether α is one number.
    pub isotropic: bool,
}

/// f_a of a block and its derivatives, see [`Derivatives`].
pub struct AnalyticRows {
    /// f_a, [channel].
    pub value: [Row; 3],
    eta: [Row; 3],
    specular: [Row; 3],
    log_alpha: [Row; 2],
}

impl Default for AnalyticRows {
    fn default() -> Self {
        AnalyticRows {
            value: [ZERO_ROW; 3],
            eta: [ZERO_ROW; 3],
            specular: [ZERO_ROW; 3],
            log_alpha: [ZERO_ROW; 2],
        }
    }
}

/// The direction in one lane of a block.
#[inline(always)]
pub(crate) fn direction(rows: &[Row; 3], column: usize, lane: usize) -> [f32; 3] {
    [rows[0][column][lane], rows[1][column][lane], rows[2][column][lane]]
}

dispatch! {
    /// Evaluates `parameters` for a block.
    pub fn evaluate(_isa, parameters: &Microfacet, pairs: &PairBlock, rows: &mut AnalyticRows) {
        for column in 0..COLUMNS {
            for lane in 0..LANES {
                let light = direction(&pairs.light, column, lane);
                let view = direction(&pairs.view, column, lane);
                let d = Derivatives::new(parameters, light, view);
                for c in 0..3 {
                    rows.value[c][column][lane] = d.value[c];
                    rows.eta[c][column][lane] = d.eta[c];
                    rows.specular[c][column][lane] = d.specular[c];
                }
                rows.log_alpha[0][column][lane] = d.log_alpha[0];
                rows.log_alpha[1][column][lane] = d.log_alpha[1];
            }
        }
    }
}

impl AnalyticRows {
    /// Σ over the block of `delta` = ∂loss/∂f_a times ∂f_a/∂(k_d, η, α_x, α_y).
    #[must_use]
    pub fn sums(&self, delta: &[Row; 3]) -> [f64; 8] {
        let mut lanes = [[0.0; LANES]; 8];
        accumulate(self, delta, &mut lanes);
        lanes.map(|lanes| lanes.iter().map(|&x| f64::from(x)).sum())
    }
}

dispatch! {
    fn accumulate(_isa, rows: &AnalyticRows, delta: &[Row; 3], sums: &mut [[f32; LANES]; 8]) {
        for column in 0..COLUMNS {
            for lane in 0..LANES {
                let d = Derivatives {
                    value: [0.0; 3],
                    eta: [rows.eta[0][column][lane], rows.eta[1][column][lane], rows.eta[2][column][lane]],
                    log_alpha: [rows.log_alpha[0][column][lane], rows.log_alpha[1][column][lane]],
                    specular: [
                        rows.specular[0][column][lane],
                        rows.specular[1][column][lane],
                        rows.specular[2][column][lane],
                    ],
                };
                let mut one = [0.0; 8];
                d.accumulate([delta[0][column][lane], delta[1][column][lane], delta[2][column][lane]], &mut one);
                for (sums, one) in sums.iter_mut().zip(one) {
                    sums[lane] += one;
                }
            }
        }
    }
}

dispatch! {
    /// The weighted loss of `model` against `target`, summed into `total` by lanes, and its slopes.
    pub fn loss_rows(_isa, loss: Loss, pairs: &PairBlock, target: &TargetBlock, model: &[Row; 3], slopes: &mut [Row; 3], total: &mut [f32; LANES],
    ) {
        for c in 0..3 {
            for column in 0..COLUMNS {
                for lane in 0..LANES {
                    let weight = pairs.weight[column][lane];
                    let (value, slope) = loss.value_and_slope(
                        pairs.light[2][column][lane],
                        target[c][column][lane],
                        model[c][column][lane],
                    );
                    total[lane] += weight * value;
                    slopes[c][column][lane] = weight * slope;
                }
            }
        }
    }
}

/// Room for one block.
#[derive(Default)]
pub struct GgxWorkspace {
    rows: AnalyticRows,
    slopes: Option<Box<[Row; 3]>>,
}

impl Objective for GgxObjective {
    type Workspace = GgxWorkspace;

    fn shared_len(&self) -> usize {
        0
    }

    fn own_len(&self) -> usize {
        analytic::len(self.isotropic)
    }

    fn workspace(&self) -> GgxWorkspace {
        GgxWorkspace::default()
    }

    fn block(
        &self,
        workspace: &mut GgxWorkspace,
        _shared: &[f32],
        own: &[f32],
        pairs: &PairBlock,
        target: &TargetBlock,
        _shared_gradient: &mut [f32],
        own_gradient: &mut [f32],
    ) -> f64 {
        let rows = &mut workspace.rows;
        let slopes = workspace.slopes.get_or_insert_with(|| Box::new([ZERO_ROW; 3]));
        evaluate(&analytic::to_parameters(own), pairs, rows);
        let mut total = [0.0; LANES];
        loss_rows(self.loss, pairs, target, &rows.value, slopes, &mut total);
        analytic::add_gradient(own, &rows.sums(slopes), own_gradient);
        total.iter().map(|&x| f64::from(x)).sum()
    }
}

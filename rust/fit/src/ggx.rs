//! The analytic BRDF as an objective: `glimt fit --model ggx`, and where every hybrid fit starts.

use glimt_core::dispatch;
use glimt_core::microfacet::Microfacet;
use glimt_core::simd::{LANES, Lanes, Real, Vector};

use crate::analytic::{self, Derivatives};
use crate::backprop::{COLUMNS, Row, ZERO_ROW};
use crate::loss::Loss;
use crate::objective::Objective;
use crate::pairs::{PairBlock, TargetBlock, lanes};

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

/// The directions in one column of a block.
#[inline(always)]
pub(crate) fn column_of<I: Lanes<LANES>>(isa: I, rows: &[Row; 3], column: usize) -> [Vector<I, LANES>; 3] {
    Vector::load3(isa, &lanes(rows, column))
}

dispatch! {
    /// Evaluates `parameters` for a block.
    pub fn evaluate(isa, parameters: &Microfacet, pairs: &PairBlock, rows: &mut AnalyticRows) {
        for column in 0..COLUMNS {
            let (light, view) = (column_of(isa, &pairs.light, column), column_of(isa, &pairs.view, column));
            let d = Derivatives::new(parameters, light, view);
            for c in 0..3 {
                d.value[c].store(&mut rows.value[c][column]);
                d.eta[c].store(&mut rows.eta[c][column]);
                d.specular[c].store(&mut rows.specular[c][column]);
            }
            d.log_alpha[0].store(&mut rows.log_alpha[0][column]);
            d.log_alpha[1].store(&mut rows.log_alpha[1][column]);
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
    fn accumulate(isa, rows: &AnalyticRows, delta: &[Row; 3], sums: &mut [[f32; LANES]; 8]) {
        let mut total = [Vector::<I, LANES>::new(isa, 0.0); 8];
        for column in 0..COLUMNS {
            let log_alpha = [
                Vector::load(isa, &rows.log_alpha[0][column]),
                Vector::load(isa, &rows.log_alpha[1][column]),
            ];
            let d = Derivatives {
                value: column_of(isa, &rows.value, column),
                eta: column_of(isa, &rows.eta, column),
                log_alpha,
                specular: column_of(isa, &rows.specular, column),
            };
            d.accumulate(column_of(isa, delta, column), &mut total);
        }
        for i in 0..8 {
            total[i].store(&mut sums[i]);
        }
    }
}

dispatch! {
    /// The weighted loss of `model` against `target`, added to `total` by lanes, and its slopes.
    pub fn loss_rows(isa, loss: Loss, pairs: &PairBlock, target: &TargetBlock, model: &[Row; 3], slopes: &mut [Row; 3], total: &mut [f32; LANES],
    ) {
        let mut sum = Vector::<I, LANES>::load(isa, total);
        for column in 0..COLUMNS {
            let weight = Vector::<I, LANES>::load(isa, &pairs.weight[column]);
            let cos_light = Vector::load(isa, &pairs.light[2][column]);
            let (target, model) = (column_of(isa, target, column), column_of(isa, model, column));
            for c in 0..3 {
                let (value, slope) = loss.value_and_slope(cos_light, target[c], model[c]);
                sum = weight.fma(value, sum);
                (weight * slope).store(&mut slopes[c][column]);
            }
        }
        sum.store(total);
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

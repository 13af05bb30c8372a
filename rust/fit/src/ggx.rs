//! The analytic BRDF as an objective: `glimt fit --model ggx`, and where every hybrid fit starts.

use glimt_core::microfacet::Microfacet;
use glimt_core::models::ggx::Ggx;
use glimt_core::simd::{LANES, Lanes, Real, Vector};
use glimt_core::{Invalid, Material, dispatch};
use serde::{Deserialize, Serialize};

use crate::adamw::AdamW;
use crate::analytic::{self, Derivatives};
use crate::backprop::{COLUMNS, Row, ZERO_ROW};
use crate::error::Error;
use crate::fittable::Fittable;
use crate::gradient::Gradient;
use crate::input::Input;
use crate::judge::{Judge, best_of};
use crate::loss::Loss;
use crate::objective::Objective;
use crate::pairs::{PairBlock, TargetBlock, lanes};
use crate::train::{Schedule, Watch};
use crate::truth::Truth;

/// A fit of the analytic BRDF alone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct GgxOptions {
    /// Loss of f.
    pub loss: Loss,
}

/// It is over when it has started: the steps of the analytic fit are its own.
impl Fittable for GgxOptions {
    type Objective = GgxObjective;

    fn check(&self, _: &[Input]) -> Result<(), String> {
        Ok(())
    }

    fn objective(&self, isotropic: bool) -> Result<GgxObjective, String> {
        Ok(GgxObjective { loss: self.loss, isotropic })
    }

    fn start(
        &self,
        objective: &GgxObjective,
        truths: &[Truth],
        schedule: &Schedule,
        watch: &mut Watch,
    ) -> Result<Option<Vec<f32>>, Error> {
        Ok(objective.fit(truths, schedule, watch)?.map(|p| p.concat()))
    }

    fn steps(&self, _: &Schedule) -> u64 {
        0
    }

    fn finish(
        &self,
        objective: &GgxObjective,
        numbers: &[f32],
        _: &[Truth],
        _: &Judge,
    ) -> Result<Vec<Material>, Invalid> {
        let materials = numbers.chunks_exact(objective.own_len());
        materials.map(|p| Ggx::new(analytic::to_parameters(p)).map(Material::from)).collect()
    }
}

/// Roughnesses from which the analytic fit starts; the best end is kept.
const START_ALPHAS: [f32; 3] = [0.05, 0.2, 0.5];

impl GgxObjective {
    /// The unbounded numbers of the best fit of every material; `None` if it was stopped.
    pub(crate) fn fit(
        &self,
        truths: &[Truth],
        schedule: &Schedule,
        watch: &mut Watch,
    ) -> Result<Option<Vec<Vec<f32>>>, Error> {
        let starts = START_ALPHAS.map(|alpha| {
            let p = Microfacet { kd: [0.2; 3], eta: [1.5; 3], alpha: [alpha; 2] };
            analytic::from_parameters(&p, self.isotropic)
        });
        // Far fewer and longer steps than networks need.
        let standard = Schedule::standard(1500, schedule.seed);
        let own = Schedule {
            rate: 0.05,
            clip: f32::INFINITY,
            adamw: AdamW { beta2: 0.99, ..standard.adamw },
            drawing: schedule.drawing,
            ..standard
        };
        best_of(self, &[], truths, vec![starts.to_vec(); truths.len()], &own, watch)
    }
}

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
        gradient: &mut Gradient,
    ) -> f64 {
        let rows = &mut workspace.rows;
        let slopes = workspace.slopes.get_or_insert_with(|| Box::new([ZERO_ROW; 3]));
        evaluate(&analytic::to_parameters(own), pairs, rows);
        let mut total = [0.0; LANES];
        loss_rows(self.loss, pairs, target, &rows.value, slopes, &mut total);
        analytic::add_gradient(own, &rows.sums(slopes), &mut gradient.own);
        total.iter().map(|&x| f64::from(x)).sum()
    }
}

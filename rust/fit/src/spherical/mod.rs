//! The spherical model as an objective: a network, and tables of features for every material.
//!
//! Features are fitted as they are, and towards the end as what they will be kept as: rounded to the
//! integers of a store, or replaced by the primitives of a codebook (paper, §3.3). The derivatives then
//! pass the rounding or the choice unchanged ("straight through").

pub(crate) mod cluster;
mod codebook;
pub(crate) mod prune;
mod refine;
pub(crate) mod stages;
mod turn;

use glimt_core::dispatch;
use glimt_core::kernels::network::Activation;
use glimt_core::models::spherical::store::StoreKind;
use glimt_core::models::spherical::tables::{Layout, MAX_TABLES, Taps};
use glimt_core::models::spherical::{MAX_BOUND, OUTPUT_SCALE, from_output};
use glimt_core::simd::math::exp;
use glimt_core::simd::{LANES, Vector};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::backprop::{COLUMNS, Row, Shape, Workspace, ZERO_ROW, backward, forward};
use crate::ggx::loss_rows;
use crate::loss::Loss;
use crate::objective::Objective;
use crate::pairs::{PairBlock, TargetBlock, lanes};

/// What stands for a row's features in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// They themselves.
    Free,
    /// The nearest integers times the scale of the table's feature, at most this large. The derivatives
    /// pass the rounding unchanged ("straight through").
    Rounded(i8),
    /// The primitive that is chosen. The derivatives are the primitive's and, as if there were no choice, the
    /// features', by which the next choice is made.
    Choosing,
    /// The primitive that was chosen last. Only primitives move.
    Chosen,
}

/// Fits the network and the features together.
///
/// Shared numbers are the network's, then the scales of [`StoreKind::I8`] and [`StoreKind::I4`], [table][k], or
/// the codebook, [2ᵇ][k]. A material's own are its features, [row][k], and with a codebook the primitive
/// of each row, [row], as a whole number. Scales and choices have no derivatives, and so stay as they are
/// while the others move. Where there are fewer rows than `rows`, the last numbers stand for nothing.
#[derive(Clone, Debug)]
pub struct SphericalObjective<'a> {
    /// The tables.
    pub layout: &'a Layout,
    /// Rows of the finest tables that the fit will have, for which there is room.
    pub rows: usize,
    /// Sizes of the network.
    pub shape: Shape,
    /// What is minimised.
    pub loss: Loss,
    /// How features will be kept.
    pub store: StoreKind,
    /// What stands for the features.
    pub stage: Stage,
}

/// Room for one block.
pub struct SphericalWorkspace {
    network: Workspace,
    taps: Vec<[Taps<LANES>; MAX_TABLES]>,
    /// f, then ∂loss/∂f.
    model: [Row; 3],
    slopes: [Row; 3],
}

/// The numbers of one material, or their derivatives, by what they are.
struct Parts<Slice> {
    network: Slice,
    scales: Slice,
    codebook: Slice,
    features: Slice,
    choices: Slice,
}

impl Objective for SphericalObjective<'_> {
    type Workspace = Box<SphericalWorkspace>;

    fn shared_len(&self) -> usize {
        self.shape.len() + self.scales_len() + self.codebook_len()
    }

    fn own_len(&self) -> usize {
        self.rows * (self.features() + usize::from(self.codebook_len() > 0))
    }

    fn workspace(&self) -> Box<SphericalWorkspace> {
        Box::new(SphericalWorkspace {
            network: Workspace::new(&self.shape),
            taps: vec![[Taps::EMPTY; MAX_TABLES]; COLUMNS],
            model: [ZERO_ROW; 3],
            slopes: [ZERO_ROW; 3],
        })
    }

    fn block(
        &self,
        workspace: &mut Box<SphericalWorkspace>,
        shared: &[f32],
        own: &[f32],
        pairs: &PairBlock,
        target: &TargetBlock,
        shared_gradient: &mut [f32],
        own_gradient: &mut [f32],
    ) -> f64 {
        let parts = self.parts(shared, own);
        self.predict(workspace, &parts, pairs);
        let mut total = [0.0; LANES];
        loss_rows(self.loss, pairs, target, &workspace.model, &mut workspace.slopes, &mut total);
        dark_rows(self.loss.relative, pairs, target, &workspace.model, &mut workspace.slopes, &mut total);
        let (outputs, delta) = workspace.network.outputs_and_delta();
        differentiate(target, outputs, &workspace.slopes, delta);
        push_zeros(self.loss.relative, pairs, target, outputs, delta);
        let (network_gradient, rest) = shared_gradient.split_at_mut(self.shape.len());
        backward(&self.shape, parts.network, &mut workspace.network, network_gradient);
        let codebook_gradient = &mut rest[self.scales_len()..];
        let features_gradient = &mut own_gradient[..parts.features.len()];
        let delta = workspace.network.input_delta();
        scatter(self, &workspace.taps, &parts, delta, features_gradient, codebook_gradient);
        total.iter().map(|&x| f64::from(x)).sum()
    }

    fn decays(&self, _: usize) -> bool {
        false
    }
}

impl SphericalObjective<'_> {
    fn features(&self) -> usize {
        self.layout.form().features.into()
    }

    fn scales_len(&self) -> usize {
        if self.store.largest().is_some() { self.layout.form().inputs() } else { 0 }
    }

    fn codebook_len(&self) -> usize {
        match self.store {
            StoreKind::Codebook(bits) => self.features() << bits,
            _ => 0,
        }
    }

    /// The numbers of one material from the shared ones and its own.
    fn parts<'n>(&self, shared: &'n [f32], own: &'n [f32]) -> Parts<&'n [f32]> {
        let (network, rest) = shared.split_at(self.shape.len());
        let (scales, codebook) = rest.split_at(self.scales_len());
        let (features, choices) = own.split_at(self.rows * self.features());
        Parts { network, scales, codebook, features, choices }
    }

    /// Evaluates network and f for a block.
    fn predict(&self, workspace: &mut SphericalWorkspace, parts: &Parts<&[f32]>, pairs: &PairBlock) {
        find(self.layout, pairs, &mut workspace.taps);
        let inputs = &mut workspace.network.values[0];
        gather(self, &workspace.taps, parts, inputs);
        forward(&self.shape, parts.network, &mut workspace.network);
        compose(workspace.network.outputs(), &mut workspace.model);
    }

    /// The largest network output over the given blocks.
    #[must_use]
    pub fn largest_output(&self, shared: &[f32], own: &[f32], pairs: &[PairBlock]) -> f32 {
        let mut workspace = self.workspace();
        let mut largest = f32::MIN;
        for pairs in pairs {
            self.predict(&mut workspace, &self.parts(shared, own), pairs);
            largest = workspace.network.outputs().iter().flatten().flatten().fold(largest, |a, &b| a.max(b));
        }
        largest.min(MAX_BOUND)
    }

    /// First numbers of the network and of `materials`: weights uniform in ±1/√inputs (PyTorch's default),
    /// and features that change slowly from row to row. Random features would leave the network
    /// nothing to go by: a fit from them ends three times worse.
    #[must_use]
    pub fn initial(&self, seed: u64, materials: usize) -> Vec<f32> {
        // y of a dull grey.
        const FIRST_OUTPUT: f32 = 3.0;
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut symmetric = || 2.0 * rng.random::<f32>() - 1.0;
        let mut numbers = Vec::new();
        for layer in 0..self.shape.layers() {
            let (inputs, outputs) = self.shape.layer(layer);
            let bound = 1.0 / (inputs as f32).sqrt();
            numbers.extend((0..(inputs + 1) * outputs).map(|_| bound * symmetric()));
        }
        let (_, bias) = self.shape.split_mut(&mut numbers, self.shape.layers() - 1);
        bias.iter_mut().for_each(|bias| *bias += FIRST_OUTPUT);
        numbers.resize(self.shared_len(), 0.0);
        for _ in 0..materials {
            let own = numbers.len() + self.own_len();
            // A plane over each table for each feature.
            let planes: Vec<[f32; 4]> =
                (0..self.shape.inputs()).map(|_| std::array::from_fn(|_| symmetric())).collect();
            for &(table, place) in self.layout.places() {
                let place = place.as_vec3();
                let planes = &planes[table * self.features()..][..self.features()];
                numbers.extend(
                    planes.iter().map(|[x, y, z, c]| x * place.x + y * place.y + z * place.z + 0.5 * c),
                );
            }
            numbers.resize(own, 0.0);
        }
        numbers
    }

    /// The activation between the layers of networks that are fitted.
    pub const ACTIVATION: Activation = Activation::HardGelu;
}

dispatch! {
    fn find(isa, layout: &Layout, pairs: &PairBlock, taps: &mut [[Taps<LANES>; MAX_TABLES]]) {
        for (column, taps) in taps.iter_mut().enumerate() {
            let [light, view] = [&pairs.light, &pairs.view].map(|rows| lanes(rows, column));
            layout.taps(isa, Vector::load3(isa, &light), Vector::load3(isa, &view), taps);
        }
    }
}

dispatch! {
    /// The features of a block's pairs, `inputs[feature]`.
    fn gather(
        _isa,
        objective: &SphericalObjective,
        taps: &[[Taps<LANES>; MAX_TABLES]],
        parts: &Parts<&[f32]>,
        inputs: &mut [Row],
    ) {
        match objective.features() {
            4 => gather_rows::<4>(objective, taps, parts, inputs),
            8 => gather_rows::<8>(objective, taps, parts, inputs),
            _ => gather_rows::<16>(objective, taps, parts, inputs),
        }
    }
}

#[inline(always)]
fn gather_rows<const K: usize>(
    objective: &SphericalObjective,
    taps: &[[Taps<LANES>; MAX_TABLES]],
    parts: &Parts<&[f32]>,
    inputs: &mut [Row],
) {
    let rows = objective.layout.rows();
    let (features, _) = parts.features.as_chunks::<K>();
    for (table, inputs) in inputs.chunks_exact_mut(K).enumerate() {
        let count = objective.layout.tap_count(table);
        for (column, taps) in taps.iter().enumerate() {
            let taps = &taps[table];
            for lane in 0..LANES {
                let mut sum = [0.0; K];
                for tap in 0..count {
                    let row = rows[taps.points[tap][lane] as usize] as usize;
                    let feature = match objective.stage {
                        Stage::Free => features[row],
                        Stage::Rounded(largest) => {
                            let (scales, _) = parts.scales.as_chunks::<K>();
                            rounded(&features[row], &scales[table], largest.into())
                        }
                        Stage::Choosing | Stage::Chosen => primitive(parts, row),
                    };
                    let weight = taps.weights[tap][lane];
                    for j in 0..K {
                        sum[j] += weight * feature[j];
                    }
                }
                for j in 0..K {
                    inputs[j][column][lane] = sum[j];
                }
            }
        }
    }
}

dispatch! {
    /// Adds the derivatives of a block's features to those of the rows and primitives that they were made
    /// of.
    fn scatter(
        _isa,
        objective: &SphericalObjective,
        taps: &[[Taps<LANES>; MAX_TABLES]],
        parts: &Parts<&[f32]>,
        delta: &[Row],
        features_gradient: &mut [f32],
        codebook_gradient: &mut [f32],
    ) {
        match objective.features() {
            4 => scatter_rows::<4>(objective, taps, parts, delta, features_gradient, codebook_gradient),
            8 => scatter_rows::<8>(objective, taps, parts, delta, features_gradient, codebook_gradient),
            _ => scatter_rows::<16>(objective, taps, parts, delta, features_gradient, codebook_gradient),
        }
    }
}

#[inline(always)]
fn scatter_rows<const K: usize>(
    objective: &SphericalObjective,
    taps: &[[Taps<LANES>; MAX_TABLES]],
    parts: &Parts<&[f32]>,
    delta: &[Row],
    features_gradient: &mut [f32],
    codebook_gradient: &mut [f32],
) {
    let rows = objective.layout.rows();
    let (features_gradient, _) = features_gradient.as_chunks_mut::<K>();
    let (codebook_gradient, _) = codebook_gradient.as_chunks_mut::<K>();
    for (table, delta) in delta.chunks_exact(K).enumerate() {
        let count = objective.layout.tap_count(table);
        for (column, taps) in taps.iter().enumerate() {
            let taps = &taps[table];
            for lane in 0..LANES {
                let mut by_feature = [0.0; K];
                for j in 0..K {
                    by_feature[j] = delta[j][column][lane];
                }
                for tap in 0..count {
                    let row = rows[taps.points[tap][lane] as usize] as usize;
                    let weight = taps.weights[tap][lane];
                    if objective.stage != Stage::Chosen {
                        add_scaled(&mut features_gradient[row], weight, &by_feature);
                    }
                    if matches!(objective.stage, Stage::Choosing | Stage::Chosen) {
                        let chosen = parts.choices[row] as usize;
                        add_scaled(&mut codebook_gradient[chosen], weight, &by_feature);
                    }
                }
            }
        }
    }
}

/// sum += weight · x.
#[inline(always)]
fn add_scaled<const K: usize>(sum: &mut [f32; K], weight: f32, x: &[f32; K]) {
    for j in 0..K {
        sum[j] += weight * x[j];
    }
}

#[inline(always)]
fn rounded<const K: usize>(features: &[f32; K], scales: &[f32; K], largest: f32) -> [f32; K] {
    let mut rounded = [0.0; K];
    for j in 0..K {
        rounded[j] = (features[j] / scales[j]).round().clamp(-largest, largest) * scales[j];
    }
    rounded
}

/// The primitive that stands for a row.
#[inline(always)]
fn primitive<const K: usize>(parts: &Parts<&[f32]>, row: usize) -> [f32; K] {
    parts.codebook.as_chunks::<K>().0[parts.choices[row] as usize]
}

dispatch! {
    fn compose(_isa, outputs: &[Row], model: &mut [Row; 3]) {
        for (model, y) in model.iter_mut().zip(outputs) {
            for (model, y) in model.iter_mut().zip(y) {
                for lane in 0..LANES {
                    model[lane] = from_output(y[lane], MAX_BOUND);
                }
            }
        }
    }
}

/// Values below this are dark in any measurement.
const DARK: f32 = 1e-5;

dispatch! {
    /// Adds `weight` times 2|f̂ − f|/(f̂ + f + [`DARK`]) of every pair to the loss and its slopes. [`Loss`] has
    /// such a term that ends at ten times as much, which is enough where a model cannot follow the
    /// darkest values anyway. This one can, and a third of some measurements is that dark.
    fn dark_rows(
        _isa,
        weight: f32,
        pairs: &PairBlock,
        target: &TargetBlock,
        model: &[Row; 3],
        slopes: &mut [Row; 3],
        total: &mut [f32; LANES],
    ) {
        for c in 0..3 {
            for column in 0..COLUMNS {
                for lane in 0..LANES {
                    let (f, model) = (target[c][column][lane], model[c][column][lane]);
                    let weight = 2.0 * weight * pairs.weight[column][lane];
                    let sum = model + f + DARK;
                    let difference = (model - f).abs();
                    let sign = if model > f { 1.0 } else { -1.0 };
                    total[lane] += weight * difference / sum;
                    slopes[c][column][lane] += weight * (sign * sum - difference) / (sum * sum);
                }
            }
        }
    }
}

dispatch! {
    /// ∂loss/∂y from ∂loss/∂f. Where y < 0, f stays 0, and only what would raise it counts; nothing, if it is to
    /// be 0: the slope at a kink is that of one of its sides, and here the wrong one.
    fn differentiate(
        _isa,
        target: &TargetBlock,
        outputs: &[Row],
        slopes: &[Row; 3],
        delta: &mut [Row],
    ) {
        for c in 0..3 {
            for column in 0..COLUMNS {
                for lane in 0..LANES {
                    let (y, slope) = (outputs[c][column][lane], slopes[c][column][lane]);
                    let by_y = slope * OUTPUT_SCALE * exp(y.min(MAX_BOUND));
                    let raised = if target[c][column][lane] == 0.0 { 0.0 } else { by_y.min(0.0) };
                    delta[c][column][lane] = if y < 0.0 { raised } else { by_y };
                }
            }
        }
    }
}

/// How far below 0 the output is pushed where a measurement is 0, as it is where noise made it negative: a
/// thousandth of a dull grey. Pushed to 0 alone, the output strays above it between the pairs of the fit, and a
/// value of 1e-6 instead of 0 has the largest relative error that there is.
const ZERO_MARGIN: f32 = 0.01;
/// Strength of the push, in units of the relative term's weight.
const ZERO_PUSH: f32 = 5.0;

dispatch! {
    /// Adds the push where a measurement is 0 to ∂loss/∂y.
    fn push_zeros(
        _isa,
        weight: f32,
        pairs: &PairBlock,
        target: &TargetBlock,
        outputs: &[Row],
        delta: &mut [Row],
    ) {
        for c in 0..3 {
            for column in 0..COLUMNS {
                for lane in 0..LANES {
                    let strays = target[c][column][lane] == 0.0 && outputs[c][column][lane] > -ZERO_MARGIN;
                    let push = if strays { ZERO_PUSH * weight } else { 0.0 };
                    delta[c][column][lane] += push * pairs.weight[column][lane];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;

//! The hybrid model as an objective: one network, and p and z for every material (paper, eq. 4).

use glimt_core::dispatch;
use glimt_core::features::{Inputs, MAX_FEATURES};
use glimt_core::hybrid::{Composition, Form};
use glimt_core::math::exp;
use glimt_core::microfacet::Microfacet;
use glimt_core::simd::LANES;

use crate::analytic;
use crate::backprop::{COLUMNS, Row, Shape, Workspace, ZERO_ROW, backward, forward, sum_row};
use crate::ggx::{AnalyticRows, direction, evaluate, loss_rows};
use crate::loss::Loss;
use crate::objective::Objective;
use crate::pairs::{PairBlock, TargetBlock, lanes};

/// Fits network, z and p together.
#[derive(Clone, Debug)]
pub struct HybridObjective {
    /// What the network is given and what its outputs mean.
    pub form: Form,
    /// Sizes of the network.
    pub shape: Shape,
    /// Length of z.
    pub latent: usize,
    /// Whether α is one number.
    pub isotropic: bool,
    /// Loss of f, the paper's L_t.
    pub loss: Loss,
    /// Loss of f_a alone, the paper's L_a; `None` for its ablation without this term.
    pub analytic_loss: Option<Loss>,
    /// Whether L_t moves p too, as in the paper. Otherwise p follows L_a alone, and the analytic
    /// part is as good an approximation as it can be.
    pub joint: bool,
}

/// Room for one block.
pub struct HybridWorkspace {
    network: Workspace,
    analytic: AnalyticRows,
    /// f, then ∂loss/∂f.
    model: [Row; 3],
    slopes: [Row; 3],
    /// ∂loss/∂f_a.
    analytic_slopes: [Row; 3],
}

impl Objective for HybridObjective {
    type Workspace = Box<HybridWorkspace>;

    fn shared_len(&self) -> usize {
        self.shape.len()
    }

    fn own_len(&self) -> usize {
        analytic::len(self.isotropic) + self.latent
    }

    fn workspace(&self) -> Box<HybridWorkspace> {
        Box::new(HybridWorkspace {
            network: Workspace::new(&self.shape),
            analytic: AnalyticRows::default(),
            model: [ZERO_ROW; 3],
            slopes: [ZERO_ROW; 3],
            analytic_slopes: [ZERO_ROW; 3],
        })
    }

    fn block(
        &self,
        workspace: &mut Box<HybridWorkspace>,
        shared: &[f32],
        own: &[f32],
        pairs: &PairBlock,
        target: &TargetBlock,
        shared_gradient: &mut [f32],
        own_gradient: &mut [f32],
    ) -> f64 {
        let workspace = &mut **workspace;
        let (p, z) = own.split_at(analytic::len(self.isotropic));
        let parameters = analytic::to_parameters(p);
        self.predict(workspace, shared, &parameters, z, pairs);

        let mut total = [0.0; LANES];
        match self.analytic_loss {
            None => workspace.analytic_slopes = [ZERO_ROW; 3],
            Some(loss) => {
                let slopes = &mut workspace.analytic_slopes;
                loss_rows(loss, pairs, target, &workspace.analytic.value, slopes, &mut total);
            }
        }
        loss_rows(self.loss, pairs, target, &workspace.model, &mut workspace.slopes, &mut total);
        differentiate(self.form.composition, self.joint, workspace);
        backward(&self.shape, shared, &mut workspace.network, shared_gradient);

        let features = self.form.features();
        let (p_gradient, z_gradient) = own_gradient.split_at_mut(p.len());
        let input_delta = workspace.network.input_delta();
        for (gradient, delta) in z_gradient.iter_mut().zip(&input_delta[features..]) {
            *gradient += sum_row(delta);
        }
        let mut alpha_sums = [0.0; 2];
        if self.joint {
            if let Some(lobe) = self.form.inputs.lobe_feature() {
                alpha_sums = lobe_sums(&parameters, pairs, &input_delta[lobe]);
            }
            if self.form.analytic_input {
                let inputs = &input_delta[self.form.inputs.count()..features];
                for (slopes, (delta, value)) in
                    workspace.analytic_slopes.iter_mut().zip(inputs.iter().zip(&workspace.analytic.value))
                {
                    for (slope, (delta, value)) in
                        slopes.iter_mut().flatten().zip(delta.iter().flatten().zip(value.iter().flatten()))
                    {
                        *slope += delta * Form::analytic_feature_derivative(*value);
                    }
                }
            }
        }
        let mut sums = workspace.analytic.sums(&workspace.analytic_slopes);
        sums[6] += alpha_sums[0];
        sums[7] += alpha_sums[1];
        analytic::add_gradient(p, &sums, p_gradient);
        total.iter().map(|&x| f64::from(x)).sum()
    }
}

impl HybridObjective {
    /// Evaluates f_a, the network and f for a block.
    fn predict(
        &self,
        workspace: &mut HybridWorkspace,
        shared: &[f32],
        parameters: &Microfacet,
        z: &[f32],
        pairs: &PairBlock,
    ) {
        evaluate(parameters, pairs, &mut workspace.analytic);
        let inputs = &mut workspace.network.values[0];
        fill_features(self.form, parameters.alpha, pairs, &workspace.analytic.value, inputs);
        for (row, &z) in inputs[self.form.features()..].iter_mut().zip(z) {
            *row = [[z; LANES]; COLUMNS];
        }
        forward(&self.shape, shared, &mut workspace.network);
        compose(self.form.composition, workspace);
    }

    /// The largest a (the network's first three outputs) over the given blocks.
    #[must_use]
    pub fn largest_residual(&self, shared: &[f32], own: &[f32], pairs: &[PairBlock]) -> f32 {
        let (p, z) = own.split_at(analytic::len(self.isotropic));
        let parameters = analytic::to_parameters(p);
        let mut workspace = self.workspace();
        let mut largest = f32::MIN;
        for pairs in pairs {
            self.predict(&mut workspace, shared, &parameters, z, pairs);
            let outputs = &workspace.network.outputs()[..3];
            largest = outputs.iter().flatten().flatten().fold(largest, |a, &b| a.max(b));
        }
        largest.min(MAX_RESIDUAL)
    }
}

/// Where training stops following exp a: far above any measured lobe, far below overflow.
const MAX_RESIDUAL: f32 = 16.0;

dispatch! {
    fn fill_features(_isa, form: Form, alpha: [f32; 2], pairs: &PairBlock, analytic: &[Row; 3], inputs: &mut [Row]) {
        let mut x = [[0.0; LANES]; MAX_FEATURES + 3];
        for column in 0..COLUMNS {
            let (light, view) = (lanes(&pairs.light, column), lanes(&pairs.view, column));
            form.features_lanes(alpha, &light, &view, &lanes(analytic, column), &mut x);
            for (row, x) in inputs.iter_mut().zip(&x[..form.features()]) {
                row[column] = *x;
            }
        }
    }
}

/// f from f_a and the network's outputs.
fn compose(composition: Composition, workspace: &mut HybridWorkspace) {
    compose_rows(composition, &workspace.analytic.value, workspace.network.outputs(), &mut workspace.model);
}

dispatch! {
    fn compose_rows(_isa, composition: Composition, analytic: &[Row; 3], outputs: &[Row], model: &mut [Row; 3]) {
        for c in 0..3 {
            for column in 0..COLUMNS {
                for lane in 0..LANES {
                    let a = outputs[c][column][lane];
                    let b = outputs[(c + 3).min(outputs.len() - 1)][column][lane];
                    model[c][column][lane] = composition.compose(a, b, analytic[c][column][lane], MAX_RESIDUAL);
                }
            }
        }
    }
}

/// From ∂loss/∂f: ∂loss/∂outputs, and what L_t adds to ∂loss/∂f_a.
fn differentiate(composition: Composition, joint: bool, workspace: &mut HybridWorkspace) {
    let outputs: Vec<Row> = workspace.network.outputs().to_vec();
    differentiate_rows(
        composition,
        joint,
        &workspace.analytic.value,
        &outputs,
        &workspace.slopes,
        &mut workspace.analytic_slopes,
        workspace.network.output_delta(),
    );
}

dispatch! {
    fn differentiate_rows(_isa, composition: Composition, joint: bool, analytic: &[Row; 3], outputs: &[Row], slopes: &[Row; 3],
        analytic_slopes: &mut [Row; 3], delta: &mut [Row],
    ) {
        let joint = if joint { 1.0 } else { 0.0 };
        for c in 0..3 {
            for column in 0..COLUMNS {
                for lane in 0..LANES {
                    let slope = slopes[c][column][lane];
                    let f_a = analytic[c][column][lane];
                    let a = outputs[c][column][lane];
                    let exp_a = exp(a.min(MAX_RESIDUAL));
                    let (by_a, by_analytic) = match composition {
                        Composition::GatedResidual => {
                            let gate = 1.0 / (1.0 + exp(-outputs[c + 3][column][lane]));
                            delta[c + 3][column][lane] = slope * gate * (1.0 - gate) * f_a;
                            (exp_a, gate)
                        }
                        Composition::Additive => {
                            let inside = if f_a + a > 0.0 { 1.0 } else { 0.0 };
                            (inside, inside)
                        }
                        Composition::LogMultiplicative => (f_a * exp_a, exp_a),
                    };
                    delta[c][column][lane] = slope * by_a;
                    analytic_slopes[c][column][lane] += joint * slope * by_analytic;
                }
            }
        }
    }
}

/// Σ over the block of ∂loss/∂(lobe feature) times its derivatives by α_x and α_y.
fn lobe_sums(parameters: &Microfacet, pairs: &PairBlock, delta: &Row) -> [f64; 2] {
    let mut sums = [0.0; 2];
    for (column, delta) in delta.iter().enumerate() {
        for (lane, &delta) in delta.iter().enumerate() {
            let light = direction(&pairs.light, column, lane);
            let view = direction(&pairs.view, column, lane);
            let slopes = Inputs::lobe_derivative(light, view, parameters.alpha);
            sums[0] += f64::from(delta * slopes[0]);
            sums[1] += f64::from(delta * slopes[1]);
        }
    }
    sums
}

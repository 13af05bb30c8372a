//! The hybrid model as an objective: one network, and p and z for every material (paper, eq. 4).

use glimt_core::directions::features::Inputs;
use glimt_core::dispatch;
use glimt_core::microfacet::{Half, Microfacet};
use glimt_core::models::hybrid::{Composition, Form};
use glimt_core::simd::math::{exp, sigmoid};
use glimt_core::simd::{LANES, Real, Vector};
use serde::{Deserialize, Serialize};

use crate::analytic;
use crate::backprop::{COLUMNS, Row, Shape, Workspace, ZERO_ROW, backward, forward, sum_row};
use crate::ggx::{AnalyticRows, column_of, evaluate, loss_rows};
use crate::loss::Loss;
use crate::objective::Objective;
use crate::pairs::{PairBlock, TargetBlock};

/// Who has a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sharing {
    /// The materials of a library share one.
    Library,
    /// Every material has one of its own.
    Material,
}

/// Fits network, z and p together.
///
/// The numbers of a material are its network's where it has one of its own, then p, then z.
#[derive(Clone, Debug)]
pub struct HybridObjective {
    /// Who has a network.
    pub sharing: Sharing,
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
        match self.sharing {
            Sharing::Library => self.shape.len(),
            Sharing::Material => 0,
        }
    }

    fn own_len(&self) -> usize {
        self.shape.len() - self.shared_len() + analytic::len(self.isotropic) + self.latent
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
        let Numbers { network, p, z } = self.split(shared, own);
        let parameters = analytic::to_parameters(p);
        self.predict(workspace, network, &parameters, z, pairs);

        let mut total = [0.0; LANES];
        match self.analytic_loss {
            None => workspace.analytic_slopes = [ZERO_ROW; 3],
            Some(loss) => {
                let slopes = &mut workspace.analytic_slopes;
                loss_rows(loss, pairs, target, &workspace.analytic.value, slopes, &mut total);
            }
        }
        loss_rows(self.loss, pairs, target, &workspace.model, &mut workspace.slopes, &mut total);
        differentiate(self, workspace);
        let (network_gradient, own_gradient) = match self.sharing {
            Sharing::Library => (shared_gradient, own_gradient),
            Sharing::Material => own_gradient.split_at_mut(network.len()),
        };
        backward(&self.shape, network, &mut workspace.network, network_gradient);

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

/// The numbers that make one material.
#[derive(Clone, Copy, Debug)]
pub struct Numbers<'a> {
    /// The network's.
    pub network: &'a [f32],
    /// The analytic BRDF's, see [`analytic`].
    pub p: &'a [f32],
    /// The latent code.
    pub z: &'a [f32],
}

impl HybridObjective {
    /// The numbers of one material from the shared ones and its own.
    #[must_use]
    pub fn split<'a>(&self, shared: &'a [f32], own: &'a [f32]) -> Numbers<'a> {
        let (network, own) = match self.sharing {
            Sharing::Library => (shared, own),
            Sharing::Material => own.split_at(self.shape.len()),
        };
        let (p, z) = own.split_at(analytic::len(self.isotropic));
        Numbers { network, p, z }
    }

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
        let Numbers { network, p, z } = self.split(shared, own);
        let parameters = analytic::to_parameters(p);
        let mut workspace = self.workspace();
        let mut largest = f32::MIN;
        for pairs in pairs {
            self.predict(&mut workspace, network, &parameters, z, pairs);
            let outputs = &workspace.network.outputs()[..3];
            largest = outputs.iter().flatten().flatten().fold(largest, |a, &b| a.max(b));
        }
        largest.min(MAX_RESIDUAL)
    }
}

/// Where training stops following exp a: far above any measured lobe, far below overflow.
const MAX_RESIDUAL: f32 = 16.0;

dispatch! {
    fn fill_features(isa, form: Form, alpha: [f32; 2], pairs: &PairBlock, analytic: &[Row; 3], inputs: &mut [Row]) {
        for column in 0..COLUMNS {
            let (light, view) = (column_of(isa, &pairs.light, column), column_of(isa, &pairs.view, column));
            let x = form.inputs.compute(light, view, alpha);
            let count = form.inputs.count();
            for i in 0..count {
                x[i].store(&mut inputs[i][column]);
            }
            if form.analytic_input {
                let f = column_of(isa, analytic, column);
                for c in 0..3 {
                    Form::analytic_feature(f[c]).store(&mut inputs[count + c][column]);
                }
            }
        }
    }
}

/// f from f_a and the network's outputs.
fn compose(composition: Composition, workspace: &mut HybridWorkspace) {
    compose_rows(composition, &workspace.analytic.value, workspace.network.outputs(), &mut workspace.model);
}

dispatch! {
    fn compose_rows(isa, composition: Composition, analytic: &[Row; 3], outputs: &[Row], model: &mut [Row; 3]) {
        // A composition of three outputs has no b.
        let second = outputs.len() - 3;
        for column in 0..COLUMNS {
            let f_a = column_of(isa, analytic, column);
            for c in 0..3 {
                let a = Vector::load(isa, &outputs[c][column]);
                let b = Vector::load(isa, &outputs[c + second][column]);
                composition.compose(a, b, f_a[c], a.splat(MAX_RESIDUAL)).store(&mut model[c][column]);
            }
        }
    }
}

/// From ∂loss/∂f: ∂loss/∂outputs, and what L_t adds to ∂loss/∂f_a.
fn differentiate(objective: &HybridObjective, workspace: &mut HybridWorkspace) {
    let (outputs, delta) = workspace.network.outputs_and_delta();
    let analytic_slopes = &mut workspace.analytic_slopes;
    differentiate_rows(
        objective,
        &workspace.analytic.value,
        outputs,
        &workspace.slopes,
        analytic_slopes,
        delta,
    );
}

dispatch! {
    fn differentiate_rows(isa, objective: &HybridObjective, analytic: &[Row; 3], outputs: &[Row], slopes: &[Row; 3],
        analytic_slopes: &mut [Row; 3], delta: &mut [Row],
    ) {
        let one = Vector::<I, LANES>::new(isa, 1.0);
        for column in 0..COLUMNS {
            let (f_a, slope) = (column_of(isa, analytic, column), column_of(isa, slopes, column));
            for c in 0..3 {
                let a = Vector::load(isa, &outputs[c][column]);
                let (by_a, by_analytic) = match objective.form.composition {
                    Composition::GatedResidual => {
                        let gate = sigmoid(Vector::load(isa, &outputs[c + 3][column]));
                        (slope[c] * gate * (one - gate) * f_a[c]).store(&mut delta[c + 3][column]);
                        (exp(a.at_most(MAX_RESIDUAL)), gate)
                    }
                    Composition::Additive => {
                        let zero = one.splat(0.0);
                        let inside = Real::select(zero.lt(f_a[c] + a), one, zero);
                        (inside, inside)
                    }
                    Composition::LogMultiplicative => {
                        let exp_a = exp(a.at_most(MAX_RESIDUAL));
                        (f_a[c] * exp_a, exp_a)
                    }
                };
                (slope[c] * by_a).store(&mut delta[c][column]);
                if objective.joint {
                    let before = Vector::load(isa, &analytic_slopes[c][column]);
                    slope[c].fma(by_analytic, before).store(&mut analytic_slopes[c][column]);
                }
            }
        }
    }
}

/// Σ over the block of ∂loss/∂(lobe feature) times its derivatives by α_x and α_y.
fn lobe_sums(parameters: &Microfacet, pairs: &PairBlock, delta: &Row) -> [f64; 2] {
    let mut lanes = [[0.0; LANES]; 2];
    lobe_lanes(parameters.alpha, pairs, delta, &mut lanes);
    lanes.map(|lanes| lanes.iter().map(|&x| f64::from(x)).sum())
}

dispatch! {
    fn lobe_lanes(isa, alpha: [f32; 2], pairs: &PairBlock, delta: &Row, sums: &mut [[f32; LANES]; 2]) {
        let mut total = [Vector::<I, LANES>::new(isa, 0.0); 2];
        for column in 0..COLUMNS {
            let half = Half::new(column_of(isa, &pairs.light, column), column_of(isa, &pairs.view, column));
            let slopes = Inputs::lobe_derivative(&half, alpha);
            let delta = Vector::load(isa, &delta[column]);
            for axis in 0..2 {
                total[axis] = delta.fma(slopes[axis], total[axis]);
            }
        }
        for axis in 0..2 {
            total[axis].store(&mut sums[axis]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pairs::{self, Drawing};
    use glam::Vec3;
    use glimt_core::kernels::network::Activation;
    use glimt_core::{Brdf, is_lit};

    /// A lobe about the mirror direction over a base, different in every channel.
    struct Target;

    impl Brdf for Target {
        fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
            if !is_lit(light, view) {
                return Vec3::ZERO;
            }
            let h = (light + view).normalize();
            let lobe = (-((h.x / 0.3).powi(2) + (h.y / 0.4).powi(2))).exp();
            Vec3::new(0.1, 0.2, 0.05) + lobe * Vec3::new(2.0, 1.0, 1.5) * (1.5 - view.z)
        }
    }

    fn pattern(n: usize, scale: f32) -> Vec<f32> {
        (0..n).map(|i| ((i as f32 * 12.9898).sin() * 43_758.547).fract() * scale).collect()
    }

    /// Every kind of number, in every form of the model: p by way of L_a, of the gate, of the lobe
    /// feature and of the analytic input; weights, biases and z.
    #[test]
    fn gradient_is_the_finite_difference_for_every_kind_of_number() {
        // Small weights and squares: no kink of an activation or of an absolute value is near.
        let squared = Loss { absolute: 0.0, squared: 1.0, relative: 0.0 };
        let forms = [
            (Inputs::Cartesian, false, Composition::GatedResidual, true, false),
            (Inputs::Isotropic, false, Composition::GatedResidual, true, true),
            (Inputs::Isotropic, true, Composition::GatedResidual, true, true),
            (Inputs::Anisotropic, true, Composition::GatedResidual, true, false),
            (Inputs::Anisotropic, false, Composition::Additive, true, false),
            (Inputs::AnisotropicReciprocal, false, Composition::LogMultiplicative, true, false),
            (Inputs::IsotropicReciprocal, false, Composition::GatedResidual, false, true),
        ];
        for (inputs, analytic_input, composition, joint, isotropic) in forms {
            for sharing in [Sharing::Library, Sharing::Material] {
                let form = Form { inputs, analytic_input, composition };
                let shape =
                    Shape::new(form.features() + 4, &[16, 16], composition.outputs(), Activation::HardGelu);
                let objective = HybridObjective {
                    sharing,
                    form,
                    shape: shape.clone(),
                    latent: 4,
                    isotropic,
                    loss: squared,
                    analytic_loss: Some(Loss { squared: 0.5, ..squared }),
                    joint,
                };
                let pairs = &pairs::draw(Drawing::Lobes, 3, 1, 1)[0];
                let target = &pairs::evaluate(&Target, std::slice::from_ref(pairs))[0];
                let mut numbers = pattern(shape.len(), 0.3);
                let start = Microfacet { kd: [0.2, 0.3, 0.1], eta: [1.6, 2.0, 2.6], alpha: [0.35, 0.5] };
                numbers.extend(analytic::from_parameters(&start, isotropic));
                numbers.extend(pattern(4, 1.0));
                let mut workspace = objective.workspace();
                let mut evaluate = |numbers: &[f32]| {
                    let (shared, own) = numbers.split_at(objective.shared_len());
                    let mut gradient = vec![0.0; numbers.len()];
                    let (shared_gradient, own_gradient) = gradient.split_at_mut(shared.len());
                    let loss = objective.block(
                        &mut workspace,
                        shared,
                        own,
                        pairs,
                        target,
                        shared_gradient,
                        own_gradient,
                    );
                    (loss, gradient)
                };
                let (_, gradient) = evaluate(&numbers);
                let largest = gradient.iter().fold(0.0f32, |a, g| a.max(g.abs()));
                // All of p and z, and every seventh number of the network.
                for n in (0..shape.len()).step_by(7).chain(shape.len()..numbers.len()) {
                    const STEP: f32 = 4e-3;
                    let original = numbers[n];
                    let mut at = |x: f32| {
                        numbers[n] = x;
                        evaluate(&numbers).0
                    };
                    let slope = (at(original + STEP) - at(original - STEP)) / f64::from(2.0 * STEP);
                    numbers[n] = original;
                    // Without `joint`, p must not see L_t, which the difference does.
                    if !joint && (shape.len()..shape.len() + 7).contains(&n) {
                        continue;
                    }
                    let error = (f64::from(gradient[n]) - slope).abs();
                    let tolerance = 0.01 * slope.abs() + 1e-3 * f64::from(largest);
                    assert!(
                        error < tolerance,
                        "{form:?} {sharing:?} number {n}: {} against {slope}",
                        gradient[n]
                    );
                }
            }
        }
    }

    #[test]
    fn without_joint_training_p_follows_the_analytic_loss_alone() {
        let loss = Loss { absolute: 1.0, squared: 1.0, relative: 0.0 };
        let form = Form { inputs: Inputs::Isotropic, ..Form::PAPER };
        let shape = Shape::new(10, &[16, 16], 6, Activation::HardGelu);
        let hybrid = HybridObjective {
            sharing: Sharing::Library,
            form,
            shape: shape.clone(),
            latent: 4,
            isotropic: true,
            loss,
            analytic_loss: Some(loss),
            joint: false,
        };
        let ggx = crate::ggx::GgxObjective { loss, isotropic: true };
        let pairs = &pairs::draw(Drawing::Lobes, 3, 1, 1)[0];
        let target = &pairs::evaluate(&Target, std::slice::from_ref(pairs))[0];
        let start = Microfacet { kd: [0.2; 3], eta: [1.6; 3], alpha: [0.35; 2] };
        let p = analytic::from_parameters(&start, true);
        let own = [p.clone(), vec![0.1; 4]].concat();
        let network = pattern(shape.len(), 0.5);
        let (mut a, mut b) = (vec![0.0; 11], vec![0.0; 7]);
        let mut shared = vec![0.0; shape.len()];
        hybrid.block(&mut hybrid.workspace(), &network, &own, pairs, target, &mut shared, &mut a);
        ggx.block(&mut ggx.workspace(), &[], &p, pairs, target, &mut [], &mut b);
        assert_eq!(a[..7], b[..]);
        assert!(shared.iter().any(|&g| g != 0.0) && a[7..].iter().all(|&g| g != 0.0));
    }
}

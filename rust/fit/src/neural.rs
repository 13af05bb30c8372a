//! The neural baseline as an objective: one network and one frame layer, and z for every material
//! ([`glimt_core::models::neural`]).
//!
//! z and the frames are constant in a block, and fold into the first layer as they do at run time:
//! what runs forward and backward is a network with six Cartesian inputs. The derivatives of its
//! first layer then go on to weights, frames and z, once per block.

use glam::{Mat3, Vec3};
use glimt_core::dispatch;
use glimt_core::kernels::network::{Activation, Layer, Network};
use glimt_core::models::neural::{FEATURES, FRAME_OUTPUTS, FRAMES, Shared, frame};
use glimt_core::simd::math::exp;
use glimt_core::simd::{LANES, Real, Vector};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::backprop::{COLUMNS, Row, Shape, Workspace, ZERO_ROW, backward, forward};
use crate::ggx::loss_rows;
use crate::loss::Loss;
use crate::objective::Objective;
use crate::pairs::{PairBlock, TargetBlock};

/// Fits network, frame layer and z together.
///
/// The shared numbers are the network's, in the order of [`Shape`], then the frame layer's weight
/// (row-major [[`FRAME_OUTPUTS`]][latent]) and bias. A material's own numbers are z.
#[derive(Clone, Debug)]
pub struct NeuralObjective {
    loss: Loss,
    activation: Activation,
    latent: usize,
    /// Sizes of ψ.
    shape: Shape,
    /// Sizes of ψ with frames and z folded away.
    folded: Shape,
}

/// Numbers of a light and a view.
const CARTESIAN: usize = 6;

/// Where training stops following exp ψ: far above any measured lobe, far below overflow.
const MAX_OUTPUT: f32 = 16.0;

/// Offsets of a normal or a tangent that leave less of it than this stand still: its direction is
/// rounding error there, or the core's replacement.
const LEAST_LENGTH: f32 = 1e-6;

/// What the outputs' biases start about: f ≈ 0.05, the order of most materials over most directions.
/// Fits of 5000 steps to twelve measured materials that started at f ≈ 1 ended with 7, 20 and 22 percent
/// more log-MAE (three seeds).
const INITIAL_OUTPUT: f32 = -3.0;
/// Range of z before training, in either direction.
const INITIAL_LATENT: f32 = 0.5;
/// Range of the frame layer's numbers before training: frames close to identity, and distinct.
const INITIAL_FRAME: f32 = 0.1;

/// Room for one block.
pub struct NeuralWorkspace {
    network: Workspace,
    /// The folded network's numbers, and their derivatives.
    numbers: Vec<f32>,
    gradient: Vec<f32>,
    /// f, then ∂loss/∂f.
    model: [Row; 3],
    slopes: [Row; 3],
}

/// The frames that z stands for.
struct Frames {
    offsets: [f32; FRAME_OUTPUTS],
    /// Tangent, bitangent and normal of each frame as columns: the transpose of F_k.
    axes: [Mat3; FRAMES],
}

impl NeuralObjective {
    /// A network with equal `hidden` layers and z of length `latent`.
    #[must_use]
    pub fn new(hidden: &[usize], latent: usize, activation: Activation, loss: Loss) -> Self {
        NeuralObjective {
            loss,
            activation,
            latent,
            shape: Shape::new(FEATURES + latent, hidden, 3, activation),
            folded: Shape::new(CARTESIAN, hidden, 3, activation),
        }
    }

    /// Numbers for the start of a fit, shared and then each material's own: layers uniform up to
    /// 1/√inputs, f dark, frames close to identity, and some z for every material.
    #[must_use]
    pub fn initial(&self, seed: u64, materials: usize) -> Vec<f32> {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut uniform = |count: usize, range: f32| -> Vec<f32> {
            (0..count).map(|_| (2.0 * rng.random::<f32>() - 1.0) * range).collect()
        };
        let mut numbers = Vec::with_capacity(self.shared_len() + materials * self.latent);
        for layer in 0..self.shape.layers() {
            let (inputs, outputs) = self.shape.layer(layer);
            numbers.extend(uniform((inputs + 1) * outputs, 1.0 / (inputs as f32).sqrt()));
        }
        let (_, output_bias) = self.shape.split_mut(&mut numbers, self.shape.layers() - 1);
        output_bias.iter_mut().for_each(|bias| *bias += INITIAL_OUTPUT);
        numbers.extend(uniform((self.latent + 1) * FRAME_OUTPUTS, INITIAL_FRAME));
        numbers.extend(uniform(materials * self.latent, INITIAL_LATENT));
        numbers
    }

    /// Network and frame layer as the core takes them, from the shared numbers.
    ///
    /// # Errors
    /// In words, if the core does not take the network: too wide, or not finite.
    pub fn to_shared(&self, shared: &[f32]) -> Result<Shared, String> {
        let network = Network::new(self.shape.to_layers(shared), FEATURES, self.activation)?;
        let (weight, bias) = self.frame_layer(shared);
        Ok(Shared { network, frames: Layer { weight: weight.to_vec(), bias: bias.to_vec() } })
    }

    /// The largest ψ of a material over the given blocks, and so the bound of its output.
    #[must_use]
    pub fn largest_output(&self, shared: &[f32], own: &[f32], pairs: &[PairBlock]) -> f32 {
        let mut workspace = self.workspace();
        let mut largest = f32::MIN;
        for pairs in pairs {
            self.predict(&mut workspace, shared, own, pairs);
            let outputs = workspace.network.outputs();
            largest = outputs.iter().flatten().flatten().fold(largest, |a, &b| a.max(b));
        }
        largest.min(MAX_OUTPUT)
    }

    /// Weight and bias of the frame layer.
    fn frame_layer<'a>(&self, shared: &'a [f32]) -> (&'a [f32], &'a [f32]) {
        shared[self.shape.len()..].split_at(self.latent * FRAME_OUTPUTS)
    }

    fn frames(&self, shared: &[f32], z: &[f32]) -> Frames {
        let (weight, bias) = self.frame_layer(shared);
        let offsets: [f32; FRAME_OUTPUTS] =
            std::array::from_fn(|i| bias[i] + dot(&weight[i * self.latent..], z));
        let axes = std::array::from_fn(|k| frame(&offsets[6 * k..]).transpose());
        Frames { offsets, axes }
    }

    /// Evaluates ψ and f for a block.
    fn predict(
        &self,
        workspace: &mut NeuralWorkspace,
        shared: &[f32],
        z: &[f32],
        pairs: &PairBlock,
    ) -> Frames {
        let frames = self.frames(shared, z);
        self.fold(shared, z, &frames, &mut workspace.numbers);
        let (light, view) = workspace.network.values[0].split_at_mut(3);
        light.copy_from_slice(&pairs.light);
        view.copy_from_slice(&pairs.view);
        forward(&self.folded, &workspace.numbers, &mut workspace.network);
        bounded_exp(workspace.network.outputs(), &mut workspace.model);
        frames
    }

    /// The folded network: Σ_k W_k F_k in place of W₁'s columns for the frames k, W_z z in the bias,
    /// and the other layers as they are.
    fn fold(&self, shared: &[f32], z: &[f32], frames: &Frames, folded: &mut [f32]) {
        let (weight, bias) = self.shape.split(shared, 0);
        let (folded_weight, folded_bias) = self.folded.split_mut(folded, 0);
        for ((row, folded), (bias, folded_bias)) in weight
            .chunks_exact(self.shape.inputs())
            .zip(folded_weight.chunks_exact_mut(CARTESIAN))
            .zip(bias.iter().zip(folded_bias))
        {
            for (side, folded) in folded.chunks_exact_mut(3).enumerate() {
                let seen = (0..FRAMES).map(|k| frames.axes[k] * columns(row, k, side));
                folded.copy_from_slice(&seen.sum::<Vec3>().to_array());
            }
            *folded_bias = bias + dot(&row[FEATURES..], z);
        }
        let rest = first_len(&self.folded);
        folded[rest..].copy_from_slice(&shared[first_len(&self.shape)..self.shape.len()]);
    }

    /// From derivatives by the folded network's numbers, adds those by the shared numbers and by z.
    fn unfold(
        &self,
        folded_gradient: &[f32],
        shared: &[f32],
        z: &[f32],
        frames: &Frames,
        shared_gradient: &mut [f32],
        z_gradient: &mut [f32],
    ) {
        let (network_gradient, frame_gradient) = shared_gradient.split_at_mut(self.shape.len());
        let rest = first_len(&self.shape);
        for (gradient, part) in
            network_gradient[rest..].iter_mut().zip(&folded_gradient[first_len(&self.folded)..])
        {
            *gradient += part;
        }

        let (weight, _) = self.shape.split(shared, 0);
        let (by_weight, by_bias) = self.folded.split(folded_gradient, 0);
        let (weight_gradient, bias_gradient) = self.shape.split_mut(network_gradient, 0);
        let mut by_axes = [Mat3::ZERO; FRAMES];
        let inputs = self.shape.inputs();
        for (o, (&by_bias, gradient)) in by_bias.iter().zip(bias_gradient).enumerate() {
            let row = &weight[o * inputs..][..inputs];
            let row_gradient = &mut weight_gradient[o * inputs..][..inputs];
            for k in 0..FRAMES {
                for side in 0..2 {
                    let by_seen = Vec3::from_slice(&by_weight[CARTESIAN * o + 3 * side..]);
                    let w = columns(row, k, side);
                    by_axes[k] += Mat3::from_cols(by_seen * w.x, by_seen * w.y, by_seen * w.z);
                    let by_columns = frames.axes[k].transpose() * by_seen;
                    add_scaled(&mut row_gradient[6 * k + 3 * side..][..3], 1.0, &by_columns.to_array());
                }
            }
            *gradient += by_bias;
            add_scaled(&mut row_gradient[FEATURES..], by_bias, z);
            add_scaled(z_gradient, by_bias, &row[FEATURES..]);
        }

        let (weight, _) = self.frame_layer(shared);
        let (weight_gradient, bias_gradient) = frame_gradient.split_at_mut(weight.len());
        for (k, by_axes) in by_axes.iter().enumerate() {
            let by_offsets = offsets_gradient(&frames.offsets[6 * k..], &frames.axes[k], by_axes);
            for (i, by_offset) in (6 * k..).zip(by_offsets) {
                let row = self.latent * i..self.latent * (i + 1);
                bias_gradient[i] += by_offset;
                add_scaled(&mut weight_gradient[row.clone()], by_offset, z);
                add_scaled(z_gradient, by_offset, &weight[row]);
            }
        }
    }
}

impl Objective for NeuralObjective {
    type Workspace = Box<NeuralWorkspace>;

    fn shared_len(&self) -> usize {
        self.shape.len() + (self.latent + 1) * FRAME_OUTPUTS
    }

    fn own_len(&self) -> usize {
        self.latent
    }

    fn workspace(&self) -> Box<NeuralWorkspace> {
        Box::new(NeuralWorkspace {
            network: Workspace::new(&self.folded),
            numbers: vec![0.0; self.folded.len()],
            gradient: vec![0.0; self.folded.len()],
            model: [ZERO_ROW; 3],
            slopes: [ZERO_ROW; 3],
        })
    }

    fn block(
        &self,
        workspace: &mut Box<NeuralWorkspace>,
        shared: &[f32],
        own: &[f32],
        pairs: &PairBlock,
        target: &TargetBlock,
        shared_gradient: &mut [f32],
        own_gradient: &mut [f32],
    ) -> f64 {
        let workspace = &mut **workspace;
        let frames = self.predict(workspace, shared, own, pairs);
        let mut total = [0.0; LANES];
        loss_rows(self.loss, pairs, target, &workspace.model, &mut workspace.slopes, &mut total);
        // The slope of exp is exp itself, beyond the limit too, so that ψ comes back.
        for ((delta, slope), f) in workspace
            .network
            .output_delta()
            .as_flattened_mut()
            .as_flattened_mut()
            .iter_mut()
            .zip(workspace.slopes.as_flattened().as_flattened())
            .zip(workspace.model.as_flattened().as_flattened())
        {
            *delta = slope * f;
        }
        workspace.gradient.fill(0.0);
        backward(&self.folded, &workspace.numbers, &mut workspace.network, &mut workspace.gradient);
        self.unfold(&workspace.gradient, shared, own, &frames, shared_gradient, own_gradient);
        total.iter().map(|&x| f64::from(x)).sum()
    }

    /// All but the frame layer's bias: it says how the frames differ from identity.
    fn decays(&self, index: usize) -> bool {
        index < self.shared_len() - FRAME_OUTPUTS
    }
}

dispatch! {
    fn bounded_exp(isa, outputs: &[Row], model: &mut [Row; 3]) {
        for column in 0..COLUMNS {
            for c in 0..3 {
                let output = Vector::<I, LANES>::load(isa, &outputs[c][column]);
                exp(output.at_most(MAX_OUTPUT)).store(&mut model[c][column]);
            }
        }
    }
}

/// From derivatives by the axes, those by the six numbers that became `axes` in
/// [`glimt_core::models::neural::frame`]: Gram and Schmidt backwards.
fn offsets_gradient(offsets: &[f32], axes: &Mat3, by_axes: &Mat3) -> [f32; 6] {
    let (tangent, normal) = (axes.x_axis, axes.z_axis);
    let long_normal = Vec3::from_slice(offsets) + Vec3::Z;
    let long_tangent = Vec3::from_slice(&offsets[3..]) + Vec3::X;
    let along = normal.dot(long_tangent);

    // bitangent = normal × tangent
    let by_tangent = by_axes.x_axis + by_axes.y_axis.cross(normal);
    let mut by_normal = by_axes.z_axis + tangent.cross(by_axes.y_axis);
    // tangent = unit(long_tangent − along · normal)
    let by_rejected = unit_gradient(tangent, (long_tangent - along * normal).length(), by_tangent);
    let by_along = -normal.dot(by_rejected);
    by_normal += by_along * long_tangent - along * by_rejected;
    let by_long_tangent = by_rejected + by_along * normal;
    let by_long_normal = unit_gradient(normal, long_normal.length(), by_normal);

    let [n, t] = [by_long_normal, by_long_tangent].map(|v| v.to_array());
    [n[0], n[1], n[2], t[0], t[1], t[2]]
}

/// From derivatives by a unit vector, those by the vector of `length` that it came from.
fn unit_gradient(unit: Vec3, length: f32, by_unit: Vec3) -> Vec3 {
    if length < LEAST_LENGTH {
        return Vec3::ZERO;
    }
    (by_unit - unit * unit.dot(by_unit)) / length
}

/// Numbers of the first layer.
fn first_len(shape: &Shape) -> usize {
    let (inputs, outputs) = shape.layer(0);
    (inputs + 1) * outputs
}

/// A neuron's weights for light (`side` 0) or view (1) in frame k.
fn columns(row: &[f32], k: usize, side: usize) -> Vec3 {
    Vec3::from_slice(&row[6 * k + 3 * side..])
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn add_scaled(sum: &mut [f32], scale: f32, part: &[f32]) {
    for (sum, part) in sum.iter_mut().zip(part) {
        *sum += scale * part;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adamw::AdamW;
    use crate::backprop::BLOCK;
    use crate::pairs::{self, Drawing};
    use crate::train::{Schedule, State, train};
    use crate::truth::Truth;
    use glam::{DMat3, DVec3};
    use glimt_core::Brdf;
    use glimt_core::microfacet::Microfacet;
    use glimt_core::models::ggx::Ggx;
    use glimt_core::models::neural::Neural;
    use std::ops::ControlFlow;
    use std::sync::Arc;

    const LOSS: Loss = Loss { absolute: 1.0, squared: 1.0, relative: 0.02 };

    fn objective(hidden: &[usize], latent: usize) -> NeuralObjective {
        NeuralObjective::new(hidden, latent, Activation::HardGelu, LOSS)
    }

    /// A bright rough mirror and a rough plastic.
    fn materials() -> [Ggx; 2] {
        [([0.02; 3], [5.0, 3.0, 2.0], 0.5), ([0.5, 0.2, 0.1], [1.5; 3], 0.4)]
            .map(|(kd, eta, alpha)| Ggx::new(Microfacet { kd, eta, alpha: [alpha; 2] }).unwrap())
    }

    fn axes(offsets: &[f64]) -> DMat3 {
        let normal = (DVec3::from_slice(offsets) + DVec3::Z).normalize();
        let tangent = DVec3::from_slice(&offsets[3..]) + DVec3::X;
        let tangent = (tangent - normal * normal.dot(tangent)).normalize();
        DMat3::from_cols(tangent, normal.cross(tangent), normal)
    }

    fn central_difference(numbers: &mut [f64], n: usize, value: impl Fn(&[f64]) -> f64) -> f64 {
        const STEP: f64 = 1e-6;
        let original = numbers[n];
        let mut at = |x| {
            numbers[n] = x;
            value(numbers)
        };
        let slope = (at(original + STEP) - at(original - STEP)) / (2.0 * STEP);
        numbers[n] = original;
        slope
    }

    fn to_f64(numbers: &[f32]) -> Vec<f64> {
        numbers.iter().map(|&x| x.into()).collect()
    }

    fn at(rows: &[Row; 3], i: usize) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|c| rows[c][i / LANES][i % LANES].into()))
    }

    fn affine(numbers: &mut &[f64], x: &[f64], outputs: usize) -> Vec<f64> {
        let (weight, rest) = numbers.split_at(x.len() * outputs);
        let (bias, rest) = rest.split_at(outputs);
        *numbers = rest;
        let rows = weight.chunks_exact(x.len()).zip(bias);
        rows.map(|(row, bias)| bias + row.iter().zip(x).map(|(w, x)| w * x).sum::<f64>()).collect()
    }

    /// The loss of a block in float64, with the frames applied to the directions.
    fn reference(
        objective: &NeuralObjective,
        numbers: &[f64],
        pairs: &PairBlock,
        target: &TargetBlock,
    ) -> f64 {
        let (shared, z) = numbers.split_at(objective.shared_len());
        let offsets = affine(&mut &shared[objective.shape.len()..], z, FRAME_OUTPUTS);
        let mut total = 0.0;
        for i in 0..BLOCK {
            let (light, view) = (at(&pairs.light, i), at(&pairs.view, i));
            let mut x: Vec<f64> = offsets
                .chunks_exact(6)
                .flat_map(|offsets| {
                    let to_frame = axes(offsets).transpose();
                    [to_frame * light, to_frame * view].map(|w| w.to_array()).concat()
                })
                .chain(z.iter().copied())
                .collect();
            let mut numbers = shared;
            for layer in 0..objective.shape.layers() {
                x = affine(&mut numbers, &x, objective.shape.layer(layer).1);
                if layer + 1 < objective.shape.layers() {
                    for x in &mut x {
                        let t = x.clamp(-1.5, 1.5);
                        *x = t * (t + 1.5) / 3.0 + (*x - 1.5).max(0.0);
                    }
                }
            }
            let f = at(target, i).to_array();
            for (f, y) in f.into_iter().zip(x) {
                let model = y.exp();
                let e = ((1.0 + light.z * model) / (1.0 + light.z * f)).ln();
                let relative = 2.0 * (model - f).abs() / (model + f + 1e-4);
                total += f64::from(pairs.weight[i / LANES][i % LANES])
                    * (f64::from(LOSS.absolute) * e.abs()
                        + f64::from(LOSS.squared) * e * e
                        + f64::from(LOSS.relative) * relative);
            }
        }
        total
    }

    #[test]
    fn gradient_is_the_finite_difference_for_every_kind_of_number() {
        const LATENT: usize = 5;
        let objective = objective(&[16, 16], LATENT);
        let numbers: Vec<f32> = (objective.initial(3, 1).iter()).map(|x| 1.5 * x).collect();
        let (shared, z) = numbers.split_at(objective.shared_len());
        let pairs = &pairs::draw(Drawing::Lobes, 2, 0, 1)[0];
        let target = &pairs::evaluate(&materials()[1], std::slice::from_ref(pairs))[0];
        let mut workspace = objective.workspace();
        // A first block, from which nothing may stay in the workspace.
        objective.block(
            &mut workspace,
            shared,
            &[0.0; LATENT],
            pairs,
            target,
            &mut vec![0.0; shared.len()],
            &mut [0.0; LATENT],
        );
        let (mut by_shared, mut by_z) = (vec![0.0; shared.len()], vec![0.0; LATENT]);
        let loss = objective.block(&mut workspace, shared, z, pairs, target, &mut by_shared, &mut by_z);
        let mut double = to_f64(&numbers);
        let truth = reference(&objective, &double, pairs, target);
        assert!((loss - truth).abs() < 1e-5 * truth, "loss {loss} against {truth}");

        let first = FEATURES + LATENT;
        let rest = first_len(&objective.shape);
        let frames = objective.shape.len();
        let frame_bias = frames + FRAME_OUTPUTS * LATENT;
        let gradient = [by_shared, by_z].concat();
        for (kind, range, step) in [
            ("weight of a frame", 0..FEATURES, 1),
            ("weight of z", 3 * first + FEATURES..4 * first, 1),
            ("first bias", 16 * first..rest, 1),
            ("hidden weight or bias", rest..rest + 17 * 16, 7),
            ("output weight or bias", rest + 17 * 16..frames, 5),
            ("frame weight", frames..frame_bias, 1),
            ("frame bias", frame_bias..shared.len(), 1),
            ("z", shared.len()..numbers.len(), 1),
        ] {
            let largest = gradient[range.clone()].iter().fold(0.0f32, |a, b| a.max(b.abs()));
            assert!(largest > 1e-3, "{kind} has no derivative");
            for n in range.step_by(step) {
                let slope = central_difference(&mut double, n, |x| reference(&objective, x, pairs, target));
                assert!(
                    (f64::from(gradient[n]) - slope).abs() < 1e-3 * slope.abs() + 1e-4 * f64::from(largest),
                    "{kind} {n}: {} against {slope}",
                    gradient[n]
                );
            }
        }
    }

    #[test]
    fn gradient_of_gram_and_schmidt_is_the_finite_difference() {
        let by_axes = Mat3::from_cols_array(&[0.3, -1.2, 0.7, 0.9, 0.4, -0.5, -0.8, 0.6, 1.1]);
        for offsets in [[0.0; 6], [0.3, -0.8, 0.5, 0.2, 0.9, -0.1], [1.4, 0.2, -1.9, -0.7, 0.3, 0.8]] {
            let gradient = offsets_gradient(&offsets, &frame(&offsets).transpose(), &by_axes);
            let mut double = to_f64(&offsets);
            for n in 0..6 {
                let slope = central_difference(&mut double, n, |x| {
                    let products =
                        axes(x).to_cols_array().into_iter().zip(by_axes.as_dmat3().to_cols_array());
                    products.map(|(a, b)| a * b).sum()
                });
                assert!((f64::from(gradient[n]) - slope).abs() < 1e-5, "{n}: {} and {slope}", gradient[n]);
            }
        }
    }

    #[test]
    fn frames_that_vanish_stand_still() {
        let by_axes = Mat3::from_cols_array(&[1.0; 9]);
        for offsets in [[0.0, 0.0, -1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, -1.0, 0.0, 2.0]] {
            let gradient = offsets_gradient(&offsets, &frame(&offsets).transpose(), &by_axes);
            assert!(gradient.iter().all(|g| g.is_finite() && g.abs() < 10.0), "{gradient:?}");
        }
    }

    #[test]
    fn training_lowers_the_loss_and_the_core_evaluates_what_was_trained() {
        const LATENT: usize = 4;
        let objective = objective(&[16, 16], LATENT);
        let materials = materials();
        let truths = materials.each_ref().map(|m| Truth::Brdf(m));
        let schedule = Schedule {
            steps: 300,
            blocks: 2,
            seed: 1,
            rate: 1e-2,
            clip: 0.1,
            adamw: AdamW { beta1: 0.9, beta2: 0.999, weight_decay: 0.0 },
            drawing: Drawing::Lobes,
            freeze_shared: false,
        };
        let mut state = State::new(objective.initial(1, 2));
        let mut losses = Vec::new();
        train(&objective, &truths, &schedule, &mut state, &mut |progress, _| {
            losses.push(progress.loss);
            ControlFlow::Continue(())
        });
        assert!(losses[5] * 4.0 < losses[0], "{losses:?}");

        let (shared, own) = state.numbers.split_at(objective.shared_len());
        let core = Arc::new(objective.to_shared(shared).unwrap());
        let pairs = pairs::draw(Drawing::Lobes, 7, 0, 4);
        let mut workspace = objective.workspace();
        for z in own.chunks_exact(LATENT) {
            let bound = objective.largest_output(shared, z, &pairs);
            let material = Neural::new(core.clone(), z.to_vec(), bound).unwrap();
            let mut largest = 0.0f32;
            for pairs in &pairs {
                objective.predict(&mut workspace, shared, z, pairs);
                for i in (0..BLOCK).filter(|&i| pairs.light[2][i / LANES][i % LANES] > 0.0) {
                    let f = material.eval(at(&pairs.light, i).as_vec3(), at(&pairs.view, i).as_vec3());
                    let model = at(&workspace.model, i).as_vec3();
                    assert!((f - model).abs().max_element() < 2e-5 * model.max_element(), "{f} and {model}");
                    largest = largest.max(model.max_element());
                }
            }
            assert!((bound.exp() / largest - 1.0).abs() < 1e-4, "{bound} against ln {largest}");
        }
    }

    #[test]
    fn first_numbers_are_dark_and_distinct_and_decay_spares_frame_biases() {
        let objective = objective(&[16], 4);
        let numbers = objective.initial(1, 3);
        assert_eq!(numbers.len(), objective.shared_len() + 3 * objective.own_len());
        assert_eq!(numbers, objective.initial(1, 3));
        assert_ne!(numbers, objective.initial(2, 3));
        let z = &numbers[objective.shared_len()..][..4];
        let brightest = objective.largest_output(&numbers, z, &pairs::draw(Drawing::Cosine, 1, 0, 1)).exp();
        assert!(0.02 < brightest && brightest < 0.3, "{brightest}");
        let frames = objective.frames(&numbers, z);
        for k in 0..FRAMES {
            let difference =
                |m: Mat3| (frames.axes[k] - m).to_cols_array().iter().map(|x| x * x).sum::<f32>();
            assert!(difference(Mat3::IDENTITY) < 0.2);
            assert!(difference(frames.axes[(k + 1) % FRAMES]) > 1e-4);
        }
        let decaying = (0..numbers.len()).filter(|&i| objective.decays(i)).count();
        assert_eq!(decaying, objective.shared_len() - FRAME_OUTPUTS);
        assert!(!objective.decays(objective.shared_len() - 1));
    }

    #[test]
    fn numbers_that_are_not_finite_do_not_become_a_network() {
        let objective = objective(&[16], 4);
        let mut numbers = objective.initial(1, 0);
        numbers[10] = f32::NAN;
        assert!(objective.to_shared(&numbers).unwrap_err().contains("not finite"));
    }
}

//! Small multilayer perceptrons: their weights, and their evaluation.
//!
//! Two shapes of kernel share one set of weights: [`Network::forward_tile`] takes samples side by side, and
//! [`Network::forward_one`] one sample. How they compute is in `packed.rs`.

mod packed;
mod values;

use crate::simd::{Isa, LANES, Lane, Lanes, Real};
pub use packed::add_column;
use packed::{LayerOfLanes, PackedLayer, Units};
pub use values::{Bias, One, Rows};

/// Widest layer that the kernels hold on the stack.
pub const MAX_WIDTH: usize = 64;

/// One affine layer, y = W x + b.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// W, row-major [outputs][inputs].
    pub weight: Vec<f32>,
    /// b, [outputs].
    pub bias: Vec<f32>,
}

impl Layer {
    /// The largest magnitude that an output can have if no input's is above `input`.
    pub(crate) fn largest_sum(&self, input: f64) -> f64 {
        let rows = self.weight.chunks_exact(self.inputs().max(1)).zip(&self.bias);
        let sums = rows.map(|(row, bias)| {
            let weights: f64 = row.iter().map(|&w| f64::from(w).abs()).sum();
            weights * input + f64::from(*bias).abs()
        });
        sums.fold(0.0, f64::max)
    }

    /// Number of values that the layer yields.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// Number of values that the layer takes.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.weight.len() / self.bias.len()
    }
}

/// The nonlinearity between the layers; the last layer has none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// 0 for x ≤ −1.5, x for x ≥ 1.5, x(x + 1.5)/3 between.
    HardGelu,
    /// max(0, x).
    Relu,
}

impl Activation {
    /// Every one.
    pub const ALL: [Activation; 2] = [Activation::HardGelu, Activation::Relu];

    /// The name as files spell it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Activation::HardGelu => "hardgelu",
            Activation::Relu => "relu",
        }
    }

    /// The one of that name.
    #[must_use]
    pub fn named(name: &str) -> Option<Activation> {
        Activation::ALL.into_iter().find(|activation| activation.name() == name)
    }

    /// The function's value.
    #[must_use]
    pub fn value(self, x: f32) -> f32 {
        self.value_and_slope(x).0
    }

    /// The function's derivative.
    #[must_use]
    pub fn derivative(self, x: f32) -> f32 {
        self.value_and_slope(x).1
    }

    /// The function's value and derivative, in any number of lanes.
    #[inline(always)]
    #[must_use]
    pub fn value_and_slope<F: Real>(self, x: F) -> (F, F) {
        let [zero, one] = [x.splat(0.0), x.splat(1.0)];
        match self {
            // The parabola on the limited x, and the rest of x on top: no branch.
            Activation::HardGelu => {
                let t = x.clamped(-1.5, 1.5);
                let value = t * ((t + 1.5) * (1.0 / 3.0)) + (x - 1.5).max(zero);
                let inside = (x * 2.0 + 1.5) * (1.0 / 3.0);
                let slope = Real::select(x.splat(-1.5).lt(x), inside, zero);
                (value, Real::select(x.lt(x.splat(1.5)), slope, one))
            }
            Activation::Relu => (x.max(zero), Real::select(zero.lt(x), one, zero)),
        }
    }
}
/// A multilayer perceptron ψ(x, z) whose inputs are `features` that change with the directions and
/// a latent code z that is constant for a material.
///
/// The latent columns of the first layer times z, and its bias, are one vector per material:
/// [`Network::fold`] computes it once, and the kernels take it in place of the first bias.
#[derive(Clone, Debug)]
pub struct Network {
    layers: Vec<Layer>,
    activation: Activation,
    features: usize,
    packed: Vec<PackedLayer>,
}

/// The largest input and latent number that a network must stand.
pub(crate) const LARGEST_INPUT: f32 = 1e6;

/// Whether a latent code is what a network can stand.
pub(crate) fn check_latent(latent: &[f32]) -> Result<(), String> {
    match latent.iter().find(|z| !(-LARGEST_INPUT..=LARGEST_INPUT).contains(*z)) {
        Some(z) => Err(format!("the latent code holds {z}, expected numbers within ±{LARGEST_INPUT}")),
        None => Ok(()),
    }
}

/// Whether no input up to [`LARGEST_INPUT`] can make a sum overflow, after which infinities of both signs
/// would meet and give NaN. The activations do not make a number larger.
fn check_sums(layers: &[Layer]) -> Result<(), String> {
    let mut largest = f64::from(LARGEST_INPUT);
    for (i, layer) in layers.iter().enumerate() {
        largest = layer.largest_sum(largest);
        if largest > f64::from(f32::MAX) / 2.0 {
            return Err(format!("layer {i} holds numbers so large that its sums overflow"));
        }
    }
    Ok(())
}

impl Network {
    /// A network from its layers, first to last; the first takes `features` values and then a
    /// latent code.
    ///
    /// # Errors
    /// What does not fit together, in words: a layer whose inputs are not its predecessor's
    /// outputs, one wider than [`MAX_WIDTH`], a bias or weight of the wrong length, a non-finite
    /// weight, or weights so large that sums of products overflow.
    pub fn new(layers: Vec<Layer>, features: usize, activation: Activation) -> Result<Self, String> {
        if layers.is_empty() {
            return Err("a network has at least one layer".into());
        }
        for (i, layer) in layers.iter().enumerate() {
            let outputs = layer.outputs();
            if outputs == 0 || outputs > MAX_WIDTH || layer.weight.len() % outputs != 0 {
                return Err(format!(
                    "layer {i} has {} weights and {outputs} biases; expected 1 to {MAX_WIDTH} biases and as many equal rows",
                    layer.weight.len()
                ));
            }
            if i > 0 && layer.inputs() != layers[i - 1].outputs() {
                return Err(format!(
                    "layer {i} takes {} values, but the layer before it yields {}",
                    layer.inputs(),
                    layers[i - 1].outputs()
                ));
            }
            if !layer.weight.iter().chain(&layer.bias).all(|w| w.is_finite()) {
                return Err(format!("layer {i} holds a weight that is not finite"));
            }
        }
        if features == 0 || layers[0].inputs() < features || layers[0].inputs() > 2 * MAX_WIDTH {
            return Err(format!(
                "the first layer takes {} values, expected at least {features}",
                layers[0].inputs()
            ));
        }
        check_sums(&layers)?;
        let (last, hidden) = (layers.len() - 1, activation.units());
        let packed = layers
            .iter()
            .enumerate()
            .map(|(i, layer)| {
                let inputs = if i == 0 { features } else { layer.inputs() };
                let from = if i == 0 { Units::PLAIN } else { hidden };
                let to = if i == last { Units::PLAIN } else { hidden };
                PackedLayer::new(layer, inputs, from, to)
            })
            .collect();
        Ok(Network { layers, activation, features, packed })
    }

    /// The layers, first to last, as they were given.
    #[must_use]
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// The nonlinearity between the layers.
    #[must_use]
    pub fn activation(&self) -> Activation {
        self.activation
    }

    /// Number of inputs that change with the directions.
    #[must_use]
    pub fn features(&self) -> usize {
        self.features
    }

    /// Length of the latent code.
    #[must_use]
    pub fn latent(&self) -> usize {
        self.layers[0].inputs() - self.features
    }

    /// Number of values that the network yields.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.layers[self.layers.len() - 1].outputs()
    }

    /// Multiply-adds of one evaluation with z folded away.
    #[must_use]
    pub fn multiply_adds(&self) -> usize {
        self.layers
            .iter()
            .enumerate()
            .map(|(i, layer)| layer.outputs() * if i == 0 { self.features } else { layer.inputs() })
            .sum()
    }

    /// The first layer's bias with the latent code's part added.
    ///
    /// # Panics
    /// If `latent` is shorter than [`Network::latent`].
    #[must_use]
    pub fn folded_bias(&self, latent: &[f32]) -> Vec<f64> {
        let first = &self.layers[0];
        first
            .weight
            .chunks_exact(first.inputs())
            .zip(&first.bias)
            .map(|(row, &bias)| {
                let weights = &row[self.features..];
                let part =
                    (0..weights.len()).map(|i| f64::from(weights[i]) * f64::from(latent[i])).sum::<f64>();
                f64::from(bias) + part
            })
            .collect()
    }

    /// [`Network::folded_bias`] as the kernels take it.
    ///
    /// # Panics
    /// If `latent` is shorter than [`Network::latent`].
    #[must_use]
    pub fn fold(&self, latent: &[f32]) -> Vec<Lane> {
        let units = if self.layers.len() == 1 { Units::PLAIN } else { self.activation.units() };
        let mut bias = vec![[0.0; LANES]; self.packed[0].bias.len()];
        for (bias, folded) in bias.as_flattened_mut().iter_mut().zip(self.folded_bias(latent)) {
            *bias = (units.scale * folded + units.shift) as f32;
        }
        bias
    }

    /// Evaluates `L` samples side by side: `x[feature][lane]` to `y[output][lane]`, `first_bias` from
    /// [`Network::fold`], flat, or such values for every lane.
    #[inline(always)]
    pub fn forward_tile<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        first_bias: impl Bias<L>,
        x: &[[f32; L]],
        y: &mut Rows<L>,
    ) {
        let mut hidden = Rows::default();
        let last = self.packed.len() - 1;
        // Layers alternate between the two buffers so that the last one yields to `y`.
        let [mut from, mut to] = if last.is_multiple_of(2) { [&mut hidden, y] } else { [y, &mut hidden] };
        for (i, layer) in self.packed.iter().enumerate() {
            let activation = (i < last).then_some(self.activation);
            if i == 0 {
                isa.run(LayerOfLanes { layer, bias: first_bias, x, y: to, activation });
            } else {
                let bias = layer.bias.as_flattened();
                isa.run(LayerOfLanes { layer, bias, x: &from[..], y: to, activation });
            }
            std::mem::swap(&mut from, &mut to);
        }
    }

    /// What a part of the first layer's inputs, from `first` on, adds to its sums, as the kernels compute them.
    #[must_use]
    pub(crate) fn first_products(&self, first: usize, x: &[f32]) -> Vec<f32> {
        self.packed[0].products(first, x)
    }

    /// [`Network::forward_tile`] from the first layer's values on, of which there is more than one.
    #[inline(always)]
    pub(crate) fn forward_tile_from<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        first: &[[f32; L]],
        y: &mut Rows<L>,
    ) {
        let mut hidden = Rows::default();
        let last = self.packed.len() - 1;
        let [mut from, mut to] = if last.is_multiple_of(2) { [y, &mut hidden] } else { [&mut hidden, y] };
        for (i, layer) in self.packed.iter().enumerate().skip(1) {
            let activation = (i < last).then_some(self.activation);
            let x = if i == 1 { first } else { &from[..] };
            isa.run(LayerOfLanes { layer, bias: layer.bias.as_flattened(), x, y: to, activation });
            std::mem::swap(&mut from, &mut to);
        }
    }

    /// [`Network::forward_one`] from the first layer's values on, of which there is more than one.
    #[inline(always)]
    pub(crate) fn forward_one_from<I: Isa>(&self, isa: I, first: &[f32], y: &mut One) {
        let mut hidden = One::default();
        let last = self.packed.len() - 1;
        let [mut from, mut to] = if last.is_multiple_of(2) { [y, &mut hidden] } else { [&mut hidden, y] };
        for (i, layer) in self.packed.iter().enumerate().skip(1) {
            let x = if i == 1 { first } else { &from[..] };
            layer.forward_one(isa, &layer.bias, x, to, (i < last).then_some(self.activation));
            std::mem::swap(&mut from, &mut to);
        }
    }

    /// Evaluates one sample: `x[feature]` to `y[output]`, otherwise as [`Network::forward_tile`].
    #[inline(always)]
    pub fn forward_one<I: Isa>(&self, isa: I, first_bias: &[Lane], x: &[f32], y: &mut One) {
        let mut hidden = One::default();
        let last = self.packed.len() - 1;
        let [mut from, mut to] = if last.is_multiple_of(2) { [&mut hidden, y] } else { [y, &mut hidden] };
        for (i, layer) in self.packed.iter().enumerate() {
            let bias = if i == 0 { first_bias } else { &layer.bias };
            let x = if i == 0 { x } else { &from[..] };
            layer.forward_one(isa, bias, x, to, (i < last).then_some(self.activation));
            std::mem::swap(&mut from, &mut to);
        }
    }
}

/// The same network in float64, written as the definition reads. What tests compare against.
pub mod reference {
    use super::{Activation, Network};

    /// ψ(features, latent).
    #[must_use]
    pub fn forward(network: &Network, features: &[f64], latent: &[f64]) -> Vec<f64> {
        let mut x = [features, latent].concat();
        let last = network.layers().len() - 1;
        for (i, layer) in network.layers().iter().enumerate() {
            let rows = layer.weight.chunks_exact(layer.inputs());
            x = rows
                .zip(&layer.bias)
                .map(|(row, &bias)| {
                    let sum =
                        row.iter().zip(&x).map(|(&w, &x)| f64::from(w) * x).sum::<f64>() + f64::from(bias);
                    if i == last { sum } else { activate(network.activation(), sum) }
                })
                .collect();
        }
        x
    }

    fn activate(activation: Activation, x: f64) -> f64 {
        match activation {
            Activation::HardGelu if x <= -1.5 => 0.0,
            Activation::HardGelu if x >= 1.5 => x,
            Activation::HardGelu => x * (x + 1.5) / 3.0,
            Activation::Relu => x.max(0.0),
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::simd;

    /// A network with weights that follow a fixed pattern of both signs.
    pub fn patterned(sizes: &[usize], features: usize, activation: Activation) -> Network {
        patterned_from(1, sizes, features, activation)
    }

    /// [`patterned`] with another pattern for every seed.
    pub fn patterned_from(seed: u32, sizes: &[usize], features: usize, activation: Activation) -> Network {
        let mut state = seed;
        let mut next = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32 - 0.5
        };
        let layers = sizes
            .windows(2)
            .map(|w| Layer {
                weight: (0..w[0] * w[1]).map(|_| next() * 2.0 / (w[0] as f32).sqrt()).collect(),
                bias: (0..w[1]).map(|_| next()).collect(),
            })
            .collect();
        Network::new(layers, features, activation).unwrap()
    }

    crate::dispatch! {
        fn forward_tile(isa, n: &Network, bias: &[Lane], x: &[Lane], y: &mut Rows<LANES>) {
            n.forward_tile(isa, bias.as_flattened(), x, y);
        }
    }
    crate::dispatch! {
        fn forward_one(isa, n: &Network, bias: &[Lane], x: &[f32], y: &mut One) {
            n.forward_one(isa, bias, x, y);
        }
    }

    const SHAPES: [(&[usize], usize); 6] = [
        (&[10, 16, 16, 6], 6),
        (&[14, 32, 32, 32, 6], 6),
        (&[10, 64, 64, 3], 6),
        (&[6, 21, 21, 3], 6),
        (&[9, 16, 16, 16, 1], 5),
        (&[4, 3], 4),
    ];

    #[test]
    fn tile_and_single_agree_and_with_the_reference() {
        for (sizes, features) in SHAPES {
            for activation in [Activation::HardGelu, Activation::Relu] {
                let network = patterned(sizes, features, activation);
                let latent: Vec<f32> = (0..network.latent()).map(|i| 0.3 - 0.2 * i as f32).collect();
                let bias = network.fold(&latent);
                let mut x = [[0.0; LANES]; MAX_WIDTH];
                for (i, x) in x.iter_mut().take(features).enumerate() {
                    for (lane, x) in x.iter_mut().enumerate() {
                        *x = ((i * 7 + lane * 3) % 11) as f32 / 5.0 - 1.0;
                    }
                }
                let mut tile = Rows::default();
                forward_tile(&network, &bias, &x, &mut tile);
                for lane in 0..LANES {
                    let one: Vec<f32> = x[..features].iter().map(|x| x[lane]).collect();
                    let mut y = One::default();
                    forward_one(&network, &bias, &one, &mut y);
                    let features: Vec<f64> = one.iter().map(|&x| x.into()).collect();
                    let latent: Vec<f64> = latent.iter().map(|&z| z.into()).collect();
                    let truth = reference::forward(&network, &features, &latent);
                    for output in 0..network.outputs() {
                        let difference = (tile[output][lane] - y[output]).abs();
                        assert!(difference < 2e-6, "{sizes:?} on {}: {difference}", simd::isa_name());
                        assert!((f64::from(y[output]) - truth[output]).abs() < 3e-6, "{sizes:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn derivative_is_the_slope_of_the_value() {
        for activation in [Activation::HardGelu, Activation::Relu] {
            for i in -300..300 {
                let x = i as f32 * 0.01 + 0.005;
                let slope = (activation.value(x + 1e-3) - activation.value(x - 1e-3)) / 2e-3;
                assert!((activation.derivative(x) - slope).abs() < 2e-3, "{activation:?} at {x}");
            }
        }
    }

    #[test]
    fn layers_that_do_not_fit_are_refused() {
        let layer = |inputs: usize, outputs: usize| Layer {
            weight: vec![0.1; inputs * outputs],
            bias: vec![0.0; outputs],
        };
        let new = |layers| Network::new(layers, 6, Activation::Relu).unwrap_err();
        assert!(new(vec![]).contains("at least one"));
        assert!(new(vec![layer(6, 8), layer(9, 3)]).contains("yields 8"));
        assert!(new(vec![layer(5, 3)]).contains("at least 6"));
        assert!(new(vec![layer(6, MAX_WIDTH + 1)]).contains("expected 1 to 64"));
        let mut broken = layer(6, 3);
        broken.weight[4] = f32::NAN;
        assert!(new(vec![broken]).contains("not finite"));
    }

    #[test]
    fn weights_whose_sums_overflow_are_refused() {
        let network = |weight: f32| {
            let layer = |inputs: usize, outputs: usize| Layer {
                weight: vec![weight; inputs * outputs],
                bias: vec![0.0; outputs],
            };
            Network::new(vec![layer(6, 16), layer(16, 16), layer(16, 3)], 6, Activation::HardGelu)
        };
        // The limit of float16, in which models may come.
        assert!(network(65_504.0).is_ok());
        assert!(network(1e12).unwrap_err().contains("overflow"));
    }
}

//! Small multilayer perceptrons: their weights, and the kernels that evaluate them.
//!
//! Two shapes of kernel share one set of weights. [`Network::forward_tile`] takes [`LANES`] samples
//! side by side, with lanes across samples; [`Network::forward_one`] takes one sample, with lanes
//! across neurons. The two add in the same order, so that their results differ by nothing.

use crate::simd::{Isa, LANES, Lane};

/// Widest layer that the kernels hold on the stack.
pub const MAX_WIDTH: usize = 64;

/// Neurons are padded to a multiple of this in the tile kernel, the most rows it takes at once, …
const ROW_BLOCK: usize = 8;

/// … and to a multiple of [`LANES`] in the single kernel.
const MAX_VECTORS: usize = MAX_WIDTH / LANES;

/// One affine layer, y = W x + b.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// W, row-major [outputs][inputs].
    pub weight: Vec<f32>,
    /// b, [outputs].
    pub bias: Vec<f32>,
}

impl Layer {
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
    /// The function's value.
    #[inline(always)]
    #[must_use]
    pub fn value(self, x: f32) -> f32 {
        match self {
            // The parabola on the limited x, and the rest of x on top: no branch.
            Activation::HardGelu => {
                let t = x.clamp(-1.5, 1.5);
                t * (t + 1.5) * (1.0 / 3.0) + (x - 1.5).max(0.0)
            }
            Activation::Relu => x.max(0.0),
        }
    }

    /// The function's derivative.
    #[inline(always)]
    #[must_use]
    pub fn derivative(self, x: f32) -> f32 {
        match self {
            Activation::HardGelu => {
                let inside = (2.0 * x + 1.5) * (1.0 / 3.0);
                let left = if x > -1.5 { inside } else { 0.0 };
                if x < 1.5 { left } else { 1.0 }
            }
            Activation::Relu => {
                if x > 0.0 {
                    1.0
                } else {
                    0.0
                }
            }
        }
    }
}

/// A layer's weights in the orders that the kernels read.
#[derive(Clone, Debug)]
struct PackedLayer {
    inputs: usize,
    /// Outputs, padded to a multiple of [`ROW_BLOCK`].
    rows: usize,
    /// [rows/4][inputs][4]: what the tile kernel broadcasts, four rows at a time.
    by_rows: Vec<[f32; 4]>,
    /// [inputs][vectors]: what the single kernel loads, [`LANES`] rows at a time.
    by_columns: Vec<Lane>,
    /// [vectors].
    bias: Vec<Lane>,
}

impl PackedLayer {
    /// Packs the columns `first..first + inputs` of `layer`.
    fn new(layer: &Layer, first: usize, inputs: usize) -> Self {
        let rows = layer.outputs().next_multiple_of(ROW_BLOCK);
        let vectors = layer.outputs().div_ceil(LANES);
        let mut by_rows = vec![[0.0; 4]; rows / 4 * inputs];
        let mut by_columns = vec![[0.0; LANES]; vectors * inputs];
        let mut bias = vec![[0.0; LANES]; vectors];
        for row in 0..layer.outputs() {
            bias[row / LANES][row % LANES] = layer.bias[row];
            for column in 0..inputs {
                let w = layer.weight[row * layer.inputs() + first + column];
                by_rows[row / 4 * inputs + column][row % 4] = w;
                by_columns[column * vectors + row / LANES][row % LANES] = w;
            }
        }
        PackedLayer { inputs, rows, by_rows, by_columns, bias }
    }

    /// y = activation(W x + bias) for [`LANES`] samples, with `bias` in place of the layer's own.
    #[inline(always)]
    fn forward_tile<I: Isa>(
        &self,
        isa: I,
        bias: &[Lane],
        x: &[Lane],
        y: &mut [Lane; MAX_WIDTH],
        activation: Option<Activation>,
    ) {
        // The two shapes of the same loop nest, with all accumulators in registers.
        if I::ROWS == 8 {
            self.forward_rows::<I, 8, 2>(isa, bias, x, y, activation);
        } else {
            self.forward_rows::<I, 4, 1>(isa, bias, x, y, activation);
        }
    }

    /// [`PackedLayer::forward_tile`], `ROWS` = 4 `GROUPS` rows at a time.
    #[inline(always)]
    fn forward_rows<I: Isa, const ROWS: usize, const GROUPS: usize>(
        &self,
        isa: I,
        bias: &[Lane],
        x: &[Lane],
        y: &mut [Lane; MAX_WIDTH],
        activation: Option<Activation>,
    ) {
        let x = &x[..self.inputs];
        for row in (0..self.rows).step_by(ROWS) {
            let mut sums = [isa.splat(0.0); ROWS];
            for r in 0..ROWS {
                sums[r] = isa.splat(bias[(row + r) / LANES][(row + r) % LANES]);
            }
            let weights = &self.by_rows[row / 4 * self.inputs..][..GROUPS * self.inputs];
            for (column, x) in x.iter().enumerate() {
                let x = isa.load(x);
                for group in 0..GROUPS {
                    let w = weights[group * self.inputs + column];
                    for r in 0..4 {
                        sums[4 * group + r] = isa.fma(isa.splat(w[r]), x, sums[4 * group + r]);
                    }
                }
            }
            for r in 0..ROWS {
                store_activated(isa, sums[r], activation, &mut y[row + r]);
            }
        }
    }

    /// y = activation(W x + bias) for one sample; `y` has a whole number of vectors.
    #[inline(always)]
    fn forward_one<I: Isa>(
        &self,
        isa: I,
        bias: &[Lane],
        x: &[f32],
        y: &mut [Lane; MAX_VECTORS],
        activation: Option<Activation>,
    ) {
        // All of the layer's accumulators at once, for as many as it has.
        match self.bias.len() {
            1 => self.forward_vectors::<I, 1>(isa, bias, x, y, activation),
            2 => self.forward_vectors::<I, 2>(isa, bias, x, y, activation),
            3 => self.forward_vectors::<I, 3>(isa, bias, x, y, activation),
            _ => self.forward_vectors::<I, MAX_VECTORS>(isa, bias, x, y, activation),
        }
    }

    #[inline(always)]
    fn forward_vectors<I: Isa, const VECTORS: usize>(
        &self,
        isa: I,
        bias: &[Lane],
        x: &[f32],
        y: &mut [Lane; MAX_VECTORS],
        activation: Option<Activation>,
    ) {
        let mut sums = [isa.splat(0.0); VECTORS];
        for v in 0..VECTORS {
            sums[v] = isa.load(&bias[v]);
        }
        let (columns, _) = self.by_columns.as_chunks::<VECTORS>();
        for (weights, &x) in columns.iter().zip(&x[..self.inputs]) {
            let x = isa.splat(x);
            for v in 0..VECTORS {
                sums[v] = isa.fma(isa.load(&weights[v]), x, sums[v]);
            }
        }
        for v in 0..VECTORS {
            store_activated(isa, sums[v], activation, &mut y[v]);
        }
    }
}

#[inline(always)]
fn store_activated<I: Isa>(isa: I, sum: I::Vector, activation: Option<Activation>, to: &mut Lane) {
    isa.store(sum, to);
    if let Some(activation) = activation {
        for lane in 0..LANES {
            to[lane] = activation.value(to[lane]);
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

impl Network {
    /// A network from its layers, first to last; the first takes `features` values and then a
    /// latent code.
    ///
    /// # Errors
    /// What does not fit together, in words: a layer whose inputs are not its predecessor's
    /// outputs, one wider than [`MAX_WIDTH`], a bias or weight of the wrong length, a non-finite
    /// weight.
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
        let packed = layers
            .iter()
            .enumerate()
            .map(|(i, layer)| PackedLayer::new(layer, 0, if i == 0 { features } else { layer.inputs() }))
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

    /// The first layer's bias with the latent code's part added, in the order of the kernels.
    ///
    /// # Panics
    /// If `latent` is shorter than [`Network::latent`].
    #[must_use]
    pub fn fold(&self, latent: &[f32]) -> Vec<Lane> {
        let first = &self.layers[0];
        let mut bias = self.packed[0].bias.clone();
        for (row, weights) in first.weight.chunks_exact(first.inputs()).enumerate() {
            let weights = &weights[self.features..];
            let part: f64 = weights.iter().zip(latent).map(|(&w, &z)| f64::from(w) * f64::from(z)).sum();
            let bias = &mut bias[row / LANES][row % LANES];
            *bias = (f64::from(*bias) + part) as f32;
        }
        bias
    }

    /// Evaluates [`LANES`] samples: `x[feature][lane]` to `y[output][lane]`, `first_bias` from
    /// [`Network::fold`]. `y` beyond [`Network::outputs`] is overwritten too.
    #[inline(always)]
    pub fn forward_tile<I: Isa>(&self, isa: I, first_bias: &[Lane], x: &[Lane], y: &mut [Lane; MAX_WIDTH]) {
        let last = self.packed.len() - 1;
        let mut hidden = [[[0.0; LANES]; MAX_WIDTH]; 2];
        let [mut from, mut to] = {
            let [a, b] = &mut hidden;
            [a, b]
        };
        for (i, layer) in self.packed.iter().enumerate() {
            let bias = if i == 0 { first_bias } else { &layer.bias };
            let x = if i == 0 { x } else { &from[..] };
            if i == last {
                layer.forward_tile(isa, bias, x, y, None);
            } else {
                layer.forward_tile(isa, bias, x, to, Some(self.activation));
                std::mem::swap(&mut from, &mut to);
            }
        }
    }

    /// Evaluates one sample: `x[feature]` to `y[output]`, otherwise as [`Network::forward_tile`].
    #[inline(always)]
    pub fn forward_one<I: Isa>(&self, isa: I, first_bias: &[Lane], x: &[f32], y: &mut [f32; MAX_WIDTH]) {
        let last = self.packed.len() - 1;
        let mut hidden = [[[0.0; LANES]; MAX_VECTORS]; 2];
        let [mut from, mut to] = {
            let [a, b] = &mut hidden;
            [a, b]
        };
        for (i, layer) in self.packed.iter().enumerate() {
            let bias = if i == 0 { first_bias } else { &layer.bias };
            let x = if i == 0 { x } else { from.as_flattened() };
            let activation = (i < last).then_some(self.activation);
            layer.forward_one(isa, bias, x, to, activation);
            std::mem::swap(&mut from, &mut to);
        }
        y.copy_from_slice(from.as_flattened());
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
        fn forward_tile(isa, n: &Network, bias: &[Lane], x: &[Lane], y: &mut [Lane; MAX_WIDTH]) {
            n.forward_tile(isa, bias, x, y);
        }
    }
    crate::dispatch! {
        fn forward_one(isa, n: &Network, bias: &[Lane], x: &[f32], y: &mut [f32; MAX_WIDTH]) {
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
    fn tile_and_single_agree_to_the_bit_and_with_the_reference() {
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
                let mut tile = [[0.0; LANES]; MAX_WIDTH];
                forward_tile(&network, &bias, &x, &mut tile);
                for lane in 0..LANES {
                    let one: Vec<f32> = x[..features].iter().map(|x| x[lane]).collect();
                    let mut y = [0.0; MAX_WIDTH];
                    forward_one(&network, &bias, &one, &mut y);
                    let features: Vec<f64> = one.iter().map(|&x| x.into()).collect();
                    let latent: Vec<f64> = latent.iter().map(|&z| z.into()).collect();
                    let truth = reference::forward(&network, &features, &latent);
                    for output in 0..network.outputs() {
                        assert_eq!(
                            tile[output][lane].to_bits(),
                            y[output].to_bits(),
                            "{sizes:?} on {}",
                            simd::isa_name()
                        );
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
}

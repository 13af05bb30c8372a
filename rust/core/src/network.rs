//! Small multilayer perceptrons: their weights, and the kernels that evaluate them.
//!
//! Two shapes of kernel share one set of weights. [`Network::forward_tile`] takes samples side by side,
//! with lanes across samples, and every sample's sums are in the order of the inputs, however many there
//! are. [`Network::forward_one`] takes one sample, with lanes across neurons, and adds sums of inputs
//! that are a few apart: a single chain of additions would take twice the time.
//!
//! HardGELU is x(x + 1.5)/3 between −1.5 and 1.5. In v = (x + 1.5)/3, limited to [0, 1] as t, a third of it
//! is t(t − ½) + max(v, 0) − t: two limits, which run beside the multiply-adds, two sums and one
//! multiply-add. The kernels therefore compute v and a third of the activation, and the packed weights and
//! biases have the factors and the shift in them.

use std::mem::MaybeUninit;

use crate::simd::{Isa, LANES, Lane, Lanes, Real, Task};

/// Widest layer that the kernels hold on the stack.
pub const MAX_WIDTH: usize = 64;

/// Neurons are padded to a multiple of this for the single kernel.
const ROW_BLOCK: usize = 8;

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
                let slope = inside.or_else(x.splat(-1.5).less(x), zero);
                (value, slope.or_else(x.less(x.splat(1.5)), one))
            }
            Activation::Relu => (x.max(zero), one.or_else(zero.less(x), zero)),
        }
    }
}

/// How the kernels' numbers differ from a network's: they compute `scale` x + `shift` in place of the sum x
/// before an activation, and the activation over `gain` in place of the activation.
#[derive(Clone, Copy)]
struct Units {
    scale: f64,
    shift: f64,
    gain: f64,
}

impl Units {
    const PLAIN: Units = Units { scale: 1.0, shift: 0.0, gain: 1.0 };
}

impl Activation {
    fn units(self) -> Units {
        match self {
            Activation::HardGelu => Units { scale: 1.0 / 3.0, shift: 0.5, gain: 3.0 },
            Activation::Relu => Units::PLAIN,
        }
    }

    /// The activation in the kernels' units.
    #[inline(always)]
    fn activate<I: Lanes<L>, const L: usize>(self, isa: I, v: I::Vector) -> I::Vector {
        let v = isa.positive(v);
        match self {
            Activation::HardGelu => {
                let t = isa.min_positive(v, isa.splat(1.0));
                isa.fma(t, isa.sub(t, isa.splat(0.5)), isa.sub(v, t))
            }
            Activation::Relu => v,
        }
    }
}

/// A layer's weights in the order and units in which the kernels read them.
#[derive(Clone, Debug)]
struct PackedLayer {
    inputs: usize,
    rows: usize,
    /// Rows with those of zeros, to a multiple of [`ROW_BLOCK`].
    stride: usize,
    /// [inputs][stride].
    weights: Vec<f32>,
    /// [rows], with zeros to whole lanes.
    bias: Vec<Lane>,
}

impl PackedLayer {
    /// Packs the first columns of `layer`, `inputs` of them, which come in the units `from`; the sums go in
    /// the units `to`.
    fn new(layer: &Layer, inputs: usize, from: Units, to: Units) -> Self {
        let rows = layer.outputs();
        let stride = rows.next_multiple_of(ROW_BLOCK);
        let mut weights = vec![0.0; stride * inputs];
        let mut bias = vec![[0.0; LANES]; rows.div_ceil(LANES)];
        for row in 0..rows {
            bias[row / LANES][row % LANES] = (to.scale * f64::from(layer.bias[row]) + to.shift) as f32;
            for column in 0..inputs {
                let w = f64::from(layer.weight[row * layer.inputs() + column]);
                weights[column * stride + row] = (w * from.gain * to.scale) as f32;
            }
        }
        PackedLayer { inputs, rows, stride, weights, bias }
    }

    /// y = activation(W x + bias) for one sample.
    #[inline(always)]
    fn forward_one<I: Isa>(
        &self,
        isa: I,
        bias: &[Lane],
        x: &[f32],
        y: &mut One,
        activation: Option<Activation>,
    ) {
        // As many sums at once as hide the latency of a multiply-add: of all rows, and of inputs that
        // are a few apart.
        match (self.stride, I::BATCH) {
            (16, 32) => self.forward_vectors::<I, 16, 1, 8>(isa, bias, x, y, 0, activation),
            (16, 16) => self.forward_vectors::<I, 8, 2, 4>(isa, bias, x, y, 0, activation),
            (32, 32) => self.forward_vectors::<I, 16, 2, 4>(isa, bias, x, y, 0, activation),
            (32, 16) => self.forward_vectors::<I, 8, 4, 2>(isa, bias, x, y, 0, activation),
            (64, 32) => self.forward_vectors::<I, 16, 4, 2>(isa, bias, x, y, 0, activation),
            (64, 16) => self.forward_vectors::<I, 8, 8, 1>(isa, bias, x, y, 0, activation),
            (_, 16 | 32) => {
                for row in (0..self.stride).step_by(ROW_BLOCK) {
                    self.forward_vectors::<I, 8, 1, 8>(isa, bias, x, y, row, activation);
                }
            }
            _ => {
                for row in (0..self.stride).step_by(ROW_BLOCK) {
                    self.forward_vectors::<I, 4, 2, 4>(isa, bias, x, y, row, activation);
                }
            }
        }
    }

    /// Rows from `row` on, `VECTORS` · `L` of them, each as the sum of `PARTS` sums.
    #[inline(always)]
    fn forward_vectors<I: Lanes<L>, const L: usize, const VECTORS: usize, const PARTS: usize>(
        &self,
        isa: I,
        bias: &[Lane],
        x: &[f32],
        y: &mut One,
        row: usize,
        activation: Option<Activation>,
    ) {
        let mut sums = [[isa.splat(0.0); VECTORS]; PARTS];
        let (bias, _) = bias.as_flattened()[row..].as_chunks::<L>();
        for v in 0..VECTORS {
            sums[0][v] = isa.load(&bias[v]);
        }
        let (chunks, last) = x[..self.inputs].as_chunks::<PARTS>();
        let mut columns = self.weights.chunks_exact(self.stride);
        for x in chunks {
            for part in 0..PARTS {
                let Some(column) = columns.next() else { return };
                add_input(isa, &column[row..], x[part], &mut sums[part]);
            }
        }
        for part in 0..PARTS {
            if part < last.len() {
                let Some(column) = columns.next() else { return };
                add_input(isa, &column[row..], last[part], &mut sums[part]);
            }
        }
        let mut half = PARTS / 2;
        while half > 0 {
            for part in 0..half {
                for v in 0..VECTORS {
                    sums[part][v] = isa.add(sums[part][v], sums[part + half][v]);
                }
            }
            half /= 2;
        }
        let (y, _) = y.0[row..].as_chunks_mut::<L>();
        for v in 0..VECTORS {
            let sum = match activation {
                Some(activation) => activation.activate(isa, sums[0][v]),
                None => sums[0][v],
            };
            isa.store(sum, &mut y[v]);
        }
    }
}

/// The values of a layer for one sample.
#[repr(align(64))]
pub struct One([f32; MAX_WIDTH]);

impl One {
    /// The values from the `FIRST` on, as a register of four takes them.
    #[inline(always)]
    pub(crate) fn four_from<const FIRST: usize>(&self) -> &[f32; 4] {
        const { assert!(FIRST + 4 <= MAX_WIDTH) };
        self.0[FIRST..].first_chunk().expect("FIRST + 4 is at most MAX_WIDTH")
    }
}

impl Default for One {
    #[inline(always)]
    fn default() -> Self {
        One([0.0; MAX_WIDTH])
    }
}

impl std::ops::Deref for One {
    type Target = [f32; MAX_WIDTH];

    #[inline(always)]
    fn deref(&self) -> &[f32; MAX_WIDTH] {
        &self.0
    }
}

/// `sums[v]` += the weights of one input, `column`, times its value x.
#[inline(always)]
fn add_input<I: Lanes<L>, const L: usize, const VECTORS: usize>(
    isa: I,
    column: &[f32],
    x: f32,
    sums: &mut [I::Vector; VECTORS],
) {
    let (weights, _) = column.as_chunks::<L>();
    let x = isa.splat(x);
    for v in 0..VECTORS {
        sums[v] = isa.fma(isa.load(&weights[v]), x, sums[v]);
    }
}

/// y = activation(W x + bias) for `L` samples, with `bias` in place of the layer's own.
struct LayerOfLanes<'a, B, const L: usize> {
    layer: &'a PackedLayer,
    bias: B,
    x: &'a [[f32; L]],
    y: &'a mut Rows<L>,
    activation: Option<Activation>,
}

impl<B: Bias<L>, const L: usize> Task<L> for LayerOfLanes<'_, B, L> {
    #[inline(always)]
    fn run<I: Lanes<L>>(self, isa: I) {
        let LayerOfLanes { layer, bias, x, y, activation } = self;
        y.clear();
        let x = &x[..layer.inputs];
        let mut row = 0;
        // The shapes of the same loop nest, with all accumulators in registers.
        while row < layer.rows {
            row += match layer.rows - row {
                8.. if I::ROWS == 8 => layer.forward_rows::<I, L, 8>(isa, row, bias, x, y, activation),
                // Eight are left to two blocks of four.
                6 | 7 | 10.. if I::ROWS >= 6 => {
                    layer.forward_rows::<I, L, 6>(isa, row, bias, x, y, activation)
                }
                4.. if I::ROWS >= 4 => layer.forward_rows::<I, L, 4>(isa, row, bias, x, y, activation),
                2.. => layer.forward_rows::<I, L, 2>(isa, row, bias, x, y, activation),
                _ => layer.forward_rows::<I, L, 1>(isa, row, bias, x, y, activation),
            };
        }
    }
}

impl PackedLayer {
    /// `ROWS` rows from `row` on: their sums, activated, are pushed to `y`. Returns `ROWS`.
    #[inline(always)]
    fn forward_rows<I: Lanes<L>, const L: usize, const ROWS: usize>(
        &self,
        isa: I,
        row: usize,
        bias: impl Bias<L>,
        x: &[[f32; L]],
        y: &mut Rows<L>,
        activation: Option<Activation>,
    ) -> usize {
        /// Columns between two branches: short loops with many exits are what a processor mispredicts.
        const UNROLLED: usize = 8;
        let mut sums = [isa.splat(0.0); ROWS];
        for r in 0..ROWS {
            sums[r] = bias.row(isa, row + r);
        }
        let (chunks, last) = x.as_chunks::<UNROLLED>();
        // By its number and not by `chunks_exact`, which begins with a division.
        let mut at = row;
        for x in chunks {
            // One check for all weights of the block.
            let weights = &self.weights[at..][..(UNROLLED - 1) * self.stride + ROWS];
            for column in 0..UNROLLED {
                add_column(isa, &weights[column * self.stride..], &x[column], &mut sums);
            }
            at += UNROLLED * self.stride;
        }
        for x in last {
            add_column(isa, &self.weights[at..], x, &mut sums);
            at += self.stride;
        }
        let rows = y.push::<ROWS>();
        for r in 0..ROWS {
            let sum = match activation {
                Some(activation) => activation.activate(isa, sums[r]),
                None => sums[r],
            };
            isa.store(sum, &mut rows[r]);
        }
        ROWS
    }
}

/// `sums[r]` += `weights[r]` x.
#[inline(always)]
fn add_column<I: Lanes<L>, const L: usize, const ROWS: usize>(
    isa: I,
    weights: &[f32],
    x: &[f32; L],
    sums: &mut [I::Vector; ROWS],
) {
    let (weights, x) = (&weights[..ROWS], isa.load(x));
    for r in 0..ROWS {
        sums[r] = isa.fma(isa.splat(weights[r]), x, sums[r]);
    }
}

/// What the sums of a layer begin with.
pub trait Bias<const L: usize>: Copy {
    /// One row.
    fn row<I: Lanes<L>>(self, isa: I, row: usize) -> I::Vector;
}

/// The same in every lane: `[vector][row]`.
impl<const L: usize> Bias<L> for &[f32] {
    #[inline(always)]
    fn row<I: Lanes<L>>(self, isa: I, row: usize) -> I::Vector {
        isa.splat(self[row])
    }
}

/// Another in every lane: `[row][lane]`.
impl<const L: usize> Bias<L> for &[[f32; L]] {
    #[inline(always)]
    fn row<I: Lanes<L>>(self, isa: I, row: usize) -> I::Vector {
        isa.load(&self[row])
    }
}

/// Up to [`MAX_WIDTH`] values of `L` samples each, on the stack: what a layer yields.
#[repr(align(64))]
pub struct Rows<const L: usize> {
    /// Not set to zero first, which would cost as much as a layer.
    values: [MaybeUninit<[f32; L]>; MAX_WIDTH],
    len: usize,
}

impl<const L: usize> Default for Rows<L> {
    #[inline(always)]
    fn default() -> Self {
        Rows { values: [const { MaybeUninit::uninit() }; MAX_WIDTH], len: 0 }
    }
}

impl<const L: usize> Rows<L> {
    #[inline(always)]
    fn clear(&mut self) {
        self.len = 0;
    }

    /// `ROWS` more rows of zeros, to be overwritten.
    #[inline(always)]
    fn push<const ROWS: usize>(&mut self) -> &mut [[f32; L]; ROWS] {
        let rows: &mut [MaybeUninit<[f32; L]>; ROWS] =
            self.values[self.len..].first_chunk_mut().expect("no layer is wider than MAX_WIDTH");
        for row in rows.iter_mut() {
            row.write([0.0; L]);
        }
        self.len += ROWS;
        // SAFETY: the rows have just been written, and the layouts are the same.
        unsafe { &mut *std::ptr::from_mut(rows).cast() }
    }
}

impl<const L: usize> std::ops::Deref for Rows<L> {
    type Target = [[f32; L]];

    #[inline(always)]
    fn deref(&self) -> &[[f32; L]] {
        // SAFETY: the first `len` rows have been written.
        unsafe { std::slice::from_raw_parts(self.values.as_ptr().cast(), self.len) }
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

//! A network in training: its numbers as one flat vector, and its gradient for a block of samples.
//!
//! Samples stand side by side in [`COLUMNS`] columns of [`LANES`], so that a row of a layer's values
//! is contiguous: forward and backward run along the columns, and a weight's derivative is the dot
//! product of two rows. All three are loops over fixed arrays, compiled for each instruction set.

use glimt_core::dispatch;
use glimt_core::kernels::network::{Activation, Layer, add_column};
use glimt_core::simd::{LANES, Lane, Lanes, Vector};

/// Columns of lanes in a block.
pub const COLUMNS: usize = 16;

/// Samples in a block.
pub const BLOCK: usize = COLUMNS * LANES;

/// One value for every sample of a block.
pub type Row = [Lane; COLUMNS];

/// A row of zeros.
pub const ZERO_ROW: Row = [[0.0; LANES]; COLUMNS];

/// Sizes of a network's layers, and where each layer's numbers are in the flat vector:
/// weight (row-major [outputs][inputs]), then bias, layer after layer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shape {
    sizes: Vec<usize>,
    activation: Activation,
}

impl Shape {
    /// A network with `inputs` (features and latent code), `hidden` equal layers and `outputs`.
    #[must_use]
    pub fn new(inputs: usize, hidden: &[usize], outputs: usize, activation: Activation) -> Self {
        let sizes = [&[inputs], hidden, &[outputs]].concat();
        Shape { sizes, activation }
    }

    /// The nonlinearity between the layers.
    #[must_use]
    pub fn activation(&self) -> Activation {
        self.activation
    }

    /// Number of layers.
    #[must_use]
    pub fn layers(&self) -> usize {
        self.sizes.len() - 1
    }

    /// Number of inputs of the first layer.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.sizes[0]
    }

    /// Inputs and outputs of a layer.
    #[must_use]
    pub fn layer(&self, layer: usize) -> (usize, usize) {
        (self.sizes[layer], self.sizes[layer + 1])
    }

    /// Numbers of one layer: weights and biases.
    fn layer_len(&self, layer: usize) -> usize {
        (self.sizes[layer] + 1) * self.sizes[layer + 1]
    }

    /// Numbers of the whole network.
    #[must_use]
    pub fn len(&self) -> usize {
        (0..self.layers()).map(|layer| self.layer_len(layer)).sum()
    }

    /// Whether the network has no numbers; it always has.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// First number of a layer.
    fn offset(&self, layer: usize) -> usize {
        (0..layer).map(|layer| self.layer_len(layer)).sum()
    }

    /// Weights and biases of a layer in the flat vector.
    #[must_use]
    pub fn split<'a>(&self, numbers: &'a [f32], layer: usize) -> (&'a [f32], &'a [f32]) {
        let (inputs, outputs) = self.layer(layer);
        numbers[self.offset(layer)..][..self.layer_len(layer)].split_at(inputs * outputs)
    }

    /// Weights and biases of a layer in the flat vector, to write to.
    pub fn split_mut<'a>(&self, numbers: &'a mut [f32], layer: usize) -> (&'a mut [f32], &'a mut [f32]) {
        let (inputs, outputs) = self.layer(layer);
        numbers[self.offset(layer)..][..self.layer_len(layer)].split_at_mut(inputs * outputs)
    }

    /// The layers as the core takes them.
    #[must_use]
    pub fn to_layers(&self, numbers: &[f32]) -> Vec<Layer> {
        (0..self.layers())
            .map(|layer| {
                let (weight, bias) = self.split(numbers, layer);
                Layer { weight: weight.to_vec(), bias: bias.to_vec() }
            })
            .collect()
    }

    /// The flat vector of a network's layers.
    #[must_use]
    pub fn from_layers(layers: &[Layer]) -> Vec<f32> {
        layers.iter().flat_map(|layer| layer.weight.iter().chain(&layer.bias).copied()).collect()
    }
}

/// The values of one block in every layer.
pub struct Workspace {
    /// Inputs of each layer: features, then activations. `values[layers]` is the output.
    pub values: Vec<Vec<Row>>,
    /// Slopes of the activation, for each layer but the last.
    slopes: Vec<Vec<Row>>,
    /// Derivatives of the loss with respect to a layer's sums, and to its inputs.
    delta: Vec<Row>,
    next_delta: Vec<Row>,
    /// A layer's weights, [inputs][outputs].
    transposed: Vec<f32>,
}

impl Workspace {
    /// Room for one block of `shape`.
    #[must_use]
    pub fn new(shape: &Shape) -> Self {
        let widest = shape.sizes.iter().copied().max().unwrap_or(0);
        let hidden = &shape.sizes[1..shape.layers()];
        Workspace {
            values: shape.sizes.iter().map(|&size| vec![ZERO_ROW; size]).collect(),
            slopes: hidden.iter().map(|&size| vec![ZERO_ROW; size]).collect(),
            delta: vec![ZERO_ROW; widest],
            next_delta: vec![ZERO_ROW; widest],
            transposed: vec![0.0; widest * widest],
        }
    }

    /// The network's outputs after [`forward`].
    #[must_use]
    pub fn outputs(&self) -> &[Row] {
        &self.values[self.values.len() - 1]
    }

    /// Where [`backward`] reads the derivatives of the loss with respect to the outputs.
    pub fn output_delta(&mut self) -> &mut [Row] {
        let outputs = self.values[self.values.len() - 1].len();
        &mut self.delta[..outputs]
    }

    /// [`Workspace::outputs`] and [`Workspace::output_delta`] at once.
    pub fn outputs_and_delta(&mut self) -> (&[Row], &mut [Row]) {
        let outputs = &self.values[self.values.len() - 1];
        (outputs, &mut self.delta[..outputs.len()])
    }

    /// The derivatives with respect to the inputs after [`backward`].
    #[must_use]
    pub fn input_delta(&self) -> &[Row] {
        &self.delta[..self.values[0].len()]
    }
}

dispatch! {
    /// Computes all layers from `workspace.values[0]`.
    pub fn forward(isa, shape: &Shape, numbers: &[f32], workspace: &mut Workspace) {
        for layer in 0..shape.layers() {
            let (inputs, outputs) = shape.layer(layer);
            let (weight, bias) = shape.split(numbers, layer);
            let matrix = &mut workspace.transposed[..weight.len()];
            for (o, row) in weight.chunks_exact(inputs).enumerate() {
                for (i, &w) in row.iter().enumerate() {
                    matrix[i * outputs + o] = w;
                }
            }
            let (before, after) = workspace.values.split_at_mut(layer + 1);
            let (x, y) = (&before[layer], &mut after[0]);
            product(isa, matrix, Some(bias), x, y);
            if let Some(slopes) = workspace.slopes.get_mut(layer) {
                activate(isa, shape.activation, y, slopes);
            }
        }
    }
}

dispatch! {
    /// From `workspace.output_delta()`, adds the derivatives of all numbers to `gradient` and leaves
    /// those of the inputs in `workspace.input_delta()`. [`forward`] comes first.
    pub fn backward(isa, shape: &Shape, numbers: &[f32], workspace: &mut Workspace, gradient: &mut [f32]) {
        for layer in (0..shape.layers()).rev() {
            let (inputs, outputs) = shape.layer(layer);
            let delta = &mut workspace.delta[..outputs];
            if let Some(slopes) = workspace.slopes.get(layer) {
                multiply(isa, delta, slopes);
            }
            let (weight_gradient, bias_gradient) = shape.split_mut(gradient, layer);
            outer_product(isa, delta, &workspace.values[layer], weight_gradient);
            for (gradient, delta) in bias_gradient.iter_mut().zip(&*delta) {
                *gradient += sum_row(delta);
            }
            let (weight, _) = shape.split(numbers, layer);
            product(isa, weight, None, delta, &mut workspace.next_delta[..inputs]);
            std::mem::swap(&mut workspace.delta, &mut workspace.next_delta);
        }
    }
}

/// From sums before the activation to the activation, and its slopes.
#[inline(always)]
fn activate<I: Lanes<LANES>>(isa: I, activation: Activation, y: &mut [Row], slopes: &mut [Row]) {
    for (y, slopes) in y.iter_mut().zip(slopes) {
        for column in 0..COLUMNS {
            let (value, slope) = activation.value_and_slope(Vector::load(isa, &y[column]));
            value.store(&mut y[column]);
            slope.store(&mut slopes[column]);
        }
    }
}

/// `delta` times `slopes`.
#[inline(always)]
fn multiply<I: Lanes<LANES>>(isa: I, delta: &mut [Row], slopes: &[Row]) {
    for (delta, slopes) in delta.iter_mut().zip(slopes) {
        for column in 0..COLUMNS {
            let product = Vector::<I, LANES>::load(isa, &delta[column]) * Vector::load(isa, &slopes[column]);
            product.store(&mut delta[column]);
        }
    }
}

/// y = Mᵀ x + bias for a block, with M as [x.len()][y.len()].
#[inline(always)]
fn product<I: Lanes<LANES>>(isa: I, matrix: &[f32], bias: Option<&[f32]>, x: &[Row], y: &mut [Row]) {
    // One column of all inputs stays in the first cache while all rows of it are computed.
    for column in 0..COLUMNS {
        let mut row = 0;
        while row < y.len() {
            // As many rows at a time as the registers hold, and the rest in smaller steps.
            row += match y.len() - row {
                8.. if I::ROWS == 8 => product_rows::<I, 8>(isa, matrix, bias, x, y, row, column),
                6 | 7 | 10.. if I::ROWS >= 6 => product_rows::<I, 6>(isa, matrix, bias, x, y, row, column),
                4.. => product_rows::<I, 4>(isa, matrix, bias, x, y, row, column),
                2.. => product_rows::<I, 2>(isa, matrix, bias, x, y, row, column),
                _ => product_rows::<I, 1>(isa, matrix, bias, x, y, row, column),
            };
        }
    }
}

#[inline(always)]
fn product_rows<I: Lanes<LANES>, const ROWS: usize>(
    isa: I,
    matrix: &[f32],
    bias: Option<&[f32]>,
    x: &[Row],
    y: &mut [Row],
    row: usize,
    column: usize,
) -> usize {
    let stride = y.len();
    let mut sums = [isa.splat(0.0); ROWS];
    if let Some(bias) = bias {
        for r in 0..ROWS {
            sums[r] = isa.splat(bias[row + r]);
        }
    }
    for (x, weights) in x.iter().zip(matrix.chunks_exact(stride)) {
        add_column(isa, &weights[row..], &x[column], &mut sums);
    }
    for r in 0..ROWS {
        isa.store(sums[r], &mut y[row + r][column]);
    }
    ROWS
}

/// `gradient[o][i]` += Σ over the block of `delta[o]` · `x[i]`.
#[inline(always)]
fn outer_product<I: Lanes<LANES>>(isa: I, delta: &[Row], x: &[Row], gradient: &mut [f32]) {
    let inputs = x.len();
    let mut o = 0;
    while o < delta.len() {
        let rows = if delta.len() - o >= 4 { 4 } else { 1 };
        let mut i = 0;
        while i < inputs {
            i += match (rows, inputs - i) {
                (4, 4..) if I::ROWS == 8 => dot_products::<I, 4, 4>(isa, delta, x, gradient, o, i),
                (4, 2..) => dot_products::<I, 4, 2>(isa, delta, x, gradient, o, i),
                (4, _) => dot_products::<I, 4, 1>(isa, delta, x, gradient, o, i),
                (_, 4..) => dot_products::<I, 1, 4>(isa, delta, x, gradient, o, i),
                _ => dot_products::<I, 1, 1>(isa, delta, x, gradient, o, i),
            };
        }
        o += rows;
    }
}

#[inline(always)]
fn dot_products<I: Lanes<LANES>, const O: usize, const N: usize>(
    isa: I,
    delta: &[Row],
    x: &[Row],
    gradient: &mut [f32],
    o: usize,
    i: usize,
) -> usize {
    let (delta, rows) = (&delta[o..o + O], &x[i..i + N]);
    let mut sums = [[isa.splat(0.0); N]; O];
    for column in 0..COLUMNS {
        for a in 0..O {
            let delta = isa.load(&delta[a][column]);
            for b in 0..N {
                sums[a][b] = isa.fma(delta, isa.load(&rows[b][column]), sums[a][b]);
            }
        }
    }
    for a in 0..O {
        for b in 0..N {
            let mut sum = [0.0; LANES];
            isa.store(sums[a][b], &mut sum);
            gradient[(o + a) * x.len() + i + b] += sum_lanes(sum);
        }
    }
    N
}

/// Sum over the samples of a block.
#[inline(always)]
#[must_use]
pub fn sum_row(row: &Row) -> f32 {
    let mut sum = [0.0; LANES];
    for column in row {
        for lane in 0..LANES {
            sum[lane] += column[lane];
        }
    }
    sum_lanes(sum)
}

/// Sum over the lanes, by halves: few instructions, and an order that does not depend on them.
#[inline(always)]
fn sum_lanes(mut x: Lane) -> f32 {
    let mut half = LANES / 2;
    while half > 0 {
        for lane in 0..half {
            x[lane] += x[lane + half];
        }
        half /= 2;
    }
    x[0]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pattern(n: usize, scale: f32) -> Vec<f32> {
        let mut state = 9u32;
        (0..n)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                ((state >> 8) as f32 / (1 << 24) as f32 - 0.5) * scale
            })
            .collect()
    }

    /// Loss for the test: Σ (1 + sample/BLOCK) · Σ_o (o + 1) y_o² / BLOCK.
    fn loss(shape: &Shape, numbers: &[f64], features: &[Vec<f64>]) -> f64 {
        let mut total = 0.0;
        for (s, features) in features.iter().enumerate() {
            let mut x = features.clone();
            let mut at = 0;
            for layer in 0..shape.layers() {
                let (inputs, outputs) = shape.layer(layer);
                let (weight, bias) = numbers[at..].split_at(inputs * outputs);
                at += (inputs + 1) * outputs;
                x = (0..outputs)
                    .map(|o| {
                        let sum: f64 =
                            (0..inputs).map(|i| weight[o * inputs + i] * x[i]).sum::<f64>() + bias[o];
                        match shape.activation {
                            _ if layer + 1 == shape.layers() => sum,
                            Activation::Relu => sum.max(0.0),
                            Activation::HardGelu if sum <= -1.5 => 0.0,
                            Activation::HardGelu if sum >= 1.5 => sum,
                            Activation::HardGelu => sum * (sum + 1.5) / 3.0,
                        }
                    })
                    .collect();
            }
            let weight = 1.0 + s as f64 / BLOCK as f64;
            total += weight * x.iter().enumerate().map(|(o, y)| (o + 1) as f64 * y * y).sum::<f64>()
                / BLOCK as f64;
        }
        total
    }

    #[test]
    fn gradient_is_the_finite_difference_for_every_number_and_input() {
        for (hidden, activation) in [
            (&[16, 16][..], Activation::HardGelu),
            (&[21, 21], Activation::Relu),
            (&[32], Activation::HardGelu),
        ] {
            let shape = Shape::new(10, hidden, 6, activation);
            let numbers = pattern(shape.len(), 1.2);
            let mut workspace = Workspace::new(&shape);
            let features = pattern(10 * BLOCK, 2.0);
            for (i, row) in workspace.values[0].iter_mut().enumerate() {
                for s in 0..BLOCK {
                    row[s / LANES][s % LANES] = features[i * BLOCK + s];
                }
            }
            forward(&shape, &numbers, &mut workspace);
            for o in 0..6 {
                for s in 0..BLOCK {
                    let y = workspace.outputs()[o][s / LANES][s % LANES];
                    let weight = 1.0 + s as f32 / BLOCK as f32;
                    workspace.output_delta()[o][s / LANES][s % LANES] =
                        2.0 * weight * (o + 1) as f32 * y / BLOCK as f32;
                }
            }
            let mut gradient = vec![0.0; shape.len()];
            backward(&shape, &numbers, &mut workspace, &mut gradient);

            let mut numbers: Vec<f64> = numbers.iter().map(|&x| x.into()).collect();
            let mut samples: Vec<Vec<f64>> =
                (0..BLOCK).map(|s| (0..10).map(|i| features[i * BLOCK + s].into()).collect()).collect();
            let check = |derivative: f32, slope: f64, what: &str| {
                let tolerance = 1e-3 * slope.abs() + 2e-5;
                assert!(
                    (f64::from(derivative) - slope).abs() < tolerance,
                    "{what}: {derivative} against {slope}"
                );
            };
            const STEP: f64 = 1e-5;
            // Every ninth number reaches all layers, weights and biases, in a second.
            for n in (0..numbers.len()).step_by(9).chain(numbers.len() - 6..numbers.len()) {
                let original = numbers[n];
                let mut at = |x| {
                    numbers[n] = x;
                    loss(&shape, &numbers, &samples)
                };
                let slope = (at(original + STEP) - at(original - STEP)) / (2.0 * STEP);
                numbers[n] = original;
                check(gradient[n], slope, &format!("number {n}"));
            }
            for (s, i) in [(0, 0), (17, 3), (BLOCK - 1, 9)] {
                let original = samples[s][i];
                let mut at = |x| {
                    samples[s][i] = x;
                    loss(&shape, &numbers, &samples)
                };
                let slope = (at(original + STEP) - at(original - STEP)) / (2.0 * STEP);
                samples[s][i] = original;
                check(
                    workspace.input_delta()[i][s / LANES][s % LANES],
                    slope,
                    &format!("input {i} of sample {s}"),
                );
            }
        }
    }
}

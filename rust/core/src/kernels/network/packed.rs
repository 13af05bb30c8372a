//! The layers of a network as the kernels read them, and the two kernels.
//!
//! [`LayerOfLanes`] takes samples side by side, with lanes across samples, and every sample's sums are in the
//! order of the inputs, however many there are. [`PackedLayer::forward_one`] takes one sample, with lanes
//! across neurons, and adds sums of inputs that are a few apart: a single chain of additions would take
//! twice the time.
//!
//! HardGELU is x(x + 1.5)/3 between −1.5 and 1.5. In v = (x + 1.5)/3, limited to [0, 1] as t, a third of it
//! is t(t − ½) + max(v, 0) − t: two limits, which run beside the multiply-adds, two sums and one
//! multiply-add. The kernels therefore compute v and a third of the activation, and the packed weights and
//! biases have the factors and the shift in them.

use super::values::{Bias, One, Rows};
use super::{Activation, Layer};
use crate::simd::{Isa, LANES, Lane, Lanes, Task};

/// Neurons are padded to a multiple of this for the single kernel.
const ROW_BLOCK: usize = 8;

/// How the kernels' numbers differ from a network's: they compute `scale` x + `shift` in place of the sum x
/// before an activation, and the activation over `gain` in place of the activation.
#[derive(Clone, Copy)]
pub(super) struct Units {
    pub(super) scale: f64,
    pub(super) shift: f64,
    gain: f64,
}

impl Units {
    pub(super) const PLAIN: Units = Units { scale: 1.0, shift: 0.0, gain: 1.0 };
}

impl Activation {
    pub(super) fn units(self) -> Units {
        match self {
            Activation::HardGelu => Units { scale: 1.0 / 3.0, shift: 0.5, gain: 3.0 },
            Activation::Relu => Units::PLAIN,
        }
    }

    /// The activation in the kernels' units.
    #[inline(always)]
    pub(crate) fn activate<I: Lanes<L>, const L: usize>(self, isa: I, v: I::Vector) -> I::Vector {
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
pub(super) struct PackedLayer {
    inputs: usize,
    rows: usize,
    /// Rows with those of zeros, to a multiple of [`ROW_BLOCK`].
    stride: usize,
    /// [inputs][stride].
    weights: Vec<f32>,
    /// [rows], with zeros to whole lanes.
    pub(super) bias: Vec<Lane>,
}

impl PackedLayer {
    /// Packs the first columns of `layer`, `inputs` of them, which come in the units `from`; the sums go in
    /// the units `to`.
    pub(super) fn new(layer: &Layer, inputs: usize, from: Units, to: Units) -> Self {
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

    /// W x of the inputs from `first` on, in the units of the sums.
    pub(super) fn products(&self, first: usize, x: &[f32]) -> Vec<f32> {
        let columns = self.weights.chunks_exact(self.stride).skip(first).zip(x);
        let mut sums = vec![0.0; self.rows];
        for (column, &x) in columns {
            for (sum, &w) in sums.iter_mut().zip(column) {
                *sum += f64::from(w) * f64::from(x);
            }
        }
        sums.into_iter().map(|sum| sum as f32).collect()
    }

    /// y = activation(W x + bias) for one sample.
    #[inline(always)]
    pub(super) fn forward_one<I: Isa>(
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
pub(super) struct LayerOfLanes<'a, B, const L: usize> {
    pub(super) layer: &'a PackedLayer,
    pub(super) bias: B,
    pub(super) x: &'a [[f32; L]],
    pub(super) y: &'a mut Rows<L>,
    pub(super) activation: Option<Activation>,
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
        if let Some(activation) = activation {
            for r in 0..ROWS {
                sums[r] = activation.activate(isa, sums[r]);
            }
        }
        y.push(isa, sums);
        ROWS
    }
}

/// `sums[r]` += `weights[r]` x: what every product of a matrix and lanes consists of, in training too.
#[inline(always)]
pub fn add_column<I: Lanes<L>, const L: usize, const ROWS: usize>(
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

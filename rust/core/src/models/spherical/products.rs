//! The first layer in the tables.
//!
//! The layer is linear in the features, and these are in the rows of the tables: its weights times a row are a row
//! of as many numbers as it has neurons, and the blend of such rows is what the layer would make of the blended
//! features. A pair then costs a few longer rows and no first layer, which is a third to three quarters of the
//! multiply-adds of small networks.

use std::collections::HashMap;

use super::Spherical;
use super::tables::{Layout, MAX_TABLES, Taps};
use crate::kernels::network::{MAX_WIDTH, Network, Rows};
use crate::simd::{Isa, LANES, Lanes, Task};

/// Largest memory of a material's products: half of the second cache of many processors. Longer ones come from
/// beyond it as soon as there is a second material, and are then slower than the layer.
const MAX_BYTES: usize = 1 << 19;

/// Rows of features times the first layer's weights, as the kernels scale them.
#[derive(Clone, Debug)]
pub(super) struct Products {
    /// Neurons of the first layer.
    width: usize,
    /// [entry][width].
    values: Vec<f32>,
    /// The entry of every point.
    entries: Vec<u32>,
}

impl Products {
    /// The products of features, [entry][k], where every point has the entry of `entries`: if the first layer
    /// is of a width that kernels are compiled for and not the last, and if they are finite and small.
    pub(super) fn new(layout: &Layout, network: &Network, values: &[f32], entries: &[u32]) -> Option<Self> {
        let k = usize::from(layout.form().features);
        let width = network.layers()[0].outputs();
        if network.layers().len() < 2 || ![LANES, 2 * LANES, 4 * LANES].contains(&width) {
            return None;
        }
        // Tables that share a primitive have products of their own, for other weights belong to them.
        let mut known = HashMap::new();
        let mut rows = Vec::new();
        let number = |(point, &entry): (usize, &u32)| {
            let row = (layout.table(point), entry);
            *known.entry(row).or_insert_with(|| {
                rows.push(row);
                rows.len() as u32 - 1
            })
        };
        let entries = entries.iter().enumerate().map(number).collect();
        if size_of::<f32>() * width * rows.len() > MAX_BYTES {
            return None;
        }
        let product = |(table, entry): (usize, u32)| {
            network.first_products(table * k, &values[entry as usize * k..][..k])
        };
        let values: Vec<f32> = rows.into_iter().flat_map(product).collect();
        // Infinity times a weight of 0 would not be a number.
        values.iter().all(|x| x.is_finite()).then_some(Products { width, values, entries })
    }

    /// The first layer of the pair in the first lane, `y[neuron]`.
    #[inline(always)]
    pub(super) fn first_layer_of_one<I: Isa>(
        &self,
        isa: I,
        material: &Spherical,
        taps: &[Taps<4>; MAX_TABLES],
        y: &mut [f32; MAX_WIDTH],
    ) {
        match self.width / LANES {
            1 => self.one::<I, 1>(isa, material, taps, y),
            2 => self.one::<I, 2>(isa, material, taps, y),
            _ => self.one::<I, 4>(isa, material, taps, y),
        }
    }

    #[inline(always)]
    fn one<I: Isa, const BLOCKS: usize>(
        &self,
        isa: I,
        material: &Spherical,
        taps: &[Taps<4>; MAX_TABLES],
        y: &mut [f32; MAX_WIDTH],
    ) {
        let sums = self.sums::<I, 4, BLOCKS>(isa, material, taps, 0);
        let (y, _) = y.as_chunks_mut();
        for block in 0..BLOCKS {
            let activated = material.network.activation().activate::<I, LANES>(isa, sums[block]);
            <I as Lanes<LANES>>::store(isa, activated, &mut y[block]);
        }
    }

    /// What the first layer's activation is applied to, in one lane.
    #[inline(always)]
    fn sums<I: Lanes<LANES>, const L: usize, const BLOCKS: usize>(
        &self,
        isa: I,
        material: &Spherical,
        taps: &[Taps<L>; MAX_TABLES],
        lane: usize,
    ) -> [I::Vector; BLOCKS] {
        let mut sums = [isa.splat(0.0); BLOCKS];
        for block in 0..BLOCKS {
            sums[block] = isa.load(&material.first_bias[block]);
        }
        let (blocks, _) = self.values.as_chunks::<LANES>();
        let (rows, _) = blocks.as_chunks::<BLOCKS>();
        let grids = material.layout.form().grids;
        for (table, taps) in taps.iter().enumerate().take(grids.tables()) {
            for tap in 0..material.layout.tap_count(table) {
                let row = &rows[self.entries[taps.points[tap][lane] as usize] as usize];
                let weight = isa.splat(taps.weights[tap][lane]);
                for block in 0..BLOCKS {
                    sums[block] = isa.fma(isa.load(&row[block]), weight, sums[block]);
                }
            }
        }
        sums
    }
}

/// The first layer of pairs side by side, `y[neuron][lane]`.
pub(super) struct FirstLayer<'a, const L: usize> {
    pub(super) products: &'a Products,
    pub(super) material: &'a Spherical,
    pub(super) taps: &'a [Taps<L>; MAX_TABLES],
    pub(super) y: &'a mut Rows<L>,
}

impl<const L: usize> Task<L> for FirstLayer<'_, L> {
    #[inline(always)]
    fn run<I: Lanes<L>>(self, isa: I) {
        match self.products.width / LANES {
            1 => self.blend::<I, 1, 16>(isa),
            2 => self.blend::<I, 2, 32>(isa),
            _ => self.blend::<I, 4, 64>(isa),
        }
    }
}

impl<const L: usize> FirstLayer<'_, L> {
    #[inline(always)]
    fn blend<I: Lanes<L>, const BLOCKS: usize, const WIDTH: usize>(self, isa: I) {
        let FirstLayer { products, material, taps, y } = self;
        let mut rows = [[0.0; WIDTH]; L];
        for lane in 0..L {
            let sums = products.sums::<I::Isa, L, BLOCKS>(isa.isa(), material, taps, lane);
            let (blocks, _) = rows[lane].as_chunks_mut::<LANES>();
            for block in 0..BLOCKS {
                isa.isa().store(sums[block], &mut blocks[block]);
            }
        }
        for first in (0..WIDTH).step_by(4) {
            let mut columns = isa.columns(&rows, first);
            for c in 0..4 {
                columns[c] = material.network.activation().activate(isa, columns[c]);
            }
            y.push(isa, columns);
        }
    }
}

//! From the places of pairs in the tables to what the network sees of them.
//!
//! Pixels and weights are computed with pairs in the lanes. Features are read one pair after the other, a row
//! at a time with the features in the lanes, and change places with the pairs when they are blended: a gather
//! would read every feature of every pair by itself.

use super::Spherical;
use super::tables::{MAX_TABLES, Taps};
use crate::kernels::network::Rows;
use crate::simd::{Isa, Lanes, Task};

/// Most features that a network sees.
pub(super) const MAX_INPUTS: usize = MAX_TABLES * 16;

impl Spherical {
    /// ψ of the pair in the first lane, `x[feature]`.
    #[inline(always)]
    pub(super) fn features_of_one<I: Isa>(
        &self,
        isa: I,
        taps: &[Taps<4>; MAX_TABLES],
        x: &mut [f32; MAX_INPUTS],
    ) {
        match self.layout.form().features {
            4 => self.blend_one::<I, 4>(isa, taps, x),
            8 => self.blend_one::<I, 8>(isa, taps, x),
            _ => self.blend_one::<I, 16>(isa, taps, x),
        }
    }

    #[inline(always)]
    fn blend_one<I: Isa + Lanes<K>, const K: usize>(
        &self,
        isa: I,
        taps: &[Taps<4>; MAX_TABLES],
        x: &mut [f32; MAX_INPUTS],
    ) {
        let grids = self.layout.form().grids;
        let (x, _) = x.as_chunks_mut::<K>();
        for (table, taps) in taps.iter().enumerate().take(grids.tables()) {
            x[table] = if table < grids.axes() {
                self.row::<I, 4, K, 2>(isa, taps, 0)
            } else {
                self.row::<I, 4, K, 4>(isa, taps, 0)
            };
        }
    }

    /// Features of one lane from one table.
    #[inline(always)]
    fn row<I: Lanes<K>, const L: usize, const K: usize, const TAPS: usize>(
        &self,
        isa: I,
        taps: &Taps<L>,
        lane: usize,
    ) -> [f32; K] {
        let (values, _) = self.values.as_chunks::<K>();
        let mut sum = isa.splat(0.0);
        for tap in 0..TAPS {
            let row = &values[self.entries[taps.points[tap][lane] as usize] as usize];
            sum = isa.fma(isa.load(row), isa.splat(taps.weights[tap][lane]), sum);
        }
        let mut features = [0.0; K];
        isa.store(sum, &mut features);
        features
    }
}

/// ψ of pairs side by side, `x[feature][lane]`.
pub(super) struct Features<'a, const L: usize> {
    pub(super) material: &'a Spherical,
    pub(super) taps: &'a [Taps<L>; MAX_TABLES],
    pub(super) x: &'a mut Rows<L>,
}

impl<const L: usize> Task<L> for Features<'_, L> {
    #[inline(always)]
    fn run<I: Lanes<L>>(self, isa: I) {
        match self.material.layout.form().features {
            4 => self.blend::<I, 4>(isa),
            8 => self.blend::<I, 8>(isa),
            _ => self.blend::<I, 16>(isa),
        }
    }
}

impl<const L: usize> Features<'_, L> {
    #[inline(always)]
    fn blend<I: Lanes<L>, const K: usize>(self, isa: I)
    where
        I::Isa: Lanes<K>,
    {
        let Features { material, taps, x } = self;
        let mut rows = [[0.0; K]; L];
        let grids = material.layout.form().grids;
        for (table, taps) in taps.iter().enumerate().take(grids.tables()) {
            if table < grids.axes() {
                for lane in 0..L {
                    rows[lane] = material.row::<I::Isa, L, K, 2>(isa.isa(), taps, lane);
                }
            } else {
                for lane in 0..L {
                    rows[lane] = material.row::<I::Isa, L, K, 4>(isa.isa(), taps, lane);
                }
            }
            for first in (0..K).step_by(4) {
                x.push(isa, isa.columns(&rows, first));
            }
        }
    }
}

//! The values between layers, on the stack, and the biases that a layer's sums begin with.

use std::mem::MaybeUninit;

use super::MAX_WIDTH;
use crate::simd::Lanes;

/// The values of a layer for one sample.
#[repr(align(64))]
pub struct One(pub(super) [f32; MAX_WIDTH]);

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
    pub(super) fn clear(&mut self) {
        self.len = 0;
    }

    /// `ROWS` more rows.
    #[inline(always)]
    pub(crate) fn push<I: Lanes<L>, const ROWS: usize>(&mut self, isa: I, vectors: [I::Vector; ROWS]) {
        let rows: &mut [MaybeUninit<[f32; L]>; ROWS] =
            self.values[self.len..].first_chunk_mut().expect("no layer is wider than MAX_WIDTH");
        for r in 0..ROWS {
            // Stored to the row itself once this is compiled.
            let mut row = [0.0; L];
            isa.store(vectors[r], &mut row);
            rows[r].write(row);
        }
        self.len += ROWS;
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

//! What kernels are held against.

use std::hint::black_box;

use super::{Lanes, Real, Vector};
use crate::dispatch;

/// As many accumulators as hide the latency of a multiply-add, and still are registers.
const ACCUMULATORS: usize = 12;

dispatch! {
    /// `count` multiply-adds in registers and nothing else, by the instruction set of all kernels: the
    /// least time that a network with as many can take. `sink` keeps them from being left out.
    pub fn multiply_adds(isa, count: usize, sink: &mut f32) {
        match I::BATCH {
            32 => in_registers::<I, 16>(isa, count, sink),
            16 => in_registers::<I, 8>(isa, count, sink),
            _ => in_registers::<I, 4>(isa, count, sink),
        }
    }
}

/// A register has `L` lanes.
#[inline(always)]
fn in_registers<I: Lanes<L>, const L: usize>(isa: I, count: usize, sink: &mut f32) {
    let (a, b) = (Vector::new(isa, black_box(0.999)), Vector::new(isa, black_box(1e-3)));
    let mut sums = [Vector::new(isa, black_box(1.0)); ACCUMULATORS];
    for _ in 0..count / (L * ACCUMULATORS) {
        for sum in &mut sums {
            *sum = sum.fma(a, b);
        }
    }
    for sum in sums {
        *sink += sum.to_array().iter().sum::<f32>();
    }
}

//! Whatever the target guarantees: plain loops over four floats, which compilers turn into the vector
//! instructions that every machine of the target has (SSE2 on x86-64). Nothing is fused.

use super::register::{Register, lanes};
use super::{Isa, SQRT_HALF_BITS};

/// The instruction set that every machine has.
#[derive(Clone, Copy)]
pub struct Portable;

impl Isa for Portable {
    const BATCH: usize = 4;
}

lanes!(Portable: 4 in 1 x Quad, 4 rows);
lanes!(Portable: 8 in 2 x Quad, 4 rows);
lanes!(Portable: 16 in 4 x Quad, 2 rows);
lanes!(Portable: 32 in 8 x Quad, 1 rows);

/// Four floats.
#[derive(Clone, Copy)]
pub struct Quad([f32; 4]);

macro_rules! lane_by_lane {
    ($($name:ident($first:ident $(, $other:ident)*) = $value:expr;)*) => {
        $(
            #[inline(always)]
            unsafe fn $name(self $(, $other: Self)*) -> Self {
                let mut y = self;
                for i in 0..4 {
                    let $first = self.0[i];
                    $(let $other = $other.0[i];)*
                    y.0[i] = $value;
                }
                y
            }
        )*
    };
}

// Nothing here is unsafe but the reads and writes behind pointers: every machine runs it.
impl Register for Quad {
    type Mask = [bool; 4];
    const LANES: usize = 4;

    #[inline(always)]
    unsafe fn splat(x: f32) -> Self {
        Quad([x; 4])
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the caller's promise of four floats; an array has the alignment of its elements.
        Quad(unsafe { *from.cast::<[f32; 4]>() })
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: as in `load`.
        unsafe { *to.cast::<[f32; 4]>() = self.0 };
    }

    #[inline(always)]
    unsafe fn load_triples(from: *const f32) -> [Self; 3] {
        // SAFETY: the caller's promise of twelve floats.
        let v = unsafe { *from.cast::<[[f32; 3]; 4]>() };
        let mut y = [Quad([0.0; 4]); 3];
        for c in 0..3 {
            y[c] = Quad([v[0][c], v[1][c], v[2][c], v[3][c]]);
        }
        y
    }

    #[inline(always)]
    unsafe fn columns(from: *const f32, stride: usize) -> [Self; 4] {
        let mut y = [Quad([0.0; 4]); 4];
        for row in 0..4 {
            // SAFETY: the caller's promise of four floats in each row.
            let four = unsafe { *from.add(row * stride).cast::<[f32; 4]>() };
            for c in 0..4 {
                y[c].0[row] = four[c];
            }
        }
        y
    }

    lane_by_lane! {
        add(a, b) = a + b;
        sub(a, b) = a - b;
        mul(a, b) = a * b;
        div(a, b) = a / b;
        fma(a, b, c) = a * b + c;
        sqrt(a) = a.sqrt();
        min(a, b) = if a < b { a } else { b };
        max(a, b) = if a > b { a } else { b };
        positive(a) = if a > 0.0 { a } else { 0.0 };
        min_positive(a, b) = if a < b { a } else { b };
        power_of_two(n) = f32::from_bits((((n as i32) + 127) << 23) as u32);
    }

    #[inline(always)]
    unsafe fn lt(self, b: Self) -> [bool; 4] {
        let mut mask = [false; 4];
        for i in 0..4 {
            mask[i] = self.0[i] < b.0[i];
        }
        mask
    }

    #[inline(always)]
    unsafe fn and(mut a: [bool; 4], b: [bool; 4]) -> [bool; 4] {
        for i in 0..4 {
            a[i] &= b[i];
        }
        a
    }

    #[inline(always)]
    unsafe fn any(mask: [bool; 4]) -> bool {
        mask[0] | mask[1] | mask[2] | mask[3]
    }

    #[inline(always)]
    unsafe fn select(mask: [bool; 4], mut a: Self, b: Self) -> Self {
        for i in 0..4 {
            a.0[i] = if mask[i] { a.0[i] } else { b.0[i] };
        }
        a
    }

    #[inline(always)]
    unsafe fn exponent_and_mantissa(self) -> (Self, Self) {
        let (mut n, mut m) = (self, self);
        for i in 0..4 {
            let bits = self.0[i].to_bits() as i32;
            let exponent = bits.wrapping_sub(SQRT_HALF_BITS) >> 23;
            n.0[i] = exponent as f32;
            m.0[i] = f32::from_bits(bits.wrapping_sub(exponent << 23) as u32);
        }
        (n, m)
    }
}

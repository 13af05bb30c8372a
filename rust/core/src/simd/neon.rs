//! NEON, which every 64-bit ARM has.

use std::arch::aarch64::*;

use super::register::{Register, lanes};
use super::{Isa, SQRT_HALF_BITS};

/// NEON.
#[derive(Clone, Copy)]
pub struct Neon(());

impl Neon {
    /// The proof: every machine of the target has it.
    #[must_use]
    #[allow(clippy::new_without_default)]
    pub fn new() -> Self {
        Neon(())
    }
}

impl Isa for Neon {
    const BATCH: usize = 8;
}

lanes!(Neon: 4 in 1 x float32x4_t, 8 rows);
lanes!(Neon: 8 in 2 x float32x4_t, 8 rows);
lanes!(Neon: 16 in 4 x float32x4_t, 4 rows);
lanes!(Neon: 32 in 8 x float32x4_t, 2 rows);

macro_rules! operations {
    ($($name:ident($($arg:ident),*) = $value:expr;)*) => {
        $(
            #[inline(always)]
            unsafe fn $name($($arg: Self),*) -> Self {
                // SAFETY: every machine of the target has NEON.
                unsafe { $value }
            }
        )*
    };
}

impl Register for float32x4_t {
    type Mask = uint32x4_t;
    const LANES: usize = 4;

    #[inline(always)]
    unsafe fn splat(x: f32) -> Self {
        // SAFETY: every machine of the target has NEON.
        unsafe { vdupq_n_f32(x) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the caller's promise of four floats.
        unsafe { vld1q_f32(from) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: the caller's promise of four floats.
        unsafe { vst1q_f32(to, self) }
    }

    #[inline(always)]
    unsafe fn load_triples(from: *const f32) -> [Self; 3] {
        // SAFETY: the caller's promise of twelve floats.
        let float32x4x3_t(x, y, z) = unsafe { vld3q_f32(from) };
        [x, y, z]
    }

    #[inline(always)]
    unsafe fn columns(from: *const f32, stride: usize) -> [Self; 4] {
        // SAFETY: the caller's promise of four floats in each row; every machine of the target has NEON.
        unsafe {
            let [a, b] = [vld1q_f32(from), vld1q_f32(from.add(stride))];
            let [c, d] = [vld1q_f32(from.add(2 * stride)), vld1q_f32(from.add(3 * stride))];
            // Of two rows, every second column side by side.
            let [ab, cd] = [vtrnq_f32(a, b), vtrnq_f32(c, d)];
            [
                vcombine_f32(vget_low_f32(ab.0), vget_low_f32(cd.0)),
                vcombine_f32(vget_low_f32(ab.1), vget_low_f32(cd.1)),
                vcombine_f32(vget_high_f32(ab.0), vget_high_f32(cd.0)),
                vcombine_f32(vget_high_f32(ab.1), vget_high_f32(cd.1)),
            ]
        }
    }

    operations! {
        add(a, b) = vaddq_f32(a, b);
        sub(a, b) = vsubq_f32(a, b);
        mul(a, b) = vmulq_f32(a, b);
        div(a, b) = vdivq_f32(a, b);
        fma(a, b, c) = vfmaq_f32(c, a, b);
        sqrt(a) = vsqrtq_f32(a);
        // NEON's own minimum passes NaN on.
        min(a, b) = vbslq_f32(vcltq_f32(a, b), a, b);
        max(a, b) = vbslq_f32(vcgtq_f32(a, b), a, b);
        positive(a) = vreinterpretq_f32_s32(vmaxq_s32(vreinterpretq_s32_f32(a), vdupq_n_s32(0)));
        min_positive(a, b) =
            vreinterpretq_f32_s32(vminq_s32(vreinterpretq_s32_f32(a), vreinterpretq_s32_f32(b)));
        power_of_two(n) =
            vreinterpretq_f32_s32(vshlq_n_s32::<23>(vaddq_s32(vcvtq_s32_f32(n), vdupq_n_s32(127))));
    }

    #[inline(always)]
    unsafe fn lt(self, b: Self) -> uint32x4_t {
        // SAFETY: every machine of the target has NEON.
        unsafe { vcltq_f32(self, b) }
    }

    #[inline(always)]
    unsafe fn and(a: uint32x4_t, b: uint32x4_t) -> uint32x4_t {
        // SAFETY: every machine of the target has NEON.
        unsafe { vandq_u32(a, b) }
    }

    #[inline(always)]
    unsafe fn any(mask: uint32x4_t) -> bool {
        // SAFETY: every machine of the target has NEON.
        unsafe { vmaxvq_u32(mask) != 0 }
    }

    #[inline(always)]
    unsafe fn select(mask: uint32x4_t, a: Self, b: Self) -> Self {
        // SAFETY: every machine of the target has NEON.
        unsafe { vbslq_f32(mask, a, b) }
    }

    #[inline(always)]
    unsafe fn exponent_and_mantissa(self) -> (Self, Self) {
        // SAFETY: every machine of the target has NEON.
        unsafe {
            let bits = vreinterpretq_s32_f32(self);
            let exponent = vshrq_n_s32::<23>(vsubq_s32(bits, vdupq_n_s32(SQRT_HALF_BITS)));
            let mantissa = vreinterpretq_f32_s32(vsubq_s32(bits, vshlq_n_s32::<23>(exponent)));
            (vcvtq_f32_s32(exponent), mantissa)
        }
    }
}

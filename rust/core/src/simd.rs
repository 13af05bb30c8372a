//! Instruction sets: one source for every kernel, compiled once for each and chosen at run time.
//!
//! A kernel is a function generic over [`Isa`]. Its matrix products are written with [`Isa::Vector`];
//! everything else is plain loops over [`LANES`] floats, which the compiler turns into vector
//! instructions. [`dispatch!`] compiles a kernel for each instruction set and runs the best that the
//! machine has.

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;

/// Samples that a kernel treats side by side: two AVX2 registers or one AVX-512 register.
pub const LANES: usize = 16;

/// One value for each of [`LANES`] samples.
pub type Lane = [f32; LANES];

/// Three components (a direction or a colour) for each of [`LANES`] samples.
pub type Lane3 = [Lane; 3];

/// An instruction set that the machine has: a value of such a type is the proof, and its methods are
/// therefore safe to call.
pub trait Isa: Copy {
    /// Output rows that a matrix kernel accumulates at once, 4 or 8: as many as fill the registers
    /// and hide the latency of the multiply-add.
    const ROWS: usize;

    /// [`LANES`] floats in registers.
    type Vector: Copy;

    /// The same number in every lane.
    fn splat(self, x: f32) -> Self::Vector;

    /// From memory.
    fn load(self, x: &Lane) -> Self::Vector;

    /// To memory.
    fn store(self, x: Self::Vector, to: &mut Lane);

    /// a·b + c, fused where the instruction set has it.
    fn fma(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
}

/// Whatever the target guarantees: SSE2 on x86-64, NEON on aarch64.
#[derive(Clone, Copy)]
pub struct Portable;

impl Isa for Portable {
    const ROWS: usize = 4;
    type Vector = Lane;

    #[inline(always)]
    fn splat(self, x: f32) -> Lane {
        [x; LANES]
    }

    #[inline(always)]
    fn load(self, x: &Lane) -> Lane {
        *x
    }

    #[inline(always)]
    fn store(self, x: Lane, to: &mut Lane) {
        *to = x;
    }

    #[inline(always)]
    fn fma(self, a: Lane, b: Lane, mut c: Lane) -> Lane {
        for lane in 0..LANES {
            c[lane] = if cfg!(target_arch = "aarch64") {
                a[lane].mul_add(b[lane], c[lane])
            } else {
                a[lane] * b[lane] + c[lane]
            };
        }
        c
    }
}

/// AVX2 with FMA.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
pub struct Avx2(());

#[cfg(target_arch = "x86_64")]
impl Avx2 {
    /// # Safety
    /// The machine must have AVX2 and FMA.
    #[must_use]
    pub unsafe fn new_unchecked() -> Self {
        Avx2(())
    }
}

#[cfg(target_arch = "x86_64")]
impl Isa for Avx2 {
    const ROWS: usize = 4;
    type Vector = [__m256; 2];

    #[inline(always)]
    fn splat(self, x: f32) -> [__m256; 2] {
        // SAFETY: `self` is the proof of AVX2.
        unsafe { [_mm256_set1_ps(x); 2] }
    }

    #[inline(always)]
    fn load(self, x: &Lane) -> [__m256; 2] {
        // SAFETY: `self` is the proof of AVX2; both halves are inside `x`, and unaligned loads are used.
        unsafe { [_mm256_loadu_ps(x.as_ptr()), _mm256_loadu_ps(x.as_ptr().add(8))] }
    }

    #[inline(always)]
    fn store(self, x: [__m256; 2], to: &mut Lane) {
        // SAFETY: `self` is the proof of AVX2; both halves are inside `to`, and unaligned stores are used.
        unsafe {
            _mm256_storeu_ps(to.as_mut_ptr(), x[0]);
            _mm256_storeu_ps(to.as_mut_ptr().add(8), x[1]);
        }
    }

    #[inline(always)]
    fn fma(self, a: [__m256; 2], b: [__m256; 2], c: [__m256; 2]) -> [__m256; 2] {
        // SAFETY: `self` is the proof of FMA.
        unsafe { [_mm256_fmadd_ps(a[0], b[0], c[0]), _mm256_fmadd_ps(a[1], b[1], c[1])] }
    }
}

/// AVX-512 (foundation).
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
pub struct Avx512(());

#[cfg(target_arch = "x86_64")]
impl Avx512 {
    /// # Safety
    /// The machine must have AVX-512F.
    #[must_use]
    pub unsafe fn new_unchecked() -> Self {
        Avx512(())
    }
}

#[cfg(target_arch = "x86_64")]
impl Isa for Avx512 {
    const ROWS: usize = 8;
    type Vector = __m512;

    #[inline(always)]
    fn splat(self, x: f32) -> __m512 {
        // SAFETY: `self` is the proof of AVX-512F.
        unsafe { _mm512_set1_ps(x) }
    }

    #[inline(always)]
    fn load(self, x: &Lane) -> __m512 {
        // SAFETY: `self` is the proof of AVX-512F; `x` has 16 floats, and an unaligned load is used.
        unsafe { _mm512_loadu_ps(x.as_ptr()) }
    }

    #[inline(always)]
    fn store(self, x: __m512, to: &mut Lane) {
        // SAFETY: `self` is the proof of AVX-512F; `to` has 16 floats, and an unaligned store is used.
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), x) }
    }

    #[inline(always)]
    fn fma(self, a: __m512, b: __m512, c: __m512) -> __m512 {
        // SAFETY: `self` is the proof of AVX-512F.
        unsafe { _mm512_fmadd_ps(a, b, c) }
    }
}

/// Name of the instruction set that [`dispatch!`] chooses on this machine.
#[must_use]
pub fn isa_name() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f") {
            return "AVX-512";
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            return "AVX2";
        }
    }
    "portable"
}

/// Defines a function whose body is compiled once for each instruction set, and that runs the best
/// that the machine has; in the body the first argument is a value of it, an [`Isa`].
///
/// What the body calls in its loops must be `#[inline(always)]`: only code that is inlined is
/// compiled for the instruction set.
#[macro_export]
macro_rules! dispatch {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($isa:ident $(, $arg:ident: $ty:ty)* $(,)?) $body:block) => {
        $(#[$meta])*
        $vis fn $name($($arg: $ty),*) {
            #[inline(always)]
            fn kernel<I: $crate::simd::Isa>($isa: I, $($arg: $ty),*) $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f")]
                fn avx512(isa: $crate::simd::Avx512, $($arg: $ty),*) {
                    kernel(isa, $($arg),*);
                }

                #[target_feature(enable = "avx2,fma")]
                fn avx2(isa: $crate::simd::Avx2, $($arg: $ty),*) {
                    kernel(isa, $($arg),*);
                }

                if is_x86_feature_detected!("avx512f") {
                    // SAFETY: the machine has AVX-512F.
                    return unsafe { avx512($crate::simd::Avx512::new_unchecked(), $($arg),*) };
                }
                if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                    // SAFETY: the machine has AVX2 and FMA.
                    return unsafe { avx2($crate::simd::Avx2::new_unchecked(), $($arg),*) };
                }
            }
            kernel($crate::simd::Portable, $($arg),*);
        }
    };
}
pub use dispatch;

//! Instruction sets: one source for every kernel, compiled once for each and chosen at run time.
//!
//! A kernel is a function generic over [`Isa`] whose loops run over fixed arrays of [`LANES`]
//! floats; the compiler turns those into vector instructions. [`dispatch!`] wraps it into one
//! function for each instruction set and picks the best that the machine has.

/// Samples that a kernel treats side by side: two AVX2 registers or one AVX-512 register.
pub const LANES: usize = 16;

/// One value for each of [`LANES`] samples.
pub type Lane = [f32; LANES];

/// Three components (a direction or a colour) for each of [`LANES`] samples.
pub type Lane3 = [Lane; 3];

/// An instruction set as the kernels see it.
pub trait Isa {
    /// Output rows that a matrix kernel accumulates at once, so that their accumulators fill the
    /// registers and hide the latency of the multiply-add.
    const ROWS: usize;

    /// a·b + c, fused where the instruction set has it.
    fn fma(a: f32, b: f32, c: f32) -> f32;
}

/// Whatever the target guarantees: SSE2 on x86-64, NEON on aarch64.
pub struct Portable;

impl Isa for Portable {
    const ROWS: usize = 4;

    #[inline(always)]
    fn fma(a: f32, b: f32, c: f32) -> f32 {
        if cfg!(target_arch = "aarch64") { a.mul_add(b, c) } else { a * b + c }
    }
}

/// AVX2 with FMA.
#[cfg(target_arch = "x86_64")]
pub struct Avx2;

#[cfg(target_arch = "x86_64")]
impl Isa for Avx2 {
    const ROWS: usize = 4;

    #[inline(always)]
    fn fma(a: f32, b: f32, c: f32) -> f32 {
        a.mul_add(b, c)
    }
}

/// AVX-512 (foundation).
#[cfg(target_arch = "x86_64")]
pub struct Avx512;

#[cfg(target_arch = "x86_64")]
impl Isa for Avx512 {
    const ROWS: usize = 8;

    #[inline(always)]
    fn fma(a: f32, b: f32, c: f32) -> f32 {
        a.mul_add(b, c)
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

/// Defines a function whose body is compiled once for each instruction set `I`, and that runs the
/// best that the machine has.
///
/// What the body calls in its loops must be `#[inline(always)]`: only code that is inlined is
/// compiled for the instruction set.
#[macro_export]
macro_rules! dispatch {
    ($(#[$meta:meta])* $vis:vis fn $name:ident<$isa:ident>($($arg:ident: $ty:ty),* $(,)?) $body:block) => {
        $(#[$meta])*
        $vis fn $name($($arg: $ty),*) {
            // A kernel without a matrix product has no use for `I` but to be compiled for it.
            #[allow(clippy::extra_unused_type_parameters)]
            #[inline(always)]
            fn kernel<$isa: $crate::simd::Isa>($($arg: $ty),*) $body

            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f")]
                fn avx512($($arg: $ty),*) {
                    kernel::<$crate::simd::Avx512>($($arg),*);
                }

                #[target_feature(enable = "avx2,fma")]
                fn avx2($($arg: $ty),*) {
                    kernel::<$crate::simd::Avx2>($($arg),*);
                }

                if is_x86_feature_detected!("avx512f") {
                    // SAFETY: the machine has AVX-512F.
                    return unsafe { avx512($($arg),*) };
                }
                if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                    // SAFETY: the machine has AVX2 and FMA.
                    return unsafe { avx2($($arg),*) };
                }
            }
            kernel::<$crate::simd::Portable>($($arg),*);
        }
    };
}
pub use dispatch;

//! Instruction sets: one source for every kernel, compiled once for each and chosen at run time.
//!
//! A kernel is a function generic over [`Isa`]. It computes in vectors of [`Lanes`], of as many floats as
//! it has pairs side by side, or in formulas generic over [`Real`], which are written as for one number.
//! [`dispatch!`] compiles a kernel for each instruction set and runs the best that the machine has, or the
//! one that the environment variable `GLIMT_ISA` names.

mod limit;
pub mod math;
#[cfg(target_arch = "aarch64")]
mod neon;
mod portable;
mod real;
mod register;
#[cfg(target_arch = "x86_64")]
mod x86;

use std::sync::atomic::{AtomicU8, Ordering};

pub use limit::multiply_adds;
#[cfg(target_arch = "aarch64")]
pub use neon::Neon;
pub use portable::Portable;
pub use real::{Real, Spread, Vector};
#[cfg(target_arch = "x86_64")]
pub use x86::{Avx2, Avx512};

/// Samples in a tile, the unit in which callers hand over pairs side by side.
pub const LANES: usize = 16;

/// One value for each of [`LANES`] samples.
pub type Lane = [f32; LANES];

/// Three components (a direction or a colour) for each of [`LANES`] samples.
pub type Lane3 = [Lane; 3];

/// `L` floats in the registers of an instruction set. A value of an implementing type is the proof that
/// the machine has the instruction set, and the methods are therefore safe to call.
pub trait Lanes<const L: usize>: Copy {
    /// Output rows that a matrix kernel accumulates at once: as many as fill the registers and hide the
    /// latency of the multiply-add.
    const ROWS: usize;

    /// The instruction set, in every number of lanes.
    type Isa: Isa;
    /// The floats.
    type Vector: Copy;
    /// A truth value for each.
    type Mask: Copy;

    /// The same instruction set, for other numbers of lanes.
    fn isa(self) -> Self::Isa;
    /// Runs a task as a function of its own, compiled once for the instruction set and the lanes, whatever
    /// kernels need it.
    fn run<T: Task<L>>(self, task: T);

    /// The same number in every lane.
    fn splat(self, x: f32) -> Self::Vector;
    /// From memory, at any alignment.
    fn load(self, x: &[f32; L]) -> Self::Vector;
    /// To memory, at any alignment.
    fn store(self, x: Self::Vector, to: &mut [f32; L]);
    /// `L` vectors of three, one after another in memory, as components side by side.
    fn load_triples(self, xyz: &[[f32; 3]; L]) -> [Self::Vector; 3];
    /// Four columns of `L` rows, from the column `first` on.
    fn columns<const K: usize>(self, rows: &[[f32; K]; L], first: usize) -> [Self::Vector; 4];
    /// a + b.
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a − b.
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a · b.
    fn mul(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a / b.
    fn div(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a·b + c, fused where the instruction set has it.
    fn fma(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    /// √x.
    fn sqrt(self, x: Self::Vector) -> Self::Vector;
    /// a where a < b, else b: b where either is NaN.
    fn min(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a where a > b, else b: b where either is NaN.
    fn max(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// x where it is positive, else 0; by the bits as an integer where that is faster, for the pipes of
    /// multiply-adds are what kernels are short of.
    fn positive(self, x: Self::Vector) -> Self::Vector;
    /// The smaller of two numbers that are not negative, likewise.
    fn min_positive(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a < b; false where either is NaN.
    fn lt(self, a: Self::Vector, b: Self::Vector) -> Self::Mask;
    /// a and b.
    fn and(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Whether the mask holds in any lane.
    fn any(self, mask: Self::Mask) -> bool;
    /// a where the mask holds, else b.
    fn select(self, mask: Self::Mask, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// 2ⁿ for whole numbers n from −126 to 127.
    fn power_of_two(self, n: Self::Vector) -> Self::Vector;
    /// (n, m) with x = m 2ⁿ and m in [√½, √2), for positive normal numbers x.
    fn exponent_and_mantissa(self, x: Self::Vector) -> (Self::Vector, Self::Vector);
}

/// A part of kernels that is large enough to be a function of its own, see [`Lanes::run`].
pub trait Task<const L: usize> {
    /// Does it. To be marked `#[inline(always)]`.
    fn run<I: Lanes<L>>(self, isa: I);
}

/// An instruction set, in every number of lanes.
pub trait Isa: Lanes<4> + Lanes<8> + Lanes<16> + Lanes<32> {
    /// Pairs side by side that are fastest in batches: two registers of them, as a weight that is loaded
    /// then serves twice; one where registers are few.
    const BATCH: usize;
}

/// Smallest bits of a mantissa in [√½, √2), which is where [`Lanes::exponent_and_mantissa`] splits.
const SQRT_HALF_BITS: i32 = 0x3f35_04f3;

/// What [`dispatch!`] chooses from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum InstructionSet {
    /// Whatever the target guarantees, unfused.
    Portable = 1,
    /// AVX2 with FMA.
    Avx2,
    /// AVX-512 (foundation).
    Avx512,
    /// NEON, which every 64-bit ARM has.
    Neon,
}

impl InstructionSet {
    /// From the least to the best.
    pub const ALL: [InstructionSet; 4] =
        [InstructionSet::Portable, InstructionSet::Avx2, InstructionSet::Avx512, InstructionSet::Neon];

    /// The name, as `GLIMT_ISA` spells it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            InstructionSet::Portable => "portable",
            InstructionSet::Avx2 => "avx2",
            InstructionSet::Avx512 => "avx512",
            InstructionSet::Neon => "neon",
        }
    }

    /// Whether the machine has it.
    #[must_use]
    pub fn is_available(self) -> bool {
        match self {
            InstructionSet::Portable => true,
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx512 => {
                InstructionSet::Avx2.is_available() && is_x86_feature_detected!("avx512f")
            }
            #[cfg(target_arch = "aarch64")]
            InstructionSet::Neon => true,
            #[allow(unreachable_patterns)]
            _ => false,
        }
    }

    /// The one that kernels use: what the environment variable `GLIMT_ISA` names, where the machine has
    /// it, and otherwise the best that the machine has. It is chosen once.
    #[must_use]
    #[inline]
    pub fn chosen() -> InstructionSet {
        /// 0 until it is known.
        static CHOSEN: AtomicU8 = AtomicU8::new(0);
        let known = CHOSEN.load(Ordering::Relaxed);
        match InstructionSet::ALL.get(usize::from(known).wrapping_sub(1)) {
            Some(&set) => set,
            None => {
                let set = InstructionSet::choose();
                CHOSEN.store(set as u8, Ordering::Relaxed);
                set
            }
        }
    }

    #[cold]
    fn choose() -> InstructionSet {
        let named = std::env::var("GLIMT_ISA").ok();
        let available = || InstructionSet::ALL.into_iter().filter(|set| set.is_available());
        available()
            .find(|set| named.as_deref() == Some(set.name()))
            .or(available().next_back())
            .unwrap_or(InstructionSet::Portable)
    }
}

/// Name of the instruction set that kernels use.
#[must_use]
pub fn isa_name() -> &'static str {
    InstructionSet::chosen().name()
}

/// Defines a function whose body is compiled once for each instruction set, and that runs the one of
/// [`InstructionSet::chosen`]; in the body the first argument is a value of it, an [`Isa`]. Generic
/// parameters stand in brackets.
///
/// What the body calls in its loops must be `#[inline(always)]`, and not a closure: only code that is
/// inlined is compiled for the instruction set.
#[macro_export]
macro_rules! dispatch {
    ($(#[$meta:meta])* $vis:vis fn $name:ident $([$($generics:tt)*])? (
        $isa:ident $(, $arg:ident: $ty:ty)* $(,)?
    ) $body:block) => {
        $(#[$meta])*
        $vis fn $name $(<$($generics)*>)? ($($arg: $ty),*) {
            #[inline(always)]
            fn kernel<I: $crate::simd::Isa, $($($generics)*)?>($isa: I, $($arg: $ty),*) $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx2,fma")]
            fn avx512 $(<$($generics)*>)? (isa: $crate::simd::Avx512, $($arg: $ty),*) {
                kernel(isa, $($arg),*);
            }

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2 $(<$($generics)*>)? (isa: $crate::simd::Avx2, $($arg: $ty),*) {
                kernel(isa, $($arg),*);
            }

            match $crate::simd::InstructionSet::chosen() {
                #[cfg(target_arch = "x86_64")]
                $crate::simd::InstructionSet::Avx512 => {
                    // SAFETY: only an available instruction set is chosen.
                    unsafe { avx512($crate::simd::Avx512::new_unchecked(), $($arg),*) }
                }
                #[cfg(target_arch = "x86_64")]
                $crate::simd::InstructionSet::Avx2 => {
                    // SAFETY: only an available instruction set is chosen.
                    unsafe { avx2($crate::simd::Avx2::new_unchecked(), $($arg),*) }
                }
                #[cfg(target_arch = "aarch64")]
                $crate::simd::InstructionSet::Neon => kernel($crate::simd::Neon::new(), $($arg),*),
                _ => kernel($crate::simd::Portable, $($arg),*),
            }
        }
    };
}
pub use dispatch;

//! Formulas that are written once, as for one number, and computed in any number of lanes.

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::{Lanes, SQRT_HALF_BITS};

/// A real number, or one in each of several lanes: what the formulas of features and models are generic over.
///
/// Plain operators are never fused; [`Real::fma`] is where the instruction set has it. Every operation
/// treats lanes alike, so that a lane's result depends neither on how many there are nor on the others.
pub trait Real:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Add<f32, Output = Self>
    + Sub<f32, Output = Self>
    + Mul<f32, Output = Self>
{
    /// A truth value in every lane.
    type Mask: Copy;
    /// The numbers of all lanes.
    type Array: Copy + AsRef<[f32]> + AsMut<[f32]>;

    /// The numbers one by one, for what cannot be written for all lanes at once.
    fn array(self) -> Self::Array;
    /// Numbers that were made one by one, in as many lanes as `self` has.
    fn with_array(self, lanes: &Self::Array) -> Self;
    /// The number `x` in as many lanes as `self` has.
    fn splat(self, x: f32) -> Self;
    /// self · a + b.
    fn fma(self, a: Self, b: Self) -> Self;
    /// √self.
    fn sqrt(self) -> Self;
    /// The smaller one; `limit` in place of NaN.
    fn min(self, limit: Self) -> Self;
    /// The larger one; `limit` in place of NaN.
    fn max(self, limit: Self) -> Self;
    /// self < other; false where either is NaN.
    fn lt(self, other: Self) -> Self::Mask;
    /// a and b.
    fn and(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// a where the mask holds, else b.
    fn select(mask: Self::Mask, a: Self, b: Self) -> Self;
    /// 2 to the power of self, a whole number from −126 to 127.
    fn power_of_two(self) -> Self;
    /// (n, m) with self = m 2ⁿ and m in [√½, √2), where self is a positive normal number.
    fn exponent_and_mantissa(self) -> (Self, Self);

    /// 1/self.
    #[inline(always)]
    fn reciprocal(self) -> Self {
        self.splat(1.0) / self
    }

    /// |self|.
    #[inline(always)]
    fn abs(self) -> Self {
        self.max(-self)
    }

    /// self limited to [low, high]; NaN stays NaN.
    #[inline(always)]
    fn clamped(self, low: f32, high: f32) -> Self {
        self.splat(high).min(self.splat(low).max(self))
    }

    /// self, or `limit` where that is smaller; NaN stays NaN.
    #[inline(always)]
    fn at_most(self, limit: f32) -> Self {
        self.splat(limit).min(self)
    }
}

/// A parameter of a formula in lanes: one number for all of them, or a number for each.
pub trait Spread<F>: Copy {
    /// The number of every lane, of which there are as many as `like` has.
    fn spread(self, like: F) -> F;
}

impl<F: Real> Spread<F> for f32 {
    #[inline(always)]
    fn spread(self, like: F) -> F {
        like.splat(self)
    }
}

impl<I: Lanes<L>, const L: usize> Spread<Self> for Vector<I, L> {
    #[inline(always)]
    fn spread(self, _: Self) -> Self {
        self
    }
}

impl Real for f32 {
    type Mask = bool;
    type Array = [f32; 1];

    #[inline(always)]
    fn array(self) -> [f32; 1] {
        [self]
    }

    #[inline(always)]
    fn with_array(self, lanes: &[f32; 1]) -> f32 {
        lanes[0]
    }

    #[inline(always)]
    fn splat(self, x: f32) -> f32 {
        x
    }

    #[inline(always)]
    fn fma(self, a: f32, b: f32) -> f32 {
        self * a + b
    }

    #[inline(always)]
    fn sqrt(self) -> f32 {
        f32::sqrt(self)
    }

    #[inline(always)]
    fn min(self, limit: f32) -> f32 {
        if self < limit { self } else { limit }
    }

    #[inline(always)]
    fn max(self, limit: f32) -> f32 {
        if self > limit { self } else { limit }
    }

    #[inline(always)]
    fn lt(self, other: f32) -> bool {
        self < other
    }

    #[inline(always)]
    fn and(self, a: bool, b: bool) -> bool {
        a & b
    }

    #[inline(always)]
    fn select(mask: bool, a: f32, b: f32) -> f32 {
        if mask { a } else { b }
    }

    #[inline(always)]
    fn power_of_two(self) -> f32 {
        f32::from_bits(((self as i32 + 127) << 23) as u32)
    }

    #[inline(always)]
    fn exponent_and_mantissa(self) -> (f32, f32) {
        let bits = self.to_bits() as i32;
        let exponent = bits.wrapping_sub(SQRT_HALF_BITS) >> 23;
        (exponent as f32, f32::from_bits(bits.wrapping_sub(exponent << 23) as u32))
    }
}

/// `L` numbers in the registers of `I`, as a [`Real`].
#[derive(Clone, Copy)]
pub struct Vector<I: Lanes<L>, const L: usize> {
    isa: I,
    lanes: I::Vector,
}

impl<I: Lanes<L>, const L: usize> Vector<I, L> {
    /// From memory.
    #[inline(always)]
    pub fn load(isa: I, x: &[f32; L]) -> Self {
        Vector { isa, lanes: isa.load(x) }
    }

    /// The same number in every lane.
    #[inline(always)]
    pub fn new(isa: I, x: f32) -> Self {
        Vector { isa, lanes: isa.splat(x) }
    }

    /// Three components from memory.
    #[inline(always)]
    pub fn load3(isa: I, x: &[[f32; L]; 3]) -> [Self; 3] {
        [Self::load(isa, &x[0]), Self::load(isa, &x[1]), Self::load(isa, &x[2])]
    }

    /// Three components of vectors that stand one after another.
    #[inline(always)]
    pub fn load_triples(isa: I, xyz: &[[f32; 3]; L]) -> [Self; 3] {
        let [x, y, z] = isa.load_triples(xyz);
        [Vector { isa, lanes: x }, Vector { isa, lanes: y }, Vector { isa, lanes: z }]
    }

    /// The columns of rows: number by number, that of every lane. There is a multiple of four of them.
    #[inline(always)]
    pub fn transpose<const N: usize>(isa: I, rows: &[[f32; N]; L]) -> [Self; N] {
        const { assert!(N.is_multiple_of(4)) };
        let mut columns = [Vector::new(isa, 0.0); N];
        for first in (0..N).step_by(4) {
            let four = isa.columns(rows, first);
            for i in 0..4 {
                columns[first + i] = Vector { isa, lanes: four[i] };
            }
        }
        columns
    }

    /// To memory.
    #[inline(always)]
    pub fn store(self, to: &mut [f32; L]) {
        self.isa.store(self.lanes, to);
    }

    /// The numbers in memory.
    #[inline(always)]
    #[must_use]
    pub fn to_array(self) -> [f32; L] {
        let mut x = [0.0; L];
        self.store(&mut x);
        x
    }

    /// The number in the first lane.
    #[inline(always)]
    #[must_use]
    pub fn first(self) -> f32 {
        self.to_array()[0]
    }

    /// The registers.
    #[inline(always)]
    pub(crate) fn lanes(self) -> I::Vector {
        self.lanes
    }

    /// Whether a mask of such numbers holds in any lane.
    #[inline(always)]
    pub fn any(isa: I, mask: I::Mask) -> bool {
        isa.any(mask)
    }
}

macro_rules! operator {
    ($trait:ident, $name:ident) => {
        impl<I: Lanes<L>, const L: usize> $trait for Vector<I, L> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Vector { isa: self.isa, lanes: self.isa.$name(self.lanes, other.lanes) }
            }
        }
    };
    ($trait:ident, $name:ident, f32) => {
        impl<I: Lanes<L>, const L: usize> $trait<f32> for Vector<I, L> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: f32) -> Self {
                Vector { isa: self.isa, lanes: self.isa.$name(self.lanes, self.isa.splat(other)) }
            }
        }
    };
}
operator!(Add, add);
operator!(Sub, sub);
operator!(Mul, mul);
operator!(Div, div);
operator!(Add, add, f32);
operator!(Sub, sub, f32);
operator!(Mul, mul, f32);

impl<I: Lanes<L>, const L: usize> Neg for Vector<I, L> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Vector { isa: self.isa, lanes: self.isa.sub(self.isa.splat(-0.0), self.lanes) }
    }
}

impl<I: Lanes<L>, const L: usize> Real for Vector<I, L> {
    type Mask = I::Mask;
    type Array = [f32; L];

    #[inline(always)]
    fn array(self) -> [f32; L] {
        self.to_array()
    }

    #[inline(always)]
    fn with_array(self, lanes: &[f32; L]) -> Self {
        Vector::load(self.isa, lanes)
    }

    #[inline(always)]
    fn splat(self, x: f32) -> Self {
        Vector { isa: self.isa, lanes: self.isa.splat(x) }
    }

    #[inline(always)]
    fn fma(self, a: Self, b: Self) -> Self {
        Vector { isa: self.isa, lanes: self.isa.fma(self.lanes, a.lanes, b.lanes) }
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Vector { isa: self.isa, lanes: self.isa.sqrt(self.lanes) }
    }

    #[inline(always)]
    fn min(self, limit: Self) -> Self {
        Vector { isa: self.isa, lanes: self.isa.min(self.lanes, limit.lanes) }
    }

    #[inline(always)]
    fn max(self, limit: Self) -> Self {
        Vector { isa: self.isa, lanes: self.isa.max(self.lanes, limit.lanes) }
    }

    #[inline(always)]
    fn lt(self, other: Self) -> I::Mask {
        self.isa.lt(self.lanes, other.lanes)
    }

    #[inline(always)]
    fn and(self, a: I::Mask, b: I::Mask) -> I::Mask {
        self.isa.and(a, b)
    }

    #[inline(always)]
    fn select(mask: I::Mask, a: Self, b: Self) -> Self {
        Vector { isa: a.isa, lanes: a.isa.select(mask, a.lanes, b.lanes) }
    }

    #[inline(always)]
    fn power_of_two(self) -> Self {
        Vector { isa: self.isa, lanes: self.isa.power_of_two(self.lanes) }
    }

    #[inline(always)]
    fn exponent_and_mantissa(self) -> (Self, Self) {
        let (n, m) = self.isa.exponent_and_mantissa(self.lanes);
        (Vector { isa: self.isa, lanes: n }, Vector { isa: self.isa, lanes: m })
    }
}

//! Numbers with their derivatives: formulas of the core that are generic over [`Real`], differentiated.

use std::ops::{Add, Div, Mul, Neg, Sub};

use glimt_core::simd::{Real, Spread};

/// A number, and its derivatives by `N` others.
///
/// Functions that take numbers apart, such as exponentials, are not differentiated: [`Real::power_of_two`],
/// [`Real::exponent_and_mantissa`] and [`Real::array`] drop the derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Dual<F, const N: usize> {
    /// The number.
    pub value: F,
    /// Its derivatives.
    pub slopes: [F; N],
}

impl<F: Real, const N: usize> Dual<F, N> {
    /// A number that does not change.
    #[inline(always)]
    pub fn constant(value: F) -> Self {
        Dual { value, slopes: [value.splat(0.0); N] }
    }

    /// The number by which derivative `index` is.
    #[inline(always)]
    pub fn variable(value: F, index: usize) -> Self {
        let mut dual = Dual::constant(value);
        dual.slopes[index] = value.splat(1.0);
        dual
    }

    #[inline(always)]
    fn scaled(value: F, slopes: [F; N], by: F) -> Self {
        let mut scaled = slopes;
        for i in 0..N {
            scaled[i] = slopes[i] * by;
        }
        Dual { value, slopes: scaled }
    }
}

impl<F: Real, const N: usize> Add for Dual<F, N> {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        self.value = self.value + other.value;
        for i in 0..N {
            self.slopes[i] = self.slopes[i] + other.slopes[i];
        }
        self
    }
}

impl<F: Real, const N: usize> Sub for Dual<F, N> {
    type Output = Self;
    #[inline(always)]
    fn sub(mut self, other: Self) -> Self {
        self.value = self.value - other.value;
        for i in 0..N {
            self.slopes[i] = self.slopes[i] - other.slopes[i];
        }
        self
    }
}

impl<F: Real, const N: usize> Mul for Dual<F, N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let mut slopes = self.slopes;
        for i in 0..N {
            slopes[i] = self.slopes[i].fma(other.value, other.slopes[i] * self.value);
        }
        Dual { value: self.value * other.value, slopes }
    }
}

impl<F: Real, const N: usize> Div for Dual<F, N> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let inverse = other.value.reciprocal();
        let ratio = self.value * inverse;
        let mut slopes = self.slopes;
        for i in 0..N {
            slopes[i] = (self.slopes[i] - other.slopes[i] * ratio) * inverse;
        }
        Dual { value: ratio, slopes }
    }
}

impl<F: Real, const N: usize> Neg for Dual<F, N> {
    type Output = Self;
    #[inline(always)]
    fn neg(mut self) -> Self {
        self.value = -self.value;
        for i in 0..N {
            self.slopes[i] = -self.slopes[i];
        }
        self
    }
}

impl<F: Real, const N: usize> Add<f32> for Dual<F, N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: f32) -> Self {
        Dual { value: self.value + other, ..self }
    }
}

impl<F: Real, const N: usize> Sub<f32> for Dual<F, N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: f32) -> Self {
        Dual { value: self.value - other, ..self }
    }
}

impl<F: Real, const N: usize> Mul<f32> for Dual<F, N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: f32) -> Self {
        Dual::scaled(self.value * other, self.slopes, self.value.splat(other))
    }
}

impl<F: Real, const N: usize> Real for Dual<F, N> {
    type Mask = F::Mask;
    type Array = F::Array;

    #[inline(always)]
    fn array(self) -> F::Array {
        self.value.array()
    }

    #[inline(always)]
    fn with_array(self, lanes: &F::Array) -> Self {
        Dual::constant(self.value.with_array(lanes))
    }

    #[inline(always)]
    fn splat(self, x: f32) -> Self {
        Dual::constant(self.value.splat(x))
    }

    #[inline(always)]
    fn fma(self, a: Self, b: Self) -> Self {
        self * a + b
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        // Where the root vanishes its slope is infinite: a large one serves.
        let inverse = root.max(root.splat(LEAST_ROOT)).reciprocal();
        Dual::scaled(root, self.slopes, inverse * 0.5)
    }

    #[inline(always)]
    fn min(self, limit: Self) -> Self {
        Dual::select(self.value.lt(limit.value), self, limit)
    }

    #[inline(always)]
    fn max(self, limit: Self) -> Self {
        Dual::select(limit.value.lt(self.value), self, limit)
    }

    #[inline(always)]
    fn lt(self, other: Self) -> F::Mask {
        self.value.lt(other.value)
    }

    #[inline(always)]
    fn and(self, a: F::Mask, b: F::Mask) -> F::Mask {
        self.value.and(a, b)
    }

    #[inline(always)]
    fn select(mask: F::Mask, a: Self, b: Self) -> Self {
        let mut slopes = a.slopes;
        for i in 0..N {
            slopes[i] = F::select(mask, a.slopes[i], b.slopes[i]);
        }
        Dual { value: F::select(mask, a.value, b.value), slopes }
    }

    #[inline(always)]
    fn power_of_two(self) -> Self {
        Dual::constant(self.value.power_of_two())
    }

    #[inline(always)]
    fn exponent_and_mantissa(self) -> (Self, Self) {
        let (exponent, mantissa) = self.value.exponent_and_mantissa();
        (Dual::constant(exponent), Dual::constant(mantissa))
    }
}

impl<F: Real, const N: usize> Spread<Self> for Dual<F, N> {
    #[inline(always)]
    fn spread(self, _: Self) -> Self {
        self
    }
}

const LEAST_ROOT: f32 = 1e-6;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_finite_differences() {
        fn formula<F: Real>(x: F, y: F) -> F {
            let root = (x * x + y * y + 0.5).sqrt();
            (x * 2.0 - y).max(x * y) / root - (x - 0.3).abs().min(y.fma(y, x))
        }
        for (x, y) in [(0.7, 0.2), (-0.4, 1.3), (2.0, -0.9), (0.1, 0.1)] {
            let dual = formula(Dual::<f32, 2>::variable(x, 0), Dual::variable(y, 1));
            let step = 1e-3;
            let by_x = (formula(x + step, y) - formula(x - step, y)) / (2.0 * step);
            let by_y = (formula(x, y + step) - formula(x, y - step)) / (2.0 * step);
            assert_eq!(dual.value, formula(x, y));
            assert!((dual.slopes[0] - by_x).abs() < 2e-3 && (dual.slopes[1] - by_y).abs() < 2e-3, "{dual:?}");
        }
    }
}

//! From the operations of one register to vectors of any number of them.

/// A vector register of floats. The methods' meanings are those of [`Lanes`](super::Lanes).
///
/// # Safety
/// The methods may only be called where the machine has the register's instruction set; `load` and `store`
/// touch as many floats as the register has, `load_triples` three times as many, and `columns` four floats in
/// each of as many rows.
pub trait Register: Copy {
    type Mask: Copy;
    const LANES: usize;

    unsafe fn splat(x: f32) -> Self;
    unsafe fn load(from: *const f32) -> Self;
    unsafe fn store(self, to: *mut f32);
    /// As many vectors of three as the register has lanes.
    unsafe fn load_triples(from: *const f32) -> [Self; 3];
    /// Four floats of each of as many rows as the register has lanes, which begin `stride` floats apart.
    unsafe fn columns(from: *const f32, stride: usize) -> [Self; 4];
    unsafe fn add(self, b: Self) -> Self;
    unsafe fn sub(self, b: Self) -> Self;
    unsafe fn mul(self, b: Self) -> Self;
    unsafe fn div(self, b: Self) -> Self;
    unsafe fn fma(self, b: Self, c: Self) -> Self;
    unsafe fn sqrt(self) -> Self;
    unsafe fn min(self, b: Self) -> Self;
    unsafe fn max(self, b: Self) -> Self;
    unsafe fn positive(self) -> Self;
    unsafe fn min_positive(self, b: Self) -> Self;
    unsafe fn lt(self, b: Self) -> Self::Mask;
    unsafe fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    unsafe fn any(mask: Self::Mask) -> bool;
    unsafe fn select(mask: Self::Mask, a: Self, b: Self) -> Self;
    unsafe fn power_of_two(self) -> Self;
    unsafe fn exponent_and_mantissa(self) -> (Self, Self);
}

/// Implements [`Lanes`](super::Lanes) of an instruction set for one number of lanes, as an array of registers.
macro_rules! lanes {
    ($isa:ty $([$features:literal])?: $lanes:literal in $count:literal x $register:ty, $rows:literal rows) => {
        impl $crate::simd::Lanes<$lanes> for $isa {
            const ROWS: usize = $rows;
            type Isa = $isa;
            type Vector = [$register; $count];
            type Mask = [<$register as Register>::Mask; $count];

            #[inline(always)]
            fn isa(self) -> $isa {
                self
            }

            fn run<T: $crate::simd::Task<$lanes>>(self, task: T) {
                $(#[target_feature(enable = $features)])?
                fn compiled<I: $crate::simd::Lanes<$lanes>, T: $crate::simd::Task<$lanes>>(isa: I, task: T) {
                    task.run(isa);
                }
                // SAFETY: `self` is the proof of the instruction set.
                #[allow(unused_unsafe)]
                unsafe {
                    compiled(self, task);
                }
            }

            #[inline(always)]
            fn splat(self, x: f32) -> Self::Vector {
                // SAFETY: `self` is the proof of the instruction set.
                unsafe { [<$register>::splat(x); $count] }
            }

            #[inline(always)]
            fn load(self, x: &[f32; $lanes]) -> Self::Vector {
                const { assert!($lanes == $count * <$register as Register>::LANES) };
                // SAFETY: `self` is the proof of the instruction set; the registers have the floats of `x`.
                unsafe {
                    let mut y = [<$register>::splat(0.0); $count];
                    for i in 0..$count {
                        y[i] = <$register>::load(x.as_ptr().add(i * <$register as Register>::LANES));
                    }
                    y
                }
            }

            #[inline(always)]
            fn load_triples(self, xyz: &[[f32; 3]; $lanes]) -> [Self::Vector; 3] {
                // SAFETY: `self` is the proof of the instruction set; the registers have the floats of `xyz`.
                unsafe {
                    let mut y = [[<$register>::splat(0.0); $count]; 3];
                    for i in 0..$count {
                        let from = xyz.as_ptr().add(i * <$register as Register>::LANES).cast();
                        [y[0][i], y[1][i], y[2][i]] = <$register>::load_triples(from);
                    }
                    y
                }
            }

            #[inline(always)]
            fn columns<const K: usize>(self, rows: &[[f32; K]; $lanes], first: usize) -> [Self::Vector; 4] {
                assert!(first + 4 <= K, "rows of {K} numbers have no four columns from {first} on");
                // SAFETY: `self` is the proof of the instruction set; the registers have as many lanes as there
                // are rows, and each row has the columns.
                unsafe {
                    let mut y = [[<$register>::splat(0.0); $count]; 4];
                    for i in 0..$count {
                        let rows = rows.as_ptr().add(i * <$register as Register>::LANES);
                        [y[0][i], y[1][i], y[2][i], y[3][i]] =
                            <$register>::columns(rows.cast::<f32>().add(first), K);
                    }
                    y
                }
            }

            #[inline(always)]
            fn store(self, x: Self::Vector, to: &mut [f32; $lanes]) {
                const { assert!($lanes == $count * <$register as Register>::LANES) };
                for i in 0..$count {
                    // SAFETY: `self` is the proof of the instruction set; the registers have the floats of `to`.
                    unsafe { x[i].store(to.as_mut_ptr().add(i * <$register as Register>::LANES)) };
                }
            }

            lanes!(@map $count; add(a, b) sub(a, b) mul(a, b) div(a, b) fma(a, b, c) sqrt(a) min(a, b) max(a, b)
                positive(a) min_positive(a, b) power_of_two(a));

            #[inline(always)]
            fn lt(self, a: Self::Vector, b: Self::Vector) -> Self::Mask {
                // SAFETY: `self` is the proof of the instruction set.
                unsafe {
                    let mut mask = [a[0].lt(b[0]); $count];
                    for (i, mask) in mask.iter_mut().enumerate() {
                        *mask = a[i].lt(b[i]);
                    }
                    mask
                }
            }

            #[inline(always)]
            fn and(self, mut a: Self::Mask, b: Self::Mask) -> Self::Mask {
                for i in 0..$count {
                    // SAFETY: `self` is the proof of the instruction set.
                    a[i] = unsafe { <$register as Register>::and(a[i], b[i]) };
                }
                a
            }

            #[inline(always)]
            fn any(self, mask: Self::Mask) -> bool {
                let mut any = false;
                for i in 0..$count {
                    // SAFETY: `self` is the proof of the instruction set.
                    any |= unsafe { <$register as Register>::any(mask[i]) };
                }
                any
            }

            #[inline(always)]
            fn select(self, mask: Self::Mask, mut a: Self::Vector, b: Self::Vector) -> Self::Vector {
                for i in 0..$count {
                    // SAFETY: `self` is the proof of the instruction set.
                    a[i] = unsafe { <$register as Register>::select(mask[i], a[i], b[i]) };
                }
                a
            }

            #[inline(always)]
            fn exponent_and_mantissa(self, x: Self::Vector) -> (Self::Vector, Self::Vector) {
                let (mut n, mut m) = (x, x);
                for i in 0..$count {
                    // SAFETY: `self` is the proof of the instruction set.
                    (n[i], m[i]) = unsafe { x[i].exponent_and_mantissa() };
                }
                (n, m)
            }
        }
    };
    (@map $count:literal; $($name:ident($first:ident $(, $other:ident)*))*) => {
        $(
            #[inline(always)]
            fn $name(self, mut $first: Self::Vector $(, $other: Self::Vector)*) -> Self::Vector {
                for i in 0..$count {
                    // SAFETY: `self` is the proof of the instruction set.
                    $first[i] = unsafe { Register::$name($first[i] $(, $other[i])*) };
                }
                $first
            }
        )*
    };
}
pub(super) use lanes;

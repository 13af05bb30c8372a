//! AVX2 with FMA, and AVX-512.

use std::arch::x86_64::*;

use super::register::{Register, lanes};
use super::{Isa, SQRT_HALF_BITS};

/// AVX2 with FMA.
#[derive(Clone, Copy)]
pub struct Avx2(());

impl Avx2 {
    /// # Safety
    /// The machine must have AVX2 and FMA.
    #[must_use]
    pub unsafe fn new_unchecked() -> Self {
        Avx2(())
    }
}

impl Isa for Avx2 {
    const BATCH: usize = 16;
}

lanes!(Avx2 ["avx2,fma"]: 4 in 1 x __m128, 8 rows);
lanes!(Avx2 ["avx2,fma"]: 8 in 1 x __m256, 8 rows);
lanes!(Avx2 ["avx2,fma"]: 16 in 2 x __m256, 6 rows);
lanes!(Avx2 ["avx2,fma"]: 32 in 4 x __m256, 2 rows);

/// AVX-512 (foundation), with AVX2 and FMA.
#[derive(Clone, Copy)]
pub struct Avx512(());

impl Avx512 {
    /// # Safety
    /// The machine must have AVX-512F, AVX2 and FMA.
    #[must_use]
    pub unsafe fn new_unchecked() -> Self {
        Avx512(())
    }
}

impl Isa for Avx512 {
    const BATCH: usize = 32;
}

lanes!(Avx512 ["avx512f,avx2,fma"]: 4 in 1 x __m128, 8 rows);
lanes!(Avx512 ["avx512f,avx2,fma"]: 8 in 1 x __m256, 8 rows);
lanes!(Avx512 ["avx512f,avx2,fma"]: 16 in 1 x __m512, 8 rows);
lanes!(Avx512 ["avx512f,avx2,fma"]: 32 in 2 x __m512, 8 rows);

/// The operations that the intrinsics of all three widths spell alike.
macro_rules! alike {
    ($splat:ident $load:ident $store:ident $add:ident $sub:ident $mul:ident $div:ident $fma:ident $sqrt:ident
     $min:ident $max:ident $to_bits:ident $from_bits:ident $int_max:ident $int_min:ident $int_add:ident
     $int_sub:ident $int_zero:ident $int_splat:ident $left:ident $right:ident $to_int:ident $to_float:ident) => {
        // SAFETY (of every block): the caller's promise that the machine has the instruction set, and for
        // `load` and `store` that the floats are there; they ask for no alignment.
        #[inline(always)]
        unsafe fn splat(x: f32) -> Self {
            unsafe { $splat(x) }
        }

        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            unsafe { $load(from) }
        }

        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            unsafe { $store(to, self) }
        }

        #[inline(always)]
        unsafe fn add(self, b: Self) -> Self {
            unsafe { $add(self, b) }
        }

        #[inline(always)]
        unsafe fn sub(self, b: Self) -> Self {
            unsafe { $sub(self, b) }
        }

        #[inline(always)]
        unsafe fn mul(self, b: Self) -> Self {
            unsafe { $mul(self, b) }
        }

        #[inline(always)]
        unsafe fn div(self, b: Self) -> Self {
            unsafe { $div(self, b) }
        }

        #[inline(always)]
        unsafe fn fma(self, b: Self, c: Self) -> Self {
            unsafe { $fma(self, b, c) }
        }

        #[inline(always)]
        unsafe fn sqrt(self) -> Self {
            unsafe { $sqrt(self) }
        }

        #[inline(always)]
        unsafe fn min(self, b: Self) -> Self {
            unsafe { $min(self, b) }
        }

        #[inline(always)]
        unsafe fn max(self, b: Self) -> Self {
            unsafe { $max(self, b) }
        }

        // Floats that are not negative are in the order of their bits, and negative ones are negative
        // integers.
        #[inline(always)]
        unsafe fn positive(self) -> Self {
            unsafe { $from_bits($int_max($to_bits(self), $int_zero())) }
        }

        #[inline(always)]
        unsafe fn min_positive(self, b: Self) -> Self {
            unsafe { $from_bits($int_min($to_bits(self), $to_bits(b))) }
        }

        #[inline(always)]
        unsafe fn power_of_two(self) -> Self {
            unsafe { $from_bits($left::<23>($int_add($to_int(self), $int_splat(127)))) }
        }

        #[inline(always)]
        unsafe fn exponent_and_mantissa(self) -> (Self, Self) {
            unsafe {
                let bits = $to_bits(self);
                let exponent = $right::<23>($int_sub(bits, $int_splat(SQRT_HALF_BITS)));
                ($to_float(exponent), $from_bits($int_sub(bits, $left::<23>(exponent))))
            }
        }
    };
}

/// [`Register::columns`] of registers of one, two and four quarters, whose rows are four apart.
macro_rules! columns {
    ($low:ident $high:ident $shuffle:ident, $from:ident, $stride:ident: $rows:expr) => {
        #[inline(always)]
        unsafe fn columns($from: *const f32, $stride: usize) -> [Self; 4] {
            unsafe {
                let [a, b, c, d] = $rows;
                // a₀b₀a₁b₁ and so on.
                let [ab, cd] = [[$low(a, b), $high(a, b)], [$low(c, d), $high(c, d)]];
                [
                    $shuffle::<0b01_00_01_00>(ab[0], cd[0]),
                    $shuffle::<0b11_10_11_10>(ab[0], cd[0]),
                    $shuffle::<0b01_00_01_00>(ab[1], cd[1]),
                    $shuffle::<0b11_10_11_10>(ab[1], cd[1]),
                ]
            }
        }
    };
}

#[allow(clippy::undocumented_unsafe_blocks)]
impl Register for __m128 {
    type Mask = __m128;
    const LANES: usize = 4;

    alike!(_mm_set1_ps _mm_loadu_ps _mm_storeu_ps _mm_add_ps _mm_sub_ps _mm_mul_ps _mm_div_ps _mm_fmadd_ps
        _mm_sqrt_ps _mm_min_ps _mm_max_ps _mm_castps_si128 _mm_castsi128_ps _mm_max_epi32 _mm_min_epi32
        _mm_add_epi32 _mm_sub_epi32 _mm_setzero_si128 _mm_set1_epi32 _mm_slli_epi32 _mm_srai_epi32
        _mm_cvtps_epi32 _mm_cvtepi32_ps);

    columns!(_mm_unpacklo_ps _mm_unpackhi_ps _mm_shuffle_ps, from, stride: [
        _mm_loadu_ps(from),
        _mm_loadu_ps(from.add(stride)),
        _mm_loadu_ps(from.add(2 * stride)),
        _mm_loadu_ps(from.add(3 * stride)),
    ]);

    #[inline(always)]
    unsafe fn load_triples(from: *const f32) -> [Self; 3] {
        unsafe {
            // x₀y₀z₀x₁ y₁z₁x₂y₂ z₂x₃y₃z₃
            let [a, b, c] = [_mm_loadu_ps(from), _mm_loadu_ps(from.add(4)), _mm_loadu_ps(from.add(8))];
            let xy = _mm_shuffle_ps::<0b10_01_11_10>(b, c);
            let yz = _mm_shuffle_ps::<0b01_00_10_01>(a, b);
            [
                _mm_shuffle_ps::<0b10_00_11_00>(a, xy),
                _mm_shuffle_ps::<0b11_01_10_00>(yz, xy),
                _mm_shuffle_ps::<0b11_00_11_01>(yz, c),
            ]
        }
    }

    #[inline(always)]
    unsafe fn lt(self, b: Self) -> __m128 {
        unsafe { _mm_cmplt_ps(self, b) }
    }

    #[inline(always)]
    unsafe fn and(a: __m128, b: __m128) -> __m128 {
        unsafe { _mm_and_ps(a, b) }
    }

    #[inline(always)]
    unsafe fn any(mask: __m128) -> bool {
        unsafe { _mm_movemask_ps(mask) != 0 }
    }

    #[inline(always)]
    unsafe fn select(mask: __m128, a: Self, b: Self) -> Self {
        unsafe { _mm_blendv_ps(b, a, mask) }
    }
}

#[allow(clippy::undocumented_unsafe_blocks)]
impl Register for __m256 {
    type Mask = __m256;
    const LANES: usize = 8;

    alike!(_mm256_set1_ps _mm256_loadu_ps _mm256_storeu_ps _mm256_add_ps _mm256_sub_ps _mm256_mul_ps
        _mm256_div_ps _mm256_fmadd_ps _mm256_sqrt_ps _mm256_min_ps _mm256_max_ps _mm256_castps_si256
        _mm256_castsi256_ps _mm256_max_epi32 _mm256_min_epi32 _mm256_add_epi32 _mm256_sub_epi32
        _mm256_setzero_si256 _mm256_set1_epi32 _mm256_slli_epi32 _mm256_srai_epi32 _mm256_cvtps_epi32
        _mm256_cvtepi32_ps);

    columns!(_mm256_unpacklo_ps _mm256_unpackhi_ps _mm256_shuffle_ps, from, stride: {
        let mut rows = [_mm256_setzero_ps(); 4];
        for row in 0..4 {
            let from = from.add(row * stride);
            rows[row] = _mm256_loadu2_m128(from.add(4 * stride), from);
        }
        rows
    });

    #[inline(always)]
    unsafe fn load_triples(from: *const f32) -> [Self; 3] {
        unsafe {
            // The first four vectors in the low halves, the others in the high halves.
            let [low, high] =
                [<__m128 as Register>::load_triples(from), <__m128 as Register>::load_triples(from.add(12))];
            [
                _mm256_set_m128(high[0], low[0]),
                _mm256_set_m128(high[1], low[1]),
                _mm256_set_m128(high[2], low[2]),
            ]
        }
    }

    #[inline(always)]
    unsafe fn lt(self, b: Self) -> __m256 {
        unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self, b) }
    }

    #[inline(always)]
    unsafe fn and(a: __m256, b: __m256) -> __m256 {
        unsafe { _mm256_and_ps(a, b) }
    }

    #[inline(always)]
    unsafe fn any(mask: __m256) -> bool {
        unsafe { _mm256_movemask_ps(mask) != 0 }
    }

    #[inline(always)]
    unsafe fn select(mask: __m256, a: Self, b: Self) -> Self {
        unsafe { _mm256_blendv_ps(b, a, mask) }
    }
}

#[allow(clippy::undocumented_unsafe_blocks)]
impl Register for __m512 {
    type Mask = __mmask16;
    const LANES: usize = 16;

    alike!(_mm512_set1_ps _mm512_loadu_ps _mm512_storeu_ps _mm512_add_ps _mm512_sub_ps _mm512_mul_ps
        _mm512_div_ps _mm512_fmadd_ps _mm512_sqrt_ps _mm512_min_ps _mm512_max_ps _mm512_castps_si512
        _mm512_castsi512_ps _mm512_max_epi32 _mm512_min_epi32 _mm512_add_epi32 _mm512_sub_epi32
        _mm512_setzero_si512 _mm512_set1_epi32 _mm512_slli_epi32 _mm512_srai_epi32 _mm512_cvtps_epi32
        _mm512_cvtepi32_ps);

    columns!(_mm512_unpacklo_ps _mm512_unpackhi_ps _mm512_shuffle_ps, from, stride: {
        let mut rows = [_mm512_setzero_ps(); 4];
        for row in 0..4 {
            let from = from.add(row * stride);
            let quarters = _mm512_castps128_ps512(_mm_loadu_ps(from));
            let quarters = _mm512_insertf32x4::<1>(quarters, _mm_loadu_ps(from.add(4 * stride)));
            let quarters = _mm512_insertf32x4::<2>(quarters, _mm_loadu_ps(from.add(8 * stride)));
            rows[row] = _mm512_insertf32x4::<3>(quarters, _mm_loadu_ps(from.add(12 * stride)));
        }
        rows
    });

    #[inline(always)]
    unsafe fn load_triples(from: *const f32) -> [Self; 3] {
        unsafe {
            let [low, high] =
                [<__m256 as Register>::load_triples(from), <__m256 as Register>::load_triples(from.add(24))];
            let mut y = [_mm512_setzero_ps(); 3];
            for c in 0..3 {
                let [low, high] = [_mm256_castps_pd(low[c]), _mm256_castps_pd(high[c])];
                y[c] = _mm512_castpd_ps(_mm512_insertf64x4::<1>(_mm512_castpd256_pd512(low), high));
            }
            y
        }
    }

    #[inline(always)]
    unsafe fn lt(self, b: Self) -> __mmask16 {
        unsafe { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self, b) }
    }

    #[inline(always)]
    unsafe fn and(a: __mmask16, b: __mmask16) -> __mmask16 {
        a & b
    }

    #[inline(always)]
    unsafe fn any(mask: __mmask16) -> bool {
        mask != 0
    }

    #[inline(always)]
    unsafe fn select(mask: __mmask16, a: Self, b: Self) -> Self {
        unsafe { _mm512_mask_blend_ps(mask, b, a) }
    }
}

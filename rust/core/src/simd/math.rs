//! Elementary functions as branch-free polynomials, in any number of lanes.
//!
//! The error budgets are constants that the tests enforce over the whole range on which the functions
//! are used, in every instruction set.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, LOG2_E};

use crate::simd::Real;

/// Largest relative error of [`exp`] on [`EXP_MIN`], [`EXP_MAX`].
pub const EXP_MAX_RELATIVE_ERROR: f64 = 1.3e-7;
/// Below this [`exp`] stays at its value here, 1.2e-38: the smallest normal number.
pub const EXP_MIN: f32 = -87.3;
/// Above this [`exp`] stays at its value here, 2.2e38: the last whose power of two is a float.
pub const EXP_MAX: f32 = 88.3;
/// Largest error of [`ln`] on positive normal numbers: absolute where |ln x| < 1, else relative.
pub const LN_MAX_ERROR: f64 = 1.3e-7;
/// Largest relative error of [`sigmoid`] from [`EXP_MIN`] on, and absolute below.
pub const SIGMOID_MAX_RELATIVE_ERROR: f64 = 2.5e-7;

/// ln 2 in two parts; the product of the first with any whole |n| ≤ 128 is exact.
const LN_2_HIGH: f32 = 0.693_359_4;
const LN_2_LOW: f32 = -2.121_944_4e-4;

/// Adding and subtracting 1.5·2²³ rounds to the nearest integer in every vector instruction set.
const ROUND: f32 = 12_582_912.0;

/// Largest relative error of [`angle`].
pub const ANGLE_MAX_RELATIVE_ERROR: f64 = 2.5e-7;

/// eˣ, with x limited to [[`EXP_MIN`], [`EXP_MAX`]]; NaN gives NaN.
///
/// Range reduction to ±ln 2/2 and the polynomial of Cephes' `expf` (Moshier 1992).
#[inline(always)]
#[must_use]
pub fn exp<F: Real>(x: F) -> F {
    /// By rising powers from r².
    const COEFFICIENTS: [f32; 6] =
        [0.5, 1.666_666_5e-1, 4.166_579_6e-2, 8.333_452e-3, 1.398_199_9e-3, 1.987_569_1e-4];

    let x = x.clamped(EXP_MIN, EXP_MAX);
    let n = x.fma(x.splat(LOG2_E), x.splat(ROUND)) - ROUND;
    let r = n.fma(x.splat(-LN_2_LOW), n.fma(x.splat(-LN_2_HIGH), x));
    let tail = polynomial(r, COEFFICIENTS).fma(r * r, r);
    (tail + 1.0) * n.power_of_two()
}

/// The largest whole number that is not above x, for |x| < 2²². Whatever is beyond that or not a number stays
/// so.
#[inline(always)]
#[must_use]
pub fn floor<F: Real>(x: F) -> F {
    let nearest = (x + ROUND) - ROUND;
    nearest - Real::select(x.lt(nearest), x.splat(1.0), x.splat(0.0))
}

/// Natural logarithm of a positive normal number. Anything else gives a meaningless number.
///
/// Mantissa in [√½, √2) and the polynomial of Cephes' `logf` (Moshier 1992).
#[inline(always)]
#[must_use]
pub fn ln<F: Real>(x: F) -> F {
    /// By rising powers from r³.
    const COEFFICIENTS: [f32; 9] = [
        3.333_333e-1,
        -2.499_999_4e-1,
        2.000_071_4e-1,
        -1.666_805_7e-1,
        1.424_932_3e-1,
        -1.242_014_1e-1,
        1.167_699_9e-1,
        -1.151_461e-1,
        7.037_683_6e-2,
    ];

    let (n, mantissa) = x.exponent_and_mantissa();
    let r = mantissa - 1.0;
    let square = r * r;
    let tail = (polynomial(r, COEFFICIENTS) * r).fma(square, n * LN_2_LOW) - square * 0.5;
    n.fma(x.splat(LN_2_HIGH), r + tail)
}

/// 1/(1 + e⁻ˣ).
#[inline(always)]
#[must_use]
pub fn sigmoid<F: Real>(x: F) -> F {
    (exp(-x) + 1.0).reciprocal()
}

/// Angle in [0, π/2] of the point (`along`, `across`), neither of which is negative; 0 at the origin.
///
/// The polynomial of Cephes' `atanf` (Moshier 1992) on [−tan π/8, tan π/8], about 0 or π/4.
#[inline(always)]
#[must_use]
pub fn angle<F: Real>(across: F, along: F) -> F {
    const TAN_PI_8: f32 = 0.414_213_56;
    /// By rising powers from t³.
    const COEFFICIENTS: [f32; 4] = [-3.333_295e-1, 1.997_771_1e-1, -1.387_768_6e-1, 8.053_744_5e-2];

    let (low, high) = (across.min(along), along.max(across).max(along.splat(f32::MIN_POSITIVE)));
    let far = (high * TAN_PI_8).lt(low);
    let t = Real::select(far, low - high, low) / Real::select(far, low + high, high);
    let square = t * t;
    let angle = (polynomial(square, COEFFICIENTS) * square).fma(t, t);
    let angle = Real::select(far, angle + FRAC_PI_4, angle);
    Real::select(along.lt(across), -(angle - FRAC_PI_2), angle)
}

/// Σ `coefficients[i]` xⁱ by Horner's rule.
#[inline(always)]
fn polynomial<F: Real, const N: usize>(x: F, coefficients: [f32; N]) -> F {
    let mut sum = x.splat(coefficients[N - 1]);
    for i in (0..N - 1).rev() {
        sum = sum.fma(x, x.splat(coefficients[i]));
    }
    sum
}

/// The same functions in float64. What the references of the models use.
pub mod reference {
    use super::{EXP_MAX, EXP_MIN};

    /// eˣ, with x limited as by [`exp`](super::exp).
    #[must_use]
    pub fn exp(x: f64) -> f64 {
        x.clamp(EXP_MIN.into(), EXP_MAX.into()).exp()
    }

    /// 1/(1 + e⁻ˣ).
    #[must_use]
    pub fn sigmoid(x: f64) -> f64 {
        1.0 / (1.0 + exp(-x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::Vector;

    fn sweep(from: f32, to: f32, steps: u32) -> impl Iterator<Item = f32> {
        (0..=steps).map(move |i| from + (to - from) * (i as f32 / steps as f32))
    }

    #[test]
    fn exp_keeps_its_error_budget() {
        let worst = sweep(EXP_MIN, EXP_MAX, 4_000_000)
            .map(|x| (f64::from(exp(x)) / f64::from(x).exp() - 1.0).abs())
            .fold(0.0, f64::max);
        assert!(worst <= EXP_MAX_RELATIVE_ERROR, "worst relative error {worst:e}");
    }

    crate::dispatch! {
        fn exp_and_ln(isa, x: &[f32; 16], y: &mut [[f32; 16]; 2]) {
            let x = Vector::<I, 16>::load(isa, x);
            exp(x).store(&mut y[0]);
            ln(exp(x)).store(&mut y[1]);
        }
    }

    /// The formulas above in the registers of the chosen instruction set, where multiply-adds are fused.
    #[test]
    fn exp_and_ln_keep_their_budgets_in_registers() {
        let all: Vec<f32> = sweep(EXP_MIN, EXP_MAX, 1_600_015).collect();
        for x in all.as_chunks::<16>().0 {
            let mut y = [[0.0; 16]; 2];
            exp_and_ln(x, &mut y);
            for lane in 0..16 {
                let exp = f64::from(y[0][lane]);
                assert!(
                    (exp / f64::from(x[lane]).exp() - 1.0).abs() <= EXP_MAX_RELATIVE_ERROR,
                    "at {}",
                    x[lane]
                );
                let error = (f64::from(y[1][lane]) - exp.ln()).abs();
                assert!(error <= LN_MAX_ERROR * exp.ln().abs().max(1.0), "at {}", x[lane]);
            }
        }
    }

    #[test]
    fn floor_is_exact_up_to_its_limit() {
        let limit = 4_194_303.0;
        let near = |whole: f32| [whole, whole.next_up(), whole.next_down(), whole + 0.5];
        let all = sweep(-limit, limit, 100_000).map(f32::round).chain(sweep(-300.0, 300.0, 600));
        for x in all.flat_map(near).filter(|x| x.abs() < limit) {
            assert_eq!(floor(x), x.floor(), "at {x}");
        }
        assert!(floor(f32::NAN).is_nan());
        assert_eq!(floor(f32::INFINITY), f32::INFINITY);
    }

    #[test]
    fn exp_saturates_and_passes_nan() {
        assert_eq!(exp(1e9), exp(EXP_MAX));
        assert_eq!(exp(f32::NEG_INFINITY), exp(EXP_MIN));
        assert!(exp(EXP_MAX).is_finite() && exp(EXP_MIN) > 0.0);
        assert!(exp(f32::NAN).is_nan());
        assert_eq!(exp(0.0), 1.0);
    }

    #[test]
    fn ln_keeps_its_error_budget() {
        // Every exponent, a thousand mantissas each.
        let first = f32::MIN_POSITIVE.to_bits();
        let worst = (first..f32::INFINITY.to_bits())
            .step_by(8_209)
            .map(f32::from_bits)
            .map(|x| {
                let truth = f64::from(x).ln();
                (f64::from(ln(x)) - truth).abs() / truth.abs().max(1.0)
            })
            .fold(0.0, f64::max);
        assert!(worst <= LN_MAX_ERROR, "worst error {worst:e}");
    }

    #[test]
    fn angle_keeps_its_error_budget() {
        let worst = sweep(0.0, 1.0, 1_000_000)
            .flat_map(|t| [(t, 1.0), (1.0, t)])
            .filter(|&(across, _)| across > 0.0)
            .map(|(across, along)| {
                let truth = f64::from(across).atan2(along.into());
                (f64::from(angle(across, along)) / truth - 1.0).abs()
            })
            .fold(0.0, f64::max);
        assert!(worst <= ANGLE_MAX_RELATIVE_ERROR, "worst relative error {worst:e}");
        assert_eq!(angle(0.0, 0.0), 0.0);
        assert_eq!(angle(0.0, 1.0), 0.0);
        assert_eq!(angle(1.0, 0.0), FRAC_PI_2);
    }

    #[test]
    fn sigmoid_keeps_its_error_budget() {
        for x in sweep(-120.0, 120.0, 2_000_000) {
            let (y, truth) = (f64::from(sigmoid(x)), 1.0 / (1.0 + (-f64::from(x)).exp()));
            let scale = if x >= EXP_MIN { truth } else { 1.0 };
            assert!(
                (y - truth).abs() <= SIGMOID_MAX_RELATIVE_ERROR * scale,
                "at {x}: {y:e} against {truth:e}"
            );
        }
    }

    #[test]
    fn sigmoid_is_bounded_and_symmetric() {
        for x in sweep(-100.0, 100.0, 10_000) {
            let y = sigmoid(x);
            assert!((0.0..=1.0).contains(&y));
            assert!((y + sigmoid(-x) - 1.0).abs() < 2e-7, "at {x}");
        }
    }
}

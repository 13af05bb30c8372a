//! Elementary functions as branch-free float32 expressions.
//!
//! A loop over an array that calls one of these vectorises, and a single call gives the very same
//! bits, because neither fuses multiply and add. The error budgets are constants that the tests
//! enforce over the whole range on which the functions are used.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};

/// Largest relative error of [`exp`] on [`EXP_MIN`], [`EXP_MAX`].
pub const EXP_MAX_RELATIVE_ERROR: f64 = 1.3e-7;
/// Below this [`exp`] stays at its value here, 1.2e-38: the smallest normal number.
pub const EXP_MIN: f32 = -87.3;
/// Above this [`exp`] stays at its value here, 3.3e38: the last before infinity.
pub const EXP_MAX: f32 = 88.7;
/// Largest error of [`ln`] on positive normal numbers: absolute where |ln x| < 1, else relative.
pub const LN_MAX_ERROR: f64 = 1.3e-7;

/// Largest relative error of [`angle`].
pub const ANGLE_MAX_RELATIVE_ERROR: f64 = 2.5e-7;

/// eˣ, with x limited to [[`EXP_MIN`], [`EXP_MAX`]]; NaN gives NaN.
///
/// Range reduction to ±ln 2/2 and the polynomial of Cephes' `expf` (Moshier 1992).
#[inline(always)]
#[must_use]
pub fn exp(x: f32) -> f32 {
    // Adding and subtracting 1.5·2²³ rounds to the nearest integer in every vector instruction set.
    const ROUND: f32 = 12_582_912.0;
    // ln 2 in two parts; the product of the first with any |n| ≤ 128 is exact.
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;

    let x = clamp(x, EXP_MIN, EXP_MAX);
    let n = (x * std::f32::consts::LOG2_E + ROUND) - ROUND;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let mut p = 1.987_569_1e-4;
    p = p * r + 1.398_199_9e-3;
    p = p * r + 8.333_452e-3;
    p = p * r + 4.166_579_6e-2;
    p = p * r + 1.666_666_5e-1;
    p = p * r + 0.5;
    let mantissa = p * (r * r) + r + 1.0;
    // Two factors, because 2ⁿ itself overflows at n = 128 while the product does not.
    let half = (n * 0.5) as i32;
    mantissa * power_of_two(half) * power_of_two(n as i32 - half)
}

/// 2ⁿ for |n| ≤ 126.
#[inline(always)]
fn power_of_two(n: i32) -> f32 {
    f32::from_bits(((n + 127) << 23) as u32)
}

/// Natural logarithm of a positive normal number. Anything else gives a meaningless finite number.
///
/// Mantissa in [√½, √2) and the polynomial of Cephes' `logf` (Moshier 1992).
#[inline(always)]
#[must_use]
pub fn ln(x: f32) -> f32 {
    const SQRT_HALF_BITS: i32 = 0x3f35_04f3;
    const LN_2_HIGH: f32 = 0.693_359_4;
    const LN_2_LOW: f32 = -2.121_944_4e-4;

    let bits = x.to_bits() as i32;
    let exponent = bits.wrapping_sub(SQRT_HALF_BITS) >> 23;
    let mantissa = f32::from_bits(bits.wrapping_sub(exponent << 23) as u32);
    let n = exponent as f32;
    let r = mantissa - 1.0;
    let mut p = 7.037_683_6e-2;
    p = p * r - 1.151_461e-1;
    p = p * r + 1.167_699_9e-1;
    p = p * r - 1.242_014_1e-1;
    p = p * r + 1.424_932_3e-1;
    p = p * r - 1.666_805_7e-1;
    p = p * r + 2.000_071_4e-1;
    p = p * r - 2.499_999_4e-1;
    p = p * r + 3.333_333e-1;
    let square = r * r;
    let tail = (p * r) * square + n * LN_2_LOW - 0.5 * square;
    (r + tail) + n * LN_2_HIGH
}

/// 1/(1 + e⁻ˣ).
#[inline(always)]
#[must_use]
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// Angle in [0, π/2] of the point (`along`, `across`), neither of which is negative; 0 at the origin.
///
/// The polynomial of Cephes' `atanf` (Moshier 1992) on [−tan π/8, tan π/8], about 0 or π/4.
#[inline(always)]
#[must_use]
pub fn angle(across: f32, along: f32) -> f32 {
    const TAN_PI_8: f32 = 0.414_213_56;
    let (low, high) = if across > along { (along, across) } else { (across, along) };
    let high = high.max(f32::MIN_POSITIVE);
    let far = low > TAN_PI_8 * high;
    let t = if far { low - high } else { low } / if far { low + high } else { high };
    let square = t * t;
    let mut p = 8.053_744_5e-2;
    p = p * square - 1.387_768_6e-1;
    p = p * square + 1.997_771_1e-1;
    p = p * square - 3.333_295e-1;
    let angle = (p * square * t + t) + if far { FRAC_PI_4 } else { 0.0 };
    if across > along { FRAC_PI_2 - angle } else { angle }
}

/// x limited to [low, high]; NaN stays NaN, as the comparisons are written to compile to one
/// minimum and one maximum instruction each.
#[inline(always)]
#[must_use]
pub fn clamp(x: f32, low: f32, high: f32) -> f32 {
    let x = if low > x { low } else { x };
    if high < x { high } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn sigmoid_is_bounded_and_symmetric() {
        for x in sweep(-100.0, 100.0, 10_000) {
            let y = sigmoid(x);
            assert!((0.0..=1.0).contains(&y));
            assert!((y + sigmoid(-x) - 1.0).abs() < 2e-7, "at {x}");
        }
    }
}

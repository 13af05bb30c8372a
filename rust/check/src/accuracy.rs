//! Errors of float32 in units that compare: in ULP of the exact result, and beside the condition of
//! the problem, which is how far the exact result moves when the inputs move by half an ULP.

use std::fmt;

/// Distance of the float32 numbers around `x`. Below the smallest normal number it is that number:
/// what underflows there is no error.
#[must_use]
pub fn ulp(x: f64) -> f64 {
    let smallest = f64::from(f32::MIN_POSITIVE);
    if x.abs() < smallest { smallest } else { (x.abs().log2().floor() - 23.0).exp2() }
}

/// Half the distance from `x` to its larger neighbour: the most by which rounding moved it.
#[must_use]
pub fn half_ulp(x: f32) -> f64 {
    0.5 * (f64::from(x.abs().next_up()) - f64::from(x.abs()))
}

/// How far `exact` moves when its inputs move by half an ULP: one at a time, to the worse side, added up.
#[must_use]
pub fn condition<const N: usize>(x: [f32; N], exact: impl Fn([f64; N]) -> f64) -> f64 {
    let inputs = x.map(f64::from);
    let here = exact(inputs);
    let moved = |i: usize, by: f64| {
        let mut inputs = inputs;
        inputs[i] += by;
        (exact(inputs) - here).abs()
    };
    (0..N).map(|i| moved(i, half_ulp(x[i])).max(moved(i, -half_ulp(x[i])))).sum()
}

/// One comparison with the exact result.
#[derive(Clone, Debug, Default)]
pub struct Comparison {
    /// The error in ULP.
    pub ulp: f64,
    /// The error over the exact result.
    pub relative: f64,
    /// The condition in ULP.
    pub condition: f64,
    /// Where: the inputs, and what was computed of them.
    pub inputs: String,
}

impl Comparison {
    /// Of the error, what the problem does not explain: error / (condition + 1 ULP). Around 1, the
    /// result is as good as float32 inputs and a float32 output allow.
    #[must_use]
    pub fn blame(&self) -> f64 {
        self.ulp / (self.condition + 1.0)
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Comparison { ulp, relative, condition, inputs } = self;
        write!(f, "{ulp:.3e} ULP, {relative:.1e} relative, condition {condition:.3e} ULP at {inputs}")
    }
}

/// The worst of many comparisons.
#[derive(Clone, Debug, Default)]
pub struct Worst {
    /// How many there were.
    pub count: u64,
    /// That of the largest error in ULP.
    pub error: Comparison,
    /// That of the largest [`Comparison::blame`].
    pub blamed: Comparison,
}

/// Errors below this many ULP are blamed on nobody: their condition is not computed.
const SMALL_ERROR: f64 = 2.0;

impl Worst {
    /// Adds a result whose error counts in ULP of `scale`, for which the exact result is the usual
    /// choice; `condition` yields how far the exact result moves, `inputs` is asked for the worst alone.
    pub fn add(
        &mut self,
        computed: f32,
        exact: f64,
        scale: f64,
        condition: impl FnOnce() -> f64,
        inputs: impl FnOnce() -> String,
    ) {
        self.count += 1;
        let error = (f64::from(computed) - exact).abs();
        // NaN and infinities count as what they are: as far off as can be.
        let error = if error.is_finite() { error } else { f64::INFINITY };
        let unit = ulp(scale);
        if error <= SMALL_ERROR.max(1.0) * unit && error / unit <= self.error.ulp {
            return;
        }
        let comparison = Comparison {
            ulp: error / unit,
            relative: error / scale.abs().max(f64::from(f32::MIN_POSITIVE)),
            condition: condition() / unit,
            inputs: String::new(),
        };
        let (is_largest, is_blamed) =
            (comparison.ulp > self.error.ulp, comparison.blame() > self.blamed.blame());
        if is_largest || is_blamed {
            let inputs = format!("{} -> {computed:e}, exactly {exact:e}", inputs());
            let comparison = Comparison { inputs, ..comparison };
            if is_largest {
                self.error = comparison.clone();
            }
            if is_blamed {
                self.blamed = comparison;
            }
        }
    }

    /// Adds what another has seen.
    pub fn merge(&mut self, other: Worst) {
        self.count += other.count;
        if other.error.ulp > self.error.ulp {
            self.error = other.error;
        }
        if other.blamed.blame() > self.blamed.blame() {
            self.blamed = other.blamed;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_those_of_float32() {
        assert_eq!(ulp(1.0), f64::from(f32::EPSILON));
        assert_eq!(ulp(-1.99), f64::from(f32::EPSILON));
        assert_eq!(ulp(1e-50), f64::from(f32::MIN_POSITIVE));
        assert_eq!(half_ulp(1.0), 0.5 * f64::from(f32::EPSILON));
    }

    #[test]
    fn condition_of_a_difference_is_that_of_its_inputs() {
        let moved = condition([1.0, 1.0 - f32::EPSILON], |[a, b]| a - b);
        assert!((moved - 0.75 * f64::from(f32::EPSILON)).abs() < 1e-12);
    }

    #[test]
    fn blame_is_what_the_condition_does_not_explain() {
        let mut worst = Worst::default();
        worst.add(1.0 + 100.0 * f32::EPSILON, 1.0, 1.0, || 99.0 * f64::from(f32::EPSILON), || "a".into());
        worst.add(1.0 + 10.0 * f32::EPSILON, 1.0, 1.0, || 0.0, || "b".into());
        assert!(worst.error.inputs.starts_with('a') && (worst.error.ulp - 100.0).abs() < 1e-9);
        assert!(worst.blamed.inputs.starts_with('b') && (worst.blamed.blame() - 10.0).abs() < 1e-9);
    }
}

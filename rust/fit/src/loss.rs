//! What a fit minimises: per pair and channel, a function of the reference f and the model's f̂.

use glimt_core::simd::Real;
use glimt_core::simd::math::ln;
use serde::{Deserialize, Serialize};

/// The error of f̂ against f at light cosine c, with e = ln(1 + c f̂) − ln(1 + c f):
/// `absolute` |e| + `squared` e² + `relative` 2|f̂ − f|/(f̂ + f + ε).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Loss {
    /// Weight of |e|, which log-MAE measures.
    pub absolute: f32,
    /// Weight of e², the paper's loss (eq. 5), which peaks rule.
    pub squared: f32,
    /// Weight of the symmetric relative error, which dark values rule.
    pub relative: f32,
}

/// ε of the relative term: values below it are dark in any picture.
const RELATIVE_FLOOR: f32 = 1e-4;

impl Loss {
    /// The paper's loss (eq. 5).
    pub const PAPER: Loss = Loss { absolute: 0.0, squared: 1.0, relative: 0.0 };

    /// The loss and its derivative with respect to f̂, in any number of lanes.
    #[inline(always)]
    #[must_use]
    pub fn value_and_slope<F: Real>(&self, cos_light: F, f: F, model: F) -> (F, F) {
        let one = f.splat(1.0);
        let model_scale = cos_light.fma(model, one);
        let e = ln(model_scale / cos_light.fma(f, one));
        let e_slope = cos_light / model_scale;
        let sign = Real::select(f.lt(model), one, -one);
        let value = e.abs() * self.absolute + e * e * self.squared;
        let slope = (sign * self.absolute + e * (2.0 * self.squared)) * e_slope;
        if self.relative == 0.0 {
            return (value, slope);
        }
        let inverse = (model + f + RELATIVE_FLOOR).reciprocal();
        let share = (model - f).abs() * inverse;
        let scale = 2.0 * self.relative;
        (value + share * scale, slope + (sign - share) * inverse * scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slope_is_the_finite_difference() {
        let loss = Loss { absolute: 1.0, squared: 3.0, relative: 0.05 };
        for (cos, f, model) in [(0.7, 0.2, 0.5), (0.3, 5.0, 0.1), (1.0, 0.0, 0.4), (0.1, 120.0, 130.0)] {
            let step = model * 1e-2;
            let value = |model| f64::from(loss.value_and_slope(cos, f, model).0);
            let difference = (value(model + step) - value(model - step)) / f64::from(2.0 * step);
            let slope = f64::from(loss.value_and_slope(cos, f, model).1);
            assert!((slope - difference).abs() < 2e-3 * slope.abs() + 1e-6, "{slope} against {difference}");
        }
    }

    #[test]
    fn a_perfect_model_loses_nothing() {
        assert_eq!(Loss { absolute: 1.0, squared: 1.0, relative: 1.0 }.value_and_slope(0.5, 0.3, 0.3).0, 0.0);
    }
}

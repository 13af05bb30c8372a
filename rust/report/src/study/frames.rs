//! Whole frames in a renderer: error against seconds as the samples grow.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Whole frames of one material in Mitsuba.
#[derive(Clone, Debug, Serialize)]
pub struct Frames {
    /// The material.
    pub material: String,
    /// By scene and Mitsuba's variant.
    pub scenes: BTreeMap<String, BTreeMap<String, Curves>>,
}

/// The frames of every BSDF in one scene, samples growing.
pub type Curves = BTreeMap<String, Vec<Frame>>;

/// A frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Samples a pixel.
    pub spp: f64,
    /// Median of the rounds.
    pub seconds: f64,
    /// Root mean square difference to the measurement's converged frame, relative to its mean.
    pub rmse: f64,
    /// The same to the BSDF's own converged frame: noise alone.
    pub noise: f64,
}

/// The longest time that every BSDF was given, for a comparison at equal time.
#[must_use]
pub fn equal_seconds(curves: &Curves) -> f64 {
    let longest = |frames: &Vec<Frame>| frames.iter().map(|frame| frame.seconds).fold(0.0, f64::max);
    curves.values().map(longest).fold(f64::INFINITY, f64::min)
}

/// The frame that takes `seconds`, along a curve that is straight in logarithms between its frames.
///
/// `None` where the curve has no two frames with that time between them: a BSDF that has not got its first frame
/// done by then.
#[must_use]
pub fn frame_at(frames: &[Frame], seconds: f64) -> Option<Frame> {
    let pairs = frames.windows(2).map(|pair| [pair[0], pair[1]]);
    let [before, after] = pairs.rev().find(|[a, b]| (a.seconds..=b.seconds).contains(&seconds))?;
    let share = if after.seconds > before.seconds {
        (seconds / before.seconds).ln() / (after.seconds / before.seconds).ln()
    } else {
        1.0
    };
    let between = |a: f64, b: f64| a * (b / a).powf(share);
    Some(Frame {
        spp: between(before.spp, after.spp),
        seconds,
        rmse: between(before.rmse, after.rmse),
        noise: between(before.noise, after.noise),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of one sample each `cost` seconds, with noise that falls with the root of the samples.
    fn curve(cost: f64) -> Vec<Frame> {
        let frame =
            |spp: f64| Frame { spp, seconds: cost * spp, rmse: 2.0 / spp.sqrt(), noise: 1.0 / spp.sqrt() };
        [1.0, 4.0, 16.0].map(frame).into()
    }

    #[test]
    fn at_equal_time_a_bsdf_of_half_the_cost_has_twice_the_samples() {
        let curves = Curves::from([("slow".into(), curve(2.0)), ("fast".into(), curve(1.0))]);
        let seconds = equal_seconds(&curves);
        assert_eq!(seconds, 16.0);
        let [slow, fast] = ["slow", "fast"].map(|name| frame_at(&curves[name], seconds).unwrap());
        assert!((slow.spp - 8.0).abs() < 1e-12 && (fast.spp - 16.0).abs() < 1e-12, "{slow:?} {fast:?}");
        assert!((slow.noise / fast.noise - 2_f64.sqrt()).abs() < 1e-12);
        assert!((slow.rmse - 2.0 * slow.noise).abs() < 1e-12);
    }

    #[test]
    fn a_time_before_the_first_frame_has_none() {
        assert_eq!(frame_at(&curve(2.0), 1.9), None);
        assert_eq!(frame_at(&curve(2.0), 33.0), None);
        assert_eq!(frame_at(&[], 1.0), None);
    }
}

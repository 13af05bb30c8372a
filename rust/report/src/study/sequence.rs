//! Points of the unit cube that fill it evenly.

use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// An additive recurrence from a random start (Roberts 2018, *The Unreasonable Effectiveness of Quasirandom
/// Sequences*): the steps are powers of the root of x⁴ = x + 1.
pub(super) struct Sequence {
    start: [f64; 3],
    index: u64,
}

impl Sequence {
    const STEPS: [f64; 3] = [0.819_172_513_396_164_5, 0.671_043_606_703_789_2, 0.549_700_477_901_970_2];

    /// A start of its own for every seed and stream.
    pub(super) fn new(seed: u64, stream: u64) -> Self {
        let mut random = Pcg64::seed_from_u64(seed ^ stream.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        Sequence { start: [random.random(), random.random(), random.random()], index: 0 }
    }
}

impl Iterator for Sequence {
    type Item = Vec3;

    fn next(&mut self) -> Option<Vec3> {
        let index = self.index as f64;
        self.index += 1;
        let coordinate = |c: usize| {
            // Rounding to float32 must not reach 1.
            ((self.start[c] + index * Self::STEPS[c]).fract() as f32).min(1.0 - f32::EPSILON / 2.0)
        };
        Some(Vec3::new(coordinate(0), coordinate(1), coordinate(2)))
    }
}

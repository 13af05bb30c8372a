//! How far two answers are from each other, and how far they may be.

use glam::Vec3;

use crate::verdict::{Finding, Measure, Test};

/// Relative difference that rounding may make between two ways to the same number in float32.
pub const ROUNDING: f64 = 2e-3;
/// Relative error of a sample's weight or density beyond which it is wrong. Narrow lobes turn the rounding
/// of a sampled direction into a change of density.
pub const OF_SAMPLE: f64 = 1e-2;
/// Densities and responses below this are compared absolutely: beneath what an image shows.
pub const FLOOR: f32 = 1e-6;

/// The worst of many comparisons, and where it was.
pub struct Worst {
    value: f64,
    place: String,
}

impl Worst {
    /// No comparison yet.
    #[must_use]
    pub fn none() -> Worst {
        Worst { value: 0.0, place: String::new() }
    }

    /// The greatest so far.
    #[must_use]
    pub fn value(&self) -> f64 {
        self.value
    }

    /// Takes one more.
    pub fn add(&mut self, value: f64, place: impl FnOnce() -> String) {
        if value > self.value {
            *self = Worst { value, place: place() };
        }
    }

    /// As a finding.
    #[must_use]
    pub fn finding(self, test: Test, limit: f64) -> Finding {
        Finding::new(test, Measure::error(self.value, limit)).note(self.place)
    }
}

/// |a − b| relative to the greater of the two, where that is more than `floor`; otherwise to `floor`.
#[must_use]
pub fn relative(a: f32, b: f32, floor: f32) -> f64 {
    let scale = a.abs().max(b.abs()).max(floor);
    if scale > 0.0 { f64::from((a - b).abs() / scale) } else { 0.0 }
}

/// Share of its brightest channel below which a channel is compared absolutely.
const DARK: f32 = 1e-2;

/// The greatest of [`relative`] over the channels.
#[must_use]
pub fn relative_rgb(a: Vec3, b: Vec3, floor: f32) -> f64 {
    let floor = floor.max(DARK * a.max(b).max_element());
    (0..3).map(|c| relative(a[c], b[c], floor)).fold(0.0, f64::max)
}

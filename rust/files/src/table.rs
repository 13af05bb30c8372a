//! A measured table that can be sampled whatever its format.

use glimt_core::lobes::{Lobes, PROXY_ALPHAS};
use glimt_core::simd::Lane3;
use glimt_core::{Brdf, Sample, SampleBrdf, Vec3};
use glimt_measured::Measured;

/// A measured BRDF with a sampler: that of RGL's format, or else lobes that were fitted to the table.
#[derive(Clone, Debug)]
pub struct Table {
    measured: Measured,
    lobes: Lobes,
}

impl Table {
    /// The table with a sampler for it.
    #[must_use]
    pub fn new(measured: Measured) -> Table {
        let lobes = Lobes::fit(&measured, &PROXY_ALPHAS);
        Table { measured, lobes }
    }

    /// The table.
    #[must_use]
    pub fn measured(&self) -> &Measured {
        &self.measured
    }
}

impl Brdf for Table {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        self.measured.eval(light, view)
    }

    fn eval_tile(&self, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        self.measured.eval_tile(light, view, out);
    }
}

impl SampleBrdf for Table {
    fn pdf(&self, light: Vec3, view: Vec3) -> f32 {
        match &self.measured {
            Measured::Rgl(rgl) => rgl.pdf(light, view),
            Measured::Merl(_) | Measured::Utia(_) => self.lobes.pdf(light, view),
        }
    }

    fn sample(&self, view: Vec3, u: Vec3) -> Sample {
        match &self.measured {
            Measured::Rgl(rgl) => rgl.sample(view, u),
            Measured::Merl(_) | Measured::Utia(_) => self.lobes.sample(&self.measured, view, u),
        }
    }
}

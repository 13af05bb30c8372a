//! What can be checked: anything that answers in batches.

use glam::Vec3;
use glimt_core::{Kind, Material, SampleBrdf};
use rayon::prelude::*;
use serde::Serialize;

/// A subject could not answer at all, as opposed to answering wrongly.
pub type Unanswered = Box<dyn std::error::Error + Send + Sync>;

/// An answer, or why there is none.
pub type Answer<T> = Result<T, Unanswered>;

/// What a subject says of itself. What is promised is tested; what is not is reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Claims {
    /// f(light, view) = f(view, light).
    pub reciprocal: bool,
    /// f is the same in every azimuth.
    pub isotropic: bool,
    /// No more energy leaves than arrives.
    pub conserving: bool,
    /// Light passes from one side to the other.
    pub transmits: bool,
    /// It also answers for views below the horizon.
    pub two_sided: bool,
    /// Its normals are not that of the surface, as those of normal maps are not: what faces the light as it sinks to
    /// the horizon reflects it.
    pub tilted: bool,
    /// It is a measurement as it is: what its numbers say against physics is a finding about the file.
    pub measured: bool,
}

impl Claims {
    /// An opaque surface, seen from above, that promises nothing.
    pub const NONE: Claims = Claims {
        reciprocal: false,
        isotropic: false,
        conserving: false,
        transmits: false,
        two_sided: false,
        tilted: false,
        measured: false,
    };

    /// What a model says of its material.
    #[must_use]
    pub fn of(material: &Material) -> Claims {
        Claims {
            reciprocal: material.is_reciprocal(),
            isotropic: material.is_isotropic(),
            tilted: material.is_surface(),
            measured: material.kind() == Kind::Tabulated,
            ..Claims::NONE
        }
    }
}

/// The whole BSDF or one of its components.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// All components together.
    Whole,
    /// One component, as if the others were not there: its response, and a sampler for it alone.
    Component(usize),
}

/// A component of a BSDF.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Component {
    /// For people.
    pub name: String,
    /// Whether it scatters into single directions, whose density is infinite: a mirror, clear glass.
    pub delta: bool,
}

/// A sampled light direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Draw {
    /// Unit direction towards the light.
    pub light: Vec3,
    /// Density in sr⁻¹; for a delta sample the probability of its component. 0 if sampling failed.
    pub pdf: f32,
    /// response / pdf, linear RGB.
    pub weight: Vec3,
    /// Whether the direction was the only one possible for its component.
    pub delta: bool,
    /// Relative index of refraction towards `light`; 1 for reflection. Radiance that crosses an interface
    /// is scaled by its inverse square, which is no loss of energy.
    pub eta: f32,
}

/// Anything that reflects or transmits, asked in batches.
///
/// The frame, the roles of `light` and `view` and all units are those of [`SampleBrdf`], but the answer is
/// the response f·|cosθ_light|, which is what renderers multiply with. All slices of one call have the
/// same length.
pub trait Subject {
    /// For people.
    fn name(&self) -> String;

    /// What it promises.
    fn claims(&self) -> Claims;

    /// Its components. None if it has no masks for them.
    fn components(&self) -> Vec<Component> {
        Vec::new()
    }

    /// f(light, view)·|cosθ_light|, linear RGB, without the delta components.
    fn response(&self, part: Part, light: &[Vec3], view: &[Vec3]) -> Answer<Vec<Vec3>>;

    /// Density of `light` for `view` in sr⁻¹, without the delta components.
    fn pdf(&self, part: Part, light: &[Vec3], view: &[Vec3]) -> Answer<Vec<f32>>;

    /// Both of the above in one call.
    fn response_and_pdf(&self, part: Part, light: &[Vec3], view: &[Vec3]) -> Answer<(Vec<Vec3>, Vec<f32>)> {
        Ok((self.response(part, light, view)?, self.pdf(part, light, view)?))
    }

    /// Light directions for `view` from numbers `u` in [0, 1).
    fn sample(&self, part: Part, view: &[Vec3], u: &[Vec3]) -> Answer<Vec<Draw>>;
}

/// A glimt BRDF of any kind as a subject. It has one component.
pub struct BrdfSubject<'a> {
    /// For people.
    pub name: String,
    /// What it promises.
    pub claims: Claims,
    /// The BRDF.
    pub brdf: &'a dyn SampleBrdf,
}

/// Rows that one task computes.
const CHUNK: usize = 1024;

impl Subject for BrdfSubject<'_> {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn claims(&self) -> Claims {
        self.claims
    }

    fn response(&self, _: Part, light: &[Vec3], view: &[Vec3]) -> Answer<Vec<Vec3>> {
        let mut response = vec![Vec3::ZERO; light.len()];
        let rows = response.par_chunks_mut(CHUNK).zip(light.par_chunks(CHUNK)).zip(view.par_chunks(CHUNK));
        rows.for_each(|((response, light), view)| {
            self.brdf.eval_batch(light, view, response);
            for (response, light) in response.iter_mut().zip(light) {
                *response *= light.z.abs();
            }
        });
        Ok(response)
    }

    fn pdf(&self, _: Part, light: &[Vec3], view: &[Vec3]) -> Answer<Vec<f32>> {
        let pairs = light.par_iter().with_min_len(CHUNK).zip(view);
        Ok(pairs.map(|(&light, &view)| self.brdf.pdf(light, view)).collect())
    }

    fn sample(&self, _: Part, view: &[Vec3], u: &[Vec3]) -> Answer<Vec<Draw>> {
        let pairs = view.par_iter().with_min_len(CHUNK).zip(u);
        let draw = |(&view, &u): (&Vec3, &Vec3)| {
            let sample = self.brdf.sample(view, u);
            Draw { light: sample.light, pdf: sample.pdf, weight: sample.weight, delta: false, eta: 1.0 }
        };
        Ok(pairs.map(draw).collect())
    }
}

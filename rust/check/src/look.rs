//! One view of a subject: samples, what the subject says of them, and the cells they fell into.

use glam::Vec3;

use crate::cells::Cells;
use crate::difference::{FLOOR, OF_SAMPLE, relative};
use crate::options::Options;
use crate::subject::{Answer, Draw, Part, Subject};
use crate::views::{View, random, uniform};

/// One part of a subject seen from one view.
pub struct Look {
    /// What was looked at.
    pub part: Part,
    /// From where.
    pub view: View,
    /// Number of samples, failed ones among them.
    pub count: usize,
    /// Samples that succeeded, delta ones left out.
    pub samples: Vec<SampledAt>,
    /// Samples of delta components.
    pub deltas: Vec<Draw>,
    /// The sphere of lights.
    pub cells: Cells,
}

/// A sample and what the subject answers at its direction.
#[derive(Clone, Copy, Debug)]
pub struct SampledAt {
    /// The sample.
    pub draw: Draw,
    /// response(light, view).
    pub response: Vec3,
    /// pdf(light, view).
    pub pdf: f32,
}

impl SampledAt {
    /// Whether renderers use the sample. A weight of 0 is that of a black direction if response and density
    /// there agree with it; one of both may by chance.
    fn succeeded(&self) -> bool {
        let is_black = || self.response == Vec3::ZERO && relative(self.draw.pdf, self.pdf, FLOOR) < OF_SAMPLE;
        self.draw.weight != Vec3::ZERO || is_black()
    }
}

impl Look {
    /// Draws samples for `view` and cuts the sphere.
    ///
    /// A sample failed if its density is 0, or if its weight is 0 where pdf() or the response are other than it
    /// says: renderers drop both, and many BSDFs return what their formulas gave beyond the horizon.
    ///
    /// # Errors
    /// The subject's.
    pub fn new(
        subject: &dyn Subject,
        part: Part,
        view: View,
        stream: u64,
        options: &Options,
    ) -> Answer<Look> {
        let mut random = random(options.seed, stream);
        let direction = view.direction();
        let (mut samples, mut deltas) = (Vec::new(), Vec::new());
        let mut left = options.samples;
        while left > 0 {
            let count = left.min(BATCH);
            left -= count;
            let u: Vec<Vec3> = (0..count).map(|_| uniform(&mut random)).collect();
            let draws = subject.sample(part, &vec![direction; count], &u)?;
            let (delta, smooth): (Vec<Draw>, Vec<Draw>) =
                draws.into_iter().filter(|draw| draw.pdf > 0.0).partition(|draw| draw.delta);
            deltas.extend(delta);
            if smooth.is_empty() {
                continue;
            }
            let lights: Vec<Vec3> = smooth.iter().map(|draw| draw.light).collect();
            let (response, pdf) = subject.response_and_pdf(part, &lights, &vec![direction; lights.len()])?;
            let answers = smooth.into_iter().zip(response.into_iter().zip(pdf));
            let answers = answers.map(|(draw, (response, pdf))| SampledAt { draw, response, pdf });
            samples.extend(answers.filter(SampledAt::succeeded));
        }
        let lights: Vec<Vec3> = samples.iter().map(|at| at.draw.light).collect();
        let cells = Cells::new(subject, part, direction, &lights, options.samples, options.resolution)?;
        Ok(Look { part, view, count: options.samples, samples, deltas, cells })
    }

    /// The share of samples that succeeded, delta ones left out.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.samples.len() as f64 / self.count as f64
    }
}

/// Samples drawn at once.
const BATCH: usize = 1 << 18;

//! Pairs of directions at which answers are compared with each other.

use glam::Vec3;
use rand::RngExt;

use crate::options::Options;
use crate::subject::{Answer, Draw, Part, Subject};
use crate::views::{View, either_side, mirror, random, uniform, upper};

/// Pairs of directions: a third uniform, a third the subject's own samples, a third around the mirror.
pub struct Pairs {
    /// Directions to the light; on the side of the view, or on either of what transmits.
    pub light: Vec<Vec3>,
    /// Directions to the viewer.
    pub view: Vec<Vec3>,
}

impl Pairs {
    /// As many as `options` ask for.
    ///
    /// # Errors
    /// The subject's.
    pub fn new(subject: &dyn Subject, options: &Options) -> Answer<Pairs> {
        let claims = subject.claims();
        let mut random = random(options.seed, u64::MAX - 2);
        let view: Vec<Vec3> = (0..options.pairs)
            .map(|_| {
                let view = upper(&mut random);
                either_side(view, claims.two_sided, &mut random)
            })
            .collect();
        let light = Pairs::lights(subject, &view, &mut random)?;
        Ok(Pairs { light, view })
    }

    /// As many lights for one view.
    ///
    /// # Errors
    /// The subject's.
    pub fn lights_for(&self, subject: &dyn Subject, view: View) -> Answer<Vec<Vec3>> {
        let views = vec![view.direction(); self.view.len()];
        Pairs::lights(subject, &views, &mut random(0, u64::MAX - 3))
    }

    fn lights(subject: &dyn Subject, view: &[Vec3], random: &mut impl rand::Rng) -> Answer<Vec<Vec3>> {
        let transmits = subject.claims().transmits;
        let u: Vec<Vec3> = view.iter().map(|_| uniform(random)).collect();
        let draws = subject.sample(Part::Whole, view, &u)?;
        let light = |(i, (&view, draw)): (usize, (&Vec3, &Draw))| {
            // Distances from the mirror direction over three decades.
            let distance = 10_f32.powf(-3.0 * random.random::<f32>());
            let uniform = upper(random);
            let light = match i % 3 {
                0 if draw.pdf > 0.0 && !draw.delta => draw.light,
                1 => (mirror(view) + distance * (uniform - Vec3::new(0.0, 0.0, 0.5))).normalize_or(Vec3::Z),
                _ => uniform,
            };
            let on_side_of_view = Vec3::new(light.x, light.y, light.z.abs() * view.z.signum());
            either_side(on_side_of_view, transmits, random)
        };
        Ok(view.iter().zip(&draws).enumerate().map(light).collect())
    }
}

//! Spheres under a light, directly lit and seen from afar, without a renderer.
//!
//! All BRDFs are rendered over the same directions, drawn for the truth: what differs between two images is
//! their reflectance, and hardly ever noise. How much noise there is, a second seed tells.

use glam::Vec3;
use glimt_core::sampling::SamplerChoice;
use glimt_core::{Brdf, Material, SampleBrdf, is_lit};
use glimt_image::{Image, Rgb};
use rayon::prelude::*;

use super::light::Light;
use super::sequence::Sequence;

/// The pairs of directions that make the image of a sphere, and what each carries.
pub struct LitSphere {
    size: usize,
    light: Vec<Vec3>,
    view: Vec<Vec3>,
    /// Pixel in which each pair counts.
    pixel: Vec<u32>,
    /// Radiance of each pair where f is 1 sr⁻¹.
    weight: Vec<Rgb>,
}

impl LitSphere {
    /// A sphere of `size` pixels across, with `directions` a pixel where the light has to be sampled.
    #[must_use]
    pub fn new(truth: &Material, light: &Light, size: usize, directions: usize, seed: u64) -> Self {
        let guide = Guide { truth, lobes: truth.with_sampler(SamplerChoice::Lobes), light };
        let rows: Vec<LitSphere> = (0..size)
            .into_par_iter()
            .map(|y| {
                let mut row = LitSphere::empty(size);
                for x in 0..size {
                    row.add_pixel(x, y, &guide, directions, seed);
                }
                row
            })
            .collect();
        let mut sphere = LitSphere::empty(size);
        for row in rows {
            sphere.light.extend(row.light);
            sphere.view.extend(row.view);
            sphere.pixel.extend(row.pixel);
            sphere.weight.extend(row.weight);
        }
        sphere
    }

    fn empty(size: usize) -> Self {
        LitSphere { size, light: Vec::new(), view: Vec::new(), pixel: Vec::new(), weight: Vec::new() }
    }

    fn add_pixel(&mut self, x: usize, y: usize, guide: &Guide, directions: usize, seed: u64) {
        let Some(frame) = Frame::at(x, y, self.size) else { return };
        let pixel = y * self.size + x;
        let view = frame.to_local(Vec3::Z);
        let mut add = |light: Vec3, weight: Rgb| {
            if is_lit(light, view) {
                self.light.push(light);
                self.view.push(view);
                self.pixel.push(pixel as u32);
                self.weight.push(weight);
            }
        };
        if let Light::Lamps(lamps) = guide.light {
            for lamp in lamps {
                let light = frame.to_local(lamp.direction);
                add(light, lamp.irradiance.map(|x| x * light.z));
            }
            return;
        }
        for (i, u) in Sequence::new(seed, pixel as u64).take(directions).enumerate() {
            let Some((light, pdf)) = guide.draw(i, view, u, &frame) else { continue };
            let scale = light.z / (pdf * directions as f32);
            add(light, guide.light.radiance(frame.to_world(light)).map(|x| x * scale));
        }
    }

    /// The image of a sphere of this reflectance, NaN beside the sphere.
    #[must_use]
    pub fn render(&self, brdf: &dyn Brdf) -> Image {
        /// Pairs that are evaluated at a time.
        const CHUNK: usize = 16_384;
        let mut f = vec![Vec3::ZERO; self.light.len()];
        let pairs = self.light.par_chunks(CHUNK).zip(self.view.par_chunks(CHUNK));
        pairs.zip(f.par_chunks_mut(CHUNK)).for_each(|((light, view), f)| brdf.eval_batch(light, view, f));
        let mut sums = vec![[0.0_f64; 3]; self.size * self.size];
        for ((f, weight), &pixel) in f.iter().zip(&self.weight).zip(&self.pixel) {
            for c in 0..3 {
                sums[pixel as usize][c] += f64::from(f[c] * weight[c]);
            }
        }
        let shown = |i: usize| match Frame::at(i % self.size, i / self.size, self.size) {
            Some(_) => sums[i].map(|sum| sum as f32),
            None => [f32::NAN; 3],
        };
        Image::new(self.size, (0..sums.len()).map(shown).collect())
    }
}

/// The shading frame of a pixel.
pub(super) struct Frame([Vec3; 3]);

impl Frame {
    /// `None` beside the sphere, which fills the image.
    pub(super) fn at(x: usize, y: usize, size: usize) -> Option<Frame> {
        let place = |i: usize| (i as f32 + 0.5) / size as f32 * 2.0 - 1.0;
        let (x, y) = (place(x), -place(y));
        let square = x * x + y * y;
        if square >= 1.0 {
            return None;
        }
        let normal = Vec3::new(x, y, (1.0 - square).sqrt());
        // Along the circles of latitude: the brushing of a turned piece.
        let tangent = Vec3::Y.cross(normal).normalize();
        Some(Frame([tangent, normal.cross(tangent), normal]))
    }

    pub(super) fn to_local(&self, world: Vec3) -> Vec3 {
        Vec3::from(self.0.map(|axis| axis.dot(world)))
    }

    pub(super) fn to_world(&self, local: Vec3) -> Vec3 {
        self.0[0] * local.x + self.0[1] * local.y + self.0[2] * local.z
    }
}

/// Where light is looked for.
struct Guide<'a> {
    truth: &'a Material,
    /// The truth, sampled by lobes.
    lobes: Material,
    light: &'a Light,
}

/// Turns of the ways in which directions are drawn.
#[derive(Clone, Copy, PartialEq)]
enum Turn {
    /// As the truth is sampled.
    Truth,
    /// By lobes of which one is the cosine: every direction has a density.
    Lobes,
    /// By the luminance of the environment.
    Environment,
}

impl Guide<'_> {
    fn turns(&self) -> &'static [Turn] {
        match self.light {
            Light::Environment(_) => &[Turn::Truth, Turn::Lobes, Turn::Environment],
            Light::Lamps(_) => &[],
        }
    }

    /// The `i`th direction of a pixel, and the density with which all turns together draw it.
    fn draw(&self, i: usize, view: Vec3, u: Vec3, frame: &Frame) -> Option<(Vec3, f32)> {
        let turns = self.turns();
        let light = match turns[i % turns.len()] {
            Turn::Truth => self.truth.sampler().sample_direction(view, u)?.0,
            Turn::Lobes => self.lobes.sampler().sample_direction(view, u)?.0,
            Turn::Environment => frame.to_local(self.light.environment()?.sample(u.to_array())),
        };
        if !is_lit(light, view) {
            return None;
        }
        let pdf = |turn: &Turn| match turn {
            Turn::Truth => self.truth.pdf(light, view),
            Turn::Lobes => self.lobes.pdf(light, view),
            Turn::Environment => {
                self.light.environment().map_or(0.0, |around| around.pdf(frame.to_world(light)))
            }
        };
        let pdf = turns.iter().map(pdf).sum::<f32>() / turns.len() as f32;
        (pdf > 0.0).then_some((light, pdf))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::light::Environment;
    use glimt_core::microfacet::Microfacet;
    use glimt_core::models::ggx::Ggx;

    fn material(alpha: f32) -> Material {
        Ggx::new(Microfacet { kd: [0.4, 0.2, 0.1], eta: [1.5; 3], alpha: [alpha; 2] }).unwrap().into()
    }

    struct Lambert;

    impl Brdf for Lambert {
        fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
            if is_lit(light, view) { Vec3::splat(std::f32::consts::FRAC_1_PI) } else { Vec3::ZERO }
        }
    }

    /// Mean over the sphere's pixels and channels.
    fn mean(image: &Image) -> f64 {
        let lit: Vec<_> = image.pixels().iter().flatten().filter(|x| x.is_finite()).collect();
        lit.iter().map(|x| f64::from(**x)).sum::<f64>() / lit.len() as f64
    }

    #[test]
    fn white_in_a_white_furnace_is_white() {
        let furnace = Image::new(16, vec![[1.0; 3]; 128]);
        let furnace = Light::Environment(Environment::new("furnace".into(), &furnace).unwrap());
        let image = LitSphere::new(&material(0.1), &furnace, 24, 512, 1).render(&Lambert);
        for pixel in image.pixels().iter().filter(|pixel| pixel[0].is_finite()) {
            assert!((pixel[0] - 1.0).abs() < 0.1, "{pixel:?}");
        }
        assert!((mean(&image) - 1.0).abs() < 5e-3, "{}", mean(&image));
    }

    #[test]
    fn a_lamp_lights_by_the_cosine() {
        let image = LitSphere::new(&material(0.1), &Light::lamps(), 33, 0, 0).render(&Lambert);
        let Light::Lamps(lamps) = Light::lamps() else { unreachable!() };
        let expected: f32 =
            lamps.iter().map(|lamp| lamp.direction.z.max(0.0) * lamp.irradiance[1]).sum::<f32>();
        let middle = image.pixels()[16 * 33 + 16][1];
        assert!((middle - expected * std::f32::consts::FRAC_1_PI).abs() < 1e-5, "{middle}");
        assert!(image.pixels()[0][0].is_nan());
    }

    #[test]
    fn seeds_and_guides_agree_about_a_narrow_lobe() {
        let narrow = material(0.02);
        let images = [(0.02, 1), (0.02, 2), (0.05, 1)].map(|(guide, seed)| {
            mean(&LitSphere::new(&material(guide), &Light::studio(), 24, 512, seed).render(&narrow))
        });
        for image in &images[1..] {
            assert!((image / images[0] - 1.0).abs() < 0.02, "{images:?}");
        }
    }
}

//! What spheres are lit by.
//!
//! The world of these images: x to the right, y up, z towards the viewer.

use std::f32::consts::{FRAC_1_PI, PI, TAU};

use glam::{FloatExt, Vec3};
use glimt_image::{Image, Rgb, Rows};

use crate::error::Error;

/// Something that lights a sphere.
#[derive(Clone, Debug)]
pub enum Light {
    /// Distant lamps. Images are exact: there is nothing to sample.
    Lamps(Vec<Lamp>),
    /// An image around everything.
    Environment(Environment),
}

/// A lamp so far away that its light is parallel.
#[derive(Clone, Copy, Debug)]
pub struct Lamp {
    /// Unit vector towards it.
    pub direction: Vec3,
    /// Irradiance of a surface that faces it.
    pub irradiance: Rgb,
}

impl Light {
    /// Three lamps: from the upper left, from the right, and from behind, grazing.
    #[must_use]
    pub fn lamps() -> Light {
        let lamp = |x, y, z, irradiance| Lamp { direction: Vec3::new(x, y, z).normalize(), irradiance };
        Light::Lamps(vec![
            lamp(-0.6, 0.7, 0.8, [3.0, 3.0, 3.0]),
            lamp(0.95, 0.1, 0.5, [1.2, 1.25, 1.4]),
            lamp(0.5, 0.6, -0.7, [2.2, 2.1, 1.9]),
        ])
    }

    /// A grey room, brighter above than below, with three soft boxes.
    #[must_use]
    pub fn studio() -> Light {
        const SIZE: [usize; 2] = [512, 256];
        let pixel = |i: usize| studio(direction(SIZE, i, [0.5, 0.5]));
        let image = Image::new(SIZE[0], (0..SIZE[0] * SIZE[1]).map(pixel).collect());
        let studio = Environment::new("studio".into(), &image);
        Light::Environment(studio.expect("an image in memory is read, and the room is not dark"))
    }

    /// Its name in tables.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Light::Lamps(_) => "lamps",
            Light::Environment(environment) => &environment.name,
        }
    }

    /// Radiance that comes from a direction; 0 for lamps, which are met by no direction.
    pub(super) fn radiance(&self, direction: Vec3) -> Rgb {
        match self {
            Light::Lamps(_) => [0.0; 3],
            Light::Environment(environment) => environment.radiance(direction),
        }
    }

    /// The environment, if it is one that can be sampled.
    pub(super) fn environment(&self) -> Option<&Environment> {
        if let Light::Environment(environment) = self { Some(environment) } else { None }
    }
}

/// Radiance of the studio.
fn studio(direction: Vec3) -> Rgb {
    /// Towards the middle, half the size along the horizon and across it (tangents), and radiance.
    const BOXES: [(Vec3, [f32; 2], Rgb); 3] = [
        (Vec3::new(-0.62, 0.55, 0.56), [0.35, 0.35], [9.0, 8.8, 8.4]),
        (Vec3::new(0.9, 0.15, 0.4), [0.12, 0.7], [5.0, 5.3, 5.8]),
        (Vec3::new(0.35, 0.75, -0.56), [0.8, 0.2], [6.0, 6.0, 6.0]),
    ];
    /// Width of a box's edge, as a tangent.
    const EDGE: f32 = 0.04;
    let room = 0.12.lerp(0.55, 0.5 + 0.5 * direction.y);
    let mut radiance = [room * 0.98, room, room * 1.04];
    for (middle, half, color) in BOXES {
        let middle = middle.normalize();
        let along = Vec3::Y.cross(middle).normalize();
        let distance = direction.dot(middle);
        if distance > 0.0 {
            let place = [direction.dot(along), direction.dot(middle.cross(along))].map(|x| x / distance);
            let inside = |axis: usize| ((half[axis] - place[axis].abs()) / EDGE + 0.5).clamp(0.0, 1.0);
            for (sum, color) in radiance.iter_mut().zip(color) {
                *sum += inside(0) * inside(1) * color;
            }
        }
    }
    radiance
}

/// An image around everything: latitude and longitude, the upper edge straight above, the middle behind the
/// viewer.
#[derive(Clone, Debug)]
pub struct Environment {
    name: String,
    size: [usize; 2],
    pixels: Vec<Rgb>,
    /// Sums of luminance times solid angle up to and with each pixel.
    sums: Vec<f64>,
}

impl Environment {
    /// From an image; `name` is what tables call it.
    ///
    /// # Errors
    /// What reading the image says, or [`Error::Dark`] where it holds no light.
    pub fn new(name: String, image: &dyn Rows) -> Result<Self, Error> {
        let size = image.size();
        let image = Image::hold(image)?;
        let finite = |pixel: &Rgb| pixel.map(|x| if x.is_finite() { x.max(0.0) } else { 0.0 });
        let pixels: Vec<Rgb> = image.pixels().iter().map(finite).collect();
        let mut environment = Environment { name, size, pixels, sums: Vec::new() };
        let mut sum = 0.0;
        for (i, pixel) in environment.pixels.iter().enumerate() {
            sum += f64::from(crate::image::luminance(*pixel) * environment.solid_angle(i / size[0]));
            environment.sums.push(sum);
        }
        if sum > 0.0 { Ok(environment) } else { Err(Error::Dark(environment.name)) }
    }

    /// Of every pixel in a row, up to the rounding of the sphere within it.
    fn solid_angle(&self, row: usize) -> f32 {
        let [width, height] = self.size.map(|n| n as f32);
        PI / height * TAU / width * (PI * (row as f32 + 0.5) / height).sin()
    }

    fn pixel(&self, direction: Vec3) -> [usize; 2] {
        let [width, height] = self.size.map(|n| n as f32);
        let x = (0.5 + direction.x.atan2(direction.z) * 0.5 * FRAC_1_PI) * width;
        let y = direction.y.clamp(-1.0, 1.0).acos() * FRAC_1_PI * height;
        [(x as usize).min(self.size[0] - 1), (y as usize).min(self.size[1] - 1)]
    }

    fn radiance(&self, direction: Vec3) -> Rgb {
        let [x, y] = self.pixel(direction);
        self.pixels[y * self.size[0] + x]
    }

    /// Density (sr⁻¹) of [`Environment::sample`].
    pub(super) fn pdf(&self, direction: Vec3) -> f32 {
        let luminance = crate::image::luminance(self.radiance(direction));
        luminance / self.sums[self.sums.len() - 1] as f32
    }

    /// A direction, about proportional to the luminance that comes from it.
    pub(super) fn sample(&self, u: [f32; 3]) -> Vec3 {
        let wanted = f64::from(u[0]) * self.sums[self.sums.len() - 1];
        let i = self.sums.partition_point(|&sum| sum <= wanted).min(self.sums.len() - 1);
        direction(self.size, i, [u[1], u[2]])
    }
}

/// The direction of a place within the `i`th pixel of an environment.
fn direction([width, height]: [usize; 2], i: usize, place: [f32; 2]) -> Vec3 {
    let theta = PI * ((i / width) as f32 + place[0]) / height as f32;
    let phi = TAU * (((i % width) as f32 + place[1]) / width as f32 - 0.5);
    Vec3::new(theta.sin() * phi.sin(), theta.cos(), theta.sin() * phi.cos())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_environment_is_sampled_by_its_luminance() {
        let pixel = |i: usize| [1.0, 3.0, 0.0, 7.0][(i * 7 + i / 32) % 4];
        let pixels = (0..32 * 16).map(|i| [pixel(i); 3]).collect();
        let environment = Environment::new("stripes".into(), &Image::new(32, pixels)).unwrap();
        let mut ratio = 0.0;
        let count = 20_000;
        for i in 0..count {
            let u = [0.754_877_7, 0.569_840_3, 0.438_579_2].map(|step| (i as f32 * step).fract());
            let direction = environment.sample(u);
            // ∫ 1 dω by importance sampling where there is light.
            ratio += 1.0 / f64::from(environment.pdf(direction)) / f64::from(count);
        }
        let lit: f64 = (0..32 * 16)
            .filter(|&i| pixel(i) > 0.0)
            .map(|i| f64::from(environment.solid_angle(i / 32)))
            .sum();
        assert!((ratio / lit - 1.0).abs() < 0.02, "{ratio} against {lit}");
    }

    #[test]
    fn a_dark_environment_is_refused() {
        let image = Image::new(4, vec![[0.0; 3]; 8]);
        assert!(Environment::new("night".into(), &image).is_err());
    }
}

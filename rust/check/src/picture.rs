//! What a page shows of a view: the plane of incidence, and the hemispheres from above.

use glam::Vec3;

use crate::look::Look;
use crate::statistics::MIN_EXPECTED;
use crate::subject::{Answer, Subject};
use crate::views::{direction, mirror};

/// Pixels along the diameter of a map.
pub const MAP_SIZE: usize = 64;
/// Directions along the plane of incidence, from horizon to horizon of the upper half and back below.
const SLICE: usize = 720;

/// Numbers behind the drawings.
#[derive(Clone, Debug, Default)]
pub struct Picture {
    /// Around the plane of incidence.
    pub slice: Vec<SlicePoint>,
    /// Hemispheres, the upper one first; the lower one only where the subject transmits or is seen from below.
    pub maps: Vec<Map>,
}

/// What there is in one direction of the plane of incidence.
#[derive(Clone, Copy, Debug)]
pub struct SlicePoint {
    /// Angle to the normal, positive towards the mirror direction, in radians in (−π, π].
    pub angle: f64,
    /// Mean response over the channels.
    pub response: f64,
    /// Density.
    pub pdf: f64,
}

/// One hemisphere, orthographic in angle: the distance to the centre is the angle to the normal.
#[derive(Clone, Debug)]
pub struct Map {
    /// Whether it is the upper one.
    pub is_upper: bool,
    /// By rows, [`MAP_SIZE`]²; `None` outside of the disc.
    pub pixels: Vec<Option<Pixel>>,
}

/// What there is around one direction of a map.
#[derive(Clone, Copy, Debug)]
pub struct Pixel {
    /// Density by quadrature, sr⁻¹.
    pub expected: f64,
    /// Density by the histogram of samples, sr⁻¹.
    pub observed: f64,
    /// (observed − expected)/√expected of the counts of the smallest cell that expects enough.
    pub residual: f64,
}

impl Picture {
    /// Takes the picture of a look.
    ///
    /// # Errors
    /// The subject's.
    pub fn new(subject: &dyn Subject, look: &Look) -> Answer<Picture> {
        let view = look.view.direction();
        let both = subject.claims().transmits;
        let towards = mirror(view);
        let azimuth = f64::from(towards.y).atan2(f64::from(towards.x));
        let angles: Vec<f64> = (0..SLICE)
            .map(|i| ((i as f64 + 0.5) / SLICE as f64 - 0.5) * std::f64::consts::TAU)
            .filter(|angle| both || (angle.cos() > 0.0) == (view.z > 0.0))
            .collect();
        let lights: Vec<Vec3> = angles.iter().map(|&angle| direction(angle, azimuth)).collect();
        let (response, pdf) = subject.response_and_pdf(look.part, &lights, &vec![view; lights.len()])?;
        let slice = angles.iter().zip(response.iter().zip(&pdf)).map(|(&angle, (response, &pdf))| {
            SlicePoint { angle, response: f64::from(response.element_sum() / 3.0), pdf: f64::from(pdf) }
        });
        let sides = [true, false].into_iter().filter(|&upper| both || upper == (view.z > 0.0));
        let maps = sides.map(|is_upper| Map { is_upper, pixels: map(look, is_upper) }).collect();
        Ok(Picture { slice: slice.collect(), maps })
    }
}

fn map(look: &Look, is_upper: bool) -> Vec<Option<Pixel>> {
    let at = |i: usize| (i as f64 + 0.5) / MAP_SIZE as f64 * 2.0 - 1.0;
    (0..MAP_SIZE * MAP_SIZE)
        .map(|i| {
            let (x, y) = (at(i % MAP_SIZE), -at(i / MAP_SIZE));
            let radius = x.hypot(y);
            if radius >= 1.0 {
                return None;
            }
            let theta = radius * std::f64::consts::FRAC_PI_2;
            let theta = if is_upper { theta } else { std::f64::consts::PI - theta };
            Some(pixel(look, direction(theta, y.atan2(x))))
        })
        .collect()
}

fn pixel(look: &Look, light: Vec3) -> Pixel {
    let draws = look.count as f64;
    let mut pixel = Pixel { expected: 0.0, observed: 0.0, residual: 0.0 };
    for cell in look.cells.path(light) {
        let (expected, observed) = (cell.integral.pdf * draws, cell.observed as f64);
        if pixel.expected == 0.0 || expected >= MIN_EXPECTED {
            let solid_angle = cell.solid_angle();
            pixel = Pixel {
                expected: cell.integral.pdf / solid_angle,
                observed: observed / draws / solid_angle,
                residual: (observed - expected) / expected.max(1.0).sqrt(),
            };
        }
    }
    pixel
}

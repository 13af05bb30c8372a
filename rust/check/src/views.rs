//! From where a subject is looked at, and the directions that its answers are compared at.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::Serialize;

use crate::subject::Claims;

/// A view direction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct View {
    /// Angle to the normal in degrees; beyond 90 it is below the horizon.
    pub theta: f64,
    /// Azimuth in degrees.
    pub phi: f64,
}

impl View {
    /// Unit direction.
    #[must_use]
    pub fn direction(self) -> Vec3 {
        direction(self.theta.to_radians(), self.phi.to_radians())
    }
}

impl std::fmt::Display for View {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{:.0}°", self.theta)?;
        if self.phi != 0.0 && self.theta != 0.0 { write!(f, "/{:.0}°", self.phi) } else { Ok(()) }
    }
}

/// Angles of views to the normal in degrees: the normal itself, the middle, and grazing ones.
const ELEVATIONS: [f64; 8] = [0.0, 20.0, 40.0, 55.0, 65.0, 75.0, 83.0, 88.5];
/// Azimuths in degrees for each elevation of an anisotropic subject; they favour no axis.
const AZIMUTHS: [f64; 3] = [17.0, 71.0, 228.0];

/// The views of a run.
#[must_use]
pub fn views(claims: &Claims) -> Vec<View> {
    let azimuths = if claims.isotropic { &AZIMUTHS[..1] } else { &AZIMUTHS };
    let above = ELEVATIONS
        .iter()
        .flat_map(|&theta| azimuths.iter().map(move |&phi| View { theta, phi }))
        .filter(|view| view.theta > 0.0 || view.phi == AZIMUTHS[0]);
    let below = |view: View| View { theta: 180.0 - view.theta, ..view };
    if claims.two_sided { above.clone().chain(above.map(below)).collect() } else { above.collect() }
}

/// Fewer of them, for components: steep, middle and grazing.
#[must_use]
pub fn few(views: &[View]) -> Vec<View> {
    let few = [ELEVATIONS[1], ELEVATIONS[4], ELEVATIONS[6]];
    let is_one = |view: &&View| view.phi == AZIMUTHS[0] && few.iter().any(|&t| (view.theta - t).abs() < 1e-9);
    views.iter().filter(is_one).copied().collect()
}

/// The direction at an angle to the normal and an azimuth, in radians.
#[must_use]
pub fn direction(theta: f64, phi: f64) -> Vec3 {
    DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()).as_vec3()
}

/// Random numbers of a run; `stream` keeps its parts apart.
#[must_use]
pub fn random(seed: u64, stream: u64) -> Pcg64 {
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    bytes[16..24].copy_from_slice(&stream.to_le_bytes());
    Pcg64::from_seed(bytes)
}

/// Three numbers in [0, 1).
pub fn uniform(random: &mut impl Rng) -> Vec3 {
    Vec3::new(random.random(), random.random(), random.random())
}

/// A direction that is uniform over the upper half of the sphere.
pub fn upper(random: &mut impl Rng) -> Vec3 {
    let (z, phi): (f64, f64) = (1.0 - random.random::<f64>(), random.random::<f64>() * TAU);
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * phi.cos(), r * phi.sin(), z).as_vec3()
}

/// `v` or its image on the other side of the surface, by chance where the subject has two sides.
pub fn either_side(v: Vec3, two_sided: bool, random: &mut impl Rng) -> Vec3 {
    if two_sided && random.random::<bool>() { Vec3::new(v.x, v.y, -v.z) } else { v }
}

/// The mirror image of `view` about the normal.
#[must_use]
pub fn mirror(view: Vec3) -> Vec3 {
    Vec3::new(-view.x, -view.y, view.z)
}

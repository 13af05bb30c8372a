//! The measurements of the catalogue: files of every format, made from functions at the edges of what a
//! table can hold, and the small RGL files of every layout on which the readers are fuzzed.

use std::path::Path;

use glam::Vec3;
use glimt_core::Brdf;
use glimt_measured::utia::Encoding;
use glimt_measured::{Colours, Measured, Merl, Rgl, Utia, merl, rgl_bytes, utia};

use super::{Case, MeasuredFile};

/// A mirror's lobe on a dark base: from one bin to the next it falls by orders of magnitude.
struct Steep;

impl Brdf for Steep {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        let half = light + view;
        let slope = half.truncate().length_squared() / (half.z * half.z);
        Vec3::new(1.0, 1e-3, 1e-6) * (1e-4 + 1e6 * (-slope / 1e-4).exp())
    }
}

/// Neighbours at the ends of float32: the largest numbers beside 0, denormals, and negative ones.
struct Wild;

impl Brdf for Wild {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        // Half of float32's range: MERL files hold the mean of two orders.
        const LARGEST: f32 = f32::MAX / 2.0;
        let is_odd = (40.0 * (light.x + view.x)) as i32 % 2 != 0;
        if is_odd { Vec3::new(LARGEST, 1e-45, -1.0) } else { Vec3::new(0.0, 1e-40, LARGEST) }
    }
}

/// Every layout of an RGL file in the fewest knots; one has values near the end of float32. They are links to the
/// corpus of the fuzz targets, and files in the published crate.
const RGL_CORPUS: [(&str, &[u8]); 5] = [
    ("isotropic", include_bytes!("rgl/isotropic.bsdf")),
    ("anisotropic", include_bytes!("rgl/anisotropic.bsdf")),
    ("half a turn", include_bytes!("rgl/halfturn.bsdf")),
    ("spectral", include_bytes!("rgl/spectral.bsdf")),
    ("huge values", include_bytes!("rgl/huge_values.bsdf")),
];

/// Measurements of every format, sampled as they come, and some by the other samplers.
///
/// # Panics
/// If a reader refuses what a writer wrote.
#[must_use]
pub fn cases() -> Vec<Case> {
    let measured = |name: String, extension: &'static str, bytes: Vec<u8>| {
        let path = Path::new("catalogue").with_extension(extension);
        let read = match extension {
            "binary" => Merl::from_bytes(&path, &bytes).map(Measured::Merl),
            "bin" => Utia::from_bytes(&path, &bytes, Encoding::default()).map(Measured::Utia),
            _ => Rgl::from_bytes(&path, &bytes).map(Measured::Rgl),
        };
        let material = read.unwrap_or_else(|e| panic!("{name}: {e}")).into_material();
        Case { file: Some(MeasuredFile { extension, bytes }), ..Case::new(name, material) }
    };
    let mut cases = Vec::new();
    for (name, brdf) in [("steep", &Steep as &dyn Brdf), ("wild", &Wild)] {
        cases.push(measured(format!("MERL, {name}"), "binary", merl::to_bytes(brdf)));
        cases.push(measured(format!("UTIA, {name}"), "bin", utia::to_bytes(brdf, Encoding::default())));
    }
    let steep = measured("RGL, steep".into(), "bsdf", rgl_bytes(&Steep, true, Colours::Rgb, "steep"));
    cases.extend(["lobes", "table"].map(|sampler| steep.sampled(sampler)));
    cases.push(steep);
    for (name, bytes) in RGL_CORPUS {
        cases.push(measured(format!("RGL, {name}"), "bsdf", bytes.to_vec()));
    }
    let huge = cases.last().expect("it was just pushed");
    let others = ["lobes", "table:2x1x1"].map(|sampler| huge.sampled(sampler));
    cases.extend(others);
    cases
}

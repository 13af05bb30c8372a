//! Curves of a material: slices of f through the plane of incidence, and the directional albedo.

use std::f64::consts::FRAC_PI_2;

use glam::Vec3;
use glimt_core::sampling::SamplerChoice;
use glimt_core::{Brdf, Material, SampleBrdf};

use super::sequence::Sequence;

/// Angles to the normal, in degrees, from which slices are seen.
pub const SLICE_VIEWS: [f64; 3] = [15.0, 45.0, 70.0];
/// Lights on a slice, from horizon to horizon.
const SLICE_LIGHTS: usize = 361;

/// Angles to the normal, in degrees, at which the albedo is measured.
pub const ALBEDO_VIEWS: [f64; 12] = [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 65.0, 70.0, 75.0, 80.0, 85.0];
/// Directions for each.
const ALBEDO_LIGHTS: usize = 4096;

/// The light angles of a slice in radians, positive on the side of the mirror direction.
#[must_use]
pub fn slice_angles() -> Vec<f64> {
    (0..SLICE_LIGHTS).map(|i| ((i as f64 + 0.5) / SLICE_LIGHTS as f64 * 2.0 - 1.0) * FRAC_PI_2).collect()
}

/// f·cosθ of the light, mean of the channels, for every view of [`SLICE_VIEWS`] and light of
/// [`slice_angles`].
#[must_use]
pub fn slices(brdf: &dyn Brdf) -> Vec<Vec<f32>> {
    let lights: Vec<Vec3> = slice_angles().into_iter().map(in_plane).collect();
    let slice = |view: f64| {
        let view = in_plane(-view.to_radians());
        let mut f = vec![Vec3::ZERO; lights.len()];
        brdf.eval_batch(&lights, &vec![view; lights.len()], &mut f);
        f.iter().zip(&lights).map(|(f, light)| f.element_sum() / 3.0 * light.z).collect()
    };
    SLICE_VIEWS.into_iter().map(slice).collect()
}

fn in_plane(angle: f64) -> Vec3 {
    Vec3::new(angle.sin() as f32, 0.0, angle.cos() as f32)
}

/// Directions for the albedo of every view, with f's factor cosθ/pdf over their number. They are drawn for the
/// truth and serve all models.
pub struct AlbedoProbes(Vec<Vec<(Vec3, f32)>>);

impl AlbedoProbes {
    /// Draws them.
    #[must_use]
    pub fn new(truth: &Material, seed: u64) -> Self {
        let lobes = truth.with_sampler(SamplerChoice::Lobes);
        let probes = |(stream, degrees): (usize, f64)| {
            let view = in_plane(-f64::to_radians(degrees));
            let draw = |(i, u): (usize, Vec3)| {
                let drawn = if i % 2 == 0 { truth } else { &lobes };
                let (light, _) = drawn.sampler().sample_direction(view, u)?;
                let pdf = 0.5 * (truth.pdf(light, view) + lobes.pdf(light, view));
                (pdf > 0.0).then(|| (light, light.z / (pdf * ALBEDO_LIGHTS as f32)))
            };
            Sequence::new(seed, stream as u64).take(ALBEDO_LIGHTS).enumerate().filter_map(draw).collect()
        };
        AlbedoProbes(ALBEDO_VIEWS.into_iter().enumerate().map(probes).collect())
    }

    /// The share of the light from everywhere that goes to each view of [`ALBEDO_VIEWS`], mean of the channels.
    #[must_use]
    pub fn albedo(&self, brdf: &dyn Brdf) -> Vec<f64> {
        let albedo = |(degrees, probes): (f64, &Vec<(Vec3, f32)>)| {
            let view = in_plane(-degrees.to_radians());
            let lights: Vec<Vec3> = probes.iter().map(|(light, _)| *light).collect();
            let mut f = vec![Vec3::ZERO; lights.len()];
            brdf.eval_batch(&lights, &vec![view; lights.len()], &mut f);
            let terms =
                f.iter().zip(probes).map(|(f, (_, factor))| f64::from(f.element_sum() / 3.0 * factor));
            terms.sum()
        };
        ALBEDO_VIEWS.into_iter().zip(&self.0).map(albedo).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glimt_core::microfacet::Microfacet;
    use glimt_core::models::ggx::Ggx;

    fn material(kd: f32, eta: f32, alpha: f32) -> Material {
        Ggx::new(Microfacet { kd: [kd; 3], eta: [eta; 3], alpha: [alpha; 2] }).unwrap().into()
    }

    #[test]
    fn a_lambertian_surface_has_its_reflectance_as_albedo() {
        let lambert = material(0.5, 1.0, 0.3);
        for albedo in AlbedoProbes::new(&lambert, 0).albedo(&lambert) {
            assert!((albedo - 0.5).abs() < 5e-3, "{albedo}");
        }
    }

    #[test]
    fn slices_peak_at_the_mirror_direction() {
        let angles = slice_angles();
        for (slice, view) in slices(&material(0.0, 1.5, 0.02)).iter().zip(SLICE_VIEWS) {
            let peak = slice.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0;
            assert!(
                (angles[peak].to_degrees() - view).abs() < 1.0,
                "{} for {view}",
                angles[peak].to_degrees()
            );
        }
    }
}

//! `nbrdf`: Sztrajman, Rainer, Ritschel, Weyrich 2021, *Neural BRDF Representation and Importance
//! Sampling*: one network of 675 numbers per isotropic material.
//!
//! f = max(0, exp ψ(h, d) − 1) per colour channel, with the half vector h turned to azimuth 0 and
//! the difference vector d of the light (Rusinkiewicz 1998); two hidden layers of 21, ReLU.
//! Isotropic by construction, not reciprocal.

use std::sync::Arc;

use glam::Vec3;

use crate::brdf::{Brdf, is_lit, mask_unlit};
use crate::dispatch;
use crate::lobes::{Lobes, PROXY_ALPHAS};
use crate::math::exp;
use crate::model::Model;
use crate::network::{MAX_WIDTH, Network};
use crate::simd::{LANES, Lane, Lane3};

/// Network inputs: h and d.
pub const FEATURES: usize = 6;
/// Width of the two hidden layers as published.
pub const WIDTH: usize = 21;

/// Largest ψ that counts: a lobe of 10⁹ sr⁻¹, beyond any measurement, still squares in float32.
const MAX_OUTPUT: f32 = 20.7;

/// One material: one network.
#[derive(Clone, Debug)]
pub struct Nbrdf {
    network: Arc<Network>,
    first_bias: Vec<Lane>,
    lobes: Lobes,
}

impl Nbrdf {
    /// The material of a network with inputs h, d and three outputs.
    ///
    /// # Errors
    /// In words, if the network has another shape.
    pub fn new(network: Arc<Network>) -> Result<Self, String> {
        if network.features() != FEATURES || network.latent() != 0 || network.outputs() != 3 {
            return Err(format!(
                "the network maps {} values to {}, expected {FEATURES} to 3",
                network.features() + network.latent(),
                network.outputs()
            ));
        }
        let first_bias = network.fold(&[]);
        let lobes = Lobes { alpha: PROXY_ALPHAS[0], specular_weight: 0.5 };
        let mut nbrdf = Nbrdf { network, first_bias, lobes };
        nbrdf.lobes = Lobes::fit(&nbrdf, &PROXY_ALPHAS);
        Ok(nbrdf)
    }

    /// The material's network.
    #[must_use]
    pub fn network(&self) -> &Arc<Network> {
        &self.network
    }
}

impl Model for Nbrdf {
    const KIND: &'static str = "nbrdf";

    /// A proxy that was fitted to the network.
    fn lobes(&self) -> Lobes {
        self.lobes
    }

    fn is_isotropic(&self) -> bool {
        true
    }

    fn network(&self) -> Option<&Network> {
        Some(&self.network)
    }
}

impl Brdf for Nbrdf {
    fn eval(&self, light: Vec3, view: Vec3) -> Vec3 {
        let mut f = Vec3::ZERO;
        if is_lit(light, view) {
            eval_one(self, light, view, &mut f);
        }
        f
    }

    fn eval_tile(&self, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        eval_tile(self, light, view, out);
        mask_unlit(light, view, out);
    }
}

dispatch! {
    fn eval_one(isa, material: &Nbrdf, light: Vec3, view: Vec3, f: &mut Vec3) {
        let mut y = [0.0; MAX_WIDTH];
        let x = half_difference(light.to_array(), view.to_array());
        material.network.forward_one(isa, &material.first_bias, &x, &mut y);
        *f = Vec3::new(radiance(y[0]), radiance(y[1]), radiance(y[2]));
    }
}

dispatch! {
    fn eval_tile(isa, material: &Nbrdf, light: &Lane3, view: &Lane3, out: &mut Lane3) {
        let mut x = [[0.0; LANES]; FEATURES];
        for lane in 0..LANES {
            let features = half_difference(
                [light[0][lane], light[1][lane], light[2][lane]],
                [view[0][lane], view[1][lane], view[2][lane]],
            );
            for (x, feature) in x.iter_mut().zip(features) {
                x[lane] = feature;
            }
        }
        let mut y = [[0.0; LANES]; MAX_WIDTH];
        material.network.forward_tile(isa, &material.first_bias, &x, &mut y);
        for (out, y) in out.iter_mut().zip(&y) {
            for lane in 0..LANES {
                out[lane] = radiance(y[lane]);
            }
        }
    }
}

/// f from the network's output.
#[inline(always)]
fn radiance(y: f32) -> f32 {
    (exp(if MAX_OUTPUT < y { MAX_OUTPUT } else { y }) - 1.0).max(0.0)
}

/// (h, d): the half vector turned about n to azimuth 0, and the light in the frame whose pole is h.
#[inline(always)]
fn half_difference(light: [f32; 3], view: [f32; 3]) -> [f32; FEATURES] {
    let h = [light[0] + view[0], light[1] + view[1], light[2] + view[2]];
    let across = (h[0] * h[0] + h[1] * h[1]).sqrt();
    let length = (across * across + h[2] * h[2]).sqrt().max(f32::MIN_POSITIVE);
    // Where h = n its azimuth is 0 by convention.
    let [cos_phi, sin_phi] = if across > 0.0 { [h[0] / across, h[1] / across] } else { [1.0, 0.0] };
    let [sin_theta, cos_theta] = [across / length, h[2] / length];
    let along = light[0] * cos_phi + light[1] * sin_phi;
    [
        sin_theta,
        0.0,
        cos_theta,
        along * cos_theta - light[2] * sin_theta,
        light[1] * cos_phi - light[0] * sin_phi,
        along * sin_theta + light[2] * cos_theta,
    ]
}

/// The same model in float64 by its definition. What tests compare against.
pub mod reference {
    use super::Nbrdf;
    use crate::network;
    use glam::{DMat3, DVec3};

    /// f for directions above the horizon.
    #[must_use]
    pub fn eval(material: &Nbrdf, light: DVec3, view: DVec3) -> [f64; 3] {
        let half = (light + view).normalize();
        let (theta, phi) = (half.z.acos(), half.y.atan2(half.x));
        let h = DMat3::from_rotation_z(-phi) * half;
        let d = DMat3::from_rotation_y(-theta) * (DMat3::from_rotation_z(-phi) * light);
        let y = network::reference::forward(&material.network, &[h.x, h.y, h.z, d.x, d.y, d.z], &[]);
        std::array::from_fn(|c| (y[c].exp() - 1.0).max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::{Activation, tests::patterned};

    #[test]
    fn eval_is_the_reference_in_every_kernel() {
        let network = patterned(&[FEATURES, WIDTH, WIDTH, 3], FEATURES, Activation::Relu);
        let material = Nbrdf::new(Arc::new(network)).unwrap();
        let direction = |i: usize| {
            let (z, phi) = (0.05 + 0.95 * (i as f32 * 0.754_877_7).fract(), i as f32 * 2.399);
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * phi.cos(), r * phi.sin(), z)
        };
        let light: Vec<_> = (0..150).map(direction).collect();
        let view: Vec<_> = (0..150).map(|i| direction(i * 7 + 3)).collect();
        let mut batch = vec![Vec3::ZERO; light.len()];
        material.eval_batch(&light, &view, &mut batch);
        for i in 0..light.len() {
            assert_eq!(batch[i], material.eval(light[i], view[i]));
            let truth = reference::eval(&material, light[i].as_dvec3(), view[i].as_dvec3());
            for (f, truth) in batch[i].to_array().into_iter().zip(truth) {
                assert!((f64::from(f) - truth).abs() < 2e-5, "{f} against {truth}");
            }
        }
        assert!(batch.iter().any(|f| f.max_element() > 0.1));
    }

    #[test]
    fn normal_pair_takes_azimuth_zero() {
        assert_eq!(half_difference([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]), [0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
        let [.., x, y, z] = half_difference([0.6, 0.0, 0.8], [-0.6, 0.0, 0.8]);
        assert!((x - 0.6).abs() < 1e-6 && y == 0.0 && (z - 0.8).abs() < 1e-6);
    }
}

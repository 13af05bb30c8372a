//! `nbrdf`: Sztrajman, Rainer, Ritschel, Weyrich 2021, *Neural BRDF Representation and Importance
//! Sampling*: one network of 675 numbers per isotropic material.
//!
//! f = max(0, exp ψ(h, d) − 1) per colour channel, with the half vector h turned to azimuth 0 and
//! the difference vector d of the light (Rusinkiewicz 1998); two hidden layers of 21, ReLU.
//! Isotropic by construction, not reciprocal.

use std::sync::Arc;

use glam::Vec3;

use crate::error::Invalid;
use crate::kernels::network::{Network, One, Rows};
use crate::kernels::{Kernel, splat3};
use crate::microfacet::Half;
use crate::models::Model;
use crate::simd::math::exp;
use crate::simd::{Isa, Lane, Lanes, Real, Vector};

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
}

impl Nbrdf {
    /// The material of a network with inputs h, d and three outputs.
    ///
    /// # Errors
    /// In words, if the network has another shape.
    pub fn new(network: Arc<Network>) -> Result<Self, Invalid> {
        if network.features() != FEATURES || network.latent() != 0 || network.outputs() != 3 {
            return Err(format!(
                "the network maps {} values to {}, expected {FEATURES} to 3",
                network.features() + network.latent(),
                network.outputs()
            )
            .into());
        }
        let first_bias = network.fold(&[]);
        Ok(Nbrdf { network, first_bias })
    }

    /// The material's network.
    #[must_use]
    pub fn network(&self) -> &Arc<Network> {
        &self.network
    }
}

impl Model for Nbrdf {
    const KIND: &'static str = "nbrdf";

    fn describe(&self) -> String {
        "half and difference vector as inputs".to_owned()
    }

    fn is_isotropic(&self) -> bool {
        true
    }

    fn network(&self) -> Option<&Network> {
        Some(&self.network)
    }
}

impl Kernel for Nbrdf {
    #[inline(always)]
    fn eval_lanes<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        let features = half_difference(light, view);
        let mut x = [[0.0; L]; FEATURES];
        for i in 0..FEATURES {
            features[i].store(&mut x[i]);
        }
        let mut y = Rows::default();
        self.network.forward_tile(isa, self.first_bias.as_flattened(), &x, &mut y);
        let f = Vector::load3(isa, &[y[0], y[1], y[2]]);
        [radiance(f[0]), radiance(f[1]), radiance(f[2])]
    }

    #[inline(always)]
    fn eval_one<I: Isa>(&self, isa: I, light: Vec3, view: Vec3) -> Vec3 {
        let features = half_difference(splat3::<I, 4>(isa, light), splat3(isa, view));
        let mut x = [0.0; FEATURES];
        for i in 0..FEATURES {
            x[i] = features[i].first();
        }
        let mut y = One::default();
        self.network.forward_one(isa, &self.first_bias, &x, &mut y);
        let f = radiance(Vector::<I, 4>::load(isa, &[y[0], y[1], y[2], 0.0])).to_array();
        Vec3::new(f[0], f[1], f[2])
    }
}

/// f from the network's output.
#[inline(always)]
fn radiance<F: Real>(y: F) -> F {
    // Near 0 the difference exp y − 1 would keep few digits of y. Up to here its series has as many
    // as the difference has from here.
    const SERIES_END: f32 = 0.06;
    let y = y.max(y.splat(0.0));
    let series = (((y * (1.0 / 24.0) + 1.0 / 6.0) * y + 0.5) * y + 1.0) * y;
    let difference = exp(y.at_most(MAX_OUTPUT)) - 1.0;
    Real::select(y.splat(SERIES_END).lt(y), difference, series)
}

/// (h, d): the half vector turned about n to azimuth 0, and the light in the frame whose pole is h.
#[inline(always)]
fn half_difference<F: Real>(light: [F; 3], view: [F; 3]) -> [F; FEATURES] {
    let half = Half::new(light, view);
    let h = half.vector;
    let [zero, one] = [h[0].splat(0.0), h[0].splat(1.0)];
    let (across, length) = (half.across.sqrt(), half.length);
    // Where h = n its azimuth is 0 by convention.
    let inclined = zero.lt(across);
    let [cos_phi, sin_phi] =
        [Real::select(inclined, h[0] / across, one), Real::select(inclined, h[1] / across, zero)];
    let [sin_theta, cos_theta] = [across / length, h[2] / length];
    let along = light[0] * cos_phi + light[1] * sin_phi;
    [
        sin_theta,
        zero,
        cos_theta,
        along * cos_theta - light[2] * sin_theta,
        light[1] * cos_phi - light[0] * sin_phi,
        along * sin_theta + light[2] * cos_theta,
    ]
}

/// The same model in float64 by its definition. What tests compare against.
pub mod reference {
    use super::{MAX_OUTPUT, Nbrdf};
    use crate::kernels::network;
    use glam::{DMat3, DVec3};

    /// f for directions above the horizon.
    #[must_use]
    pub fn eval(material: &Nbrdf, light: DVec3, view: DVec3) -> [f64; 3] {
        let half = (light + view).normalize();
        // Of the arc functions the tangent's alone keeps the digits of small angles.
        let (theta, phi) = (half.x.hypot(half.y).atan2(half.z), half.y.atan2(half.x));
        let h = DMat3::from_rotation_z(-phi) * half;
        let d = DMat3::from_rotation_y(-theta) * (DMat3::from_rotation_z(-phi) * light);
        let y = network::reference::forward(&material.network, &[h.x, h.y, h.z, d.x, d.y, d.z], &[]);
        std::array::from_fn(|c| y[c].min(MAX_OUTPUT.into()).exp_m1().max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::network::{Activation, tests::patterned};
    use crate::kernels::tests::assert_is_the_reference;

    #[test]
    fn eval_is_the_reference_in_every_kernel() {
        let network = patterned(&[FEATURES, WIDTH, WIDTH, 3], FEATURES, Activation::Relu);
        let material = Nbrdf::new(Arc::new(network)).unwrap();
        let batch = assert_is_the_reference(&material, |l, v| reference::eval(&material, l, v), |_| 2e-5);
        assert!(batch.iter().any(|f| f.max_element() > 0.1));
    }

    #[test]
    fn normal_pair_takes_azimuth_zero() {
        assert_eq!(half_difference([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]), [0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
        let [.., x, y, z] = half_difference([0.6, 0.0, 0.8], [-0.6, 0.0, 0.8]);
        assert!((x - 0.6).abs() < 1e-6 && y == 0.0 && (z - 0.8).abs() < 1e-6);
    }
}

//! `neural`: the network-only baseline of the hybrid's paper, after Zeltner et al. 2024, *Real-time
//! Neural Appearance Models*: a network on directions seen from learned shading frames.
//!
//! f = exp ψ(F₁l, F₁v, F₂l, F₂v, F₃l, F₃v; z) per colour channel. The three frames F_k are a linear
//! function of the latent code z, made orthonormal; network and frame layer are shared by a library,
//! and z (12 or 16 numbers, as many as the hybrid spends) is all that a material has of its own.
//!
//! z, and with it the frames, is constant for a material. The frames are rotations, which fold into
//! the first layer: at run time the network has the six Cartesian inputs.

use std::sync::Arc;

use glam::{Mat3, Vec3};

use crate::error::{Invalid, Unmixable};
use crate::kernels::Kernel;
use crate::kernels::network::{LARGEST_INPUT, Layer, Network, One, Rows, check_latent};
use crate::models::Model;
use crate::models::edit::{Albedos, Allowed, Black, Fitted, Origin, Room, Views, mix_latents};
use crate::models::hybrid::check_bound;
use crate::simd::math::exp;
use crate::simd::{Isa, Lane, Lanes, Real, Vector};

/// Learned frames.
pub const FRAMES: usize = 3;
/// Network inputs that change with the directions: light and view in each frame.
pub const FEATURES: usize = 6 * FRAMES;
/// Numbers that the frame layer yields: an offset of the normal and one of the tangent, per frame.
pub const FRAME_OUTPUTS: usize = 6 * FRAMES;

/// What the materials of a library share.
#[derive(Clone, Debug)]
pub struct Shared {
    /// ψ, with [`FEATURES`] inputs and z.
    pub network: Network,
    /// The frame layer: z to [`FRAME_OUTPUTS`] numbers.
    pub frames: Layer,
}

/// One material of the neural baseline.
#[derive(Clone, Debug)]
pub struct Neural {
    shared: Arc<Shared>,
    latent: Vec<f32>,
    bound: f32,
    /// ψ with this material's frames and latent code folded into its first layer.
    network: Network,
    first_bias: Vec<Lane>,
    /// None if z is that of the fit.
    recoded: Option<Box<Recoded>>,
}

/// What makes a material with another code differ from a fitted one: f is multiplied by what there is room
/// for, see [`crate::models::edit`].
#[derive(Clone, Debug, PartialEq)]
pub struct Recoded {
    /// What it was made of.
    pub fitted: Fitted,
    /// The share of f that stays.
    pub room: Room,
}

impl Neural {
    /// A material with latent code z; `bound` is the largest output that the fit saw, beyond which
    /// exp ψ does not follow.
    ///
    /// # Errors
    /// In words, if network, frame layer and latent code do not fit together.
    pub fn new(shared: Arc<Shared>, latent: Vec<f32>, bound: f32) -> Result<Self, Invalid> {
        let network = &shared.network;
        if network.features() != FEATURES || network.outputs() != 3 {
            return Err(format!(
                "the network maps {} features to {} values, expected {FEATURES} to 3",
                network.features(),
                network.outputs()
            )
            .into());
        }
        if network.latent() != latent.len() || latent.is_empty() {
            return Err(Invalid::LatentLength { found: latent.len(), expected: network.latent() });
        }
        if shared.frames.outputs() != FRAME_OUTPUTS || shared.frames.inputs() != latent.len() {
            return Err(format!(
                "the frame layer maps {} numbers to {}, expected {} to {FRAME_OUTPUTS}",
                shared.frames.inputs(),
                shared.frames.outputs(),
                latent.len()
            )
            .into());
        }
        check_latent(&latent)?;
        // Lengths of the frames' axes are squared.
        if shared.frames.largest_sum(LARGEST_INPUT.into()) > f64::from(f32::MAX).sqrt() / 2.0 {
            return Err("the frame layer holds numbers so large that its sums overflow".into());
        }
        check_bound(bound)?;
        let network = fold_frames(&shared, &latent)?;
        let first_bias = network.fold(&[]);
        Ok(Neural { shared, latent, bound, network, first_bias, recoded: None })
    }

    /// The same network with another code, made of the material `fitted`, or that material itself.
    ///
    /// # Errors
    /// See [`Neural::new`].
    pub fn recoded(&self, fitted: Fitted, latent: Vec<f32>) -> Result<Self, Invalid> {
        let unedited = Neural::new(Arc::clone(&self.shared), fitted.latent.clone(), self.bound)?;
        if fitted.origin == Origin::Fit && latent == fitted.latent {
            return Ok(unedited);
        }
        let mut neural = Neural::new(Arc::clone(&self.shared), latent, self.bound)?;
        let allowed = Allowed {
            before: if fitted.origin == Origin::Fit { &unedited } else { &Black },
            analytic: &Black,
            ends: fitted.origin.ends(),
        };
        let room = Room::of(&Views::new(false, &VIEW_ALPHAS), &allowed, &Black, &neural);
        neural.recoded = Some(Box::new(Recoded { fitted, room }));
        Ok(neural)
    }

    /// Between this material and another of the same network, with a share `t` in [0, 1] of the other: z and the
    /// bound are linear.
    ///
    /// # Errors
    /// In words, that the two share no network.
    pub fn mix(&self, other: &Neural, t: f32) -> Result<Self, Invalid> {
        if !Arc::ptr_eq(&self.shared, &other.shared) {
            return Err(Unmixable::Networks.into());
        }
        let (fitted, other_fitted) = (self.fitted(), other.fitted());
        let mixed = Fitted {
            latent: mix_latents(&fitted.latent, &other_fitted.latent, t),
            origin: Origin::mix(&self.ceiling(), &other.ceiling()),
        };
        let bound = self.bound + (other.bound - self.bound) * t;
        Neural { bound, ..self.clone() }.recoded(mixed, mix_latents(&self.latent, &other.latent, t))
    }

    /// Albedos that a mix of this material may reach.
    fn ceiling(&self) -> Albedos {
        match self.recoded.as_ref().and_then(|recoded| recoded.fitted.origin.ends()) {
            Some(ends) => *ends,
            None => Views::new(false, &VIEW_ALPHAS).albedos(self),
        }
    }

    /// What this material is made of; itself if its code is that of the fit.
    #[must_use]
    pub fn fitted(&self) -> Fitted {
        match &self.recoded {
            Some(recoded) => recoded.fitted.clone(),
            None => Fitted { latent: self.latent.clone(), origin: Origin::Fit },
        }
    }

    /// None if z is that of the fit.
    #[must_use]
    pub fn recoding(&self) -> Option<&Recoded> {
        self.recoded.as_deref()
    }

    /// Network and frame layer of the library.
    #[must_use]
    pub fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }

    /// The network at run time: six Cartesian inputs, no latent code.
    #[must_use]
    pub fn folded_network(&self) -> &Network {
        &self.network
    }

    /// z.
    #[must_use]
    pub fn latent(&self) -> &[f32] {
        &self.latent
    }

    /// The largest output that counts.
    #[must_use]
    pub fn bound(&self) -> f32 {
        self.bound
    }
}

impl Model for Neural {
    const KIND: &'static str = "neural";

    fn describe(&self) -> String {
        format!("{FRAMES} learned shading frames")
    }

    fn is_isotropic(&self) -> bool {
        false
    }

    fn latent(&self) -> &[f32] {
        &self.latent
    }

    fn network(&self) -> Option<&Network> {
        Some(&self.shared.network)
    }

    fn with_latent(&self, latent: Vec<f32>) -> Result<Self, Invalid> {
        self.recoded(self.fitted(), latent)
    }

    fn mix(&self, other: &Self, t: f32) -> Result<Self, Invalid> {
        Neural::mix(self, other, t)
    }
}

/// Roughnesses of the lobes over which albedos are integrated: the model has none of its own.
const VIEW_ALPHAS: [[f32; 2]; 3] = [[0.02; 2], [0.1; 2], [0.4; 2]];

/// The frame that six numbers stand for: offsets of the normal from z and of the tangent from x,
/// then Gram and Schmidt. The matrix takes a direction to (tangent, bitangent, normal) coordinates.
#[must_use]
pub fn frame(offsets: &[f32]) -> Mat3 {
    let normal = (Vec3::from_slice(offsets) + Vec3::Z).normalize_or(Vec3::Z);
    let tangent = Vec3::from_slice(&offsets[3..]) + Vec3::X;
    let tangent = (tangent - normal * normal.dot(tangent)).normalize_or(normal.any_orthonormal_vector());
    Mat3::from_cols(tangent, normal.cross(tangent), normal).transpose()
}

/// ψ with light and view as inputs: W₁ [F₁ 0; 0 F₁; …] in place of W₁, and W_z z in the bias.
fn fold_frames(shared: &Shared, latent: &[f32]) -> Result<Network, Invalid> {
    let offsets: Vec<f32> = shared
        .frames
        .weight
        .chunks_exact(latent.len())
        .zip(&shared.frames.bias)
        .map(|(row, bias)| row.iter().zip(latent).map(|(w, z)| w * z).sum::<f32>() + bias)
        .collect();
    let first = &shared.network.layers()[0];
    let mut weight = Vec::with_capacity(6 * first.outputs());
    for row in first.weight.chunks_exact(first.inputs()) {
        let mut folded = [Vec3::ZERO; 2];
        for (k, offsets) in offsets.chunks_exact(6).enumerate() {
            let to_world = frame(offsets).transpose();
            for (side, folded) in folded.iter_mut().enumerate() {
                *folded += to_world * Vec3::from_slice(&row[6 * k + 3 * side..]);
            }
        }
        weight.extend(folded.iter().flat_map(|v| v.to_array()));
    }
    let bias = shared.network.folded_bias(latent).into_iter().map(|b| b as f32).collect();
    let mut layers = vec![Layer { weight, bias }];
    layers.extend_from_slice(&shared.network.layers()[1..]);
    Network::new(layers, 6, shared.network.activation())
}

impl Kernel for Neural {
    #[inline(always)]
    fn eval_lanes<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        let mut x = [[0.0; L]; 6];
        for c in 0..3 {
            light[c].store(&mut x[c]);
            view[c].store(&mut x[3 + c]);
        }
        let mut y = Rows::default();
        self.network.forward_tile(isa, self.first_bias.as_flattened(), &x, &mut y);
        let f = Vector::load3(isa, &[y[0], y[1], y[2]]).map(|y| bounded_exp(y, self.bound));
        let Some(recoded) = &self.recoded else { return f };
        let room = recoded.room.share(light, view);
        f.map(|f| f * room)
    }

    #[inline(always)]
    fn eval_one<I: Isa>(&self, isa: I, light: Vec3, view: Vec3) -> Vec3 {
        let x = [light.x, light.y, light.z, view.x, view.y, view.z];
        let mut y = One::default();
        self.network.forward_one(isa, &self.first_bias, &x, &mut y);
        let f = bounded_exp(Vector::<I, 4>::load(isa, &[y[0], y[1], y[2], 0.0]), self.bound).to_array();
        let room = self.recoded.as_ref().map_or(1.0, |r| r.room.share(light.into(), view.into()));
        Vec3::new(f[0], f[1], f[2]) * room
    }
}

#[inline(always)]
fn bounded_exp<F: Real>(y: F, bound: f32) -> F {
    exp(y.at_most(bound))
}

/// The same model in float64, with the frames applied to the directions. What tests compare against.
pub mod reference {
    use super::{Neural, frame};
    use crate::kernels::network;
    use crate::models::edit;
    use crate::simd::math::reference::exp;
    use glam::DVec3;

    /// f for directions above the horizon.
    #[must_use]
    pub fn eval(material: &Neural, light: DVec3, view: DVec3) -> [f64; 3] {
        let latent: Vec<f64> = material.latent.iter().map(|&z| z.into()).collect();
        let layer = &material.shared.frames;
        let offsets: Vec<f32> = layer
            .weight
            .chunks_exact(latent.len())
            .zip(&layer.bias)
            .map(|(row, &bias)| {
                (row.iter().zip(&latent).map(|(&w, z)| f64::from(w) * z).sum::<f64>() + f64::from(bias))
                    as f32
            })
            .collect();
        let features: Vec<f64> = offsets
            .chunks_exact(6)
            .flat_map(|offsets| {
                let axes = frame(offsets).transpose();
                [light, view].map(|w| [0, 1, 2].map(|i| axes.col(i).as_dvec3().dot(w))).concat()
            })
            .collect();
        let y = network::reference::forward(&material.shared.network, &features, &latent);
        let room =
            material.recoded.as_ref().map_or(1.0, |r| edit::reference::share(&r.room, light.z, view.z));
        std::array::from_fn(|c| room * exp(y[c].min(material.bound.into())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::network::{Activation, tests::patterned};
    use crate::kernels::tests::assert_is_the_reference;

    fn material() -> Neural {
        let network = patterned(&[FEATURES + 12, 32, 32, 3], FEATURES, Activation::HardGelu);
        let weight = (0..FRAME_OUTPUTS * 12).map(|i| (i as f32 * 0.77).sin() * 0.3).collect();
        let frames = Layer { weight, bias: vec![0.1; FRAME_OUTPUTS] };
        let latent = (0..12).map(|i| (i as f32).cos()).collect();
        Neural::new(Arc::new(Shared { network, frames }), latent, 3.0).unwrap()
    }

    #[test]
    fn folded_network_is_the_reference_in_every_kernel() {
        let material = material();
        assert_is_the_reference(&material, |l, v| reference::eval(&material, l, v), |truth| 1e-5 * truth);
    }

    #[test]
    fn frames_are_rotations_and_start_at_identity() {
        assert_eq!(frame(&[0.0; 6]), Mat3::IDENTITY);
        for offsets in [[0.3, -0.8, 0.5, 0.2, 0.9, -0.1], [0.0, 0.0, -1.0, -1.0, 0.0, 0.0]] {
            let f = frame(&offsets);
            assert!((f * f.transpose()).abs_diff_eq(Mat3::IDENTITY, 1e-6));
            assert!((f.determinant() - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let good = material();
        assert!(
            Neural::new(good.shared.clone(), vec![0.0; 5], 1.0)
                .unwrap_err()
                .to_string()
                .contains("expected 12")
        );
        assert!(
            Neural::new(good.shared.clone(), vec![f32::NAN; 12], 1.0)
                .unwrap_err()
                .to_string()
                .contains("holds NaN")
        );
    }
}

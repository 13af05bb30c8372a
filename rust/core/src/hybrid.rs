//! `hybrid`: De Oliveira, Karpova, Nader, Houdard, Mézières, Rioux-Lavoie, Pacanowski, *A Hybrid
//! Neural-Microfacet BRDF Model for Real-Time Rendering*.
//!
//! f = f_c + f_g · f_a (eq. 1) with the analytic BRDF f_a of [`crate::microfacet`] (eq. 3) and
//! (f_c, f_g) = (exp a, sigmoid b) from one small network ψ(inputs; z) (eq. 2), per colour channel.
//! A material is k_d, η, α and a latent code z; all materials of a library share the network.
//!
//! exp a can explode where the fit never looked. a is therefore limited to a little more than the
//! largest value that it took over directions like the fit's, which the library stores for each
//! material.

use std::sync::Arc;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::features::{Inputs, MAX_FEATURES};
use crate::kernel::{Kernel, splat3};
use crate::math::{exp, ln, sigmoid};
use crate::microfacet::{Half, Microfacet};
use crate::model::Model;
use crate::network::{Network, One, Rows, check_latent};
use crate::simd::{Isa, Lane, Lanes, Real, Vector};

/// How the network's outputs and f_a make f.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Composition {
    /// exp a + sigmoid b · f_a, six outputs (eq. 1).
    GatedResidual,
    /// max(0, f_a + a), three outputs: the paper's ablation "additive" (§4.2), limited to what a
    /// BRDF can be.
    Additive,
    /// f_a · exp a, three outputs: the paper's ablation "log multiplicative" (§4.2).
    LogMultiplicative,
}

impl Composition {
    /// Number of network outputs.
    #[must_use]
    pub fn outputs(self) -> usize {
        match self {
            Composition::GatedResidual => 6,
            Composition::Additive | Composition::LogMultiplicative => 3,
        }
    }

    /// f of one channel from the network's outputs a and b and the analytic value.
    #[inline(always)]
    #[must_use]
    pub fn compose<F: Real>(self, a: F, b: F, analytic: F, bound: f32) -> F {
        let a = a.at_most(bound);
        match self {
            Composition::GatedResidual => sigmoid(b).fma(analytic, exp(a)),
            Composition::Additive => (analytic + a).max(a.splat(0.0)),
            Composition::LogMultiplicative => analytic * exp(a),
        }
    }
}

/// What the network is given and what its outputs mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Form {
    /// The functions of the two directions that the network sees.
    pub inputs: Inputs,
    /// Whether it also sees ln f_a of each channel (the paper's ablation "analytical input").
    pub analytic_input: bool,
    /// How f is made of the outputs.
    pub composition: Composition,
}

impl Form {
    /// The paper's own form.
    pub const PAPER: Form =
        Form { inputs: Inputs::Cartesian, analytic_input: false, composition: Composition::GatedResidual };

    /// Number of network inputs that change with the directions.
    #[must_use]
    pub fn features(self) -> usize {
        self.inputs.count() + if self.analytic_input { 3 } else { 0 }
    }

    /// f_a, and the network's inputs to `x[input][lane]`, which have much in common.
    #[inline(always)]
    pub fn inputs_and_analytic<I: Lanes<L>, const L: usize>(
        self,
        microfacet: &Microfacet,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
        x: &mut [[f32; L]; MAX_INPUTS],
    ) -> [Vector<I, L>; 3] {
        let half = Half::new(light, view);
        let analytic = microfacet.eval_half(&half, light, view);
        let features = self.inputs.compute_half(&half, light, view, microfacet.alpha);
        let count = self.inputs.count();
        for i in 0..count {
            features[i].store(&mut x[i]);
        }
        if self.analytic_input {
            for c in 0..3 {
                Form::analytic_feature(analytic[c]).store(&mut x[count + c]);
            }
        }
        analytic
    }

    /// The network input for an analytic value: its logarithm, on the scale of the other inputs.
    #[inline(always)]
    #[must_use]
    pub fn analytic_feature<F: Real>(analytic: F) -> F {
        ln(analytic + ANALYTIC_FLOOR) * ANALYTIC_SCALE
    }

    /// Derivative of [`Form::analytic_feature`].
    #[must_use]
    pub fn analytic_feature_derivative(analytic: f32) -> f32 {
        ANALYTIC_SCALE / (analytic + ANALYTIC_FLOOR)
    }
}

/// Most inputs of a network that change with the directions.
pub const MAX_INPUTS: usize = MAX_FEATURES + 3;

/// Keeps the logarithm finite; far below any reflectance that is measured.
const ANALYTIC_FLOOR: f32 = 1e-4;
/// ln f_a reaches from −9 to 9: to the size of the other inputs.
const ANALYTIC_SCALE: f32 = 0.2;

/// Largest bound of a network's exponent: e²⁰ is beyond any measured lobe, and its square is finite.
pub const MAX_BOUND: f32 = 20.0;

/// Whether `bound` can bound an exponent.
///
/// # Errors
/// In words, that it cannot.
pub(crate) fn check_bound(bound: f32) -> Result<(), String> {
    if bound <= MAX_BOUND {
        Ok(())
    } else {
        Err(format!("the bound of the exponent is {bound}, expected at most {MAX_BOUND}"))
    }
}

/// One material of the hybrid model.
#[derive(Clone, Debug)]
pub struct Hybrid {
    form: Form,
    network: Arc<Network>,
    pub(crate) microfacet: Microfacet,
    latent: Vec<f32>,
    bound: f32,
    /// The latent code folded into the network's first bias.
    pub(crate) first_bias: Vec<Lane>,
}

impl Hybrid {
    /// A material with parameters p and latent code z; `bound` is the largest a that the fit saw.
    ///
    /// # Errors
    /// In words, a parameter that is out of range or a network that does not fit `form` and `latent`.
    pub fn new(
        form: Form,
        network: Arc<Network>,
        microfacet: Microfacet,
        latent: Vec<f32>,
        bound: f32,
    ) -> Result<Self, String> {
        microfacet.validate()?;
        if network.features() != form.features() || network.outputs() != form.composition.outputs() {
            return Err(format!(
                "the network maps {} features to {} values, expected {} to {}",
                network.features(),
                network.outputs(),
                form.features(),
                form.composition.outputs()
            ));
        }
        if network.latent() != latent.len() {
            return Err(format!(
                "the latent code has {} numbers, expected {}",
                latent.len(),
                network.latent()
            ));
        }
        check_latent(&latent)?;
        check_bound(bound)?;
        let first_bias = network.fold(&latent);
        Ok(Hybrid { form, network, microfacet, latent, bound, first_bias })
    }

    /// What the network is given and what its outputs mean.
    #[must_use]
    pub fn form(&self) -> Form {
        self.form
    }

    /// The network that the library's materials share.
    #[must_use]
    pub fn network(&self) -> &Arc<Network> {
        &self.network
    }

    /// k_d, η, α.
    #[must_use]
    pub fn microfacet(&self) -> &Microfacet {
        &self.microfacet
    }

    /// z.
    #[must_use]
    pub fn latent(&self) -> &[f32] {
        &self.latent
    }

    /// The largest value of a that counts.
    #[must_use]
    pub fn bound(&self) -> f32 {
        self.bound
    }
}

impl Model for Hybrid {
    const KIND: &'static str = "hybrid";

    fn is_isotropic(&self) -> bool {
        self.form.inputs.is_isotropic() && self.microfacet.is_isotropic()
    }

    fn is_reciprocal(&self) -> bool {
        self.form.inputs.is_reciprocal()
    }

    fn microfacet(&self) -> Option<&Microfacet> {
        Some(&self.microfacet)
    }

    fn latent(&self) -> &[f32] {
        &self.latent
    }

    fn network(&self) -> Option<&Network> {
        Some(&self.network)
    }

    fn with_microfacet(&self, microfacet: Microfacet) -> Result<Self, String> {
        Hybrid::new(self.form, self.network.clone(), microfacet, self.latent.clone(), self.bound)
    }

    fn with_latent(&self, latent: Vec<f32>) -> Result<Self, String> {
        Hybrid::new(self.form, self.network.clone(), self.microfacet, latent, self.bound)
    }
}

impl Kernel for Hybrid {
    #[inline(always)]
    fn eval_lanes<I: Lanes<L>, const L: usize>(
        &self,
        isa: I,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
    ) -> [Vector<I, L>; 3] {
        let mut x = [[0.0; L]; MAX_INPUTS];
        let analytic = self.form.inputs_and_analytic(&self.microfacet, light, view, &mut x);
        let mut y = Rows::default();
        self.network.forward_tile(isa, self.first_bias.as_flattened(), &x, &mut y);
        let mut f = analytic;
        // A composition of three outputs has no b.
        let second = y.len() - 3;
        for c in 0..3 {
            let [a, b] = [Vector::load(isa, &y[c]), Vector::load(isa, &y[c + second])];
            f[c] = self.form.composition.compose(a, b, analytic[c], self.bound);
        }
        f
    }

    #[inline(always)]
    fn eval_one<I: Isa>(&self, isa: I, light: Vec3, view: Vec3) -> Vec3 {
        // Before the network the pair stands in all lanes, so that nothing has to move between them;
        // after it the lanes are the channels.
        let (light, view) = (splat3::<I, 4>(isa, light), splat3(isa, view));
        let half = Half::new(light, view);
        let analytic = self.microfacet.eval_one(isa, &half, light, view);
        let features = self.form.inputs.compute_half(&half, light, view, self.microfacet.alpha);
        let mut x = [0.0; MAX_INPUTS];
        for i in 0..MAX_FEATURES {
            x[i] = features[i].first();
        }
        if self.form.analytic_input {
            let count = self.form.inputs.count();
            x[count..count + 3].copy_from_slice(&Form::analytic_feature(analytic).to_array()[..3]);
        }
        let mut y = One::default();
        self.network.forward_one(isa, &self.first_bias, &x, &mut y);
        let [a, b] = [Vector::load(isa, y.four_from::<0>()), Vector::load(isa, y.four_from::<3>())];
        let f = self.form.composition.compose(a, b, analytic, self.bound).to_array();
        Vec3::new(f[0], f[1], f[2])
    }
}

/// The same model in float64, written as the paper prints it. What tests compare against.
pub mod reference {
    use super::{ANALYTIC_FLOOR, ANALYTIC_SCALE, Composition, Hybrid};
    use crate::math::reference::{exp, sigmoid};
    use crate::{features, microfacet, network};
    use glam::DVec3;

    /// f for directions above the horizon.
    #[must_use]
    pub fn eval(material: &Hybrid, light: DVec3, view: DVec3) -> [f64; 3] {
        let analytic = microfacet::reference::eval(&material.microfacet, light.to_array(), view.to_array());
        let alpha = material.microfacet.alpha.map(f64::from);
        let mut x = features::reference::compute(material.form.inputs, light, view, alpha);
        if material.form.analytic_input {
            x.extend(analytic.map(|f| f64::from(ANALYTIC_SCALE) * (f + f64::from(ANALYTIC_FLOOR)).ln()));
        }
        let latent: Vec<f64> = material.latent.iter().map(|&z| z.into()).collect();
        let y = network::reference::forward(&material.network, &x, &latent);
        std::array::from_fn(|c| {
            let a = y[c].min(material.bound.into());
            match material.form.composition {
                Composition::GatedResidual => exp(a) + sigmoid(y[c + 3]) * analytic[c],
                Composition::Additive => (analytic[c] + a).max(0.0),
                Composition::LogMultiplicative => analytic[c] * exp(a),
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Brdf;
    use crate::kernel::ONE_MAX_RELATIVE_DIFFERENCE;
    use crate::network::{Activation, tests::patterned};
    use glam::DVec3;

    const FORMS: [Form; 6] = [
        Form::PAPER,
        Form { inputs: Inputs::Isotropic, ..Form::PAPER },
        Form { inputs: Inputs::AnisotropicReciprocal, ..Form::PAPER },
        Form { composition: Composition::Additive, ..Form::PAPER },
        Form { composition: Composition::LogMultiplicative, ..Form::PAPER },
        Form { inputs: Inputs::IsotropicReciprocal, analytic_input: true, ..Form::PAPER },
    ];

    fn material(form: Form, width: usize, layers: usize, latent: usize) -> Hybrid {
        let mut sizes = vec![width; layers + 2];
        sizes[0] = form.features() + latent;
        sizes[layers + 1] = form.composition.outputs();
        let network = Arc::new(patterned(&sizes, form.features(), Activation::HardGelu));
        let alpha = if form.inputs.is_isotropic() { [0.2; 2] } else { [0.2, 0.35] };
        let microfacet = Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.5, 1.8, 2.5], alpha };
        let latent = (0..latent).map(|i| (i as f32 * 1.3).sin()).collect();
        Hybrid::new(form, network, microfacet, latent, 2.0).unwrap()
    }

    fn pairs(n: usize) -> (Vec<Vec3>, Vec<Vec3>) {
        let direction = |u: f64, v: f64| {
            let (z, phi) = (0.03 + 0.97 * u.fract(), v.fract() * std::f64::consts::TAU);
            let r = (1.0 - z * z).sqrt();
            DVec3::new(r * phi.cos(), r * phi.sin(), z).as_vec3()
        };
        (0..n)
            .map(|i| i as f64 + 0.5)
            .map(|i| {
                (direction(i * 0.856_674_9, i * 0.733_891_9), direction(i * 0.628_706_7, i * 0.538_596_9))
            })
            .unzip()
    }

    #[test]
    fn every_size_and_form_agrees_with_the_reference_and_across_kernels() {
        let (light, view) = pairs(203);
        for form in FORMS {
            for (width, layers, latent) in
                [(16, 2, 4), (16, 3, 8), (32, 2, 8), (32, 3, 4), (64, 2, 4), (64, 3, 8)]
            {
                let material = material(form, width, layers, latent);
                let mut batch = vec![Vec3::ZERO; light.len()];
                material.eval_batch(&light, &view, &mut batch);
                for i in 0..light.len() {
                    let f = material.eval(light[i], view[i]);
                    let difference = (f - batch[i]).abs().max_element();
                    let most = ONE_MAX_RELATIVE_DIFFERENCE * batch[i].max_element() + 1e-6;
                    assert!(
                        difference <= most,
                        "{form:?} {width}x{layers}: {difference} beside {}",
                        batch[i]
                    );
                    let truth = reference::eval(&material, light[i].as_dvec3(), view[i].as_dvec3());
                    for (f, truth) in f.to_array().into_iter().zip(truth) {
                        // Absolute where the additive form cancels, relative everywhere else.
                        let error = (f64::from(f) - truth).abs();
                        assert!(
                            error <= 5e-5 * truth + 2e-6,
                            "{form:?} {width}x{layers}: {f} against {truth}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn isotropic_inputs_make_an_isotropic_material() {
        let material = material(Form { inputs: Inputs::Isotropic, ..Form::PAPER }, 32, 2, 4);
        let (light, view) = pairs(100);
        for (l, v) in light.into_iter().zip(view) {
            let turn = glam::Quat::from_rotation_z(1.234);
            let (f, turned) = (material.eval(l, v), material.eval(turn * l, turn * v));
            assert!((f - turned).abs().max_element() <= 1e-4 * f.max_element(), "{f} {turned}");
        }
    }

    #[test]
    fn reciprocal_inputs_make_a_reciprocal_material() {
        for inputs in [Inputs::IsotropicReciprocal, Inputs::AnisotropicReciprocal] {
            let material = material(Form { inputs, ..Form::PAPER }, 16, 3, 4);
            let (light, view) = pairs(100);
            for (l, v) in light.into_iter().zip(view) {
                assert_eq!(material.eval(l, v), material.eval(v, l));
            }
        }
    }

    #[test]
    fn residual_never_exceeds_its_bound() {
        for composition in [Composition::GatedResidual, Composition::LogMultiplicative] {
            let far = composition.compose(1e6, 0.0, 1.0, 0.7);
            assert!(far <= exp(0.7) + 0.5 + 1e-6, "{composition:?}: {far}");
        }
        assert_eq!(Composition::Additive.compose(-5.0, 0.0, 1.0, 0.7), 0.0);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let good = material(Form::PAPER, 16, 2, 4);
        let new = |form, microfacet, latent: Vec<f32>| {
            Hybrid::new(form, good.network.clone(), microfacet, latent, 0.0).unwrap_err()
        };
        let z = vec![0.0; 4];
        assert!(new(FORMS[5], good.microfacet, z.clone()).contains("expected 9"));
        assert!(new(FORMS[3], good.microfacet, z.clone()).contains("to 3"));
        assert!(new(Form::PAPER, good.microfacet, vec![0.0; 3]).contains("expected 4"));
        assert!(new(Form::PAPER, good.microfacet, vec![f32::NAN; 4]).contains("holds NaN"));
        assert!(
            new(Form::PAPER, Microfacet { alpha: [2.0; 2], ..good.microfacet }, z).contains("alpha is 2")
        );
    }
}

//! `hybrid`: De Oliveira, Karpova, Nader, Houdard, Mézières, Rioux-Lavoie, Pacanowski, *A Hybrid
//! Neural-Microfacet BRDF Model for Real-Time Rendering*.
//!
//! f = f_c + f_g · f_a (eq. 1) with the analytic BRDF f_a of [`crate::microfacet`] (eq. 3) and
//! (f_c, f_g) = (exp a, sigmoid b) from one small network ψ(inputs; z) (eq. 2), per colour channel.
//! A material is k_d, η, α and a latent code z; all materials of a library share the network.
//!
//! exp a can explode where the fit never looked. a is therefore limited to a little more than the
//! largest value that it took over directions like the fit's, which the library stores for each
//! material. What other k_d, η, α and z make of it says [`crate::models::edit`].

mod lanes;

use std::sync::Arc;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::directions::features::{Inputs, MAX_FEATURES};
use crate::error::{Invalid, Unmixable};
use crate::kernels::mixed;
use crate::kernels::network::{Network, One, check_latent};
use crate::kernels::{Kernel, splat3};
use crate::microfacet::{Half, Microfacet, Terms};
use crate::models::edit::{self, Albedos, Allowed, Black, Edit, Fitted, Origin, Room, Turn, Views};
use crate::models::ggx::Ggx;
use crate::models::{Model, spelled};
use crate::simd::math::{exp, ln, sigmoid};
use crate::simd::{Isa, LANES, Lane, Lane3, Lanes, Real, Spread, Vector};
use lanes::Own;

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
    pub fn compose<F: Real>(self, a: F, b: F, analytic: F, bound: F) -> F {
        let a = bound.min(a);
        match self {
            Composition::GatedResidual => sigmoid(b).fma(analytic, exp(a)),
            Composition::Additive => (analytic + a).max(a.splat(0.0)),
            Composition::LogMultiplicative => analytic * exp(a),
        }
    }

    /// f of one channel of an edited material: what the network adds goes with the analytic value from `fitted`
    /// to `edited`, and of that the share `room` stays, see [`crate::models::edit`].
    #[inline(always)]
    #[must_use]
    pub fn compose_edited<F: Real>(self, a: F, b: F, fitted: F, edited: F, room: F, bound: F) -> F {
        let a = bound.min(a);
        let (zero, one) = (a.splat(0.0), a.splat(1.0));
        match self {
            Composition::GatedResidual => {
                let residual = exp(a);
                sigmoid(b).fma(edited, residual * edit::change(fitted, edited, residual) * room)
            }
            Composition::Additive => {
                let (more, less) = (a.max(zero), a.min(zero));
                let change = edit::change(fitted, edited, more - less);
                change.fma(more.fma(room, less), edited).max(zero)
            }
            Composition::LogMultiplicative => {
                let factor = exp(a);
                edited * (factor - 1.0).max(zero).fma(room, factor.min(one))
            }
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
        terms: &Terms<impl Spread<Vector<I, L>>>,
        light: [Vector<I, L>; 3],
        view: [Vector<I, L>; 3],
        x: &mut [[f32; L]; MAX_INPUTS],
    ) -> [Vector<I, L>; 3] {
        let half = Half::new(light, view);
        let analytic = terms.eval_half(&half, light, view);
        let features = self.inputs.compute_half(&half, light, view, &terms.roughness);
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
pub(crate) fn check_bound(bound: f32) -> Result<(), Invalid> {
    if bound <= MAX_BOUND {
        Ok(())
    } else {
        Err(format!("the bound of the exponent is {bound}, expected at most {MAX_BOUND}").into())
    }
}

/// One material of the hybrid model.
///
/// A fit makes one, and a library brings it:
///
/// ```
/// use glimt_core::models::hybrid::{Composition, Hybrid};
/// use glimt_core::{Brdf, Library, Vec3};
///
/// let library = Library::open("../../scenes/models/rgl.safetensors")?;
/// let hybrid: &Hybrid = library.material(Some("chm_orange"))?.try_into().unwrap();
/// assert_eq!(hybrid.form().composition, Composition::GatedResidual);
/// assert_eq!((hybrid.latent().len(), hybrid.network().outputs()), (4, 6));
/// assert!(hybrid.eval(Vec3::Z, Vec3::Z).x > 1.0);
/// # Ok::<(), glimt_core::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct Hybrid {
    form: Form,
    network: Arc<Network>,
    microfacet: Microfacet,
    latent: Vec<f32>,
    bound: f32,
    /// The latent code folded into the network's first bias.
    first_bias: Vec<Lane>,
    /// Of p₀, beside which the network was fitted.
    terms: Terms,
    /// None if k_d, η, α and z are those of the fit.
    edit: Option<Box<Edit>>,
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
    ) -> Result<Self, Invalid> {
        microfacet.validate()?;
        if network.features() != form.features() || network.outputs() != form.composition.outputs() {
            return Err(format!(
                "the network maps {} features to {} values, expected {} to {}",
                network.features(),
                network.outputs(),
                form.features(),
                form.composition.outputs()
            )
            .into());
        }
        if network.latent() != latent.len() {
            return Err(Invalid::LatentLength { found: latent.len(), expected: network.latent() });
        }
        check_latent(&latent)?;
        check_bound(bound)?;
        let (first_bias, terms) = (network.fold(&latent), microfacet.terms());
        Ok(Hybrid { form, network, microfacet, latent, bound, first_bias, terms, edit: None })
    }

    /// The same network with other parameters: an edit of the material with p₀ = `origin` and `fitted`, or that
    /// material itself.
    ///
    /// # Errors
    /// See [`Hybrid::new`].
    pub fn edited(
        &self,
        origin: Microfacet,
        fitted: Fitted,
        microfacet: Microfacet,
        latent: Vec<f32>,
    ) -> Result<Self, Invalid> {
        let new = |p, z| Hybrid::new(self.form, self.network.clone(), p, z, self.bound);
        if fitted.origin == Origin::Fit && microfacet == origin && latent == fitted.latent {
            return new(origin, latent);
        }
        let mut edited = new(microfacet, latent)?;
        edited.make_room(origin, fitted)?;
        Ok(edited)
    }

    /// Between this material and another of the same network, with a share `t` in [0, 1] of the other: z and the
    /// bound are linear, p as [`Microfacet::mix`] says.
    ///
    /// # Errors
    /// In words, that the two share no network.
    pub fn mix(&self, other: &Hybrid, t: f32) -> Result<Self, Invalid> {
        if !self.shares_tiles_with(other) {
            return Err(Unmixable::Networks.into());
        }
        let ((p, fitted), (other_p, other_fitted)) = (self.fitted(), other.fitted());
        let mixed = Fitted {
            latent: edit::mix_latents(&fitted.latent, &other_fitted.latent, t),
            origin: Origin::mix(&self.ceiling(), &other.ceiling()),
        };
        let bound = self.bound + (other.bound - self.bound) * t;
        Hybrid { bound, ..self.clone() }.edited(
            p.mix(&other_p, t),
            mixed,
            self.microfacet.mix(&other.microfacet, t),
            edit::mix_latents(&self.latent, &other.latent, t),
        )
    }

    /// Albedos that a mix of this material may reach.
    fn ceiling(&self) -> Albedos {
        match self.edit.as_ref().and_then(|edit| edit.fitted.origin.ends()) {
            Some(ends) => *ends,
            None => Views::new(self.is_isotropic(), &[self.microfacet.alpha]).albedos(self),
        }
    }

    /// Gives the residual the share that there is room for.
    fn make_room(&mut self, origin: Microfacet, fitted: Fitted) -> Result<(), Invalid> {
        let turn = Turn::new(origin.alpha, self.microfacet.alpha);
        let with = |room| {
            let terms = self.microfacet.terms();
            let edit = Edit { fitted: fitted.clone(), microfacet: origin, terms, turn, room };
            Hybrid { terms: origin.terms(), edit: Some(Box::new(edit)), ..self.clone() }
        };
        let views = Views::new(self.is_isotropic(), &[origin.alpha, self.microfacet.alpha]);
        let unedited =
            Hybrid::new(self.form, self.network.clone(), origin, fitted.latent.clone(), self.bound)?;
        let allowed = Allowed {
            before: if fitted.origin == Origin::Fit { &unedited } else { &Black },
            analytic: &Ggx::new(self.microfacet)?,
            ends: fitted.origin.ends(),
        };
        let room = Room::of(&views, &allowed, &with(Room::NONE), &with(Room::ALL));
        *self = with(room);
        Ok(())
    }

    /// p₀ and the rest of what this material is an edit of; its own if it is none.
    #[must_use]
    pub fn fitted(&self) -> (Microfacet, Fitted) {
        match &self.edit {
            Some(edit) => (edit.microfacet, edit.fitted.clone()),
            None => (self.microfacet, Fitted { latent: self.latent.clone(), origin: Origin::Fit }),
        }
    }

    /// None if k_d, η, α and z are those of the fit.
    #[must_use]
    pub fn edit(&self) -> Option<&Edit> {
        self.edit.as_deref()
    }

    /// p₀, beside which the network was fitted.
    #[must_use]
    pub fn fitted_microfacet(&self) -> &Microfacet {
        self.edit.as_ref().map_or(&self.microfacet, |edit| &edit.microfacet)
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

    fn describe(&self) -> String {
        let Form { inputs, analytic_input, composition } = &self.form;
        let logarithm = if *analytic_input { " and ln f_a" } else { "" };
        format!("{} inputs{logarithm}, {}", spelled(inputs), spelled(composition))
    }

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

    fn with_microfacet(&self, microfacet: Microfacet) -> Result<Self, Invalid> {
        let (origin, fitted) = self.fitted();
        self.edited(origin, fitted, microfacet, self.latent.clone())
    }

    fn with_latent(&self, latent: Vec<f32>) -> Result<Self, Invalid> {
        let (origin, fitted) = self.fitted();
        self.edited(origin, fitted, self.microfacet, latent)
    }

    fn shares_tiles_with(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.network, &other.network) && self.form == other.form
    }

    fn eval_mixed_tile(materials: &[&Self; LANES], light: &Lane3, view: &Lane3, out: &mut Lane3) {
        mixed::eval_tile(materials, light, view, out);
    }

    fn mix(&self, other: &Self, t: f32) -> Result<Self, Invalid> {
        Hybrid::mix(self, other, t)
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
        let first_bias = self.first_bias.as_flattened();
        lanes::evaluate(isa, self.form, &self.network, first_bias, &Own::of(self), light, view)
    }

    #[inline(always)]
    fn eval_one<I: Isa>(&self, isa: I, light: Vec3, view: Vec3) -> Vec3 {
        // Before the network the pair stands in all lanes, so that nothing has to move between them;
        // after it the lanes are the channels.
        let (light, view) = (splat3::<I, 4>(isa, light), splat3(isa, view));
        let [asked_light, asked_view] = match self.edit.as_ref().and_then(|edit| edit.turn) {
            Some(turn) => turn.apply(light, view),
            None => [light, view],
        };
        let half = Half::new(asked_light, asked_view);
        let analytic = self.terms.eval_one(isa, &half, asked_light, asked_view);
        let roughness = &self.terms.roughness;
        let features = self.form.inputs.compute_half(&half, asked_light, asked_view, roughness);
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
        let (composition, bound) = (self.form.composition, a.splat(self.bound));
        let f = match &self.edit {
            None => composition.compose(a, b, analytic, bound),
            Some(edit) => {
                let edited = edit.terms.eval_one(isa, &Half::new(light, view), light, view);
                let room = edit.room.share(light, view);
                composition.compose_edited(a, b, analytic, edited, room, bound)
            }
        };
        let f = f.to_array();
        Vec3::new(f[0], f[1], f[2])
    }
}

/// The same model in float64, written as the paper prints it. What tests compare against.
pub mod reference {
    use super::{ANALYTIC_FLOOR, ANALYTIC_SCALE, Composition, Hybrid};
    use crate::directions::features;
    use crate::kernels::network;
    use crate::microfacet;
    use crate::models::edit;
    use crate::simd::math::reference::{exp, sigmoid};
    use glam::DVec3;

    /// f for directions above the horizon.
    #[must_use]
    pub fn eval(material: &Hybrid, light: DVec3, view: DVec3) -> [f64; 3] {
        let edited = microfacet::reference::eval(&material.microfacet, light.to_array(), view.to_array());
        let (fitted, edit) = (material.fitted_microfacet(), material.edit());
        let turn = edit.and_then(|edit| edit.turn);
        let (asked_light, asked_view) =
            turn.map_or((light, view), |turn| edit::reference::turn(&turn, light, view));
        let analytic = microfacet::reference::eval(fitted, asked_light.to_array(), asked_view.to_array());
        let alpha = fitted.alpha.map(f64::from);
        let mut x = features::reference::compute(material.form.inputs, asked_light, asked_view, alpha);
        if material.form.analytic_input {
            x.extend(analytic.map(|f| f64::from(ANALYTIC_SCALE) * (f + f64::from(ANALYTIC_FLOOR)).ln()));
        }
        let latent: Vec<f64> = material.latent.iter().map(|&z| z.into()).collect();
        let y = network::reference::forward(&material.network, &x, &latent);
        let room = edit.map_or(1.0, |edit| edit::reference::share(&edit.room, light.z, view.z));
        std::array::from_fn(|c| {
            let a = y[c].min(material.bound.into());
            let change = |residual: f64| edit::reference::change(analytic[c], edited[c], residual);
            match material.form.composition {
                Composition::GatedResidual => room * change(exp(a)) * exp(a) + sigmoid(y[c + 3]) * edited[c],
                Composition::Additive => {
                    (edited[c] + change(a.abs()) * (room * a.max(0.0) + a.min(0.0))).max(0.0)
                }
                Composition::LogMultiplicative => {
                    edited[c] * (exp(a).min(1.0) + room * (exp(a) - 1.0).max(0.0))
                }
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Brdf;
    use crate::kernels::ONE_MAX_RELATIVE_DIFFERENCE;
    use crate::kernels::network::{Activation, tests::patterned};
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

    /// Batches, single pairs and the reference give one value.
    fn assert_agrees(material: &Hybrid, what: &str) {
        let (light, view) = pairs(203);
        let mut batch = vec![Vec3::ZERO; light.len()];
        material.eval_batch(&light, &view, &mut batch);
        for i in 0..light.len() {
            let f = material.eval(light[i], view[i]);
            let difference = (f - batch[i]).abs().max_element();
            let most = ONE_MAX_RELATIVE_DIFFERENCE * batch[i].max_element() + 1e-6;
            assert!(difference <= most, "{what}: {difference} beside {}", batch[i]);
            let truth = reference::eval(material, light[i].as_dvec3(), view[i].as_dvec3());
            for (f, truth) in f.to_array().into_iter().zip(truth) {
                // Absolute where the additive form cancels, relative everywhere else.
                let error = (f64::from(f) - truth).abs();
                assert!(error <= 5e-5 * truth + 2e-6, "{what}: {f} against {truth}");
            }
        }
    }

    #[test]
    fn every_size_and_form_agrees_with_the_reference_and_across_kernels() {
        for form in FORMS {
            for (width, layers, latent) in
                [(16, 2, 4), (16, 3, 8), (32, 2, 8), (32, 3, 4), (64, 2, 4), (64, 3, 8)]
            {
                let material = material(form, width, layers, latent);
                assert_agrees(&material, &format!("{form:?} {width}x{layers}"));
            }
        }
    }

    /// Wider, narrower, brighter, and another code.
    fn edits(material: &Hybrid) -> Vec<Hybrid> {
        let p = material.microfacet;
        let [x, y] = p.alpha;
        let mut edits: Vec<Hybrid> = [
            Microfacet { alpha: [2.0 * x, 2.5 * y], ..p },
            Microfacet { alpha: [0.5 * x, 0.5 * y], kd: [0.9, 0.1, 1.0], ..p },
            Microfacet { eta: [4.0, 1.05, 2.5], kd: [1.0; 3], ..p },
        ]
        .map(|p| material.with_microfacet(p).unwrap())
        .into();
        edits.push(material.with_latent(material.latent.iter().map(|z| 0.5 - z).collect()).unwrap());
        edits
    }

    #[test]
    fn edited_materials_agree_with_the_reference_and_across_kernels() {
        for form in FORMS {
            for edited in edits(&material(form, 16, 2, 4)) {
                assert!(edited.edit().is_some());
                assert_agrees(&edited, &format!("{form:?} {:?}", edited.edit()));
            }
        }
    }

    #[test]
    fn what_is_edited_back_is_what_was_fitted() {
        for form in FORMS {
            let fitted = material(form, 16, 2, 4);
            let (light, view) = pairs(50);
            for edited in edits(&fitted) {
                let back = edited.with_latent(fitted.latent.clone()).unwrap();
                let back = back.with_microfacet(fitted.microfacet).unwrap();
                assert!(back.edit().is_none());
                for (&l, &v) in light.iter().zip(&view) {
                    assert_eq!(back.eval(l, v), fitted.eval(l, v));
                }
            }
        }
    }

    #[test]
    fn an_edit_of_nothing_is_near_to_the_fit() {
        for form in FORMS {
            let fitted = material(form, 16, 2, 4);
            let p = fitted.microfacet;
            let edited =
                fitted.with_microfacet(Microfacet { alpha: p.alpha.map(|a| a * 1.0001), ..p }).unwrap();
            let (light, view) = pairs(200);
            for (&l, &v) in light.iter().zip(&view) {
                let (f, g) = (fitted.eval(l, v), edited.eval(l, v));
                assert!((f - g).abs().max_element() <= 2e-3 * f.max_element(), "{form:?}: {f} {g}");
            }
        }
    }

    #[test]
    fn mixes_lie_between_and_know_their_ends() {
        for form in FORMS {
            let a = material(form, 16, 2, 4);
            let p = Microfacet {
                kd: [0.1, 0.6, 0.2],
                eta: [1.3, 2.2, 1.5],
                alpha: a.microfacet.alpha.map(|x| 2.0 * x),
            };
            let z = a.latent.iter().map(|z| -z).collect();
            let b = Hybrid::new(form, a.network.clone(), p, z, 1.0).unwrap();
            let middle = a.mix(&b, 0.5).unwrap();
            assert_agrees(&middle, &format!("{form:?}"));
            assert_eq!(middle.bound, 1.5);
            assert_eq!(middle.latent, [0.0; 4]);
            assert!((middle.microfacet.kd[1] - 0.4).abs() < 1e-6);
            // Its own numbers are no fit's: edited back to them it is the mix again.
            let there = middle.with_microfacet(a.microfacet).unwrap();
            let back = there.with_microfacet(middle.microfacet).unwrap();
            assert_eq!(back.edit(), middle.edit());
            let other = material(form, 16, 2, 4);
            assert!(a.mix(&other, 0.5).unwrap_err().to_string().contains("no network in common"));
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
        assert!(new(FORMS[5], good.microfacet, z.clone()).to_string().contains("expected 9"));
        assert!(new(FORMS[3], good.microfacet, z.clone()).to_string().contains("to 3"));
        assert!(new(Form::PAPER, good.microfacet, vec![0.0; 3]).to_string().contains("expected 4"));
        assert!(new(Form::PAPER, good.microfacet, vec![f32::NAN; 4]).to_string().contains("holds NaN"));
        assert!(
            new(Form::PAPER, Microfacet { alpha: [2.0; 2], ..good.microfacet }, z)
                .to_string()
                .contains("alpha is 2")
        );
    }
}

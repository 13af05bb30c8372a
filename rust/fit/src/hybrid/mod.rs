//! The hybrid model: its options, and how its fit starts and ends. `objective.rs` is what is trained; `addition.rs`
//! adds materials to a finished library.

pub(crate) mod addition;
mod objective;

use std::sync::Arc;

use glimt_core::Invalid;
use glimt_core::Material;
use glimt_core::directions::features::Inputs;
use glimt_core::kernels::network::{Activation, Network};
use glimt_core::models::hybrid::{Composition, Form, Hybrid};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::analytic;
use crate::backprop::Shape;
use crate::error::Error;
use crate::fittable::Fittable;
use crate::ggx::GgxObjective;
use crate::input::Input;
use crate::judge::{BOUND_MARGIN, Judge};
use crate::loss::{DEFAULT_ANALYTIC_LOSS, DEFAULT_LOSS, Loss};
use crate::net::{NEEDS_CODE, Net, random_layers, symmetric};
use crate::objective::Objective;
use crate::train::{Schedule, Watch};
use crate::truth::Truth;

pub use objective::{HybridObjective, Sharing};

/// A hybrid fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HybridOptions {
    /// Hidden layers.
    pub net: Net,
    /// Numbers in the latent code; 0 where every material has its own network.
    pub latent: usize,
    /// Who has a network.
    pub sharing: Sharing,
    /// What the network sees.
    pub inputs: InputChoice,
    /// Whether it also sees ln f_a.
    pub analytic_input: bool,
    /// How f is made of its outputs.
    pub composition: Composition,
    /// Loss of f.
    pub loss: Loss,
    /// Loss of f_a.
    pub analytic_loss: Option<Loss>,
    /// Whether the loss of f moves k_d, η and α.
    pub joint: bool,
}

/// What of a hybrid fit is not in the model that it makes, and what [`crate::add()`] goes on with. A library
/// keeps it with every material.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// Loss of f.
    pub loss: Loss,
    /// Loss of f_a.
    pub analytic_loss: Option<Loss>,
    /// Whether the loss of f moves k_d, η and α.
    pub joint: bool,
}

/// What a network sees; the materials' symmetry decides the rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum InputChoice {
    /// The Cartesian directions, as in the paper.
    Cartesian,
    /// Functions of half and difference vector.
    HalfDifference,
    /// The same, with f(l, v) = f(v, l) by construction.
    Reciprocal,
}

impl InputChoice {
    fn inputs(self, isotropic: bool) -> Inputs {
        match (self, isotropic) {
            (InputChoice::Cartesian, _) => Inputs::Cartesian,
            (InputChoice::HalfDifference, true) => Inputs::Isotropic,
            (InputChoice::HalfDifference, false) => Inputs::Anisotropic,
            (InputChoice::Reciprocal, true) => Inputs::IsotropicReciprocal,
            (InputChoice::Reciprocal, false) => Inputs::AnisotropicReciprocal,
        }
    }
}

impl HybridOptions {
    /// glimt's own recipe for a network shared by all materials.
    #[must_use]
    pub fn shared(net: Net, latent: usize) -> Self {
        HybridOptions {
            net,
            latent,
            sharing: Sharing::Library,
            inputs: InputChoice::HalfDifference,
            analytic_input: false,
            composition: Composition::GatedResidual,
            loss: DEFAULT_LOSS,
            analytic_loss: Some(DEFAULT_ANALYTIC_LOSS),
            joint: false,
        }
    }

    /// glimt's recipe for a network per material.
    #[must_use]
    pub fn per_material(net: Net) -> Self {
        HybridOptions { sharing: Sharing::Material, latent: 0, ..Self::shared(net, 0) }
    }

    /// What a library keeps of the options.
    #[must_use]
    pub fn recipe(&self) -> Recipe {
        Recipe { loss: self.loss, analytic_loss: self.analytic_loss, joint: self.joint }
    }

    /// The paper's inputs and loss.
    #[must_use]
    pub fn paper(net: Net, latent: usize) -> Self {
        HybridOptions {
            inputs: InputChoice::Cartesian,
            loss: Loss::PAPER,
            analytic_loss: Some(Loss::PAPER),
            joint: true,
            ..Self::shared(net, latent)
        }
    }
}

impl Fittable for HybridOptions {
    type Objective = HybridObjective;

    fn check(&self, inputs: &[Input]) -> Result<(), String> {
        self.net.check(self.latent)?;
        let needs_code = self.sharing == Sharing::Library && inputs.len() > 1;
        if needs_code && self.latent == 0 { Err(NEEDS_CODE.into()) } else { Ok(()) }
    }

    fn objective(&self, isotropic: bool) -> Result<HybridObjective, String> {
        let form = Form {
            inputs: self.inputs.inputs(isotropic),
            analytic_input: self.analytic_input,
            composition: self.composition,
        };
        let (inputs, outputs) = (form.features() + self.latent, self.composition.outputs());
        Ok(HybridObjective {
            sharing: self.sharing,
            form,
            shape: Shape::new(inputs, &self.net.hidden(), outputs, Activation::HardGelu),
            latent: self.latent,
            isotropic,
            loss: self.loss,
            analytic_loss: self.analytic_loss,
            joint: self.joint,
        })
    }

    /// Random weights and codes, and the analytic fits.
    fn start(
        &self,
        objective: &HybridObjective,
        truths: &[Truth],
        schedule: &Schedule,
        watch: &mut Watch,
    ) -> Result<Option<Vec<f32>>, Error> {
        let Some(p) = objective.fit_analytic(truths, schedule, watch)? else { return Ok(None) };
        let mut rng = Pcg64::seed_from_u64(schedule.seed);
        let mut numbers = Vec::new();
        if objective.sharing == Sharing::Library {
            numbers.extend(random_network(objective, &mut rng));
        }
        for p in p {
            if objective.sharing == Sharing::Material {
                numbers.extend(random_network(objective, &mut rng));
            }
            numbers.extend(p);
            numbers.extend((0..objective.latent).map(|_| 0.5 * symmetric(&mut rng)));
        }
        Ok(Some(numbers))
    }

    fn finish(
        &self,
        objective: &HybridObjective,
        numbers: &[f32],
        truths: &[Truth],
        judge: &Judge,
    ) -> Result<Vec<Material>, Invalid> {
        let (shared, own) = numbers.split_at(objective.shared_len());
        let network = |numbers: &[f32]| {
            let layers = objective.shape.to_layers(numbers);
            Network::new(layers, objective.form.features(), objective.shape.activation()).map(Arc::new)
        };
        let library = match objective.sharing {
            Sharing::Library => Some(network(shared)?),
            Sharing::Material => None,
        };
        let materials = own.chunks_exact(objective.own_len()).zip(truths);
        let material = |(own, &truth): (&[f32], &Truth)| {
            let of_material = || network(objective.split(shared, own).network);
            let network = library.clone().map_or_else(of_material, Ok)?;
            objective.material(network, shared, own, truth, judge)
        };
        materials.map(material).collect()
    }

    fn recipe_json(&self) -> Option<serde_json::Value> {
        Some(self.recipe().to_json())
    }
}

impl Recipe {
    fn to_json(self) -> serde_json::Value {
        serde_json::to_value(self).expect("numbers always serialise")
    }
}

impl HybridObjective {
    /// The unbounded numbers of the best analytic fit of every material; `None` if it was stopped.
    fn fit_analytic(
        &self,
        truths: &[Truth],
        schedule: &Schedule,
        watch: &mut Watch,
    ) -> Result<Option<Vec<Vec<f32>>>, Error> {
        let analytic =
            GgxObjective { loss: self.analytic_loss.unwrap_or(self.loss), isotropic: self.isotropic };
        analytic.fit(truths, schedule, watch)
    }

    /// The material of `own` numbers and `network`.
    fn material(
        &self,
        network: Arc<Network>,
        shared: &[f32],
        own: &[f32],
        truth: Truth,
        judge: &Judge,
    ) -> Result<Material, Invalid> {
        let parts = self.split(shared, own);
        let bound = self.largest_residual(shared, own, &judge.look(truth).0) + BOUND_MARGIN;
        let p = analytic::to_parameters(parts.p);
        Hybrid::new(self.form, network, p, parts.z.to_vec(), bound).map(Material::from)
    }
}

/// A random network whose outputs leave the analytic part nearly as it is: a small residual and an open gate.
fn random_network(objective: &HybridObjective, rng: &mut Pcg64) -> Vec<f32> {
    const RESIDUAL: f32 = -3.0;
    const GATE: f32 = 1.0;
    let shape = &objective.shape;
    let mut numbers = random_layers(shape, rng);
    let (_, bias) = shape.split_mut(&mut numbers, shape.layers() - 1);
    if objective.form.composition == Composition::GatedResidual {
        for c in 0..3 {
            bias[c] += RESIDUAL;
            bias[c + 3] += GATE;
        }
    }
    numbers
}

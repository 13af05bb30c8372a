//! What is fitted, and how.

use glimt_core::directions::features::Inputs;
use glimt_core::kernels::network::Activation;
use glimt_core::models::hybrid::{self, Composition};
use glimt_core::models::spherical::store::StoreKind;
use glimt_core::models::spherical::tables::{Form, Grids};
use serde::{Deserialize, Serialize};

use crate::adamw::AdamW;
use crate::analytic;
use crate::backprop::Shape;
use crate::fit::Input;
use crate::hybrid::{HybridObjective, Sharing};
use crate::loss::Loss;
use crate::neural::NeuralObjective;
use crate::objective::Objective;
use crate::pairs::Drawing;
use crate::train::Schedule;

/// A fit, in full: the same options on the same materials give the same library.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// What is fitted.
    pub model: Model,
    /// How long and how fast.
    pub schedule: Schedule,
}

/// What is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// The analytic BRDF alone.
    Ggx(Loss),
    /// The hybrid model.
    Hybrid(HybridOptions),
    /// The network-only baseline.
    Neural(NeuralOptions),
    /// Features in tables on hemispheres, and a network.
    Spherical(SphericalOptions),
}

/// Hidden layers of a network: width × number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Net {
    /// Neurons in a layer.
    pub width: usize,
    /// Hidden layers.
    pub layers: usize,
}

impl Net {
    /// Whether fits offer it: 16, 32 or 64 neurons in 2 or 3 layers.
    #[must_use]
    pub fn is_supported(self) -> bool {
        matches!(self.width, 16 | 32 | 64) && matches!(self.layers, 2 | 3)
    }

    pub(crate) fn hidden(self) -> Vec<usize> {
        vec![self.width; self.layers]
    }
}

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

/// Loss of glimt's fits, see [`Loss`].
pub const DEFAULT_LOSS: Loss = Loss { absolute: 1.0, squared: 10.0, relative: 0.02 };
/// Loss of the analytic part in glimt's fits.
pub const DEFAULT_ANALYTIC_LOSS: Loss = Loss { absolute: 1.0, squared: 1.0, relative: 0.02 };

impl Options {
    /// How many numbers each of so many materials has, its part of those that they share included; `None` for
    /// models that take as many as the samples allow.
    #[must_use]
    pub fn numbers_each(&self, materials: usize, isotropic: bool) -> Option<usize> {
        let part = |shared: usize, own: usize| Some(own + shared / materials.max(1));
        match &self.model {
            Model::Ggx(_) => Some(analytic::len(isotropic)),
            Model::Hybrid(hybrid) => {
                let objective = hybrid.objective(isotropic);
                part(objective.shared_len(), objective.own_len())
            }
            Model::Neural(neural) => {
                let objective = neural.objective();
                part(objective.shared_len(), objective.own_len())
            }
            Model::Spherical(_) => None,
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

    pub(crate) fn objective(&self, isotropic: bool) -> HybridObjective {
        let form = hybrid::Form {
            inputs: self.inputs.inputs(isotropic),
            analytic_input: self.analytic_input,
            composition: self.composition,
        };
        let (inputs, outputs) = (form.features() + self.latent, self.composition.outputs());
        HybridObjective {
            sharing: self.sharing,
            form,
            shape: Shape::new(inputs, &self.net.hidden(), outputs, Activation::HardGelu),
            latent: self.latent,
            isotropic,
            loss: self.loss,
            analytic_loss: self.analytic_loss,
            joint: self.joint,
        }
    }
}

/// A fit of the network-only baseline.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NeuralOptions {
    /// Hidden layers.
    pub net: Net,
    /// Numbers in the latent code.
    pub latent: usize,
    /// Loss of f.
    pub loss: Loss,
}

impl NeuralOptions {
    pub(crate) fn objective(&self) -> NeuralObjective {
        NeuralObjective::new(&self.net.hidden(), self.latent, Activation::HardGelu, self.loss)
    }
}

/// A spherical fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SphericalOptions {
    /// The tables.
    pub form: Form,
    /// How features are kept.
    pub store: StoreKind,
    /// Hidden layers.
    pub net: Net,
    /// Clusters of materials that share network and codebook; `None`: every material has its own.
    pub clusters: Option<usize>,
    /// Loss of f.
    pub loss: Loss,
}

/// Loss of glimt's spherical fits.
pub const SPHERICAL_LOSS: Loss = Loss { absolute: 1.0, squared: 1.0, relative: 0.02 };

impl SphericalOptions {
    /// Whether such a model can be fitted to `inputs`.
    pub(crate) fn check(&self, inputs: &[Input]) -> Result<(), String> {
        self.form.validate()?;
        self.store.validate()?;
        if let Some(input) = inputs.iter().find(|input| !input.isotropic && self.form.grids == Grids::Iso) {
            return Err(format!(
                "\"{}\" is anisotropic, but the grids iso are not; fit it with hd",
                input.name
            ));
        }
        match self.clusters {
            Some(count) if count == 0 || count > inputs.len() => {
                Err(format!("{count} clusters of {0} materials; expected 1 to {0}", inputs.len()))
            }
            _ => Ok(()),
        }
    }
}

impl Schedule {
    /// glimt's own schedule.
    #[must_use]
    pub fn standard(steps: u64, seed: u64) -> Self {
        Schedule {
            steps,
            blocks: 4,
            seed,
            rate: 1e-2,
            clip: 0.02,
            adamw: AdamW { weight_decay: 0.0, ..AdamW::PAPER },
            drawing: Drawing::Lobes,
            freeze_shared: false,
        }
    }

    /// The paper's schedule (§3.3): 1024 cosine-distributed pairs a step, gradients clipped at 0.01.
    #[must_use]
    pub fn paper(steps: u64, seed: u64) -> Self {
        Schedule {
            rate: 5e-3,
            clip: 0.01,
            adamw: AdamW::PAPER,
            drawing: Drawing::Cosine,
            ..Self::standard(steps, seed)
        }
    }

    /// glimt's schedule for the spherical model. On three RGL materials rates of 0.01 and 0.04 ended worse.
    #[must_use]
    pub fn spherical(steps: u64, seed: u64) -> Self {
        Schedule { rate: 0.02, drawing: Drawing::NearNormal, ..Self::standard(steps, seed) }
    }

    /// The schedule for k_d, η and α alone, which need far fewer and longer steps.
    pub(crate) fn analytic(drawing: Drawing, seed: u64) -> Self {
        Schedule {
            steps: 1500,
            rate: 0.05,
            clip: f32::INFINITY,
            adamw: AdamW { beta2: 0.99, ..Self::standard(0, 0).adamw },
            drawing,
            ..Self::standard(0, seed)
        }
    }
}

//! What is measured: a material of each model and size.

use std::sync::Arc;

use anyhow::{Result, anyhow};
use clap::ValueEnum;
use glimt_core::features::Inputs;
use glimt_core::ggx::Ggx;
use glimt_core::healpix::Healpix;
use glimt_core::hybrid::{Form, Hybrid};
use glimt_core::microfacet::Microfacet;
use glimt_core::nbrdf::Nbrdf;
use glimt_core::network::{Activation, Layer, Network};
use glimt_core::neural::{FEATURES, FRAME_OUTPUTS, Neural, Shared};
use glimt_core::spherical::pixelation::Pixelation;
use glimt_core::spherical::store::Store;
use glimt_core::spherical::tables::{self, Grids, Interpolation, Layout};
use glimt_core::spherical::{Features, Spherical};
use glimt_core::{AnyModel, Material};
use glimt_fit::Net;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// The models that have a case without a file.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Kind {
    Ggx,
    Hybrid,
    Neural,
    Nbrdf,
    Spherical,
}

/// A material and its size.
pub struct Case {
    pub material: Material,
    /// Multiply-adds of one evaluation, with the latent code folded away.
    pub multiply_adds: usize,
    /// The hybrid network of which a training step is measured, too.
    pub training: Option<Net>,
}

impl Case {
    pub fn new(material: Material) -> Self {
        let multiply_adds = match material.model() {
            // Frames and latent code are folded into the network that runs.
            AnyModel::Neural(neural) => neural.folded_network().multiply_adds(),
            _ => material.network().map_or(0, Network::multiply_adds),
        };
        Case { material, multiply_adds, training: None }
    }

    /// Widths of the network's layers, inputs and outputs left out; "–" without a network.
    pub fn size(&self) -> String {
        let Some(network) = self.material.network() else { return "–".into() };
        let (_, hidden) = network.layers().split_last().expect("a network has a layer");
        match hidden {
            [] => "linear".into(),
            [first, ..] => format!("{}x{}", first.outputs(), hidden.len()),
        }
    }
}

/// Numbers in a latent code, as `glimt fit` chooses them.
const HYBRID_LATENT: usize = 4;
const NEURAL_LATENT: usize = 12;
/// Largest output that counts; of no influence on the time.
const BOUND: f32 = 2.0;

impl Kind {
    /// One case for each of `nets`, or only one where the model's size is fixed.
    pub fn cases(self, nets: &[Net]) -> Vec<Result<Case>> {
        let microfacet = Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.5, 1.8, 2.5], alpha: [0.2; 2] };
        match self {
            Kind::Ggx => vec![case(Ggx::new(microfacet))],
            Kind::Nbrdf => {
                let network = network(&[6, 21, 21, 3], 6, Activation::Relu);
                vec![case(network.and_then(|network| Nbrdf::new(Arc::new(network))))]
            }
            Kind::Hybrid => nets
                .iter()
                .map(|&net| {
                    let made = hybrid(net, microfacet);
                    made.map(|m| Case { training: Some(net), ..Case::new(m.into()) }).map_err(|e| anyhow!(e))
                })
                .collect(),
            Kind::Neural => nets.iter().map(|&net| case(neural(net))).collect(),
            Kind::Spherical => nets.iter().map(|&net| case(spherical(net))).collect(),
        }
    }
}

fn case<M: Into<Material>>(made: Result<M, String>) -> Result<Case> {
    made.map(|material| Case::new(material.into())).map_err(|e| anyhow!(e))
}

fn hybrid(net: Net, microfacet: Microfacet) -> Result<Hybrid, String> {
    let form = Form { inputs: Inputs::Isotropic, ..Form::PAPER };
    let sizes = sizes(form.features() + HYBRID_LATENT, net, form.composition.outputs());
    let network = Arc::new(network(&sizes, form.features(), Activation::HardGelu)?);
    Hybrid::new(form, network, microfacet, vec![0.1; HYBRID_LATENT], BOUND)
}

/// The tables that `glimt fit` chooses for isotropic materials.
fn spherical(net: Net) -> Result<Spherical, String> {
    let form = tables::Form {
        grids: Grids::Iso,
        pixelation: Pixelation::Healpix,
        nside: Healpix::try_from(32)?,
        nodes: 64,
        features: 16,
        interpolation: Interpolation::Bilinear,
    };
    let layout = Arc::new(Layout::new(form)?);
    let wave = |row: usize| (0..form.features).map(move |j| (0.1 * row as f32 + f32::from(j)).sin());
    let store = Store::F32((0..layout.places().len()).flat_map(wave).collect());
    let network = network(&sizes(form.inputs(), net, 3), form.inputs(), Activation::HardGelu)?;
    Spherical::new(layout, Arc::new(network), Features { store, links: None }, BOUND)
}

fn neural(net: Net) -> Result<Neural, String> {
    let network = network(&sizes(FEATURES + NEURAL_LATENT, net, 3), FEATURES, Activation::HardGelu)?;
    let frames = Layer { weight: vec![0.01; FRAME_OUTPUTS * NEURAL_LATENT], bias: vec![0.1; FRAME_OUTPUTS] };
    Neural::new(Arc::new(Shared { network, frames }), vec![0.1; NEURAL_LATENT], BOUND)
}

/// Values in each layer, from the inputs to the outputs.
fn sizes(inputs: usize, net: Net, outputs: usize) -> Vec<usize> {
    let mut sizes = vec![net.width; net.layers + 2];
    sizes[0] = inputs;
    sizes[net.layers + 1] = outputs;
    sizes
}

/// A network of random weights.
fn network(sizes: &[usize], features: usize, activation: Activation) -> Result<Network, String> {
    let mut random = Pcg64::seed_from_u64(1);
    let layers = sizes.windows(2).map(|pair| {
        let scale = 1.5 / (pair[0] as f32).sqrt();
        let mut weights = |n| (0..n).map(|_| random.random_range(-scale..scale)).collect();
        Layer { weight: weights(pair[0] * pair[1]), bias: weights(pair[1]) }
    });
    Network::new(layers.collect(), features, activation)
}

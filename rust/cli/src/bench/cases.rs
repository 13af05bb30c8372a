//! What is measured: a material of each model and size.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Result, anyhow};
use glimt_core::directions::features::Inputs;
use glimt_core::directions::healpix::Healpix;
use glimt_core::kernels::network::{Activation, Layer, Network};
use glimt_core::microfacet::Microfacet;
use glimt_core::models::analytic::{Analytic, Parameters, Specular};
use glimt_core::models::factor::{self, DIFF_BINS, Factor, Factors, HALF_BINS, Product};
use glimt_core::models::gated::angles::FRAME;
use glimt_core::models::gated::texture::{Disk, Texture};
use glimt_core::models::gated::{
    self, Angles, Base, FEATURES as GATED_FEATURES, Gated, LATENT, Linear, WARPS,
};
use glimt_core::models::ggx::Ggx;
use glimt_core::models::hybrid::{Form, Hybrid};
use glimt_core::models::maps::{Filter, Maps, Texel};
use glimt_core::models::nbrdf::Nbrdf;
use glimt_core::models::neural::{FEATURES, FRAME_OUTPUTS, Neural, Shared};
use glimt_core::models::spherical::pixelation::Pixelation;
use glimt_core::models::spherical::store::Store;
use glimt_core::models::spherical::tables::{self, Grids, Interpolation, Layout};
use glimt_core::models::spherical::{Features, Spherical};
use glimt_core::surface::{self, Pyramid, Wrap};
use glimt_core::{AnyModel, Invalid, Kind, Material};
use glimt_fit::Net;
use glimt_measured::{Measured, Merl, merl};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

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

/// The cases of a model: one for each of `nets`, or only one where the model's size is fixed.
pub fn cases(kind: Kind, nets: &[Net]) -> Vec<Result<Case>> {
    match kind {
        Kind::Ggx => vec![case(Ggx::new(MICROFACET))],
        Kind::Hybrid => nets
            .iter()
            .map(|&net| {
                let made = hybrid(net);
                made.map(|m| Case { training: Some(net), ..Case::new(m.into()) }).map_err(|e| anyhow!(e))
            })
            .collect(),
        Kind::Neural => nets.iter().map(|&net| case(neural(net))).collect(),
        Kind::Nbrdf => {
            let network = network(&[6, 21, 21, 3], 6, Activation::Relu);
            vec![case(network.and_then(|network| Nbrdf::new(Arc::new(network))))]
        }
        Kind::Factor => vec![case(factor())],
        Kind::Tabulated => vec![tabulated()],
        Kind::Analytic => vec![case(analytic())],
        Kind::Maps => vec![case(maps())],
        Kind::Gated => vec![case(gated())],
        Kind::Spherical => nets.iter().map(|&net| case(spherical(net))).collect(),
    }
}

/// An ordinary plastic.
const MICROFACET: Microfacet = Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.5, 1.8, 2.5], alpha: [0.2; 2] };

fn case<M: Into<Material>>(made: Result<M, Invalid>) -> Result<Case> {
    made.map(|material| Case::new(material.into())).map_err(|e| anyhow!(e))
}

fn hybrid(net: Net) -> Result<Hybrid, Invalid> {
    let form = Form { inputs: Inputs::Isotropic, ..Form::PAPER };
    let sizes = sizes(form.features() + HYBRID_LATENT, net, form.composition.outputs());
    let network = Arc::new(network(&sizes, form.features(), Activation::HardGelu)?);
    Hybrid::new(form, network, MICROFACET, vec![0.1; HYBRID_LATENT], BOUND)
}

/// A surface of one texel: what is timed is its evaluation, and no place is fetched.
fn maps() -> Result<Maps, Invalid> {
    let texel = Texel { kd: MICROFACET.kd, f0: [0.04, 0.08, 0.2], alpha: 0.2, slope: [0.1, 0.0] };
    Maps::new(1, [texel], Wrap::Repeat, Filter::Moments)
}

/// A surface of one texel, as [`maps`].
fn gated() -> Result<Gated, Invalid> {
    let disk = Disk { rings: 32, sectors: 32 };
    let texture = |seed: usize| {
        let number =
            |i: usize| std::array::from_fn(|k| ((i * GATED_FEATURES + k + seed) as f32 * 0.754_878).sin());
        Texture::new(disk, LATENT, (0..disk.texels() * LATENT).map(number).collect())
    };
    let inputs = Angles::Matrices.inputs();
    Gated::new(gated::Parts {
        base: Base::Maps,
        angles: Angles::Matrices,
        maps: maps()?,
        latents: Pyramid::of_levels(surface::Layout::new([1, 1], Wrap::Repeat), vec![[0.3; LATENT]])?,
        frames: Some(Linear { weight: [[0.0; LATENT]; FRAME], bias: [0.0, 0.0, 1.0, 1.0, 0.0, 0.0] }),
        warps: Some(Linear { weight: [[0.1; LATENT]; WARPS], bias: [0.0; WARPS] }),
        half: texture(0)?,
        difference: texture(1)?,
        network: network(&[inputs, 16, 16, 6], inputs, Activation::HardGelu)?,
        bound: BOUND,
    })
}

/// The variant and interpolation that `glimt fit` chooses.
fn factor() -> Result<Factor, Invalid> {
    let bin = |i: usize, bins: usize| (i as f32 + 0.5) / bins as f32;
    let ndf = std::array::from_fn(|i| (-20.0 * bin(i, HALF_BINS).powi(4)).exp());
    let fresnel = std::array::from_fn(|i| 0.04 + 0.96 * bin(i, DIFF_BINS).powi(5));
    let product = Product { diffuse: [0.1; 3], specular: [0.5; 3], ndf: [ndf; 3], fresnel: [fresnel; 3] };
    Factor::new(Factors::GFromD(product), factor::Interpolation::default())
}

/// The published model of the most numbers, near those of gold-metallic-paint.
fn analytic() -> Result<Analytic, Invalid> {
    let specular = Specular::ShiftedGamma {
        scale: [0.2; 3],
        alpha: [0.1; 3],
        power: [0.8; 3],
        fresnel: [[0.0; 3], [-1.0; 3]],
        norm: [6.0; 3],
        masking: [[2.7; 3], [0.5; 3], [24.0; 3], [-0.3; 3]],
    };
    Analytic::new(Parameters { diffuse: [0.3, 0.2, 0.1], specular })
}

/// The microfacet model in MERL's bins.
fn tabulated() -> Result<Case> {
    let bytes = merl::to_bytes(&Ggx::new(MICROFACET).map_err(|e| anyhow!(e))?);
    Ok(Case::new(Measured::Merl(Merl::from_bytes(Path::new("ggx.binary"), &bytes)?).into_material()))
}

/// The tables that `glimt fit` chooses for isotropic materials.
fn spherical(net: Net) -> Result<Spherical, Invalid> {
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

fn neural(net: Net) -> Result<Neural, Invalid> {
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
fn network(sizes: &[usize], features: usize, activation: Activation) -> Result<Network, Invalid> {
    let mut random = Pcg64::seed_from_u64(1);
    let layers = sizes.windows(2).map(|pair| {
        let scale = 1.5 / (pair[0] as f32).sqrt();
        let mut weights = |n| (0..n).map(|_| random.random_range(-scale..scale)).collect();
        Layer { weight: weights(pair[0] * pair[1]), bias: weights(pair[1]) }
    });
    Network::new(layers.collect(), features, activation)
}

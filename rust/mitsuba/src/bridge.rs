//! What the Mitsuba plugin calls: one material, opened, edited, evaluated and sampled.

use glimt_core::directions::features;
use glimt_core::kernels::network;
use glimt_core::models::edit::Room;
use glimt_core::models::hybrid;
use glimt_core::models::nbrdf::Nbrdf;
use glimt_core::models::neural::Neural;
use glimt_core::sampling::Plan;
use glimt_core::surface;
use glimt_core::{AnyModel, Brdf, Kind, Model, Sample, SampleBrdf, Vec3, microfacet};

use crate::material::{Material, guarded, guarded_result, mixed, open};
use crate::packet::eval_packet_address;
use crate::place_packet::{eval_at_packet_address, sample_at_packet_address};
use crate::sampler_packet::{pdf_packet_address, sample_packet_address};

#[cxx::bridge(namespace = "glimt::core")]
mod ffi {
    /// The models that `traced.h` of the plugin knows, and one for all others.
    enum Kind {
        Ggx,
        Hybrid,
        Neural,
        Nbrdf,
        Untraced,
    }

    /// What a network sees of two directions, see `features.rs` of the core.
    enum Inputs {
        Cartesian,
        Isotropic,
        IsotropicReciprocal,
        Anisotropic,
        AnisotropicReciprocal,
    }

    /// The nonlinearity between a network's layers.
    enum Activation {
        HardGelu,
        Relu,
    }

    /// How a hybrid model combines its network with its analytic part, see `hybrid.rs` of the core.
    enum Composition {
        GatedResidual,
        Additive,
        LogMultiplicative,
    }

    /// k_d, η and α of the analytic part.
    #[derive(Clone, Copy)]
    struct Microfacet {
        kd: [f32; 3],
        eta: [f32; 3],
        alpha: [f32; 2],
    }

    /// The sampler, see `lobes/` of the core.
    struct Lobes {
        /// α_x and α_y of every GGX lobe.
        alpha: Vec<f32>,
        /// At each knot the shares of the GGX lobes and that of the cosine lobe.
        shares: Vec<f32>,
    }

    /// A sampled light direction, its density and f · cosθ / pdf.
    struct Sample {
        light: [f32; 3],
        pdf: f32,
        weight: [f32; 3],
    }

    /// A place on a surface, and the two axes that a round Gaussian around it becomes, in uv.
    #[derive(Clone, Copy)]
    struct Place {
        uv: [f32; 2],
        along: [f32; 2],
        across: [f32; 2],
    }

    /// One affine layer: weights as [outputs][inputs], and biases.
    struct Layer {
        weight: Vec<f32>,
        bias: Vec<f32>,
    }

    /// A network; its first layer takes the features and then the latent code.
    struct Network {
        layers: Vec<Layer>,
        activation: Activation,
    }

    /// All that it takes to trace a hybrid, apart from its editable parameters.
    struct Hybrid {
        network: Network,
        /// The largest output that counts.
        bound: f32,
        /// What the network sees, ln f_a besides or not.
        inputs: Inputs,
        analytic_input: bool,
        /// How f is made of the outputs.
        composition: Composition,
        /// The analytic part beside which the network was fitted.
        fitted: Microfacet,
    }

    /// The same of a neural material.
    struct Neural {
        network: Network,
        /// The largest output that counts.
        bound: f32,
        /// The layer from the latent code to the shading frames.
        frames: Layer,
    }

    /// The same of an NBRDF.
    struct Nbrdf {
        network: Network,
    }

    extern "Rust" {
        type Material;

        /// The material `name` of the file at `path`; an empty name is the only material of its file.
        /// `sampler` is empty for the default one.
        fn open(path: &str, name: &str, sampler: &str) -> Result<Box<Material>>;
        /// The material between those named `a` and `b`, with a share `weight` of `b`; otherwise as `open`.
        fn mixed(path: &str, a: &str, b: &str, weight: f32, sampler: &str) -> Result<Box<Material>>;
        /// The same material with other parameters; what it does not have is ignored.
        fn edited(&self, microfacet: &Microfacet, latent: &[f32]) -> Result<Box<Material>>;

        fn name(&self) -> &str;
        /// Kind and size, for people.
        fn description(&self) -> String;
        /// Which traced form it has.
        fn kind(&self) -> Kind;
        /// What `kind` says it is; an error for any other.
        fn hybrid(&self) -> Result<Hybrid>;
        fn neural(&self) -> Result<Neural>;
        fn nbrdf(&self) -> Result<Nbrdf>;
        fn has_microfacet(&self) -> bool;
        /// The analytic part, or zeros where there is none.
        fn microfacet(&self) -> Microfacet;
        fn latent(&self) -> &[f32];
        /// The shares that an edit leaves of what the network adds, see `edit.rs` of the core.
        fn room(&self) -> &[f32];
        /// Names of the models that have a traced form, for messages.
        fn traced_models() -> String;
        /// Whether the sampler is made of `lobes`, and can be traced elsewhere.
        fn has_lobes(&self) -> bool;
        /// The lobes, or nothing where the sampler is something else.
        fn lobes(&self) -> Lobes;
        /// Name of the sampler.
        fn sampler(&self) -> &str;
        fn is_isotropic(&self) -> bool;
        fn is_reciprocal(&self) -> bool;
        /// Whether it is another at every place, for which the functions with a place ask.
        fn is_surface(&self) -> bool;

        fn eval(&self, light: &[f32; 3], view: &[f32; 3]) -> [f32; 3];
        fn pdf(&self, light: &[f32; 3], view: &[f32; 3]) -> f32;
        fn sample(&self, view: &[f32; 3], u: &[f32; 3]) -> Sample;
        fn eval_at(&self, place: &Place, light: &[f32; 3], view: &[f32; 3]) -> [f32; 3];
        fn pdf_at(&self, place: &Place, light: &[f32; 3], view: &[f32; 3]) -> f32;
        fn sample_at(&self, place: &Place, view: &[f32; 3], u: &[f32; 3]) -> Sample;
        fn eval_packet_address(width: usize) -> usize;
        fn pdf_packet_address(width: usize) -> usize;
        fn sample_packet_address(width: usize) -> usize;
        fn eval_at_packet_address(width: usize) -> usize;
        fn sample_at_packet_address(width: usize) -> usize;
    }
}

/// Which form of `traced.h` a model has. A model that is not named has none: the core evaluates it.
const fn traced_kind(kind: Kind) -> ffi::Kind {
    match kind {
        Kind::Ggx => ffi::Kind::Ggx,
        Kind::Hybrid => ffi::Kind::Hybrid,
        Kind::Neural => ffi::Kind::Neural,
        Kind::Nbrdf => ffi::Kind::Nbrdf,
        _ => ffi::Kind::Untraced,
    }
}

fn traced_models() -> String {
    let is_traced = |&kind: &Kind| traced_kind(kind) != ffi::Kind::Untraced;
    Kind::ALL.into_iter().filter(is_traced).map(Kind::name).collect::<Vec<_>>().join(", ")
}

impl Material {
    fn edited(&self, microfacet: &ffi::Microfacet, latent: &[f32]) -> Result<Box<Material>, String> {
        guarded_result(|| {
            let mut material = self.material.clone();
            let ffi::Microfacet { kd, eta, alpha } = *microfacet;
            let p = microfacet::Microfacet { kd, eta, alpha };
            if material.microfacet().is_some_and(|current| *current != p) {
                material = material.with_microfacet(p)?;
            }
            if !latent.is_empty() && latent != material.latent() {
                material = material.with_latent(latent.to_vec())?;
            }
            Ok(Box::new(Material::new(self.name.clone(), material, self.library.clone())))
        })
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn description(&self) -> String {
        let kind = match self.material.model() {
            AnyModel::Tabulated(tabulated) => {
                return format!("{} ({})", self.material.kind(), tabulated.table().format());
            }
            _ => self.material.kind().name(),
        };
        let Some(network) = self.material.network() else { return kind.to_owned() };
        let layers = network.layers();
        let sizes = [layers[0].inputs()].into_iter().chain(layers.iter().map(network::Layer::outputs));
        let sizes: Vec<String> = sizes.map(|size| size.to_string()).collect();
        format!("{kind} ({} network)", sizes.join("-"))
    }

    fn kind(&self) -> ffi::Kind {
        traced_kind(self.material.kind())
    }

    /// The model, where it is the one that is asked for.
    fn as_model<'a, M: Model>(&'a self) -> Result<&'a M, String>
    where
        &'a M: TryFrom<&'a glimt_core::Material>,
    {
        let model = (&self.material).try_into();
        model.map_err(|_| {
            format!("\"{}\" is of the model {}, not {}", self.name, self.material.kind(), M::KIND)
        })
    }

    fn hybrid(&self) -> Result<ffi::Hybrid, String> {
        let m: &hybrid::Hybrid = self.as_model()?;
        Ok(ffi::Hybrid {
            network: m.network().as_ref().into(),
            bound: m.bound(),
            inputs: m.form().inputs.into(),
            analytic_input: m.form().analytic_input,
            composition: m.form().composition.into(),
            fitted: m.fitted_microfacet().into(),
        })
    }

    fn neural(&self) -> Result<ffi::Neural, String> {
        let m: &Neural = self.as_model()?;
        let (network, frames) = (&m.shared().network, &m.shared().frames);
        Ok(ffi::Neural { network: network.into(), bound: m.bound(), frames: frames.into() })
    }

    fn nbrdf(&self) -> Result<ffi::Nbrdf, String> {
        let m: &Nbrdf = self.as_model()?;
        Ok(ffi::Nbrdf { network: m.network().as_ref().into() })
    }

    fn has_microfacet(&self) -> bool {
        self.material.microfacet().is_some()
    }

    fn microfacet(&self) -> ffi::Microfacet {
        let zero = microfacet::Microfacet { kd: [0.0; 3], eta: [0.0; 3], alpha: [0.0; 2] };
        self.material.microfacet().unwrap_or(&zero).into()
    }

    fn latent(&self) -> &[f32] {
        self.material.latent()
    }

    fn room(&self) -> &[f32] {
        let room = match self.material.model() {
            AnyModel::Hybrid(hybrid) => hybrid.edit().map(|edit| &edit.room),
            AnyModel::Neural(neural) => neural.recoding().map(|recoded| &recoded.room),
            _ => None,
        };
        room.unwrap_or(&Room::ALL).shares()
    }

    fn has_lobes(&self) -> bool {
        matches!(self.material.plan(), Plan::Lobes)
    }

    fn lobes(&self) -> ffi::Lobes {
        let none = ffi::Lobes { alpha: Vec::new(), shares: Vec::new() };
        // A sampler of another kind is not made to learn that it has none.
        if !self.has_lobes() {
            return none;
        }
        guarded(none, || {
            let lobes = self.material.sampler().lobes().expect("the plan is kept");
            ffi::Lobes {
                alpha: lobes.alpha().as_flattened().to_vec(),
                shares: lobes.shares().as_flattened().to_vec(),
            }
        })
    }

    fn sampler(&self) -> &str {
        self.material.plan().name()
    }

    fn is_isotropic(&self) -> bool {
        self.material.is_isotropic()
    }

    fn is_reciprocal(&self) -> bool {
        self.material.is_reciprocal()
    }

    fn eval(&self, light: &[f32; 3], view: &[f32; 3]) -> [f32; 3] {
        let f = || self.material.eval(Vec3::from_array(*light), Vec3::from_array(*view));
        guarded(Vec3::ZERO, f).to_array()
    }

    fn pdf(&self, light: &[f32; 3], view: &[f32; 3]) -> f32 {
        guarded(0.0, || self.material.pdf(Vec3::from_array(*light), Vec3::from_array(*view)))
    }

    fn sample(&self, view: &[f32; 3], u: &[f32; 3]) -> ffi::Sample {
        let sample = || self.material.sample(Vec3::from_array(*view), Vec3::from_array(*u));
        guarded(Sample::FAILED, sample).into()
    }

    fn is_surface(&self) -> bool {
        self.material.is_surface()
    }

    fn eval_at(&self, place: &ffi::Place, light: &[f32; 3], view: &[f32; 3]) -> [f32; 3] {
        let f = || self.material.at(&place.into()).eval(Vec3::from_array(*light), Vec3::from_array(*view));
        guarded(Vec3::ZERO, f).to_array()
    }

    fn pdf_at(&self, place: &ffi::Place, light: &[f32; 3], view: &[f32; 3]) -> f32 {
        let pdf = || self.material.at(&place.into()).pdf(Vec3::from_array(*light), Vec3::from_array(*view));
        guarded(0.0, pdf)
    }

    fn sample_at(&self, place: &ffi::Place, view: &[f32; 3], u: &[f32; 3]) -> ffi::Sample {
        let sample = || self.material.at(&place.into()).sample(Vec3::from_array(*view), Vec3::from_array(*u));
        guarded(Sample::FAILED, sample).into()
    }
}

impl From<Sample> for ffi::Sample {
    fn from(Sample { light, pdf, weight }: Sample) -> Self {
        ffi::Sample { light: light.to_array(), pdf, weight: weight.to_array() }
    }
}

impl From<&ffi::Place> for surface::Place {
    fn from(&ffi::Place { uv, along, across }: &ffi::Place) -> Self {
        surface::Place { uv, footprint: surface::Footprint::Axes([along, across]) }
    }
}

impl From<&microfacet::Microfacet> for ffi::Microfacet {
    fn from(&microfacet::Microfacet { kd, eta, alpha }: &microfacet::Microfacet) -> Self {
        ffi::Microfacet { kd, eta, alpha }
    }
}

impl From<&network::Layer> for ffi::Layer {
    fn from(layer: &network::Layer) -> Self {
        ffi::Layer { weight: layer.weight.clone(), bias: layer.bias.clone() }
    }
}

impl From<&network::Network> for ffi::Network {
    fn from(network: &network::Network) -> Self {
        ffi::Network {
            layers: network.layers().iter().map(Into::into).collect(),
            activation: match network.activation() {
                network::Activation::HardGelu => ffi::Activation::HardGelu,
                network::Activation::Relu => ffi::Activation::Relu,
            },
        }
    }
}

impl From<features::Inputs> for ffi::Inputs {
    fn from(inputs: features::Inputs) -> Self {
        match inputs {
            features::Inputs::Cartesian => ffi::Inputs::Cartesian,
            features::Inputs::Isotropic => ffi::Inputs::Isotropic,
            features::Inputs::IsotropicReciprocal => ffi::Inputs::IsotropicReciprocal,
            features::Inputs::Anisotropic => ffi::Inputs::Anisotropic,
            features::Inputs::AnisotropicReciprocal => ffi::Inputs::AnisotropicReciprocal,
        }
    }
}

impl From<hybrid::Composition> for ffi::Composition {
    fn from(composition: hybrid::Composition) -> Self {
        match composition {
            hybrid::Composition::GatedResidual => ffi::Composition::GatedResidual,
            hybrid::Composition::Additive => ffi::Composition::Additive,
            hybrid::Composition::LogMultiplicative => ffi::Composition::LogMultiplicative,
        }
    }
}

//! How each model's materials are laid out in tensors.

use std::sync::Arc;

use safetensors::tensor::Dtype;
use serde_json::Value;

use super::container::{Latents, Rows, Tensor, Tensors};
use crate::kernels::network::{Activation, Network};
#[cfg(test)]
use crate::kernels::network::{Layer, tests::patterned_from};
use crate::microfacet::Microfacet;
use crate::models::Model;
#[cfg(test)]
use crate::models::analytic::tests::specimens;
use crate::models::analytic::{Analytic, Lobe, Parameters, Specular};
use crate::models::edit::{Fitted, KNOTS, Origin};
use crate::models::ggx::Ggx;
use crate::models::hybrid::{Form, Hybrid};
use crate::models::nbrdf::{self, Nbrdf};
use crate::models::neural::{self, Neural, Shared};
use crate::models::tabulated::Tabulated;

/// A model's part of the library file.
pub(crate) trait Codec: Model {
    /// Whether a library can hold the model.
    const STORED: bool = true;

    /// What the materials of a library have in common and no tensor's shape tells, for the metadata.
    fn form(&self) -> Option<Value> {
        None
    }

    /// The tensors of a library's materials; none if a library cannot hold the model.
    fn encode(materials: &[&Self]) -> Vec<Tensor>;

    /// What reads the materials of a file, whose shared parts it has read and checked.
    fn decoder(file: &Tensors, form: Option<&Value>) -> Result<Decoder<Self>, String>;

    /// Pairs of materials that can stand in one library, as many as there are ways to lie in a file; their networks,
    /// where they have one, with this activation.
    #[cfg(test)]
    fn specimens(activation: Activation) -> Vec<[Self; 2]>;

    /// Whether two materials can stand in one library, beyond having the same form and network sizes.
    fn check_together(&self, _: &Self) -> Result<(), String> {
        Ok(())
    }
}

/// Reads the material of a number.
pub(crate) type Decoder<M> = Box<dyn Fn(usize) -> Result<M, String> + Send + Sync>;

impl Codec for Ggx {
    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        microfacet_tensors("", materials.iter().map(|m| *m.microfacet()).collect())
    }

    fn decoder(file: &Tensors, _: Option<&Value>) -> Result<Decoder<Self>, String> {
        let microfacets = file.microfacets("")?;
        Ok(Box::new(move |i| Ok(Ggx::new(microfacets.at(i)?)?)))
    }

    #[cfg(test)]
    fn specimens(_: Activation) -> Vec<[Self; 2]> {
        let ggx =
            |alpha| Ggx::new(Microfacet { alpha, ..tests::PARAMETERS }).expect("numbers in their ranges");
        vec![[ggx([0.1; 2]), ggx([0.1, 0.3])]]
    }
}

impl Codec for Hybrid {
    fn form(&self) -> Option<Value> {
        Some(serde_json::to_value(Hybrid::form(self)).expect("a form is names and switches"))
    }

    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        let mut tensors = microfacet_tensors("", materials.iter().map(|m| *m.microfacet()).collect());
        tensors.extend(latent_tensor(materials));
        tensors.push(bound_tensor(materials.iter().map(|m| m.bound()).collect()));
        if materials.iter().any(|m| m.edit().is_some()) {
            let (origins, fitted): (Vec<_>, Vec<_>) = materials.iter().map(|m| m.fitted()).unzip();
            tensors.extend(microfacet_tensors(FITTED, origins));
            tensors.extend(fitted_tensors(&fitted));
        }
        tensors.extend(network_tensors(&materials.iter().map(|m| Hybrid::network(m)).collect::<Vec<_>>()));
        tensors
    }

    fn decoder(file: &Tensors, form: Option<&Value>) -> Result<Decoder<Self>, String> {
        let form = form.ok_or("its metadata has no \"form\", which a hybrid library needs")?;
        let form: Form = serde::Deserialize::deserialize(form)
            .map_err(|e| format!("its \"glimt\" metadata is broken: the form: {e}"))?;
        let (microfacets, latents) = (file.microfacets("")?, file.latents("latent")?);
        let bounds = file.rows("bound", &[])?;
        let networks = file.networks(form.features(), Activation::HardGelu)?;
        let fitted = file.fitted()?.map(|fitted| Ok::<_, String>((file.microfacets(FITTED)?, fitted)));
        let fitted = fitted.transpose()?;
        Ok(Box::new(move |i| {
            let (network, bound) = (networks.of_material(i)?, bounds.number(i)?);
            let (microfacet, latent) = (microfacets.at(i)?, latents.row(i)?);
            let Some((origins, fitted)) = &fitted else {
                return Ok(Hybrid::new(form, network, microfacet, latent, bound)?);
            };
            let (origin, fitted) = (origins.at(i)?, fitted.at(i)?);
            let base = Hybrid::new(form, network, origin, fitted.latent.clone(), bound)?;
            Ok(base.edited(origin, fitted, microfacet, latent)?)
        }))
    }

    #[cfg(test)]
    fn specimens(activation: Activation) -> Vec<[Self; 2]> {
        let network = |seed| Arc::new(patterned_from(seed, &[10, 16, 16, 6], 6, activation));
        let (shared, other) = (network(1), network(5));
        vec![
            [tests::hybrid(&shared, [0.2; 2], 0.1), tests::hybrid(&shared, [0.3; 2], -0.4)],
            [tests::hybrid(&shared, [0.2, 0.4], 0.1), tests::hybrid(&other, [0.3; 2], 0.2)],
        ]
    }
}

impl Codec for Neural {
    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        let shared = materials[0].shared();
        let frames = &shared.frames;
        let mut tensors: Vec<Tensor> = latent_tensor(materials).into_iter().collect();
        tensors.push(bound_tensor(materials.iter().map(|m| m.bound()).collect()));
        if materials.iter().any(|m| m.recoding().is_some()) {
            tensors.extend(fitted_tensors(&materials.iter().map(|m| m.fitted()).collect::<Vec<_>>()));
        }
        tensors.extend(layers_tensors(&[&shared.network], false));
        tensors.push(Tensor::shared(
            "frames.weight",
            vec![frames.outputs(), frames.inputs()],
            &frames.weight,
        ));
        tensors.push(Tensor::shared("frames.bias", vec![frames.outputs()], &frames.bias));
        tensors
    }

    fn decoder(file: &Tensors, _: Option<&Value>) -> Result<Decoder<Self>, String> {
        let (latents, bounds) = (file.latents("latent")?, file.rows("bound", &[])?);
        let networks = file.networks(neural::FEATURES, Activation::HardGelu)?;
        let frames = file.layer("frames", None, &[Dtype::F32])?.at(0)?;
        if networks.count() > 1 {
            return Err(
                "it has one network per material, expected one for all, as its model is neural".into()
            );
        }
        let shared = Arc::new(Shared { network: Network::clone(&*networks.at(0)?), frames });
        let fitted = file.fitted()?;
        Ok(Box::new(move |i| {
            let (shared, latent, bound) = (shared.clone(), latents.row(i)?, bounds.number(i)?);
            let Some(fitted) = &fitted else { return Ok(Neural::new(shared, latent, bound)?) };
            let fitted = fitted.at(i)?;
            Ok(Neural::new(shared, fitted.latent.clone(), bound)?.recoded(fitted, latent)?)
        }))
    }

    fn check_together(&self, other: &Self) -> Result<(), String> {
        if Arc::ptr_eq(self.shared(), other.shared()) {
            Ok(())
        } else {
            Err("have different networks, and a neural library has one".into())
        }
    }

    #[cfg(test)]
    fn specimens(activation: Activation) -> Vec<[Self; 2]> {
        let shared = Arc::new(Shared {
            network: patterned_from(1, &[30, 16, 3], neural::FEATURES, activation),
            frames: Layer { weight: vec![0.1; 18 * 12], bias: vec![0.2; 18] },
        });
        let neural = |z, bound| Neural::new(shared.clone(), vec![z; 12], bound).expect("parts that fit");
        vec![[neural(0.1, 1.0), neural(-0.2, 2.0)]]
    }
}

impl Codec for Nbrdf {
    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        let networks: Vec<&Network> = materials.iter().map(|m| &**m.network()).collect();
        layers_tensors(&networks, true)
    }

    fn decoder(file: &Tensors, _: Option<&Value>) -> Result<Decoder<Self>, String> {
        let networks = file.networks(nbrdf::FEATURES, Activation::Relu)?;
        Ok(Box::new(move |i| Ok(Nbrdf::new(networks.of_material(i)?)?)))
    }

    #[cfg(test)]
    fn specimens(activation: Activation) -> Vec<[Self; 2]> {
        let network = |seed| Arc::new(patterned_from(seed, &[6, 21, 21, 3], 6, activation));
        vec![[1, 2].map(|seed| Nbrdf::new(network(seed)).expect("the sizes of its network"))]
    }
}

/// Measurements stay in their own formats.
impl Codec for Tabulated {
    const STORED: bool = false;

    fn encode(_: &[&Self]) -> Vec<Tensor> {
        Vec::new()
    }

    fn decoder(_: &Tensors, _: Option<&Value>) -> Result<Decoder<Self>, String> {
        Err("a library cannot hold measured tables".into())
    }

    #[cfg(test)]
    fn specimens(_: Activation) -> Vec<[Self; 2]> {
        Vec::new()
    }
}

impl Codec for Analytic {
    fn form(&self) -> Option<Value> {
        Some(serde_json::json!({ "lobe": self.parameters().specular.lobe() }))
    }

    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        let rows = |numbers: &dyn Fn(&Parameters) -> Vec<f64>| -> Vec<Vec<f32>> {
            materials.iter().map(|m| numbers(m.parameters()).iter().map(|&x| x as f32).collect()).collect()
        };
        vec![
            Tensor::rows("diffuse", &rows(&|p| p.diffuse.to_vec())),
            Tensor::rows("specular", &rows(&|p| p.specular.numbers())),
        ]
    }

    fn decoder(file: &Tensors, form: Option<&Value>) -> Result<Decoder<Self>, String> {
        let lobe = form.and_then(|form| form.get("lobe")).ok_or("its metadata names no \"lobe\"")?;
        let lobe: Lobe = serde::Deserialize::deserialize(lobe)
            .map_err(|e| format!("its \"glimt\" metadata is broken: the lobe: {e}"))?;
        let diffuse = file.rows("diffuse", &[3])?;
        let specular = file.rows_of_any_width("specular", "parameters")?;
        Ok(Box::new(move |i| {
            let numbers: Vec<f64> = specular.row(i)?.iter().map(|&x| x.into()).collect();
            let specular = Specular::from_numbers(lobe, &numbers)?;
            Ok(Analytic::new(Parameters { diffuse: diffuse.array(i)?.map(f64::from), specular })?)
        }))
    }

    #[cfg(test)]
    fn specimens(_: Activation) -> Vec<[Self; 2]> {
        let pair = |parameters: Parameters| {
            let other = Parameters { diffuse: [0.5; 3], ..parameters.clone() };
            [parameters, other].map(|p| Analytic::new(p).expect("numbers in their ranges"))
        };
        specimens().map(pair).into()
    }
}

/// What the names of tensors begin with that hold what edited materials were made of.
const FITTED: &str = "fitted.";

fn microfacet_tensors(prefix: &str, microfacets: Vec<Microfacet>) -> Vec<Tensor> {
    let width = if microfacets.iter().all(Microfacet::is_isotropic) { 1 } else { 2 };
    let name = |name| format!("{prefix}{name}");
    vec![
        Tensor::rows(&name("kd"), &microfacets.iter().map(|m| m.kd).collect::<Vec<_>>()),
        Tensor::rows(&name("eta"), &microfacets.iter().map(|m| m.eta).collect::<Vec<_>>()),
        Tensor::rows(&name("alpha"), &microfacets.iter().map(|m| &m.alpha[..width]).collect::<Vec<_>>()),
    ]
}

/// Codes of what edited materials were made of, whether they are mixes, and the albedos of what was mixed.
fn fitted_tensors(fitted: &[Fitted]) -> Vec<Tensor> {
    let none = [[0.0; 3]; KNOTS];
    let latents: Vec<&[f32]> = fitted.iter().map(|fitted| &fitted.latent[..]).collect();
    let ends: Vec<&[f32]> =
        fitted.iter().map(|fitted| fitted.origin.ends().unwrap_or(&none).as_flattened()).collect();
    let mixed: Vec<f32> =
        fitted.iter().map(|fitted| if fitted.origin == Origin::Fit { 0.0 } else { 1.0 }).collect();
    let mut tensors =
        vec![Tensor::rows("fitted.albedo", &ends), Tensor::own("fitted.mixed", vec![mixed.len()], &mixed)];
    if !latents[0].is_empty() {
        tensors.push(Tensor::rows("fitted.latent", &latents));
    }
    tensors
}

/// k_d, η and α of a file.
struct Microfacets {
    kd: Rows,
    eta: Rows,
    /// One number where all materials are isotropic, else two.
    alpha: Rows,
    is_isotropic: bool,
}

impl Microfacets {
    fn at(&self, i: usize) -> Result<Microfacet, String> {
        let alpha = if self.is_isotropic { [self.alpha.number(i)?; 2] } else { self.alpha.array(i)? };
        Ok(Microfacet { kd: self.kd.array(i)?, eta: self.eta.array(i)?, alpha })
    }
}

/// What the edited materials of a file were made of.
struct FittedParts {
    albedos: Rows,
    latents: Latents,
    mixed: Rows,
}

impl FittedParts {
    fn at(&self, i: usize) -> Result<Fitted, String> {
        let mut ends = [[0.0; 3]; KNOTS];
        ends.as_flattened_mut().copy_from_slice(&self.albedos.array::<{ 3 * KNOTS }>(i)?);
        let origin = if self.mixed.number(i)? > 0.0 { Origin::Mix(Box::new(ends)) } else { Origin::Fit };
        Ok(Fitted { latent: self.latents.row(i)?, origin })
    }
}

impl Tensors {
    fn microfacets(&self, prefix: &str) -> Result<Microfacets, String> {
        let name = |name| format!("{prefix}{name}");
        let (kd, eta) = (self.rows(&name("kd"), &[3])?, self.rows(&name("eta"), &[3])?);
        let isotropic = self.rows(&name("alpha"), &[1]);
        let is_isotropic = isotropic.is_ok();
        let alpha = isotropic.or_else(|_| self.rows(&name("alpha"), &[2]))?;
        Ok(Microfacets { kd, eta, alpha, is_isotropic })
    }

    /// What edited materials were made of; `None` where a file holds none.
    fn fitted(&self) -> Result<Option<FittedParts>, String> {
        if !self.has("fitted.albedo") {
            return Ok(None);
        }
        Ok(Some(FittedParts {
            albedos: self.rows("fitted.albedo", &[3 * KNOTS])?,
            latents: self.latents("fitted.latent")?,
            mixed: self.rows("fitted.mixed", &[])?,
        }))
    }
}

/// None where every material has a network of its own and no code.
fn latent_tensor<M: Model>(materials: &[&M]) -> Option<Tensor> {
    let latents: Vec<&[f32]> = materials.iter().map(|&m| Model::latent(m)).collect();
    (!latents[0].is_empty()).then(|| Tensor::rows("latent", &latents))
}

fn bound_tensor(bounds: Vec<f32>) -> Tensor {
    Tensor::own("bound", vec![bounds.len()], &bounds)
}

/// One network where all materials share it, else one per material.
fn network_tensors(networks: &[&Arc<Network>]) -> Vec<Tensor> {
    if networks.iter().all(|network| Arc::ptr_eq(network, networks[0])) {
        layers_tensors(&[networks[0]], false)
    } else {
        layers_tensors(&networks.iter().map(|&network| &**network).collect::<Vec<_>>(), true)
    }
}

/// The layers of `networks`, which have the same sizes, stacked along a leading axis if `own`.
pub(super) fn layers_tensors(networks: &[&Network], own: bool) -> Vec<Tensor> {
    let tensor = |name: String, shape: &[usize], part: &dyn Fn(&Network) -> Vec<f32>| {
        let data: Vec<f32> = networks.iter().flat_map(|&network| part(network)).collect();
        if own {
            Tensor::own(&name, [&[networks.len()], shape].concat(), &data)
        } else {
            Tensor::shared(&name, shape.to_vec(), &data)
        }
    };
    let mut tensors = Vec::new();
    for (i, layer) in networks[0].layers().iter().enumerate() {
        let (outputs, inputs) = (layer.outputs(), layer.inputs());
        let weight = |network: &Network| network.layers()[i].weight.clone();
        tensors.push(tensor(format!("network.{i}.weight"), &[outputs, inputs], &weight));
        let bias = |network: &Network| network.layers()[i].bias.clone();
        tensors.push(tensor(format!("network.{i}.bias"), &[outputs], &bias));
    }
    tensors
}

/// Numbers that specimens have in common.
#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::directions::features::Inputs;

    pub const PARAMETERS: Microfacet =
        Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.5, 1.8, 2.5], alpha: [0.2; 2] };

    /// A hybrid material with a network of six features and four numbers in its code.
    pub fn hybrid(network: &Arc<Network>, alpha: [f32; 2], z: f32) -> Hybrid {
        let form = Form { inputs: Inputs::Isotropic, ..Form::PAPER };
        let microfacet = Microfacet { alpha, ..PARAMETERS };
        Hybrid::new(form, network.clone(), microfacet, vec![z; 4], 1.5).expect("parts that fit")
    }
}

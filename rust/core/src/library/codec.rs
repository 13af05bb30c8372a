//! How each model's materials are laid out in tensors.

use std::sync::Arc;

use serde_json::Value;

use super::container::{Tensor, Tensors, layer_at};
use crate::kernels::network::{Activation, Network};
use crate::microfacet::Microfacet;
use crate::models::Model;
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

    /// The materials of a file.
    fn decode(file: &Tensors, form: Option<&Value>) -> Result<Vec<Self>, String>;

    /// Whether two materials can stand in one library, beyond having the same form and network sizes.
    fn check_together(&self, _: &Self) -> Result<(), String> {
        Ok(())
    }
}

impl Codec for Ggx {
    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        microfacet_tensors("", materials.iter().map(|m| *m.microfacet()).collect())
    }

    fn decode(file: &Tensors, _: Option<&Value>) -> Result<Vec<Self>, String> {
        let microfacets = file.microfacets("")?;
        file.each(|i| Ggx::new(microfacets[i]))
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

    fn decode(file: &Tensors, form: Option<&Value>) -> Result<Vec<Self>, String> {
        let form = form.ok_or("its metadata has no \"form\", which a hybrid library needs")?;
        let form: Form = serde::Deserialize::deserialize(form)
            .map_err(|e| format!("its \"glimt\" metadata is broken: the form: {e}"))?;
        let (microfacets, latents, bounds) =
            (file.microfacets("")?, file.latents("latent")?, file.numbers("bound")?);
        let networks = file.networks(form.features(), Activation::HardGelu)?;
        let material = |i: usize, p, z| Hybrid::new(form, networks[i].clone(), p, z, bounds[i]);
        let Some(fitted) = file.fitted()? else {
            return file.each(|i| material(i, microfacets[i], latents[i].clone()));
        };
        let origins = file.microfacets(FITTED)?;
        file.each(|i| {
            let (origin, fitted) = (origins[i], fitted[i].clone());
            let base = material(i, origin, fitted.latent.clone())?;
            base.edited(origin, fitted, microfacets[i], latents[i].clone())
        })
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

    fn decode(file: &Tensors, _: Option<&Value>) -> Result<Vec<Self>, String> {
        let (latents, bounds) = (file.latents("latent")?, file.numbers("bound")?);
        let networks = file.networks(neural::FEATURES, Activation::HardGelu)?;
        let frames = layer_at(&[file.take("frames.weight")?, file.take("frames.bias")?], None, 0)?;
        if networks.iter().any(|network| !Arc::ptr_eq(network, &networks[0])) {
            return Err(
                "it has one network per material, expected one for all, as its model is neural".into()
            );
        }
        let network = Arc::unwrap_or_clone(networks[0].clone());
        let shared = Arc::new(Shared { network, frames });
        let fitted = file.fitted()?;
        file.each(|i| match &fitted {
            None => Neural::new(shared.clone(), latents[i].clone(), bounds[i]),
            Some(fitted) => Neural::new(shared.clone(), fitted[i].latent.clone(), bounds[i])?
                .recoded(fitted[i].clone(), latents[i].clone()),
        })
    }

    fn check_together(&self, other: &Self) -> Result<(), String> {
        if Arc::ptr_eq(self.shared(), other.shared()) {
            Ok(())
        } else {
            Err("have different networks, and a neural library has one".into())
        }
    }
}

impl Codec for Nbrdf {
    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        let networks: Vec<&Network> = materials.iter().map(|m| &**m.network()).collect();
        layers_tensors(&networks, true)
    }

    fn decode(file: &Tensors, _: Option<&Value>) -> Result<Vec<Self>, String> {
        let networks = file.networks(nbrdf::FEATURES, Activation::Relu)?;
        file.each(|i| Nbrdf::new(networks[i].clone()))
    }
}

/// Measurements stay in their own formats.
impl Codec for Tabulated {
    const STORED: bool = false;

    fn encode(_: &[&Self]) -> Vec<Tensor> {
        Vec::new()
    }

    fn decode(_: &Tensors, _: Option<&Value>) -> Result<Vec<Self>, String> {
        Err("a library cannot hold measured tables".into())
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

    fn decode(file: &Tensors, form: Option<&Value>) -> Result<Vec<Self>, String> {
        let lobe = form.and_then(|form| form.get("lobe")).ok_or("its metadata names no \"lobe\"")?;
        let lobe: Lobe = serde::Deserialize::deserialize(lobe)
            .map_err(|e| format!("its \"glimt\" metadata is broken: the lobe: {e}"))?;
        let diffuse = file.rows::<3>("diffuse")?;
        let specular = file.take("specular")?;
        let [materials, width] = specular.shape[..] else {
            return Err(specular.unexpected_shape("[materials, parameters]"));
        };
        if materials != file.materials() || width == 0 {
            return Err(specular.unexpected_shape(&format!("[{}, parameters]", file.materials())));
        }
        file.each(|i| {
            let numbers: Vec<f64> = specular.data[i * width..][..width].iter().map(|&x| x.into()).collect();
            let specular = Specular::from_numbers(lobe, &numbers)?;
            Analytic::new(Parameters { diffuse: diffuse[i].map(f64::from), specular })
        })
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

impl Tensors<'_> {
    fn microfacets(&self, prefix: &str) -> Result<Vec<Microfacet>, String> {
        let name = |name| format!("{prefix}{name}");
        let (kd, eta) = (self.rows(&name("kd"))?, self.rows(&name("eta"))?);
        let alpha = match self.rows::<1>(&name("alpha")) {
            Ok(alpha) => alpha.into_iter().map(|[a]| [a, a]).collect(),
            Err(_) => self.rows::<2>(&name("alpha"))?,
        };
        Ok((0..self.materials()).map(|i| Microfacet { kd: kd[i], eta: eta[i], alpha: alpha[i] }).collect())
    }

    /// What edited materials were made of; `None` where a file holds none.
    fn fitted(&self) -> Result<Option<Vec<Fitted>>, String> {
        const NUMBERS: usize = 3 * KNOTS;
        if !self.has("fitted.albedo") {
            return Ok(None);
        }
        let albedos = self.rows::<NUMBERS>("fitted.albedo")?;
        let (latents, mixed) = (self.latents("fitted.latent")?, self.numbers("fitted.mixed")?);
        let of = |i: usize| {
            let mut ends = [[0.0; 3]; KNOTS];
            ends.as_flattened_mut().copy_from_slice(&albedos[i]);
            let origin = if mixed[i] > 0.0 { Origin::Mix(Box::new(ends)) } else { Origin::Fit };
            Fitted { latent: latents[i].clone(), origin }
        };
        Ok(Some((0..self.materials()).map(of).collect()))
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
fn layers_tensors(networks: &[&Network], own: bool) -> Vec<Tensor> {
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

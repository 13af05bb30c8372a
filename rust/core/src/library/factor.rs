//! How `factor` materials are laid out in tensors.

use serde_json::Value;

use super::codec::Codec;
use super::container::{Tensor, Tensors};
use crate::models::factor::{Curve, DIFF_BINS, Factor, Factors, Form, HALF_BINS, Product, Variant};

impl Codec for Factor {
    fn form(&self) -> Option<Value> {
        Some(serde_json::to_value(Factor::form(self)).expect("a form is names and switches"))
    }

    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        let mut products = Vec::new();
        // The factor that not all variants have.
        let (mut masking, mut azimuth, mut tables) = (Vec::new(), Vec::new(), Vec::new());
        for material in materials {
            match material.factors() {
                Factors::IndependentG { product, masking: g } => {
                    products.push(product);
                    masking.push(*g);
                }
                Factors::GFromD(product) => products.push(product),
                Factors::Naive { product, azimuth: h } => {
                    products.push(product);
                    azimuth.push(*h);
                }
                Factors::Bivariate(table) => tables.extend_from_slice(table),
            }
        }
        let mut tensors = Vec::new();
        if !products.is_empty() {
            tensors = vec![
                Tensor::rows("diffuse", &products.iter().map(|p| p.diffuse).collect::<Vec<_>>()),
                Tensor::rows("specular", &products.iter().map(|p| p.specular).collect::<Vec<_>>()),
            ];
            tensors.extend(curves_tensor("ndf", products.iter().map(|p| p.ndf).collect()));
            tensors.extend(curves_tensor("fresnel", products.iter().map(|p| p.fresnel).collect()));
        }
        tensors.extend(curves_tensor("masking", masking));
        tensors.extend(curves_tensor("azimuth", azimuth));
        if !tables.is_empty() {
            let shape = vec![materials.len(), HALF_BINS, DIFF_BINS, 3];
            tensors.push(Tensor::own("bivariate", shape, tables.as_flattened()));
        }
        tensors
    }

    fn decode(file: &Tensors, form: Option<&Value>) -> Result<Vec<Self>, String> {
        let form = form.ok_or("its metadata has no \"form\", which a factor library needs")?;
        let form: Form = serde::Deserialize::deserialize(form)
            .map_err(|e| format!("its \"glimt\" metadata is broken: the form: {e}"))?;
        let factors: Vec<Factors> = match form.variant {
            Variant::IndependentG => {
                let masking = curves(file, "masking")?;
                let both = products(file)?.into_iter().zip(masking);
                both.map(|(product, masking)| Factors::IndependentG { product, masking }).collect()
            }
            Variant::GFromD => products(file)?.into_iter().map(Factors::GFromD).collect(),
            Variant::Naive => {
                let azimuth = curves(file, "azimuth")?;
                let both = products(file)?.into_iter().zip(azimuth);
                both.map(|(product, azimuth)| Factors::Naive { product, azimuth }).collect()
            }
            Variant::Bivariate => {
                let table = file.take("bivariate")?;
                if table.shape != [file.materials(), HALF_BINS, DIFF_BINS, 3] {
                    return Err(table.unexpected_shape(&format!("[{}, 90, 90, 3]", file.materials())));
                }
                let values = table.data.as_chunks::<3>().0;
                values.chunks_exact(HALF_BINS * DIFF_BINS).map(|t| Factors::Bivariate(t.to_vec())).collect()
            }
        };
        file.each(|i| Factor::new(factors[i].clone(), form.interpolation))
    }
}

fn products(file: &Tensors) -> Result<Vec<Product>, String> {
    let (diffuse, specular) = (file.rows("diffuse")?, file.rows("specular")?);
    let (ndf, fresnel) = (curves(file, "ndf")?, curves(file, "fresnel")?);
    let product =
        |i: usize| Product { diffuse: diffuse[i], specular: specular[i], ndf: ndf[i], fresnel: fresnel[i] };
    Ok((0..file.materials()).map(product).collect())
}

/// A curve per material and colour channel; none where no material has it.
fn curves_tensor<const N: usize>(name: &str, curves: Vec<Curve<N>>) -> Option<Tensor> {
    let shape = vec![curves.len(), 3, N];
    (!curves.is_empty()).then(|| Tensor::own(name, shape, curves.as_flattened().as_flattened()))
}

fn curves<const N: usize>(file: &Tensors, name: &str) -> Result<Vec<Curve<N>>, String> {
    let tensor = file.take(name)?;
    if tensor.shape != [file.materials(), 3, N] {
        return Err(tensor.unexpected_shape(&format!("[{}, 3, {N}]", file.materials())));
    }
    let rows: &[[f32; N]] = tensor.data.as_chunks().0;
    Ok(rows.as_chunks().0.to_vec())
}

//! How `factor` materials are laid out in tensors.

use serde_json::Value;

use super::codec::{Codec, Decoder};
use super::container::{Rows, Tensor, Tensors};
#[cfg(test)]
use crate::kernels::network::Activation;
use crate::models::factor::{
    AZIMUTH_BINS, Curve, DIFF_BINS, Factor, Factors, Form, HALF_BINS, MASKING_KNOTS, Product, Variant,
};
#[cfg(test)]
use crate::models::factor::{Interpolation, tests::patterned_factors};

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

    fn decoder(file: &Tensors, form: Option<&Value>) -> Result<Decoder<Self>, String> {
        let form = form.ok_or("its metadata has no \"form\", which a factor library needs")?;
        let form: Form = serde::Deserialize::deserialize(form)
            .map_err(|e| format!("its \"glimt\" metadata is broken: the form: {e}"))?;
        let factors: Decoder<Factors> = match form.variant {
            Variant::IndependentG => {
                let (products, masking) = (Products::new(file)?, curves_of(file, "masking", MASKING_KNOTS)?);
                Box::new(move |i| {
                    Ok(Factors::IndependentG { product: products.at(i)?, masking: curve(&masking, i)? })
                })
            }
            Variant::GFromD => {
                let products = Products::new(file)?;
                Box::new(move |i| products.at(i).map(Factors::GFromD))
            }
            Variant::Naive => {
                let (products, azimuth) = (Products::new(file)?, curves_of(file, "azimuth", AZIMUTH_BINS)?);
                Box::new(move |i| {
                    Ok(Factors::Naive { product: products.at(i)?, azimuth: curve(&azimuth, i)? })
                })
            }
            Variant::Bivariate => {
                let tables = file.rows("bivariate", &[HALF_BINS, DIFF_BINS, 3])?;
                Box::new(move |i| Ok(Factors::Bivariate(tables.row(i)?.as_chunks().0.to_vec())))
            }
        };
        Ok(Box::new(move |i| Ok(Factor::new(factors(i)?, form.interpolation)?)))
    }

    #[cfg(test)]
    fn specimens(_: Activation) -> Vec<[Self; 2]> {
        let factor =
            |factors: Factors| Factor::new(factors, Interpolation::Nearest).expect("numbers in their ranges");
        patterned_factors().map(|factors| [factor(factors.clone()), factor(factors)]).into()
    }
}

/// The factors that all variants but one have.
struct Products {
    diffuse: Rows,
    specular: Rows,
    ndf: Rows,
    fresnel: Rows,
}

impl Products {
    fn new(file: &Tensors) -> Result<Products, String> {
        Ok(Products {
            diffuse: file.rows("diffuse", &[3])?,
            specular: file.rows("specular", &[3])?,
            ndf: curves_of(file, "ndf", HALF_BINS)?,
            fresnel: curves_of(file, "fresnel", DIFF_BINS)?,
        })
    }

    fn at(&self, i: usize) -> Result<Product, String> {
        Ok(Product {
            diffuse: self.diffuse.array(i)?,
            specular: self.specular.array(i)?,
            ndf: curve(&self.ndf, i)?,
            fresnel: curve(&self.fresnel, i)?,
        })
    }
}

/// A curve per material and colour channel; none where no material has it.
fn curves_tensor<const N: usize>(name: &str, curves: Vec<Curve<N>>) -> Option<Tensor> {
    let shape = vec![curves.len(), 3, N];
    (!curves.is_empty()).then(|| Tensor::own(name, shape, curves.as_flattened().as_flattened()))
}

fn curves_of(file: &Tensors, name: &str, knots: usize) -> Result<Rows, String> {
    file.rows(name, &[3, knots])
}

/// The curve of a material.
fn curve<const N: usize>(curves: &Rows, i: usize) -> Result<Curve<N>, String> {
    let mut curve = [[0.0; N]; 3];
    curve.as_flattened_mut().copy_from_slice(&curves.row(i)?);
    Ok(curve)
}

//! How materials that vary over a surface are laid out in tensors.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::codec::{Codec, Decoder};
use super::container::{Tensor, Tensors, unexpected_shape};
#[cfg(test)]
use crate::kernels::network::Activation;
use crate::models::maps::{Filter, Maps, Texel};
use crate::surface::Wrap;

/// What the metadata says of maps.
#[derive(Serialize, Deserialize)]
struct MapsForm {
    wrap: Wrap,
    filter: Filter,
}

/// Numbers of a texel: k_d, F₀, α and the slope.
const NUMBERS: usize = 9;

impl Codec for Maps {
    fn form(&self) -> Option<Value> {
        let form = MapsForm { wrap: self.wrap(), filter: self.filter() };
        Some(serde_json::to_value(form).expect("a form is names"))
    }

    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        let [width, height] = materials[0].size();
        let mut numbers = Vec::with_capacity(materials.len() * width * height * NUMBERS);
        for material in materials {
            for texel in (0..width * height).map(|i| material.texel(i % width, i / width)) {
                numbers.extend(texel.kd.into_iter().chain(texel.f0).chain([texel.alpha]).chain(texel.slope));
            }
        }
        vec![Tensor::own("maps", vec![materials.len(), height, width, NUMBERS], &numbers)]
    }

    fn decoder(file: &Tensors, form: Option<&Value>) -> Result<Decoder<Self>, String> {
        let form = form.ok_or("its metadata has no \"form\", which a library of maps needs")?;
        let MapsForm { wrap, filter } = Deserialize::deserialize(form)
            .map_err(|e| format!("its \"glimt\" metadata is broken: the form: {e}"))?;
        let shape = &file.info("maps", &[safetensors::tensor::Dtype::F32])?.shape;
        let &[_, height, width, NUMBERS] = &shape[..] else {
            let expected = format!("[{}, height, width, {NUMBERS}]", file.materials());
            return Err(unexpected_shape("maps", shape, &expected));
        };
        let rows = file.rows("maps", &[height, width, NUMBERS])?;
        Ok(Box::new(move |i| {
            let numbers = rows.row(i)?;
            let texels = numbers.as_chunks::<NUMBERS>().0.iter().map(
                |&[kd_r, kd_g, kd_b, f0_r, f0_g, f0_b, alpha, x, y]| Texel {
                    kd: [kd_r, kd_g, kd_b],
                    f0: [f0_r, f0_g, f0_b],
                    alpha,
                    slope: [x, y],
                },
            );
            Ok(Maps::new(width, texels, wrap, filter)?)
        }))
    }

    #[cfg(test)]
    fn specimens(_: Activation) -> Vec<[Self; 2]> {
        use crate::models::maps::tests::patterned;
        vec![[patterned(5, 3, Filter::Moments), patterned(5, 3, Filter::Moments)]]
    }

    fn check_together(&self, other: &Self) -> Result<(), String> {
        if self.size() == other.size() { Ok(()) } else { Err("have maps of different sizes".into()) }
    }
}

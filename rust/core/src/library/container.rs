//! The container: named, typed tensors, checked as they are taken from a file.

use std::sync::Arc;

use half::f16;
use safetensors::tensor::{Dtype, SafeTensors};

use crate::kernels::network::{Activation, Layer, Network};

/// A tensor that is written or was read, little-endian.
pub(crate) struct Tensor {
    pub name: String,
    pub shape: Vec<usize>,
    pub dtype: Dtype,
    pub bytes: Vec<u8>,
    /// Whether all materials use it, rather than each a part of its own.
    pub shared: bool,
}

impl Tensor {
    /// Numbers of which each material has its own, along the first axis.
    pub fn own(name: &str, shape: Vec<usize>, data: &[f32]) -> Tensor {
        let bytes = data.iter().flat_map(|x| x.to_le_bytes()).collect();
        Tensor { name: name.to_owned(), shape, dtype: Dtype::F32, bytes, shared: false }
    }

    /// Numbers that all materials use.
    pub fn shared(name: &str, shape: Vec<usize>, data: &[f32]) -> Tensor {
        Tensor { shared: true, ..Tensor::own(name, shape, data) }
    }

    /// The same tensor, used by all materials or by each a part.
    pub fn with_shared(self, shared: bool) -> Tensor {
        Tensor { shared, ..self }
    }

    /// Numbers of another type than float32, of which each material has its own.
    pub fn typed(name: &str, shape: Vec<usize>, dtype: Dtype, bytes: Vec<u8>) -> Tensor {
        Tensor { name: name.to_owned(), shape, dtype, bytes, shared: false }
    }

    /// One row per material.
    pub fn rows<Row: AsRef<[f32]>>(name: &str, rows: &[Row]) -> Tensor {
        let data: Vec<f32> = rows.iter().flat_map(|row| row.as_ref().iter().copied()).collect();
        Tensor::own(name, vec![rows.len(), data.len() / rows.len()], &data)
    }
}

/// A float32 tensor of a file.
pub(crate) struct Numbers {
    pub name: String,
    pub shape: Vec<usize>,
    pub data: Vec<f32>,
}

impl Numbers {
    pub fn unexpected_shape(&self, expected: &str) -> String {
        format!("the tensor \"{}\" has shape {:?}, expected {expected}", self.name, self.shape)
    }
}

/// A file's tensors by name, checked as they are taken.
pub(crate) struct Tensors<'a> {
    pub file: SafeTensors<'a>,
    /// Names of the materials.
    pub names: Vec<&'a str>,
    /// The activation of the networks, where the header says it.
    pub activation: Option<Activation>,
}

impl Tensors<'_> {
    pub fn materials(&self) -> usize {
        self.names.len()
    }

    /// One material for each name; an error names the material.
    pub fn each<M>(&self, material: impl Fn(usize) -> Result<M, String>) -> Result<Vec<M>, String> {
        let named = |i: usize| material(i).map_err(|e| format!("material \"{}\": {e}", self.names[i]));
        (0..self.materials()).map(named).collect()
    }

    pub fn has(&self, name: &str) -> bool {
        self.file.tensor(name).is_ok()
    }

    /// The bytes of a tensor whose numbers are of one of `types`, and its shape.
    pub fn bytes(&self, name: &str, types: &[Dtype]) -> Result<(Dtype, Vec<usize>, &[u8]), String> {
        let view = self.file.tensor(name).map_err(|_| format!("the tensor \"{name}\" is missing"))?;
        if !types.contains(&view.dtype()) {
            let expected: Vec<String> = types.iter().map(|t| format!("{t:?}")).collect();
            return Err(format!(
                "the tensor \"{name}\" is {:?}, expected {}",
                view.dtype(),
                expected.join(" or ")
            ));
        }
        Ok((view.dtype(), view.shape().to_vec(), view.data()))
    }

    pub fn take(&self, name: &str) -> Result<Numbers, String> {
        self.floats(name, &[Dtype::F32])
    }

    /// A tensor of float32 or, where `types` has it, float16.
    pub fn floats(&self, name: &str, types: &[Dtype]) -> Result<Numbers, String> {
        let (dtype, shape, bytes) = self.bytes(name, types)?;
        // Copied float by float: the bytes in a file have no alignment to rely on.
        let data: Vec<f32> = match dtype {
            Dtype::F16 => bytes.as_chunks().0.iter().map(|&b| f16::from_le_bytes(b).to_f32()).collect(),
            _ => bytes.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
        };
        if let Some(at) = data.iter().position(|x| !x.is_finite()) {
            return Err(format!(
                "the tensor \"{name}\" holds {} at index {at}, expected finite numbers",
                data[at]
            ));
        }
        Ok(Numbers { name: name.to_owned(), shape, data })
    }

    /// A tensor with a row of `width` numbers per material.
    pub fn rows<const WIDTH: usize>(&self, name: &str) -> Result<Vec<[f32; WIDTH]>, String> {
        let tensor = self.take(name)?;
        if tensor.shape != [self.materials(), WIDTH] {
            return Err(tensor.unexpected_shape(&format!("[{}, {WIDTH}]", self.materials())));
        }
        Ok(tensor.data.as_chunks().0.to_vec())
    }

    /// Latent codes; none where the file has none, which is so where every material has a network.
    pub fn latents(&self, name: &str) -> Result<Vec<Vec<f32>>, String> {
        if !self.has(name) {
            return Ok(vec![Vec::new(); self.materials()]);
        }
        let tensor = self.take(name)?;
        match tensor.shape[..] {
            [materials, width] if materials == self.materials() && width > 0 => {
                Ok(tensor.data.chunks_exact(width).map(<[f32]>::to_vec).collect())
            }
            _ => Err(tensor.unexpected_shape(&format!("[{}, l]", self.materials()))),
        }
    }

    /// A tensor with one number per material.
    pub fn numbers(&self, name: &str) -> Result<Vec<f32>, String> {
        let tensor = self.take(name)?;
        if tensor.shape != [self.materials()] {
            return Err(tensor.unexpected_shape(&format!("[{}]", self.materials())));
        }
        Ok(tensor.data)
    }

    /// The activation of the networks. Files of version 1 that do not say it hold networks of the one that every
    /// network of the model then had.
    pub fn activation_or(&self, unsaid: Activation) -> Activation {
        self.activation.unwrap_or(unsaid)
    }

    /// One network per material, the same one where they share it; `unsaid` as for [`Tensors::activation_or`].
    pub fn networks(&self, features: usize, unsaid: Activation) -> Result<Vec<Arc<Network>>, String> {
        let activation = self.activation_or(unsaid);
        let mut stacks: Vec<[Numbers; 2]> = Vec::new();
        while self.has(&format!("network.{}.weight", stacks.len())) {
            let i = stacks.len();
            stacks
                .push([self.take(&format!("network.{i}.weight"))?, self.take(&format!("network.{i}.bias"))?]);
        }
        let own = stacks.first().is_some_and(|[weight, _]| weight.shape.len() == 3);
        let count = if own { self.materials() } else { 1 };
        let build = |index: usize| {
            let layers = stacks.iter().map(|stack| layer_at(stack, own.then_some(count), index));
            Network::new(layers.collect::<Result<_, _>>()?, features, activation).map(Arc::new)
        };
        let networks = (0..count).map(build).collect::<Result<Vec<_>, _>>()?;
        Ok((0..self.materials()).map(|i| networks[if own { i } else { 0 }].clone()).collect())
    }
}

/// One network's layer from the tensors of all: weight (n, out, in) and bias (n, out), or without
/// the first axis.
pub(crate) fn layer_at(
    [weight, bias]: &[Numbers; 2],
    count: Option<usize>,
    index: usize,
) -> Result<Layer, String> {
    let axes = usize::from(count.is_some());
    let fits = weight.shape.len() == axes + 2
        && bias.shape.len() == axes + 1
        && weight.shape[..=axes] == bias.shape[..]
        && count.is_none_or(|n| weight.shape[0] == n)
        && !weight.data.is_empty();
    if !fits {
        return Err(format!(
            "{} of shape {:?} and {} of shape {:?} do not make a layer",
            weight.name, weight.shape, bias.name, bias.shape
        ));
    }
    let (outputs, inputs) = (weight.shape[axes], weight.shape[axes + 1]);
    Ok(Layer {
        weight: weight.data[index * outputs * inputs..][..outputs * inputs].to_vec(),
        bias: bias.data[index * outputs..][..outputs].to_vec(),
    })
}

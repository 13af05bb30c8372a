//! An interrupted fit as a file, from which it goes on to the same result.
//!
//! The container is safetensors: the numbers and what the optimiser keeps as tensors, and in the
//! metadata under `glimt-checkpoint` the options and the materials, which must be the same again.

use std::collections::HashMap;
use std::path::Path;

use glimt_disk::write_whole;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::adamw::Moments;
use crate::error::Error;
use crate::input::{Input, identities};
use crate::options::Options;
use crate::train::State;

/// A fit that can go on; `O` are its options.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckpointOf<O> {
    /// What was asked for.
    pub options: O,
    /// The materials by name and hash of their source.
    pub materials: Vec<(String, String)>,
    /// Where the fit is.
    pub state: State,
}

/// A fit of materials that can go on.
pub type Checkpoint = CheckpointOf<Options>;

#[derive(Serialize, Deserialize)]
struct Header<O> {
    options: O,
    materials: Vec<(String, String)>,
    step: u64,
}

const KEY: &str = "glimt-checkpoint";

impl Checkpoint {
    /// Of a fit of `inputs` that has come to `state`.
    #[must_use]
    pub fn new(inputs: &[Input], options: &Options, state: State) -> Checkpoint {
        Checkpoint { options: options.clone(), materials: identities(inputs), state }
    }
}

impl<O: Clone + Serialize + DeserializeOwned> CheckpointOf<O> {
    /// Writes the checkpoint: whole, or not at all.
    ///
    /// # Errors
    /// [`Error::Checkpoint`].
    pub fn save(&self, path: &Path) -> Result<(), Error> {
        let header = Header {
            options: self.options.clone(),
            materials: self.materials.clone(),
            step: self.state.step,
        };
        let json = serde_json::to_string(&header).expect("numbers and strings always serialise");
        let moments = &self.state.moments;
        let mut tensors: Vec<(&str, Dtype, &[u8])> = vec![
            ("numbers", Dtype::F32, bytemuck::cast_slice(&self.state.numbers)),
            ("first", Dtype::F32, bytemuck::cast_slice(&moments.first)),
            ("second", Dtype::F32, bytemuck::cast_slice(&moments.second)),
        ];
        if !moments.touched.is_empty() {
            tensors.push(("touched", Dtype::U32, bytemuck::cast_slice(&moments.touched)));
        }
        let views = tensors.into_iter().map(|(name, dtype, bytes)| {
            let view = TensorView::new(dtype, vec![bytes.len() / 4], bytes);
            (name, view.expect("the shape is made from the data"))
        });
        let bytes = safetensors::serialize(views, Some(HashMap::from([(KEY.to_owned(), json)])))
            .expect("names and shapes are valid");
        write_whole(path, &bytes).map_err(|e| failed(path, format!("cannot be written: {e}")))
    }

    /// Reads a checkpoint.
    ///
    /// # Errors
    /// [`Error::Checkpoint`].
    pub fn open(path: &Path) -> Result<Self, Error> {
        let bytes = std::fs::read(path).map_err(|e| {
            let hint = match e.kind() {
                std::io::ErrorKind::NotFound => {
                    "; no fit of this output was interrupted: leave --resume out to start one"
                }
                _ => "",
            };
            failed(path, format!("cannot be read: {e}{hint}"))
        })?;
        CheckpointOf::from_bytes(&bytes).map_err(|reason| failed(path, reason))
    }

    /// Decodes the bytes of a checkpoint.
    ///
    /// # Errors
    /// In words, what was found and what was expected.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        decode(bytes)
    }
}

fn failed(path: &Path, reason: String) -> Error {
    Error::Checkpoint { path: path.to_path_buf(), reason }
}

fn decode<O: DeserializeOwned>(bytes: &[u8]) -> Result<CheckpointOf<O>, String> {
    let container = |e: safetensors::SafeTensorError| format!("as a safetensors file it is broken: {e}");
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(container)?;
    let json = metadata.metadata().as_ref().and_then(|m| m.get(KEY));
    let json = json.ok_or("it is not a checkpoint of glimt")?;
    let header: Header<O> =
        serde_json::from_str(json).map_err(|e| format!("it is of another version of glimt: {e}"))?;
    let file = SafeTensors::deserialize(bytes).map_err(container)?;
    let words = |name: &str, dtype: Dtype| -> Result<Vec<[u8; 4]>, String> {
        let view = file.tensor(name).map_err(|_| format!("the tensor \"{name}\" is missing"))?;
        if view.dtype() != dtype {
            return Err(format!("the tensor \"{name}\" is {:?}, expected {dtype:?}", view.dtype()));
        }
        Ok(view.data().as_chunks::<4>().0.to_vec())
    };
    let floats = |name: &str| -> Result<Vec<f32>, String> {
        Ok(words(name, Dtype::F32)?.into_iter().map(f32::from_le_bytes).collect())
    };
    let (numbers, first, second) = (floats("numbers")?, floats("first")?, floats("second")?);
    // Fits without tables have none.
    let touched = match file.tensor("touched") {
        Ok(_) => words("touched", Dtype::U32)?.into_iter().map(u32::from_le_bytes).collect(),
        Err(_) => Vec::new(),
    };
    if !numbers.iter().chain(&first).chain(&second).all(|x| x.is_finite()) {
        return Err("it holds numbers that are not finite".into());
    }
    if first.len() != numbers.len() || second.len() != numbers.len() {
        return Err("its tensors differ in length".into());
    }
    let state = State { numbers, moments: Moments { first, second, touched }, step: header.step };
    Ok(CheckpointOf { options: header.options, materials: header.materials, state })
}

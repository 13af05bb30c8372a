//! The container: named, typed tensors. Of a file that is read, the header is in memory and the numbers stay where they
//! are until they are asked for, and are checked then.

use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use half::f16;
use safetensors::tensor::{Dtype, Metadata, TensorInfo};

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

/// Where the bytes of a file are.
pub(crate) enum Content {
    /// In memory, from byte `first` of the file on.
    Memory {
        /// Place of the first one.
        first: usize,
        /// All from there on.
        bytes: Vec<u8>,
    },
    /// In a file that is open.
    File(Mutex<Box<dyn Stream>>),
}

/// What bytes are read from.
pub(crate) trait Stream: Read + Seek + Send {}

impl<S: Read + Seek + Send> Stream for S {}

impl Content {
    /// The bytes at these places.
    fn read(&self, places: Range<usize>) -> Result<Vec<u8>, String> {
        const CUT_OFF: &str = "it was cut off while it was open";
        match self {
            Content::Memory { first, bytes } => {
                let part = places.start.checked_sub(*first).zip(places.end.checked_sub(*first));
                Ok(part.and_then(|(start, end)| bytes.get(start..end)).ok_or(CUT_OFF)?.to_vec())
            }
            Content::File(stream) => {
                // A read that panicked left nothing behind: every read says where it begins.
                let mut stream = stream.lock().unwrap_or_else(PoisonError::into_inner);
                let mut bytes = vec![0; places.len()];
                let read = stream
                    .seek(SeekFrom::Start(places.start as u64))
                    .and_then(|_| stream.read_exact(&mut bytes));
                read.map_err(|error| format!("{CUT_OFF} or cannot be read: {error}"))?;
                Ok(bytes)
            }
        }
    }
}

/// Bytes that are read at once: less work than reading them by parts. A file of no more is checked whole when it is
/// opened.
pub(crate) const SMALL: usize = 1 << 16;

/// Bytes before the header, which say how long it is.
const LENGTH: usize = size_of::<u64>();

/// Longest header that is read: that of a million materials.
const MAX_HEADER: usize = 1 << 28;

impl Content {
    /// The same bytes from `start` on, in memory if they are few.
    pub fn at_hand(self, start: usize, size: usize) -> Result<Content, String> {
        if size - start > SMALL {
            return Ok(self);
        }
        Ok(Content::Memory { first: start, bytes: self.read(start..size)? })
    }
}

/// The header of a file of `size` bytes, and where the tensors begin.
pub(crate) fn read_header(content: &Content, size: usize) -> Result<(Metadata, usize), String> {
    let broken = |why: &dyn std::fmt::Display| {
        format!("as a safetensors file of {size} bytes it is broken or cut off: {why}")
    };
    if size < LENGTH {
        return Err(broken(&"it is shorter than the length of a header"));
    }
    let length = content.read(0..LENGTH)?.first_chunk().map_or(0, |&bytes| u64::from_le_bytes(bytes));
    let length = usize::try_from(length).ok().filter(|&length| length <= MAX_HEADER.min(size - LENGTH));
    let length = length.ok_or_else(|| broken(&"its header is longer than itself"))?;
    let start = LENGTH + length;
    let metadata: Metadata =
        serde_json::from_slice(&content.read(LENGTH..start)?).map_err(|error| broken(&error))?;
    match metadata.data_len() {
        expected if size - start == expected => Ok((metadata, start)),
        expected => {
            Err(broken(&format!("its tensors have {expected} bytes, but {} follow the header", size - start)))
        }
    }
}

/// A file's tensors by name, checked as they are taken.
#[derive(Clone)]
pub(crate) struct Tensors {
    file: Arc<File>,
}

struct File {
    content: Content,
    metadata: Metadata,
    /// Where the tensors begin.
    start: usize,
    materials: usize,
    activation: Option<Activation>,
}

impl Tensors {
    /// Of a file with that header; `activation` is that of the networks, where the header says it.
    pub fn new(
        content: Content,
        (metadata, start): (Metadata, usize),
        materials: usize,
        activation: Option<Activation>,
    ) -> Tensors {
        Tensors { file: Arc::new(File { content, metadata, start, materials, activation }) }
    }

    pub fn materials(&self) -> usize {
        self.file.materials
    }

    pub fn has(&self, name: &str) -> bool {
        self.file.metadata.info(name).is_some()
    }

    /// A tensor whose numbers are of one of `types`.
    pub fn info(&self, name: &str, types: &[Dtype]) -> Result<&TensorInfo, String> {
        let info =
            self.file.metadata.info(name).ok_or_else(|| format!("the tensor \"{name}\" is missing"))?;
        if !types.contains(&info.dtype) {
            let expected: Vec<String> = types.iter().map(|t| format!("{t:?}")).collect();
            let expected = expected.join(" or ");
            return Err(format!("the tensor \"{name}\" is {:?}, expected {expected}", info.dtype));
        }
        Ok(info)
    }

    /// Bytes of a tensor, from its begin.
    pub fn part(&self, name: &str, part: Range<usize>) -> Result<Vec<u8>, String> {
        let info =
            self.file.metadata.info(name).ok_or_else(|| format!("the tensor \"{name}\" is missing"))?;
        let start = self.file.start + info.data_offsets.0;
        self.file.content.read(start + part.start..start + part.end)
    }

    /// The bytes of a tensor whose numbers are of one of `types`, and its shape.
    pub fn bytes(&self, name: &str, types: &[Dtype]) -> Result<(Vec<usize>, Vec<u8>), String> {
        let info = self.info(name, types)?;
        let (begin, end) = info.data_offsets;
        Ok((info.shape.clone(), self.part(name, 0..end - begin)?))
    }

    /// A tensor with a row of `shape` for each material.
    pub fn rows(&self, name: &str, shape: &[usize]) -> Result<Rows, String> {
        let info = self.info(name, &[Dtype::F32])?;
        let expected = [&[self.materials()], shape].concat();
        if info.shape != expected {
            return Err(unexpected_shape(name, &info.shape, &format!("{expected:?}")));
        }
        Ok(Rows::new(self, name, info, shape.iter().product()))
    }

    /// A tensor with a row for each material, as long as it is; `what` a row is called.
    pub fn rows_of_any_width(&self, name: &str, what: &str) -> Result<Rows, String> {
        let info = self.info(name, &[Dtype::F32])?;
        match info.shape[..] {
            [materials, width] if materials == self.materials() && width > 0 => {
                Ok(Rows::new(self, name, info, width))
            }
            _ => Err(unexpected_shape(name, &info.shape, &format!("[{}, {what}]", self.materials()))),
        }
    }

    /// Latent codes; none where the file has none, which is so where every material has a network.
    pub fn latents(&self, name: &str) -> Result<Latents, String> {
        let rows = self.has(name).then(|| self.rows_of_any_width(name, "l")).transpose()?;
        Ok(Latents(rows))
    }

    /// The activation of the networks. Files of version 1 that do not say it hold networks of the one that every
    /// network of the model then had.
    pub fn activation_or(&self, unsaid: Activation) -> Activation {
        self.file.activation.unwrap_or(unsaid)
    }

    /// One network for each material or one for all; `unsaid` as for [`Tensors::activation_or`].
    pub fn networks(&self, features: usize, unsaid: Activation) -> Result<Networks, String> {
        let first = self.file.metadata.info("network.0.weight");
        let own = first.is_some_and(|weight| weight.shape.len() == 3);
        let count = if own { self.materials() } else { 1 };
        self.stacked_networks(own.then_some(count), features, self.activation_or(unsaid), &[Dtype::F32])
    }

    /// As many networks as `count` says, along the first axis of their tensors; one without such an axis if it is
    /// `None`.
    pub fn stacked_networks(
        &self,
        count: Option<usize>,
        features: usize,
        activation: Activation,
        types: &[Dtype],
    ) -> Result<Networks, String> {
        let mut layers = Vec::new();
        while self.has(&format!("network.{}.weight", layers.len())) {
            layers.push(self.layer(&format!("network.{}", layers.len()), count, types)?);
        }
        let made = (0..count.unwrap_or(1)).map(|_| OnceLock::new()).collect();
        let networks = Networks { layers, features, activation, made };
        // What is wrong with one that all share is wrong with the file.
        if networks.count() == 1 {
            networks.at(0)?;
        }
        Ok(networks)
    }

    /// The layer of `prefix`.weight, (out, in), and `prefix`.bias, (out); of `count` networks along a first axis.
    pub fn layer(&self, prefix: &str, count: Option<usize>, types: &[Dtype]) -> Result<StackedLayer, String> {
        let names = [format!("{prefix}.weight"), format!("{prefix}.bias")];
        let [weight, bias] = [self.info(&names[0], types)?, self.info(&names[1], types)?];
        let axes = usize::from(count.is_some());
        let fits = weight.shape.len() == axes + 2
            && bias.shape.len() == axes + 1
            && weight.shape[..=axes] == bias.shape[..]
            && count.is_none_or(|n| weight.shape[0] == n)
            && !weight.shape.contains(&0);
        if !fits {
            return Err(format!(
                "{} of shape {:?} and {} of shape {:?} do not make a layer",
                names[0], weight.shape, names[1], bias.shape
            ));
        }
        let rows =
            |name: &str, info: &TensorInfo| Rows::new(self, name, info, info.shape[axes..].iter().product());
        Ok(StackedLayer { weight: rows(&names[0], weight), bias: rows(&names[1], bias) })
    }
}

pub(crate) fn unexpected_shape(name: &str, shape: &[usize], expected: &str) -> String {
    format!("the tensor \"{name}\" has shape {shape:?}, expected {expected}")
}

/// Bytes as finite numbers, the first of which is number `first` of the tensor.
fn finite(name: &str, dtype: Dtype, bytes: &[u8], first: usize) -> Result<Vec<f32>, String> {
    let data: Vec<f32> = match dtype {
        Dtype::F16 => bytes.as_chunks().0.iter().map(|&b| f16::from_le_bytes(b).to_f32()).collect(),
        _ => bytes.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect(),
    };
    match data.iter().position(|x| !x.is_finite()) {
        None => Ok(data),
        Some(at) => Err(format!(
            "the tensor \"{name}\" holds {} at index {}, expected finite numbers",
            data[at],
            first + at
        )),
    }
}

/// A tensor of float32 or float16 in rows of the same length.
pub(crate) struct Rows {
    file: Tensors,
    name: String,
    dtype: Dtype,
    width: usize,
}

impl Rows {
    fn new(file: &Tensors, name: &str, info: &TensorInfo, width: usize) -> Rows {
        Rows { file: file.clone(), name: name.to_owned(), dtype: info.dtype, width }
    }

    /// A row.
    pub fn row(&self, row: usize) -> Result<Vec<f32>, String> {
        let bytes = self.width * self.dtype.bitsize() / 8;
        let bytes = self.file.part(&self.name, row * bytes..(row + 1) * bytes)?;
        finite(&self.name, self.dtype, &bytes, row * self.width)
    }

    /// A row of `N` numbers, which the rows have.
    pub fn array<const N: usize>(&self, row: usize) -> Result<[f32; N], String> {
        let found =
            |row: Vec<f32>| format!("a row of \"{}\" has {} numbers, expected {N}", self.name, row.len());
        self.row(row)?.try_into().map_err(found)
    }

    /// The number of a row of one.
    pub fn number(&self, row: usize) -> Result<f32, String> {
        self.array(row).map(|[number]| number)
    }
}

/// Latent codes, where there are any.
pub(crate) struct Latents(Option<Rows>);

impl Latents {
    /// A material's code.
    pub fn row(&self, material: usize) -> Result<Vec<f32>, String> {
        self.0.as_ref().map_or(Ok(Vec::new()), |rows| rows.row(material))
    }
}

/// The same layer of several networks, or that of one.
pub(crate) struct StackedLayer {
    weight: Rows,
    bias: Rows,
}

impl StackedLayer {
    /// That of a network.
    pub fn at(&self, network: usize) -> Result<Layer, String> {
        Ok(Layer { weight: self.weight.row(network)?, bias: self.bias.row(network)? })
    }
}

/// Networks of the same sizes; each is made when it is first asked for.
pub(crate) struct Networks {
    layers: Vec<StackedLayer>,
    features: usize,
    activation: Activation,
    made: Vec<OnceLock<Arc<Network>>>,
}

impl Networks {
    pub fn count(&self) -> usize {
        self.made.len()
    }

    /// A network.
    pub fn at(&self, index: usize) -> Result<Arc<Network>, String> {
        if let Some(network) = self.made[index].get() {
            return Ok(Arc::clone(network));
        }
        let layers = self.layers.iter().map(|layer| layer.at(index)).collect::<Result<_, _>>()?;
        let network = Arc::new(Network::new(layers, self.features, self.activation)?);
        Ok(Arc::clone(self.made[index].get_or_init(|| network)))
    }

    /// That of a material: its own, or the one of all.
    pub fn of_material(&self, material: usize) -> Result<Arc<Network>, String> {
        self.at(if self.count() == 1 { 0 } else { material })
    }
}

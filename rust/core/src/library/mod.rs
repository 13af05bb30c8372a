//! The model library: one `.safetensors` file with the materials of one model.
//!
//! The metadata of the container holds one JSON object under `glimt` (`header.rs`): format version,
//! model, activation of its networks, names, and where each material came from. Tensors are little-endian float32:
//!
//! | tensor | shape | models |
//! |---|---|---|
//! | `kd`, `eta` | (materials, 3) | ggx, hybrid |
//! | `alpha` | (materials, 1) if all are isotropic, else (materials, 2) | ggx, hybrid |
//! | `latent` | (materials, l) | hybrid, neural |
//! | `bound` | (materials) | hybrid, neural |
//! | `network.i.weight`, `network.i.bias` | (out, in), (out); with a leading axis of materials where each has a network of its own | hybrid, neural, nbrdf |
//! | `frames.weight`, `frames.bias` | (18, l), (18) | neural |
//! | `fitted.kd`, `fitted.eta`, `fitted.alpha` | as `kd`, `eta`, `alpha` | hybrid, where a material is an edit |
//! | `fitted.latent`, `fitted.albedo`, `fitted.mixed` | (materials, l), (materials, 72), (materials) | hybrid and neural, where a material is an edit or a mix |
//! | `diffuse`, `specular` | (materials, 3) | factor, but for bivariate |
//! | `ndf`, `fresnel` | (materials, 3, 90) | factor, but for bivariate |
//! | `masking` | (materials, 3, 90) | factor, independent-g |
//! | `azimuth` | (materials, 3, 180) | factor, naive |
//! | `bivariate` | (materials, 90, 90, 3) | factor, bivariate |
//! | `diffuse`, `specular` | (materials, 3), (materials, parameters of the lobe) | analytic |
//! | `maps` | (materials, height, width, 9): k_d, F₀, α, slope along u and v; rows from the bottom | maps |
//!
//! What a spherical library holds says [`spherical`].

use std::collections::HashMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock};

use glimt_disk::write_whole;
use safetensors::tensor::TensorView;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::error::Error;
use crate::kernels::network::{Activation, Network};
use crate::material::{Kind, Material, with_kind, with_model};

use codec::{Codec, Decoder};
use container::{Content, SMALL, Tensor};
use header::{COLOR_SPACE, Header, MaterialHeader, check_names};
use opened::OpenFile;

mod codec;
mod container;
mod factor;
mod header;
mod names;
mod opened;
mod spherical;
mod surfaces;

pub use names::nearest;

/// Version of the file format that this code writes and reads.
pub const FORMAT_VERSION: u32 = 1;

/// Largest library that is read: thousands of materials fit, and a wrong file does not fill memory.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// A named material and where it came from.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Name, unique in the library.
    pub name: String,
    /// The material.
    pub material: Material,
    /// Where it came from.
    pub origin: Origin,
}

/// Where a material came from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// Name of the file that it was fitted to or imported from.
    pub source: String,
    /// SHA-256 of that file, in hexadecimal; of several files that of the lines that `sha256sum` prints of them.
    pub sha256: String,
    /// The files, where there are several.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<SourceFile>,
    /// The command that made it.
    pub command: String,
    /// The version of glimt that did, where that is kept.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub version: String,
    /// Seed of the fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Steps of the fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u64>,
    /// Error metrics against the source by name, as the command measured them.
    #[serde(default, skip_serializing_if = "std::collections::BTreeMap::is_empty")]
    pub metrics: std::collections::BTreeMap<String, f64>,
    /// Licence of the source, where it is known.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub license: String,
    /// What a fit minimised, as far as later fits to the same network need it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recipe: Option<Value>,
}

/// One of several files that a material was made from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SourceFile {
    /// Its name.
    pub name: String,
    /// SHA-256 of it, in hexadecimal.
    pub sha256: String,
}

/// The name of what [`Library::mix`] makes.
#[must_use]
pub fn mix_name(a: &str, b: &str, t: f32) -> String {
    format!("{a} + {t} {b}")
}

/// Materials of one model.
///
/// Of a file that is opened the header is read, and what its materials share. A material is read when it is first
/// asked for, so that one of thousands costs what one costs; a file that is small is read and checked at once.
///
/// ```
/// use glimt_core::library::{Entry, Origin};
/// use glimt_core::microfacet::Microfacet;
/// use glimt_core::models::ggx::Ggx;
/// use glimt_core::{Brdf, Kind, Library, Vec3};
///
/// let shipped = Library::open("../../scenes/models/rgl.safetensors")?;
/// assert_eq!((shipped.kind(), shipped.names().len()), (Kind::Hybrid, 12));
/// let between = shipped.mix("chm_mint", "chm_orange", 0.3)?;
/// assert!(between.eval(Vec3::Z, Vec3::Z).min_element() >= 0.0);
///
/// // A library of one's own.
/// let plastic = Ggx::new(Microfacet { kd: [0.2; 3], eta: [1.5; 3], alpha: [0.1; 2] }).unwrap();
/// let entry = Entry { name: "plastic".to_owned(), material: plastic.into(), origin: Origin::default() };
/// let library = Library::new("plastic.safetensors", vec![entry])?;
/// let read = Library::from_bytes("plastic.safetensors", &library.to_bytes()?.unwrap())?;
/// assert_eq!(read.names(), ["plastic"]);
/// # Ok::<(), glimt_core::Error>(())
/// ```
#[derive(Clone)]
pub struct Library {
    path: PathBuf,
    kind: Kind,
    names: Vec<String>,
    digest: Option<String>,
    entries: Vec<OnceLock<Entry>>,
    /// What reads the others; `None` where there are none.
    file: Option<Arc<Decoder<Entry>>>,
}

impl fmt::Debug for Library {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Library { path, kind, names, .. } = self;
        f.debug_struct("Library").field("path", path).field("kind", kind).field("names", names).finish()
    }
}

impl Library {
    /// A library of materials that share model and architecture; `path` is where it will be
    /// written, and what messages name.
    ///
    /// # Errors
    /// [`Error::Format`] if there is no material, a name is empty or that of two, or models differ.
    pub fn new(path: impl Into<PathBuf>, entries: Vec<Entry>) -> Result<Self, Error> {
        let path = path.into();
        check(&entries).map_err(|reason| Error::Format { path: path.clone(), reason })?;
        Ok(Library {
            path,
            kind: entries[0].material.kind(),
            names: entries.iter().map(|entry| entry.name.clone()).collect(),
            digest: None,
            entries: entries.into_iter().map(OnceLock::from).collect(),
            file: None,
        })
    }

    /// Opens a library.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] with what was found and what was expected.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, Error> {
        let path = path.as_ref().to_path_buf();
        let open = || {
            let file = std::fs::File::open(&path)?;
            let size = file.metadata()?.len();
            if size > MAX_FILE_BYTES {
                let message = format!("it has {size} bytes; a model library has at most {MAX_FILE_BYTES}");
                return Err(std::io::Error::other(message));
            }
            Ok((file, size as usize))
        };
        let (file, size) = open().map_err(|source| Error::Read { path: path.clone(), source })?;
        Library::from_content(path, Content::File(Mutex::new(Box::new(file))), size)
    }

    /// Decodes the bytes of a library; `path` is what messages name.
    ///
    /// # Errors
    /// [`Error::Format`] with what was found and what was expected.
    pub fn from_bytes(path: impl Into<PathBuf>, bytes: &[u8]) -> Result<Self, Error> {
        let content = Content::Memory { first: 0, bytes: bytes.to_vec() };
        Library::from_content(path.into(), content, bytes.len())
    }

    fn from_content(path: PathBuf, content: Content, size: usize) -> Result<Self, Error> {
        let opened =
            OpenFile::new(content, size).map_err(|reason| Error::Format { path: path.clone(), reason })?;
        let OpenFile { kind, names, digest, decoder } = opened;
        let entries = names.iter().map(|_| OnceLock::new()).collect();
        let library = Library { path, kind, names, digest, entries, file: Some(Arc::new(decoder)) };
        if size <= SMALL {
            library.entries()?;
        }
        Ok(library)
    }

    /// Writes the library to its path: whole, or not at all.
    ///
    /// # Errors
    /// [`Error::Write`], for measured tables too: a library cannot hold them.
    pub fn save(&self) -> Result<(), Error> {
        let error = |source| Error::Write { path: self.path.clone(), source };
        let bytes = self.to_bytes()?.ok_or_else(|| {
            let reason = "a library cannot hold a measurement; fit a model to it with glimt fit";
            error(std::io::Error::other(reason))
        })?;
        write_whole(&self.path, &bytes).map_err(error)
    }

    /// The bytes that [`Library::from_bytes`] reads; `None` for measured tables, which a library cannot hold.
    ///
    /// # Errors
    /// As [`Library::entries`].
    pub fn to_bytes(&self) -> Result<Option<Vec<u8>>, Error> {
        let entries = self.entries()?;
        Ok(with_kind!(self.kind, Stored => Stored::STORED).then(|| encode(&entries, self.digest.clone())))
    }

    /// Where the library was read from or will be written.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What whoever made the library left in its header to recognise it by.
    #[must_use]
    pub fn digest(&self) -> Option<&str> {
        self.digest.as_deref()
    }

    /// The same library with this to recognise it by. A library of other materials, or of more, is a new one
    /// without it.
    #[must_use]
    pub fn with_digest(self, digest: Option<String>) -> Library {
        Library { digest, ..self }
    }

    /// The materials in the file's order, of which there is one at least.
    ///
    /// # Errors
    /// [`Error::Format`] with what is wrong with a material that had not been asked for before.
    pub fn entries(&self) -> Result<Vec<&Entry>, Error> {
        (0..self.entries.len()).map(|i| self.at(i)).collect()
    }

    /// The model.
    #[must_use]
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// What its materials have in common and no tensor's shape tells, as the header has it; `None` for models that
    /// have nothing of the kind.
    ///
    /// # Errors
    /// As [`Library::entries`].
    pub fn form(&self) -> Result<Option<Value>, Error> {
        self.first().map(|first| form(&first.material))
    }

    /// Names of the materials in the file's order.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        self.names.clone()
    }

    /// The first material.
    ///
    /// # Errors
    /// As [`Library::entries`].
    pub fn first(&self) -> Result<&Entry, Error> {
        self.at(0)
    }

    /// The material of a number, which the library has.
    fn at(&self, index: usize) -> Result<&Entry, Error> {
        if let Some(entry) = self.entries[index].get() {
            return Ok(entry);
        }
        let decode = self.file.as_ref().expect("what is not in memory is in a file");
        let entry = decode(index).map_err(|reason| {
            let reason = format!("material \"{}\": {reason}", self.names[index]);
            Error::Format { path: self.path.clone(), reason }
        })?;
        // Whoever was first is kept, so that all have the same network and sampler.
        Ok(self.entries[index].get_or_init(|| entry))
    }

    /// The entry of that name; the only one if `name` is `None` and the library holds one.
    ///
    /// # Errors
    /// [`Error::UnknownMaterial`] with the nearest names, [`Error::MaterialNotNamed`], and as
    /// [`Library::entries`].
    pub fn entry(&self, name: Option<&str>) -> Result<&Entry, Error> {
        let Some(name) = name else {
            return match self.names.len() {
                1 => self.at(0),
                _ => Err(Error::MaterialNotNamed { path: self.path.clone(), materials: self.names.clone() }),
            };
        };
        let index = self.names.iter().position(|known| known == name);
        self.at(index.ok_or_else(|| Error::UnknownMaterial {
            path: self.path.clone(),
            name: name.to_owned(),
            nearest: nearest(name, self.names.iter().map(String::as_str)),
            materials: self.names.clone(),
        })?)
    }

    /// The material of that name, as [`Library::entry`].
    ///
    /// # Errors
    /// As [`Library::entry`].
    pub fn material(&self, name: Option<&str>) -> Result<&Material, Error> {
        self.entry(name).map(|entry| &entry.material)
    }

    /// A material between the two of those names, with a share `t` in [0, 1] of the second.
    ///
    /// # Errors
    /// As [`Library::entry`], and [`Error::Mix`] for a model whose materials cannot be mixed or a share outside
    /// [0, 1].
    pub fn mix(&self, a: &str, b: &str, t: f32) -> Result<Material, Error> {
        let (first, second) = (self.material(Some(a))?, self.material(Some(b))?);
        let (path, names) = (self.path.clone(), (a.to_owned(), b.to_owned()));
        first.mix(second, t).map_err(|reason| Error::Mix { path, a: names.0, b: names.1, reason })
    }

    /// Bytes of the tensors that one material has of its own, and of those that all share.
    ///
    /// # Errors
    /// As [`Library::entries`].
    pub fn tensor_bytes(&self) -> Result<(usize, usize), Error> {
        let (mut own, mut shared) = (0, 0);
        for tensor in tensors(&self.entries()?) {
            if tensor.shared {
                shared += tensor.bytes.len();
            } else {
                own += tensor.bytes.len();
            }
        }
        Ok((own / self.names.len(), shared))
    }

    /// Bytes of every tensor, by its name.
    ///
    /// # Errors
    /// As [`Library::entries`].
    pub fn bytes_by_tensor(&self) -> Result<Vec<(String, usize)>, Error> {
        Ok(tensors(&self.entries()?).into_iter().map(|tensor| (tensor.name, tensor.bytes.len())).collect())
    }

    /// Whether one network serves all materials.
    ///
    /// # Errors
    /// As [`Library::entries`].
    pub fn shares_network(&self) -> Result<bool, Error> {
        let address = |entry: &Entry| entry.material.network().map(std::ptr::from_ref);
        let entries = self.entries()?;
        let first = address(entries[0]);
        Ok(self.kind != Kind::Nbrdf && first.is_some() && entries.iter().all(|entry| address(entry) == first))
    }
}

/// Whether these can be a library.
fn check(entries: &[Entry]) -> Result<(), String> {
    let first = &entries.first().ok_or("it holds no material")?.material;
    check_names(entries.iter().map(|entry| entry.name.as_str()))?;
    for entry in entries {
        if Architecture::of(&entry.material) != Architecture::of(first) {
            return Err(format!("\"{}\" and \"{}\" differ in model", entries[0].name, entry.name));
        }
        let together = with_model!(first.model(), first => first.check_together(model_of(&entry.material)));
        together.map_err(|e| format!("\"{}\" and \"{}\" {e}", entries[0].name, entry.name))?;
    }
    Ok(())
}

/// The bytes of a file of `entries`, whose model a library can hold.
fn encode(entries: &[&Entry], digest: Option<String>) -> Vec<u8> {
    let first = &entries[0].material;
    let header = Header {
        format: FORMAT_VERSION,
        kind: first.kind().name().to_owned(),
        color_space: COLOR_SPACE.to_owned(),
        form: form(first),
        activation: activation(first).map(|activation| activation.name().to_owned()),
        digest,
        materials: entries
            .iter()
            .map(|entry| MaterialHeader { name: entry.name.clone(), origin: entry.origin.clone() })
            .collect(),
    };
    let json = serde_json::to_string(&header).expect("strings and numbers always serialise");
    let tensors = tensors(entries);
    let views = tensors.iter().map(|tensor| {
        let view = TensorView::new(tensor.dtype, tensor.shape.clone(), &tensor.bytes);
        (tensor.name.clone(), view.expect("the shape is made from the data"))
    });
    let metadata = HashMap::from([("glimt".to_owned(), json)]);
    safetensors::serialize(views, Some(metadata)).expect("names and shapes are valid")
}

fn tensors(entries: &[&Entry]) -> Vec<Tensor> {
    fn encode<'a, M: Codec + 'a>(_: &M, entries: &[&'a Entry]) -> Vec<Tensor>
    where
        &'a M: TryFrom<&'a Material>,
    {
        M::encode(&entries.iter().map(|entry| model_of(&entry.material)).collect::<Vec<_>>())
    }
    with_model!(entries[0].material.model(), first => encode(first, entries))
}

/// The model in a material of a library, all of whose materials are of that model.
fn model_of<'a, M: 'a>(material: &'a Material) -> &'a M
where
    &'a M: TryFrom<&'a Material>,
{
    material.try_into().unwrap_or_else(|_| unreachable!("a library's materials are of one model"))
}

fn form(material: &Material) -> Option<Value> {
    with_model!(material.model(), model => Codec::form(model))
}

fn activation(material: &Material) -> Option<Activation> {
    material.network().map(Network::activation)
}

/// What the materials of one library have in common.
#[derive(PartialEq)]
struct Architecture {
    kind: Kind,
    form: Option<Value>,
    /// Outputs and inputs of each layer.
    sizes: Vec<(usize, usize)>,
    activation: Option<Activation>,
}

impl Architecture {
    fn of(material: &Material) -> Architecture {
        let layers = material.network().map_or(&[][..], Network::layers);
        let sizes = layers.iter().map(|layer| (layer.outputs(), layer.inputs())).collect();
        Architecture { kind: material.kind(), form: form(material), sizes, activation: activation(material) }
    }
}

#[cfg(test)]
mod tests;

//! The model library: one `.safetensors` file with the materials of one model.
//!
//! The metadata of the container holds one JSON object under `glimt` ([`Header`]): format version,
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
//!
//! What a spherical library holds says [`spherical`].

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock};

use glimt_disk::write_whole;
use safetensors::tensor::TensorView;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use serde_json::value::RawValue;

use crate::error::Error;
use crate::kernels::network::{Activation, Network};
use crate::material::{Kind, Material, with_kind, with_model};

use codec::{Codec, Decoder};
use container::{Content, Tensor, Tensors, read_header};

mod codec;
mod container;
mod factor;
mod names;
mod spherical;

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
    /// SHA-256 of that file, in hexadecimal.
    pub sha256: String,
    /// The command that made it.
    pub command: String,
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

/// The JSON object in the file's metadata.
#[derive(Serialize, Deserialize)]
struct Header<M> {
    format: u32,
    kind: String,
    color_space: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    form: Option<Value>,
    /// The activation of the networks, where the model has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    activation: Option<String>,
    /// [`Library::digest`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    digest: Option<String>,
    materials: Vec<M>,
}

#[derive(Serialize, Deserialize)]
struct MaterialHeader {
    name: String,
    #[serde(flatten)]
    origin: Origin,
}

/// What is read of a [`MaterialHeader`] until the material is asked for.
#[derive(Deserialize)]
struct Named<'a> {
    #[serde(borrow)]
    name: Cow<'a, str>,
}

/// The name of what [`Library::mix`] makes.
#[must_use]
pub fn mix_name(a: &str, b: &str, t: f32) -> String {
    format!("{a} + {t} {b}")
}

const COLOR_SPACE: &str = "linear sRGB";

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

/// Bytes up to which a file is read and checked at once.
const SMALL_BYTES: usize = 1 << 16;

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
        if size <= SMALL_BYTES {
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

fn check_names<'a>(names: impl Iterator<Item = &'a str>) -> Result<(), String> {
    let mut known = HashSet::new();
    for name in names {
        if name.is_empty() {
            return Err("a material's name is empty".into());
        }
        if !known.insert(name) {
            return Err(format!("two materials are named \"{name}\""));
        }
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

/// A file whose header has been read.
struct OpenFile {
    kind: Kind,
    names: Vec<String>,
    digest: Option<String>,
    decoder: Decoder<Entry>,
}

impl OpenFile {
    fn new(content: Content, size: usize) -> Result<OpenFile, String> {
        let (metadata, start) = read_header(&content, size)?;
        let content = content.at_hand(start, size)?;
        let json = metadata.metadata().as_ref().and_then(|entries| entries.get("glimt"));
        let (header, names) =
            header(json.ok_or("its metadata has no entry \"glimt\"; it is some other safetensors file")?)?;
        let kind: Kind = header
            .kind
            .parse()
            .map_err(|_| format!("its model is \"{}\", expected {}", header.kind, names_of_stored_kinds()))?;
        let activation = header.activation.as_deref().map(activation_named).transpose()?;
        let tensors = Tensors::new(content, (metadata, start), header.materials.len(), activation);
        let material = with_kind!(kind, Decoded => decoder::<Decoded>(&tensors, header.form.as_ref()))?;
        let (digest, materials) = (header.digest, header.materials);
        let decoder = move |i: usize| {
            let MaterialHeader { name, origin } = from_json(materials[i].get())?;
            Ok(Entry { name, material: material(i)?, origin })
        };
        Ok(OpenFile { kind, names, digest, decoder: Box::new(decoder) })
    }
}

fn decoder<M: Codec + 'static>(tensors: &Tensors, form: Option<&Value>) -> Result<Decoder<Material>, String>
where
    Material: From<M>,
{
    let decode = M::decoder(tensors, form)?;
    Ok(Box::new(move |i| decode(i).map(Material::from)))
}

/// The JSON object in a file's metadata, checked, and the names of its materials.
fn header(json: &str) -> Result<(Header<Box<RawValue>>, Vec<String>), String> {
    let header: Header<Box<RawValue>> = from_json(json).or_else(|broken| {
        // A later version may be another object altogether.
        let version: FormatVersion = from_json(json)?;
        Err(if version.format == FORMAT_VERSION { broken } else { other_version(version.format) })
    })?;
    if header.format != FORMAT_VERSION {
        return Err(other_version(header.format));
    }
    if header.color_space != COLOR_SPACE {
        return Err(format!("its colour space is \"{}\", expected \"{COLOR_SPACE}\"", header.color_space));
    }
    if header.materials.is_empty() {
        return Err("it holds no material".into());
    }
    let mut names = Vec::with_capacity(header.materials.len());
    for material in &header.materials {
        names.push(from_json::<Named>(material.get())?.name.into_owned());
    }
    check_names(names.iter().map(String::as_str))?;
    Ok((header, names))
}

fn from_json<'a, T: Deserialize<'a>>(json: &'a str) -> Result<T, String> {
    serde_json::from_str(json).map_err(|e| format!("its \"glimt\" metadata is broken: {e}"))
}

fn other_version(found: u32) -> String {
    format!("it has format version {found}, expected {FORMAT_VERSION}")
}

fn activation_named(name: &str) -> Result<Activation, String> {
    let expected = || Activation::ALL.map(Activation::name).join(" or ");
    Activation::named(name).ok_or_else(|| format!("its activation is \"{name}\", expected {}", expected()))
}

/// The part of the header that is read first: a later version may change the rest.
#[derive(Deserialize)]
struct FormatVersion {
    format: u32,
}

/// The models that a library can hold, for messages.
fn names_of_stored_kinds() -> String {
    let is_stored = |&kind: &Kind| with_kind!(kind, Stored => Stored::STORED);
    let names: Vec<&str> = Kind::ALL.into_iter().filter(is_stored).map(Kind::name).collect();
    let (last, others) = names.split_last().expect("there are models");
    format!("{} or {last}", others.join(", "))
}

#[cfg(test)]
mod tests {
    use super::codec::tests::PARAMETERS;
    use super::*;
    use crate::brdf::Brdf;
    use crate::directions::features::Inputs;
    use crate::kernels::network::tests::patterned;
    use crate::microfacet::Microfacet;
    use crate::models::hybrid::{Form, Hybrid};
    use glam::Vec3;
    use proptest::prelude::*;
    use std::io::{Read, Seek, SeekFrom};
    use std::sync::LazyLock;
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn entry(name: &str, material: Material) -> Entry {
        let origin = Origin { source: format!("{name}.bsdf"), seed: Some(7), ..Origin::default() };
        Entry { name: name.to_owned(), material, origin }
    }

    fn hybrid(network: &Arc<Network>, alpha: [f32; 2], z: f32) -> Material {
        codec::tests::hybrid(network, alpha, z).into()
    }

    fn two(a: Material, b: Material) -> Vec<Entry> {
        vec![entry("a", a), entry("b", b)]
    }

    /// Libraries of two materials of a model, as many as there are ways to lie in a file; their networks, where they
    /// have one, with this activation.
    fn libraries_of(kind: Kind, activation: Activation) -> Vec<Vec<Entry>> {
        fn libraries<M: Codec + Into<Material>>(activation: Activation) -> Vec<Vec<Entry>> {
            M::specimens(activation).into_iter().map(|[a, b]| two(a.into(), b.into())).collect()
        }
        with_kind!(kind, Stored => libraries::<Stored>(activation))
    }

    /// Libraries of every model.
    fn libraries() -> Vec<Vec<Entry>> {
        Kind::ALL.into_iter().flat_map(|kind| libraries_of(kind, Activation::HardGelu)).collect()
    }

    /// The first library of a model.
    fn library_of(kind: Kind) -> Vec<Entry> {
        libraries_of(kind, Activation::HardGelu).remove(0)
    }

    /// What the file at `path` has for `entries`, which are saved there first.
    fn saved_and_read(path: &Path, entries: Vec<Entry>) -> [Library; 2] {
        let saved = Library::new(path, entries).unwrap();
        saved.save().unwrap();
        [saved, Library::open(path).unwrap()]
    }

    /// f of some pairs.
    fn values(material: &Material) -> Vec<Vec3> {
        let sides =
            [Vec3::new(0.48, 0.36, 0.8), Vec3::new(-0.6, 0.0, 0.8), Vec3::new(0.0, 0.8, 0.6), Vec3::Z];
        sides.iter().flat_map(|&light| sides.map(|view| material.eval(light, view))).collect()
    }

    #[test]
    fn every_activation_of_every_network_comes_back_as_it_was_saved() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("library.safetensors");
        let has_network = |kind: &Kind| {
            let mut libraries = libraries_of(*kind, Activation::Relu).into_iter();
            libraries.any(|entries| entries[0].material.network().is_some())
        };
        let with_network: Vec<Kind> = Kind::ALL.into_iter().filter(has_network).collect();
        assert!(with_network.len() >= 4, "{with_network:?}");
        for kind in with_network {
            let mut of_activation = Vec::new();
            for activation in Activation::ALL {
                for entries in libraries_of(kind, activation) {
                    let [saved, read] = saved_and_read(&path, entries);
                    for (a, b) in saved.entries().unwrap().iter().zip(read.entries().unwrap()) {
                        assert_eq!(b.material.network().unwrap().activation(), activation, "{kind}");
                        assert_eq!(values(&a.material), values(&b.material), "{kind}, {activation:?}");
                    }
                    of_activation.push(values(&read.entries().unwrap()[0].material));
                }
            }
            // The test of the test: the activation matters.
            let distinct = of_activation.iter().enumerate().all(|(i, f)| !of_activation[..i].contains(f));
            assert!(distinct, "{kind}");
        }
    }

    #[test]
    fn files_that_do_not_say_their_activation_have_the_one_that_their_model_had() {
        for (kind, expected) in [
            (Kind::Hybrid, Activation::HardGelu),
            (Kind::Neural, Activation::HardGelu),
            (Kind::Spherical, Activation::HardGelu),
            (Kind::Nbrdf, Activation::Relu),
        ] {
            let library = Library::new("", libraries_of(kind, expected).remove(0)).unwrap();
            let said = format!("\\\"activation\\\":\\\"{}\\\",", expected.name());
            let read =
                Library::from_bytes("", &replaced(&library.to_bytes().unwrap().unwrap(), &said, "")).unwrap();
            for (a, b) in library.entries().unwrap().iter().zip(read.entries().unwrap()) {
                assert_eq!(b.material.network().unwrap().activation(), expected, "{kind}");
                assert_eq!(values(&a.material), values(&b.material), "{kind}");
            }
        }
    }

    #[test]
    fn networks_of_two_activations_do_not_make_a_library() {
        for kind in [Kind::Hybrid, Kind::Nbrdf] {
            let [a, mut b] =
                Activation::ALL.map(|activation| libraries_of(kind, activation).remove(0).remove(0));
            b.name = "b".to_owned();
            let message = Library::new("merged", vec![a, b]).unwrap_err().to_string();
            assert!(message.contains("differ in model"), "{message}");
        }
    }

    /// A library's bytes with other metadata; the length of the header, in front, follows.
    fn replaced(bytes: &[u8], from: &str, to: &str) -> Vec<u8> {
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes());
        let at = at.unwrap_or_else(|| panic!("{from} is not in the file"));
        let mut changed = bytes.to_vec();
        changed.splice(at..at + from.len(), to.bytes());
        let (length, _) = changed.split_first_chunk_mut().unwrap();
        let grown = u64::from_le_bytes(*length) + to.len() as u64 - from.len() as u64;
        *length = grown.to_le_bytes();
        changed
    }

    #[test]
    fn every_model_comes_back_as_it_was_saved() {
        let folder = tempfile::tempdir().unwrap();
        for (i, entries) in libraries().into_iter().enumerate() {
            let [saved, read] = saved_and_read(&folder.path().join(format!("{i}.safetensors")), entries);
            assert_eq!(read.names(), ["a", "b"]);
            assert_eq!(read.tensor_bytes().unwrap(), saved.tensor_bytes().unwrap());
            for (a, b) in saved.entries().unwrap().iter().zip(read.entries().unwrap()) {
                assert_eq!(a.origin, b.origin);
                assert_eq!(values(&a.material), values(&b.material));
                assert_eq!(a.material.sampler().lobes(), b.material.sampler().lobes());
            }
        }
    }

    #[test]
    fn edits_and_mixes_come_back_as_they_were_saved() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("edits.safetensors");
        let pairs = [Vec3::new(0.48, 0.36, 0.8), Vec3::new(-0.6, 0.0, 0.8), Vec3::new(0.0, 0.96, 0.28)];
        for entries in libraries().into_iter().filter(|entries| !entries[0].material.latent().is_empty()) {
            let (a, b) = (&entries[0].material, &entries[1].material);
            let latent: Vec<f32> = a.latent().iter().map(|z| 0.3 - z).collect();
            let mut changed = vec![entry("a", a.clone()), entry("code", a.with_latent(latent).unwrap())];
            if let Some(&p) = a.microfacet() {
                let alpha = p.alpha.map(|alpha| alpha * 1.5);
                changed.push(entry("edit", a.with_microfacet(Microfacet { alpha, ..p }).unwrap()));
            }
            if let Ok(mix) = a.mix(b, 0.25) {
                changed.push(entry("mix", mix));
            }
            let saved = Library::new(&path, changed).unwrap();
            saved.save().unwrap();
            for (saved, read) in
                saved.entries().unwrap().iter().zip(Library::open(&path).unwrap().entries().unwrap())
            {
                for (light, view) in pairs.into_iter().flat_map(|l| pairs.map(|v| (l, v))) {
                    assert_eq!(
                        saved.material.eval(light, view),
                        read.material.eval(light, view),
                        "{}",
                        saved.name
                    );
                }
            }
        }
    }

    #[test]
    fn only_materials_with_something_in_common_mix() {
        let mut all = libraries();
        let networks = Library::new("own.safetensors", all.remove(2)).unwrap();
        let message = networks.mix("a", "b", 0.5).unwrap_err().to_string();
        assert!(
            message.contains("own.safetensors") && message.contains("\"a\" and \"b\" have no network"),
            "{message}"
        );
        let shared = Library::new("", all.remove(1)).unwrap();
        assert!(shared.mix("a", "b", 1.5).unwrap_err().to_string().contains("weight of 1.5"));
        assert!(shared.mix("a", "b", f32::NAN).is_err());
        assert!(shared.mix("a", "c", 0.5).unwrap_err().to_string().contains("\"c\""));
        let ggx = Library::new("", all.remove(0)).unwrap();
        assert!(ggx.mix("a", "b", 0.5).is_ok());
        let nbrdf = Library::new("", libraries().remove(4)).unwrap();
        assert!(nbrdf.mix("a", "b", 0.5).unwrap_err().to_string().contains("a nbrdf material has no"));
    }

    #[test]
    fn neural_materials_of_two_networks_do_not_make_a_library() {
        let [mut entries, other] = [Kind::Neural; 2].map(library_of);
        let mut stranger = other.into_iter().next().unwrap();
        stranger.name = "c".to_owned();
        entries.push(stranger);
        let message = Library::new("merged", entries).unwrap_err().to_string();
        assert!(message.contains("different networks"), "{message}");
    }

    /// Whoever recognises a file by a digest of its bytes relies on that.
    #[test]
    fn a_library_that_is_read_has_the_bytes_and_the_digest_that_were_written() {
        for entries in libraries() {
            let kind = entries[0].material.kind();
            let Some(bytes) =
                Library::new("", entries).unwrap().with_digest(Some("a digest".into())).to_bytes().unwrap()
            else {
                continue;
            };
            let read = Library::from_bytes("", &bytes).unwrap();
            assert_eq!(read.digest(), Some("a digest"), "{kind}");
            assert!(read.to_bytes().unwrap().unwrap() == bytes, "{kind}");
            let merged = Library::new("", read.entries().unwrap().into_iter().cloned().collect()).unwrap();
            assert_eq!(merged.digest(), None, "{kind}");
        }
    }

    #[test]
    fn twelve_numbers_a_material() {
        let library = Library::new("", library_of(Kind::Hybrid)).unwrap();
        // k_d 3, η 3, α 1, z 4, bound 1; the network 10-16-16-6 with its biases.
        assert_eq!(library.tensor_bytes().unwrap(), (4 * 12, 4 * (11 * 16 + 17 * 16 + 17 * 6)));
    }

    #[test]
    fn unknown_names_are_answered_with_near_ones() {
        let network = Arc::new(patterned(&[10, 16, 6], 6, Activation::HardGelu));
        let names = ["chm_orange", "chm_mint", "vch_golden_yellow"];
        let entries = names.iter().map(|name| entry(name, hybrid(&network, [0.2; 2], 0.1))).collect();
        let library = Library::new("lib.safetensors", entries).unwrap();
        let message = |name: Option<&str>| library.material(name).unwrap_err().to_string();
        assert!(
            message(Some("chm_ornage")).ends_with("did you mean chm_orange?"),
            "{}",
            message(Some("chm_ornage"))
        );
        assert!(message(Some("orange")).contains("chm_orange"));
        assert!(message(Some("zzzzzzzzzz")).contains("it holds chm_orange, chm_mint, vch_golden_yellow"));
        assert!(message(None).contains("3 materials"));
        assert!(library.material(Some("chm_mint")).is_ok());
    }

    #[test]
    fn what_is_no_library_is_refused_with_its_name_and_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("broken.safetensors");
        let refused = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            let message = Library::open(&path).unwrap_err().to_string();
            assert!(message.contains("broken.safetensors"), "{message}");
            message
        };
        let good = Library::new(&path, library_of(Kind::Hybrid)).unwrap().to_bytes().unwrap().unwrap();
        let replaced = |from: &str, to: &str| replaced(&good, from, to);
        assert!(refused(b"MZ").contains("broken"));
        assert!(refused(&good[..good.len() - 5]).contains("broken"));
        assert!(refused(&replaced("\"glimt\"", "\"other\"")).contains("some other safetensors file"));
        assert!(refused(&replaced("\\\"format\\\":1", "\\\"format\\\":9")).contains("version 9, expected 1"));
        assert!(
            refused(&replaced("hybrid", "hybrod")).contains("its model is \"hybrod\", expected ggx, hybrid,")
        );
        assert!(
            refused(&replaced("hardgelu", "softplus"))
                .contains("its activation is \"softplus\", expected hardgelu or relu")
        );
        assert!(
            refused(&replaced("{\\\"name\\\":\\\"a\\\"", "{\\\"nome\\\":\\\"a\\\""))
                .contains("metadata is broken")
        );
        assert!(refused(&replaced("bound", "sound")).contains("\"bound\" is missing"));
        assert!(refused(&replaced("latent", "lament")).contains("0 numbers, expected 4"));
        let mut bytes = good.clone();
        let end = bytes.len();
        bytes[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(refused(&bytes).contains("NaN"));
        assert!(Library::open(folder.path().join("none")).unwrap_err().to_string().contains("cannot read"));
    }

    /// Counts the bytes that are read from memory.
    struct Counted(std::io::Cursor<Vec<u8>>, Arc<AtomicUsize>);

    impl Read for Counted {
        fn read(&mut self, to: &mut [u8]) -> std::io::Result<usize> {
            let read = self.0.read(to)?;
            self.1.fetch_add(read, Ordering::Relaxed);
            Ok(read)
        }
    }

    impl Seek for Counted {
        fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
            self.0.seek(to)
        }
    }

    #[test]
    fn of_a_thousand_materials_those_are_read_that_are_asked_for() {
        let network = Arc::new(patterned(&[14, 32, 32, 32, 6], 6, Activation::HardGelu));
        let form = Form { inputs: Inputs::Isotropic, ..Form::PAPER };
        let material = |i: usize| {
            let latent = (0..8).map(|k| ((i * 8 + k) as f32).sin()).collect();
            entry(&i.to_string(), Hybrid::new(form, network.clone(), PARAMETERS, latent, 1.5).unwrap().into())
        };
        let whole = Library::new("", (0..1000).map(material).collect()).unwrap();
        let bytes = whole.to_bytes().unwrap().unwrap();
        let (header, size) = (u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize + 8, bytes.len());
        let read = Arc::new(AtomicUsize::new(0));
        let stream = Counted(std::io::Cursor::new(bytes), read.clone());
        let content = Content::File(Mutex::new(Box::new(stream)));
        let library = Library::from_content("".into(), content, size).unwrap();
        let [a, b] = ["17", "900"].map(|name| library.material(Some(name)).unwrap());
        let beyond = read.load(Ordering::Relaxed) - header;
        assert!(beyond < 1 << 16, "{beyond} bytes beyond the header");
        assert!(std::ptr::eq(a.network().unwrap(), b.network().unwrap()));
        assert!(std::ptr::eq(a, library.material(Some("17")).unwrap()));
        assert_eq!(library.entries.iter().filter(|entry| entry.get().is_some()).count(), 2);
        for (read, saved) in library.entries().unwrap().iter().zip(whole.entries().unwrap()) {
            assert_eq!(values(&read.material), values(&saved.material));
        }
    }

    #[test]
    fn what_is_wrong_with_a_material_of_a_large_file_is_said_when_it_is_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("large.safetensors");
        let network = Arc::new(patterned(&[10, 16, 16, 6], 6, Activation::HardGelu));
        let entries = (0..2000).map(|i| entry(&i.to_string(), hybrid(&network, [0.2; 2], 0.1))).collect();
        let mut bytes = Library::new(&path, entries).unwrap().to_bytes().unwrap().unwrap();
        // Tensors follow in the order of their names: the last number is of the last layer's weights, and those before
        // the networks' are the codes.
        let codes = 2000 * 4 * 4;
        let networks: usize = network.layers().iter().map(|l| 4 * (l.weight.len() + l.bias.len())).sum();
        let last_code = bytes.len() - networks - 4;
        assert!(codes < last_code);
        bytes[last_code..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
        std::fs::write(&path, bytes).unwrap();
        let library = Library::open(&path).unwrap();
        assert!(library.material(Some("0")).is_ok());
        let message = library.material(Some("1999")).unwrap_err().to_string();
        let parts = ["large.safetensors", "material \"1999\"", "\"latent\" holds NaN"];
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        assert!(library.entries().is_err() && library.to_bytes().is_err());
    }

    #[test]
    fn a_path_that_cannot_be_written_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("missing").join("lib.safetensors");
        let message = Library::new(&path, library_of(Kind::Ggx)).unwrap().save().unwrap_err().to_string();
        assert!(message.contains("cannot write"), "{message}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    proptest! {
        #[test]
        fn mutated_files_never_panic(at in 0..4000usize, byte in any::<u8>(), cut in 0..4000usize) {
            static ENCODED: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
                libraries().into_iter().map(|entries| Library::new("", entries).unwrap().to_bytes().unwrap().unwrap()).collect()
            });
            for bytes in &*ENCODED {
                let mut bytes = bytes.clone();
                let at = at % bytes.len();
                bytes[at] = byte;
                let _ = Library::from_bytes("", &bytes).and_then(|library| library.to_bytes());
                bytes.truncate(cut % bytes.len());
                prop_assert!(Library::from_bytes("", &bytes).is_err());
            }
        }
    }
}

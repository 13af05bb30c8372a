//! The model library: one `.safetensors` file with the materials of one model.
//!
//! The metadata of the container holds one JSON object under `glimt` ([`Header`]): format version,
//! model, names, and where each material came from. Tensors are little-endian float32:
//!
//! | tensor | shape | models |
//! |---|---|---|
//! | `kd`, `eta` | (materials, 3) | ggx, hybrid |
//! | `alpha` | (materials, 1) if all are isotropic, else (materials, 2) | ggx, hybrid |
//! | `latent` | (materials, l) | hybrid, neural |
//! | `bound` | (materials) | hybrid, neural |
//! | `network.i.weight`, `network.i.bias` | (out, in), (out); with a leading axis of materials where each has a network of its own | hybrid, neural, nbrdf |
//! | `frames.weight`, `frames.bias` | (18, l), (18) | neural |
//! | `diffuse`, `specular` | (materials, 3) | factor, but for bivariate |
//! | `ndf`, `fresnel` | (materials, 3, 90) | factor, but for bivariate |
//! | `masking` | (materials, 3, 90) | factor, independent-g |
//! | `azimuth` | (materials, 3, 180) | factor, naive |
//! | `bivariate` | (materials, 90, 90, 3) | factor, bivariate |
//! | `diffuse`, `specular` | (materials, 3), (materials, parameters of the lobe) | analytic |
//!
//! What a spherical library holds says [`spherical`].

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use safetensors::tensor::{SafeTensors, TensorView};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::analytic::Analytic;
use crate::error::Error;
use crate::factor::Factor;
use crate::ggx::Ggx;
use crate::hybrid::Hybrid;
use crate::material::{Material, with_model};
use crate::model::Model;
use crate::nbrdf::Nbrdf;
use crate::network::Network;
use crate::neural::Neural;
use crate::spherical::Spherical;

use codec::Codec;
use container::{Tensor, Tensors};

mod codec;
mod container;
mod factor;
mod names;
mod spherical;
mod write;

pub use names::nearest;
pub use write::write_whole;

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
struct Header {
    format: u32,
    kind: String,
    color_space: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    form: Option<Value>,
    materials: Vec<MaterialHeader>,
}

#[derive(Serialize, Deserialize)]
struct MaterialHeader {
    name: String,
    #[serde(flatten)]
    origin: Origin,
}

const COLOR_SPACE: &str = "linear sRGB";

/// Materials of one model.
#[derive(Clone, Debug)]
pub struct Library {
    path: PathBuf,
    entries: Vec<Entry>,
}

impl Library {
    /// A library of materials that share model and architecture; `path` is where it will be
    /// written, and what messages name.
    ///
    /// # Errors
    /// [`Error::Format`] if there is no material, two have one name, or models differ.
    pub fn new(path: impl Into<PathBuf>, entries: Vec<Entry>) -> Result<Self, Error> {
        let library = Library { path: path.into(), entries };
        library.check().map_err(|reason| Error::Format { path: library.path.clone(), reason })?;
        Ok(library)
    }

    fn check(&self) -> Result<(), String> {
        let first = &self.entries.first().ok_or("it holds no material")?.material;
        let mut names = HashSet::new();
        for entry in &self.entries {
            if !names.insert(entry.name.as_str()) {
                return Err(format!("two materials are named \"{}\"", entry.name));
            }
            if architecture(&entry.material) != architecture(first) {
                return Err(format!("\"{}\" and \"{}\" differ in model", self.entries[0].name, entry.name));
            }
            let together =
                with_model!(first.model(), first => first.check_together(model_of(&entry.material)));
            together.map_err(|e| format!("\"{}\" and \"{}\" {e}", self.entries[0].name, entry.name))?;
        }
        Ok(())
    }

    /// Reads a library.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] with what was found and what was expected.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, Error> {
        let path = path.as_ref().to_path_buf();
        let read = || {
            let size = std::fs::metadata(&path)?.len();
            if size > MAX_FILE_BYTES {
                let message = format!("it has {size} bytes; a model library has at most {MAX_FILE_BYTES}");
                return Err(std::io::Error::other(message));
            }
            std::fs::read(&path)
        };
        let bytes = read().map_err(|source| Error::Read { path: path.clone(), source })?;
        Library::from_bytes(path, &bytes)
    }

    /// Decodes the bytes of a library; `path` is what messages name.
    ///
    /// # Errors
    /// [`Error::Format`] with what was found and what was expected.
    pub fn from_bytes(path: impl Into<PathBuf>, bytes: &[u8]) -> Result<Self, Error> {
        let path = path.into();
        let entries = decode(bytes).map_err(|reason| Error::Format { path: path.clone(), reason })?;
        Library::new(path, entries)
    }

    /// Writes the library to its path: whole, or not at all.
    ///
    /// # Errors
    /// [`Error::Write`], for measured tables too: a library cannot hold them.
    pub fn save(&self) -> Result<(), Error> {
        let error = |source| Error::Write { path: self.path.clone(), source };
        if self.tensors().is_empty() {
            let reason = "a library cannot hold a measurement; fit a model to it with glimt fit";
            return Err(error(std::io::Error::other(reason)));
        }
        write_whole(&self.path, &self.encode()).map_err(error)
    }

    /// Where the library was read from or will be written.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The materials in the file's order.
    #[must_use]
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// The model's name.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        self.entries[0].material.kind()
    }

    /// Names of the materials in the file's order.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        self.entries.iter().map(|entry| entry.name.clone()).collect()
    }

    /// The entry of that name; the only one if `name` is `None` and the library holds one.
    ///
    /// # Errors
    /// [`Error::UnknownMaterial`] with the nearest names, [`Error::MaterialNotNamed`].
    pub fn entry(&self, name: Option<&str>) -> Result<&Entry, Error> {
        let Some(name) = name else {
            return match &self.entries[..] {
                [only] => Ok(only),
                _ => Err(Error::MaterialNotNamed { path: self.path.clone(), materials: self.names() }),
            };
        };
        self.entries.iter().find(|entry| entry.name == name).ok_or_else(|| Error::UnknownMaterial {
            path: self.path.clone(),
            name: name.to_owned(),
            nearest: nearest(name, self.entries.iter().map(|entry| entry.name.as_str())),
            materials: self.names(),
        })
    }

    /// The material of that name, as [`Library::entry`].
    ///
    /// # Errors
    /// As [`Library::entry`].
    pub fn material(&self, name: Option<&str>) -> Result<&Material, Error> {
        self.entry(name).map(|entry| &entry.material)
    }

    /// Bytes of the tensors that one material has of its own, and of those that all share.
    #[must_use]
    pub fn tensor_bytes(&self) -> (usize, usize) {
        let (mut own, mut shared) = (0, 0);
        for tensor in self.tensors() {
            if tensor.shared {
                shared += tensor.bytes.len();
            } else {
                own += tensor.bytes.len();
            }
        }
        (own / self.entries.len(), shared)
    }

    /// Whether one network serves all materials.
    #[must_use]
    pub fn shares_network(&self) -> bool {
        let address = |entry: &Entry| entry.material.network().map(std::ptr::from_ref);
        let first = address(&self.entries[0]);
        self.kind() != "nbrdf" && first.is_some() && self.entries.iter().all(|entry| address(entry) == first)
    }

    /// The file's bytes.
    fn encode(&self) -> Vec<u8> {
        let header = Header {
            format: FORMAT_VERSION,
            kind: self.kind().to_owned(),
            color_space: COLOR_SPACE.to_owned(),
            form: form(&self.entries[0].material),
            materials: self
                .entries
                .iter()
                .map(|entry| MaterialHeader { name: entry.name.clone(), origin: entry.origin.clone() })
                .collect(),
        };
        let json = serde_json::to_string(&header).expect("strings and numbers always serialise");
        let tensors = self.tensors();
        let views = tensors.iter().map(|tensor| {
            let view = TensorView::new(tensor.dtype, tensor.shape.clone(), &tensor.bytes);
            (tensor.name.clone(), view.expect("the shape is made from the data"))
        });
        let metadata = HashMap::from([("glimt".to_owned(), json)]);
        safetensors::serialize(views, Some(metadata)).expect("names and shapes are valid")
    }

    fn tensors(&self) -> Vec<Tensor> {
        fn encode<'a, M: Codec + 'a>(_: &M, entries: &'a [Entry]) -> Vec<Tensor>
        where
            &'a M: TryFrom<&'a Material>,
        {
            M::encode(&entries.iter().map(|entry| model_of(&entry.material)).collect::<Vec<_>>())
        }
        with_model!(self.entries[0].material.model(), first => encode(first, &self.entries))
    }
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

/// Model and sizes: what the materials of one library have in common.
fn architecture(material: &Material) -> (&'static str, Option<Value>, Vec<(usize, usize)>) {
    let layers = material.network().map_or(&[][..], Network::layers);
    let sizes = layers.iter().map(|layer| (layer.outputs(), layer.inputs())).collect();
    (material.kind(), form(material), sizes)
}

fn decode(bytes: &[u8]) -> Result<Vec<Entry>, String> {
    let container = |e: safetensors::SafeTensorError| {
        format!("as a safetensors file of {} bytes it is broken or cut off: {e}", bytes.len())
    };
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(container)?;
    let json = metadata
        .metadata()
        .as_ref()
        .and_then(|m| m.get("glimt"))
        .ok_or("its metadata has no entry \"glimt\"; it is some other safetensors file")?;
    let version: FormatVersion =
        serde_json::from_str(json).map_err(|e| format!("its \"glimt\" metadata is broken: {e}"))?;
    if version.format != FORMAT_VERSION {
        return Err(format!("it has format version {}, expected {FORMAT_VERSION}", version.format));
    }
    let header: Header =
        serde_json::from_str(json).map_err(|e| format!("its \"glimt\" metadata is broken: {e}"))?;
    if header.color_space != COLOR_SPACE {
        return Err(format!("its colour space is \"{}\", expected \"{COLOR_SPACE}\"", header.color_space));
    }
    if header.materials.is_empty() {
        return Err("it holds no material".into());
    }
    let file = SafeTensors::deserialize(bytes).map_err(container)?;
    let names = header.materials.iter().map(|material| material.name.as_str()).collect();
    let materials = decode_materials(&header, &Tensors { file, names })?;
    Ok(header
        .materials
        .into_iter()
        .zip(materials)
        .map(|(MaterialHeader { name, origin }, material)| Entry { name, material, origin })
        .collect())
}

/// The part of the header that is read first: a later version may change the rest.
#[derive(Deserialize)]
struct FormatVersion {
    format: u32,
}

fn decode_materials(header: &Header, file: &Tensors) -> Result<Vec<Material>, String> {
    fn decode<M: Codec>(header: &Header, file: &Tensors) -> Result<Vec<Material>, String>
    where
        Material: From<M>,
    {
        Ok(M::decode(file, header.form.as_ref())?.into_iter().map(Material::from).collect())
    }
    match header.kind.as_str() {
        Ggx::KIND => decode::<Ggx>(header, file),
        Hybrid::KIND => decode::<Hybrid>(header, file),
        Neural::KIND => decode::<Neural>(header, file),
        Nbrdf::KIND => decode::<Nbrdf>(header, file),
        Factor::KIND => decode::<Factor>(header, file),
        Analytic::KIND => decode::<Analytic>(header, file),
        Spherical::KIND => decode::<Spherical>(header, file),
        other => Err(format!(
            "its model is \"{other}\", expected ggx, hybrid, neural, nbrdf, factor, analytic or spherical"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analytic::tests::specimens;
    use crate::brdf::Brdf;
    use crate::factor::{Factors, Interpolation, tests::patterned_factors};
    use crate::features::Inputs;
    use crate::hybrid::Form;
    use crate::microfacet::Microfacet;
    use crate::network::tests::{patterned, patterned_from};
    use crate::network::{Activation, Layer};
    use crate::neural::{self, Shared};
    use glam::Vec3;
    use proptest::prelude::*;
    use std::sync::{Arc, LazyLock};

    const PARAMETERS: Microfacet = Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.5, 1.8, 2.5], alpha: [0.2; 2] };

    fn entry(name: &str, material: Material) -> Entry {
        let origin = Origin { source: format!("{name}.bsdf"), seed: Some(7), ..Origin::default() };
        Entry { name: name.to_owned(), material, origin }
    }

    fn hybrid(network: &Arc<Network>, alpha: [f32; 2], z: f32) -> Material {
        let form = Form { inputs: Inputs::Isotropic, ..Form::PAPER };
        let microfacet = Microfacet { alpha, ..PARAMETERS };
        Material::from(Hybrid::new(form, network.clone(), microfacet, vec![z; 4], 1.5).unwrap())
    }

    /// Two materials of every model, and of the hybrid with one network each.
    fn libraries() -> Vec<Vec<Entry>> {
        let network = || Arc::new(patterned(&[10, 16, 16, 6], 6, Activation::HardGelu));
        let shared = network();
        let own = [network(), Arc::new(patterned_from(5, &[10, 16, 16, 6], 6, Activation::HardGelu))];
        let neural = Arc::new(Shared {
            network: patterned(&[30, 16, 3], neural::FEATURES, Activation::HardGelu),
            frames: Layer { weight: vec![0.1; 18 * 12], bias: vec![0.2; 18] },
        });
        let nbrdf = |seed| Arc::new(patterned_from(seed, &[6, 21, 21, 3], 6, Activation::Relu));
        let ggx = |alpha| Material::from(Ggx::new(Microfacet { alpha, ..PARAMETERS }).unwrap());
        let factor = |factors: Factors| {
            let material = |name: &str, interpolation| {
                entry(name, Material::from(Factor::new(factors.clone(), interpolation).unwrap()))
            };
            vec![material("a", Interpolation::Nearest), material("b", Interpolation::Nearest)]
        };
        let mut libraries = vec![
            vec![entry("a", ggx([0.1; 2])), entry("b", ggx([0.1, 0.3]))],
            vec![entry("a", hybrid(&shared, [0.2; 2], 0.1)), entry("b", hybrid(&shared, [0.3; 2], -0.4))],
            vec![entry("a", hybrid(&own[0], [0.2, 0.4], 0.1)), entry("b", hybrid(&own[1], [0.3; 2], 0.2))],
            vec![
                entry("a", Material::from(Neural::new(neural.clone(), vec![0.1; 12], 1.0).unwrap())),
                entry("b", Material::from(Neural::new(neural, vec![-0.2; 12], 2.0).unwrap())),
            ],
            vec![
                entry("a", Material::from(Nbrdf::new(nbrdf(1)).unwrap())),
                entry("b", Material::from(Nbrdf::new(nbrdf(2)).unwrap())),
            ],
        ];
        libraries.extend(patterned_factors().map(factor));
        libraries.extend(specimens().map(|parameters| {
            let mut other = parameters.clone();
            other.diffuse = [0.5; 3];
            let material = |parameters| Material::from(Analytic::new(parameters).unwrap());
            vec![entry("a", material(parameters)), entry("b", material(other))]
        }));
        libraries
    }

    #[test]
    fn every_model_comes_back_as_it_was_saved() {
        let folder = tempfile::tempdir().unwrap();
        for (i, entries) in libraries().into_iter().enumerate() {
            let path = folder.path().join(format!("{i}.safetensors"));
            let saved = Library::new(&path, entries).unwrap();
            saved.save().unwrap();
            let read = Library::open(&path).unwrap();
            assert_eq!(read.names(), ["a", "b"]);
            assert_eq!(read.tensor_bytes(), saved.tensor_bytes());
            let (light, view) = (Vec3::new(0.48, 0.36, 0.8), Vec3::new(-0.6, 0.0, 0.8));
            for (a, b) in saved.entries().iter().zip(read.entries()) {
                assert_eq!(a.origin, b.origin);
                assert_eq!(a.material.eval(light, view), b.material.eval(light, view));
                assert_eq!(a.material.sampler().lobes(), b.material.sampler().lobes());
            }
        }
    }

    #[test]
    fn neural_materials_of_two_networks_do_not_make_a_library() {
        let [mut entries, other] = [libraries().remove(3), libraries().remove(3)];
        let mut stranger = other.into_iter().next().unwrap();
        stranger.name = "c".to_owned();
        entries.push(stranger);
        let message = Library::new("merged", entries).unwrap_err().to_string();
        assert!(message.contains("different networks"), "{message}");
    }

    #[test]
    fn twelve_numbers_a_material() {
        let library = Library::new("", libraries().remove(1)).unwrap();
        // k_d 3, η 3, α 1, z 4, bound 1; the network 10-16-16-6 with its biases.
        assert_eq!(library.tensor_bytes(), (4 * 12, 4 * (11 * 16 + 17 * 16 + 17 * 6)));
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
        let good = Library::new(&path, libraries().remove(1)).unwrap().encode();
        let replaced = |from: &str, to: &str| {
            let at = good.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
            let mut bytes = good.clone();
            bytes.splice(at..at + from.len(), to.bytes());
            bytes
        };
        assert!(refused(b"MZ").contains("broken"));
        assert!(refused(&good[..good.len() - 5]).contains("broken"));
        assert!(refused(&replaced("\"glimt\"", "\"other\"")).contains("some other safetensors file"));
        assert!(refused(&replaced("\\\"format\\\":1", "\\\"format\\\":9")).contains("version 9, expected 1"));
        assert!(refused(&replaced("hybrid", "hybrod")).contains("its model is \"hybrod\""));
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

    #[test]
    fn a_path_that_cannot_be_written_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("missing").join("lib.safetensors");
        let message = Library::new(&path, libraries().remove(0)).unwrap().save().unwrap_err().to_string();
        assert!(message.contains("cannot write"), "{message}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        // Renaming onto a directory, a device or a pipe must not be tried.
        let message = write_whole(folder.path(), b"bytes").unwrap_err().to_string();
        assert!(message.contains("not a regular file"), "{message}");
    }

    proptest! {
        #[test]
        fn mutated_files_never_panic(at in 0..4000usize, byte in any::<u8>(), cut in 0..4000usize) {
            static ENCODED: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
                libraries().into_iter().map(|entries| Library::new("", entries).unwrap().encode()).collect()
            });
            for bytes in &*ENCODED {
                let mut bytes = bytes.clone();
                let at = at % bytes.len();
                bytes[at] = byte;
                let _ = decode(&bytes);
                bytes.truncate(cut % bytes.len());
                prop_assert!(decode(&bytes).is_err());
            }
        }
    }
}

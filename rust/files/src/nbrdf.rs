//! Weights of neural BRDFs as Sztrajman et al. 2021 publish them.
//!
//! Six arrays: three weights, [inputs][outputs] as Keras stores them, and three biases. They come as
//! the `.h5` file of Keras, as one `.npz` with the names `w1 b1 w2 b2 w3 b3` (or `fc1` … for the
//! weights), or as six `.npy` files `<material>_fc1.npy`, `<material>_b1.npy` …, of which the first
//! stands for all.

use std::collections::HashMap;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glimt_core::kernels::network::{Activation, Layer, Network};
use glimt_core::models::nbrdf::{FEATURES, Nbrdf};
use glimt_measured::file::open_regular;

use crate::error::Error;
use crate::keras;
use crate::npy::Array;

/// First bytes of a `.npz` file: that of a zip archive with members.
pub const NPZ_MAGIC: &[u8; 4] = b"PK\x03\x04";

/// How the first of six `.npy` files is named, after the material.
pub const FIRST_NPY: [&str; 2] = ["_fc1.npy", "_w1.npy"];

const LAYERS: usize = 3;
/// Largest file that is read; the published ones have 5 kB.
const MAX_BYTES: u64 = 1 << 24;
/// Largest array of an archive that is unpacked: float64 weights of a layer of the widest network, and
/// more than that. What a small file unpacks to is thereby bounded.
const MAX_MEMBER_BYTES: u64 = 1 << 17;
const FORMAT: &str = "a set of NBRDF weights";

/// Reads a material's network; `path` is an `.h5` or `.npz` file or the first of six `.npy` files.
///
/// # Errors
/// [`Error::Read`], or [`Error::Format`] for a broken file and for arrays that are missing, not finite
/// or of other shapes.
pub fn open(path: impl AsRef<Path>) -> Result<Nbrdf, Error> {
    let path = path.as_ref();
    let arrays = match prefix(path) {
        Some(prefix) => from_npy_files(&prefix)?,
        None => return from_bytes(path, &read(path)?),
    };
    assemble(&arrays).map_err(format_error(path))
}

/// Decodes the bytes of an `.h5` or `.npz` file; `path` is what messages name.
///
/// # Errors
/// [`Error::Format`], as [`open`].
pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Nbrdf, Error> {
    let from = if bytes.starts_with(keras::MAGIC) { from_h5 } else { from_npz };
    from(bytes).and_then(|arrays| assemble(&arrays)).map_err(format_error(path))
}

/// The material's name: the file's, without what says that it is the first of several.
#[must_use]
pub fn name(path: &Path) -> String {
    let stem = prefix(path).unwrap_or_else(|| path.with_extension(""));
    stem.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// What the names of six `.npy` files have in common, if `path` is the first of them.
fn prefix(path: &Path) -> Option<PathBuf> {
    let name = path.file_name()?.to_str()?;
    let material = FIRST_NPY.iter().find_map(|end| name.strip_suffix(end))?;
    Some(path.with_file_name(material))
}

fn format_error(path: &Path) -> impl Fn(String) -> Error + '_ {
    |reason| Error::Format { path: path.to_owned(), format: FORMAT, reason }
}

fn read(path: &Path) -> Result<Vec<u8>, Error> {
    let read = || {
        let mut bytes = Vec::new();
        open_regular(path)?.take(MAX_BYTES).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    read().map_err(Error::read(path))
}

/// The arrays of an archive by name.
fn from_npz(bytes: &[u8]) -> Result<HashMap<String, Array>, String> {
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).map_err(|error| error.to_string())?;
    let mut arrays = HashMap::new();
    for index in 0..archive.len() {
        let member = archive.by_index(index).map_err(|error| error.to_string())?;
        let name = member.name().map_err(|error| error.to_string())?.into_owned();
        let Some(key) = name.strip_suffix(".npy").filter(|key| is_wanted(key)) else { continue };
        let mut bytes = Vec::new();
        member.take(MAX_MEMBER_BYTES).read_to_end(&mut bytes).map_err(|error| format!("{name}: {error}"))?;
        let array = Array::from_bytes(&bytes).map_err(|reason| format!("{name}: {reason}"))?;
        arrays.insert(key.to_owned(), array);
    }
    Ok(arrays)
}

/// The arrays of a file of Keras by the names that they have elsewhere.
fn from_h5(bytes: &[u8]) -> Result<HashMap<String, Array>, String> {
    let named = |(i, layer): (usize, keras::Dense)| {
        [(format!("w{}", i + 1), layer.kernel), (format!("b{}", i + 1), layer.bias)]
    };
    Ok(keras::dense_layers(bytes)?.into_iter().enumerate().flat_map(named).collect())
}

/// The arrays `<prefix>_fc1.npy` … by the last part of their names.
fn from_npy_files(prefix: &Path) -> Result<HashMap<String, Array>, Error> {
    let mut arrays = HashMap::new();
    for (key, file) in npy_files(prefix) {
        if file.exists() {
            arrays.insert(key, Array::from_bytes(&read(&file)?).map_err(format_error(&file))?);
        }
    }
    Ok(arrays)
}

/// The files that [`open`] reads besides or in the place of `path`, `path` first; not all need be there.
#[must_use]
pub fn parts(path: &Path) -> Vec<PathBuf> {
    let others = prefix(path)
        .into_iter()
        .flat_map(|prefix| npy_files(&prefix).map(|(_, file)| file).collect::<Vec<_>>());
    std::iter::once(path.to_owned()).chain(others).collect()
}

/// The arrays of a set by the last part of their names.
fn npy_files(prefix: &Path) -> impl Iterator<Item = (String, PathBuf)> + '_ {
    let keys = (1..=LAYERS).flat_map(|layer| weight_names(layer).into_iter().chain([format!("b{layer}")]));
    keys.map(|key| {
        let mut file = prefix.as_os_str().to_owned();
        file.push(format!("_{key}.npy"));
        (key, PathBuf::from(file))
    })
}

/// Whether the network has an array of this name.
fn is_wanted(key: &str) -> bool {
    (1..=LAYERS).any(|layer| weight_names(layer).contains(&key.to_owned()) || key == format!("b{layer}"))
}

/// The names under which a layer's weights are published.
fn weight_names(layer: usize) -> [String; 2] {
    [format!("w{layer}"), format!("fc{layer}")]
}

fn assemble(arrays: &HashMap<String, Array>) -> Result<Nbrdf, String> {
    let mut inputs = FEATURES;
    let mut layers = Vec::new();
    for number in 1..=LAYERS {
        let [w, fc] = weight_names(number);
        let weight = arrays.get(&w).or_else(|| arrays.get(&fc));
        let weight = weight.ok_or_else(|| format!("the array {w} (or {fc}) is missing"))?;
        let name = format!("b{number}");
        let bias = arrays.get(&name).ok_or_else(|| format!("the array {name} is missing"))?;
        let layer = layer(weight, bias, inputs).map_err(|reason| format!("{w}: {reason}"))?;
        inputs = layer.outputs();
        layers.push(layer);
    }
    let network = Network::new(layers, FEATURES, Activation::Relu)?;
    Nbrdf::new(Arc::new(network))
}

/// A layer from its weights, [inputs][outputs].
fn layer(weight: &Array, bias: &Array, inputs: usize) -> Result<Layer, String> {
    let outputs = bias.values.len();
    if bias.shape != [outputs] || weight.shape != [inputs, outputs] || outputs == 0 {
        return Err(format!(
            "weights of shape {:?} and biases of shape {:?}, expected [{inputs}, n] (inputs, outputs) and [n]",
            weight.shape, bias.shape
        ));
    }
    let transposed = |row: usize| (0..inputs).map(move |column| weight.values[column * outputs + row]);
    Ok(Layer { weight: (0..outputs).flat_map(transposed).collect(), bias: bias.values.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glimt_core::{Brdf, Vec3};
    use std::io::Write;

    /// Weights in which the position of every number tells: w[i][o] = i + o/10 scaled down.
    fn arrays() -> Vec<(&'static str, Array)> {
        let weight = |inputs: usize, outputs: usize, scale: f32| Array {
            shape: vec![inputs, outputs],
            values: (0..inputs * outputs)
                .map(|i| scale * ((i / outputs) as f32 + 0.1 * (i % outputs) as f32))
                .collect(),
        };
        let bias = |n: usize| Array { shape: vec![n], values: vec![0.01; n] };
        vec![
            ("w1", weight(6, 21, 0.01)),
            ("b1", bias(21)),
            ("w2", weight(21, 21, 0.001)),
            ("b2", bias(21)),
            ("w3", weight(21, 3, 0.001)),
            ("b3", bias(3)),
        ]
    }

    fn npz(arrays: &[(&str, Array)]) -> Vec<u8> {
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, array) in arrays {
            zip.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
            zip.write_all(&array.to_bytes()).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }

    #[test]
    fn every_format_holds_the_same_material() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("paint.npz");
        // As NumPy does, bytes after the end are ignored.
        std::fs::write(&path, [&npz(&arrays())[..], b"bytes after the end"].concat()).unwrap();
        for (name, array) in arrays() {
            let name = name.replace('w', "fc");
            array.save(folder.path().join(format!("paint_{name}.npy"))).unwrap();
        }
        let arrays = arrays();
        let keras_name = |name: &str| {
            let (layer, kind) = (&name[1..], if name.starts_with('w') { "kernel" } else { "bias" });
            format!("dense_{layer}/dense_{layer}/{kind}:0")
        };
        let datasets: Vec<_> = arrays.iter().map(|(name, array)| (keras_name(name), array)).collect();
        std::fs::write(folder.path().join("paint.h5"), keras::tests::file(&datasets)).unwrap();

        let archive = open(&path).unwrap();
        for other in ["paint_fc1.npy", "paint.h5"] {
            let other = open(folder.path().join(other)).unwrap();
            assert_eq!(archive.network().layers(), other.network().layers());
        }
        // The second output's weight for the fourth input.
        assert_eq!(archive.network().layers()[0].weight[6 + 3], 0.01 * 3.1);
        assert!(archive.eval(Vec3::Z, Vec3::Z).min_element() > 0.0);
        assert_eq!(name(&path), "paint");
        assert_eq!(name(Path::new("there/gold_fc1.npy")), "gold");
    }

    #[test]
    fn what_does_not_fit_is_refused_in_words() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("broken.npz");
        let refused = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            let message = open(&path).unwrap_err().to_string();
            assert!(message.contains("broken.npz is not a set of NBRDF weights"), "{message}");
            message
        };
        let with = |index: usize, array: Array| {
            let mut arrays = arrays();
            arrays[index].1 = array;
            npz(&arrays)
        };
        let good = npz(&arrays());
        refused(b"nothing");
        refused(&good[..good.len() / 2]);
        assert!(refused(&npz(&arrays()[..5])).contains("b3 is missing"));
        let swapped = Array { shape: vec![21, 6], values: vec![0.1; 126] };
        assert!(refused(&with(0, swapped)).contains("expected [6, n]"));
        let mut nan = arrays().remove(2).1;
        nan.values[7] = f32::NAN;
        assert!(refused(&with(2, nan)).contains("not finite"));
        let wide = Array { shape: vec![21, 4], values: vec![0.1; 84] };
        let mut arrays = arrays();
        arrays[4].1 = wide;
        arrays[5].1 = Array { shape: vec![4], values: vec![0.1; 4] };
        assert!(refused(&npz(&arrays)).contains("expected 6 to 3"));
    }
}

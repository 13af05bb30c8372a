//! How spherical materials lie in a file.
//!
//! The `form` in the metadata is that of the tables, with `store`, how features are kept. Materials that
//! share a network and, where there is one, a codebook are a cluster. A material keeps some rows of k
//! features: as many as its tables have, or fewer where it was pruned.
//!
//! | tensor | numbers | shape |
//! |---|---|---|
//! | `network.i.weight`, `network.i.bias` | float16, or float32 where that would change them | (clusters, out, in), (clusters, out) |
//! | `cluster` | uint16: the cluster of each material; only where it is not 0 for all, nor one each | (materials) |
//! | `bound` | float32 | (materials) |
//! | `features` | float32, float16 or int8; of 4-bit features uint8, two in a byte, the lower half first | (kept rows of all, k), or their bytes |
//! | `scales` | float32: what an int8 or 4-bit feature is multiplied by | (materials, tables, k) |
//! | `indices` | uint8: b bits each, from the lowest bit up, each material from a whole byte on | (bytes) |
//! | `codebook` | float16 | (clusters, 2ᵇ, k) |
//! | `links` | uint32: the kept row of each row; only where rows were pruned | (materials, rows) |

use std::sync::Arc;

use half::f16;
use safetensors::tensor::Dtype;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::codec::{Codec, Decoder};
use super::container::{Networks, Rows, Tensor, Tensors};
use crate::kernels::network::{Activation, Layer};
use crate::models::spherical::store::{Codebook, Store, StoreKind, pack, unpack};
#[cfg(test)]
use crate::models::spherical::tables::Grids;
use crate::models::spherical::tables::{Form, Layout};
#[cfg(test)]
use crate::models::spherical::tests::{form, material_with};
use crate::models::spherical::{Features, Spherical};

/// What the metadata says.
#[derive(Serialize, Deserialize)]
struct StoredForm {
    #[serde(flatten)]
    form: Form,
    store: StoreKind,
}

/// Types that a network's numbers may have.
const FLOATS: [Dtype; 2] = [Dtype::F32, Dtype::F16];

impl Codec for Spherical {
    fn form(&self) -> Option<Value> {
        let form = StoredForm { form: self.layout().form(), store: self.features().store.kind() };
        Some(serde_json::to_value(form).expect("a form is names and numbers"))
    }

    fn encode(materials: &[&Self]) -> Vec<Tensor> {
        let k = usize::from(materials[0].layout().form().features);
        let tables = materials[0].layout().form().grids.tables();
        let (firsts, clusters) = clusters(materials);
        // What serves one of several materials is its own, on average.
        let shared = firsts.len() == 1 && materials.len() > 1;
        let mut tensors = Vec::new();
        for (i, layer) in firsts[0].network().layers().iter().enumerate() {
            let stack = |name: &str, shape: &[usize], part: &dyn Fn(&Layer) -> Vec<f32>| {
                let data: Vec<f32> = firsts.iter().flat_map(|m| part(&m.network().layers()[i])).collect();
                let shape = [&[firsts.len()], shape].concat();
                floats(&format!("network.{i}.{name}"), shape, &data).with_shared(shared)
            };
            tensors.push(stack("weight", &[layer.outputs(), layer.inputs()], &|l| l.weight.clone()));
            tensors.push(stack("bias", &[layer.outputs()], &|l| l.bias.clone()));
        }
        if firsts.len() > 1 && firsts.len() < materials.len() {
            let bytes = clusters.iter().flat_map(|&c| (c as u16).to_le_bytes()).collect();
            tensors.push(Tensor::typed("cluster", vec![materials.len()], Dtype::U16, bytes));
        }
        let bounds: Vec<f32> = materials.iter().map(|m| m.bound()).collect();
        tensors.push(Tensor::own("bound", vec![bounds.len()], &bounds));

        let (mut rows, mut features, mut indices, mut scales) = (0, Vec::new(), Vec::new(), Vec::new());
        for material in materials {
            let store = &material.features().store;
            rows += store.rows(k);
            match store {
                Store::F32(own) => features.extend(own.iter().flat_map(|x| x.to_le_bytes())),
                Store::F16(own) => features.extend(own.iter().flat_map(|x| x.to_le_bytes())),
                Store::Scaled { kind, integers, scales: own } => {
                    match kind {
                        StoreKind::I4 => features.extend(integers.as_chunks().0.iter().map(nibbles)),
                        _ => features.extend(integers.iter().map(|&i| i as u8)),
                    }
                    scales.extend(own);
                }
                Store::Indexed { bits, indices: own, .. } => indices.extend(pack(own, *bits)),
            }
        }
        let kind = materials[0].features().store.kind();
        match kind {
            StoreKind::Codebook(bits) => {
                tensors.push(Tensor::typed("indices", vec![indices.len()], Dtype::U8, indices));
                let bytes = firsts.iter().flat_map(|m| match &m.features().store {
                    Store::Indexed { codebook, .. } => codebook.primitives.as_slice(),
                    _ => &[],
                });
                let bytes = bytes.flat_map(|x| x.to_le_bytes()).collect();
                let shape = vec![firsts.len(), 1 << bits, k];
                tensors.push(Tensor::typed("codebook", shape, Dtype::F16, bytes).with_shared(shared));
            }
            StoreKind::I4 => {
                tensors.push(Tensor::typed("features", vec![features.len()], Dtype::U8, features));
            }
            kind => tensors.push(Tensor::typed("features", vec![rows, k], dtype(kind), features)),
        }
        if kind.largest().is_some() {
            tensors.push(Tensor::own("scales", vec![materials.len(), tables, k], &scales));
        }
        if materials.iter().any(|m| m.features().links.is_some()) {
            let rows = materials[0].layout().places().len();
            let whole: Vec<u32> = (0..rows as u32).collect();
            let links = materials.iter().flat_map(|m| m.features().links.as_ref().unwrap_or(&whole));
            let bytes = links.flat_map(|link| link.to_le_bytes()).collect();
            tensors.push(Tensor::typed("links", vec![materials.len(), rows], Dtype::U32, bytes));
        }
        tensors
    }

    fn decoder(file: &Tensors, form: Option<&Value>) -> Result<Decoder<Self>, String> {
        let form = form.ok_or("its metadata has no \"form\", which a spherical library needs")?;
        let StoredForm { form, store } = Deserialize::deserialize(form)
            .map_err(|e| format!("its \"glimt\" metadata is broken: the form: {e}"))?;
        store.validate()?;
        let layout = Arc::new(Layout::new(form)?);
        let networks = networks(file, form.inputs())?;
        let clusters = cluster_numbers(file, networks.count())?;
        let links = links(file, layout.places().len())?;
        let kept = |i: usize| {
            let last = |links: &Vec<u32>| links.iter().max().map_or(0, |&row| row as usize + 1);
            links.as_ref().map_or(layout.places().len(), |links| last(&links[i]))
        };
        let kept = (0..file.materials()).map(kept).collect();
        let stores = Stores::new(file, store, form, kept, networks.count())?;
        let bounds = file.rows("bound", &[])?;
        Ok(Box::new(move |i| {
            let links = links.as_ref().map(|links| links[i].clone());
            let features = Features { store: stores.at(i, clusters[i])?, links };
            Ok(Spherical::new(layout.clone(), networks.at(clusters[i])?, features, bounds.number(i)?)?)
        }))
    }

    fn check_together(&self, other: &Self) -> Result<(), String> {
        let codebook = |m: &Self| match &m.features().store {
            Store::Indexed { codebook, .. } => Some(Arc::as_ptr(codebook)),
            _ => None,
        };
        if Arc::ptr_eq(self.network(), other.network()) && codebook(self) != codebook(other) {
            return Err("share a network but not its codebook".into());
        }
        Ok(())
    }

    #[cfg(test)]
    fn specimens(activation: Activation) -> Vec<[Self; 2]> {
        let material = |store| material_with(form(Grids::Iso), store, activation);
        [StoreKind::F32, StoreKind::Codebook(5)].map(|store| [material(store), material(store)]).into()
    }
}

/// The first material of every cluster, and the cluster of every material.
fn clusters<'a>(materials: &[&'a Spherical]) -> (Vec<&'a Spherical>, Vec<usize>) {
    let mut firsts: Vec<&Spherical> = Vec::new();
    let mut number = |material: &'a Spherical| {
        let known = firsts.iter().position(|first| Arc::ptr_eq(first.network(), material.network()));
        known.unwrap_or_else(|| {
            firsts.push(material);
            firsts.len() - 1
        })
    };
    let clusters = materials.iter().map(|material| number(material)).collect();
    (firsts, clusters)
}

/// Float16 where that loses nothing, else float32.
fn floats(name: &str, shape: Vec<usize>, data: &[f32]) -> Tensor {
    if data.iter().any(|&x| f16::from_f32(x).to_f32() != x) {
        return Tensor::own(name, shape, data);
    }
    let bytes = data.iter().flat_map(|&x| f16::from_f32(x).to_le_bytes()).collect();
    Tensor::typed(name, shape, Dtype::F16, bytes)
}

/// The type of a store's features where each is a whole number of bytes.
fn dtype(kind: StoreKind) -> Dtype {
    match kind {
        StoreKind::F32 => Dtype::F32,
        StoreKind::F16 => Dtype::F16,
        StoreKind::I8 => Dtype::I8,
        StoreKind::I4 | StoreKind::Codebook(_) => Dtype::U8,
    }
}

/// Two 4-bit integers in a byte, in two's complement.
fn nibbles([low, high]: &[i8; 2]) -> u8 {
    (*low as u8 & 15) | ((*high as u8) << 4)
}

fn from_nibbles(byte: u8) -> [i8; 2] {
    [((byte << 4) as i8) >> 4, (byte as i8) >> 4]
}

fn networks(file: &Tensors, inputs: usize) -> Result<Networks, String> {
    let first = file.info("network.0.weight", &FLOATS).ok();
    let count = first.and_then(|weight| weight.shape.first().copied()).unwrap_or(0);
    if !(1..=file.materials()).contains(&count) {
        let materials = file.materials();
        return Err(format!(
            "it has {count} networks, expected 1 to {materials}, the number of its materials"
        ));
    }
    file.stacked_networks(Some(count), inputs, file.activation_or(Activation::HardGelu), &FLOATS)
}

fn cluster_numbers(file: &Tensors, networks: usize) -> Result<Vec<usize>, String> {
    let materials = file.materials();
    if networks == 1 {
        return Ok(vec![0; materials]);
    }
    if networks == materials {
        return Ok((0..materials).collect());
    }
    let (shape, bytes) = file.bytes("cluster", &[Dtype::U16])?;
    let clusters: Vec<usize> = bytes.as_chunks().0.iter().map(|&b| u16::from_le_bytes(b).into()).collect();
    if shape != [materials] {
        return Err(format!("the tensor \"cluster\" has shape {shape:?}, expected [{materials}]"));
    }
    match clusters.iter().find(|&&cluster| cluster >= networks) {
        Some(cluster) => Err(format!("a material is of cluster {cluster}, expected less than {networks}")),
        None => Ok(clusters),
    }
}

fn links(file: &Tensors, rows: usize) -> Result<Option<Vec<Vec<u32>>>, String> {
    if !file.has("links") {
        return Ok(None);
    }
    let (shape, bytes) = file.bytes("links", &[Dtype::U32])?;
    if shape != [file.materials(), rows] {
        let materials = file.materials();
        return Err(format!("the tensor \"links\" has shape {shape:?}, expected [{materials}, {rows}]"));
    }
    let links: Vec<u32> = bytes.as_chunks().0.iter().map(|&b| u32::from_le_bytes(b)).collect();
    if links.iter().any(|&link| link as usize >= rows) {
        return Err(format!("the tensor \"links\" points beyond the {rows} rows that there can be"));
    }
    Ok(Some(links.chunks_exact(rows).map(<[u32]>::to_vec).collect()))
}

/// Where the features of the materials are.
struct Stores {
    file: Tensors,
    kind: StoreKind,
    /// Rows that each material keeps.
    kept: Vec<usize>,
    /// Where each material's bytes begin, and the last one's end.
    starts: Vec<usize>,
    scales: Option<Rows>,
    codebooks: Vec<Arc<Codebook>>,
}

impl Stores {
    /// Of materials that keep these rows.
    fn new(
        file: &Tensors,
        kind: StoreKind,
        form: Form,
        kept: Vec<usize>,
        networks: usize,
    ) -> Result<Stores, String> {
        let k = usize::from(form.features);
        let bytes = |&rows: &usize| match kind {
            StoreKind::Codebook(bits) => (rows * usize::from(bits)).div_ceil(8),
            StoreKind::I4 => rows * k / 2,
            StoreKind::F32 => rows * k * 4,
            StoreKind::F16 => rows * k * 2,
            StoreKind::I8 => rows * k,
        };
        let mut starts = vec![0];
        starts.extend(kept.iter().map(bytes).scan(0, |end, bytes| {
            *end += bytes;
            Some(*end)
        }));
        let (name, expected) = (features_name(kind), starts[kept.len()]);
        let (begin, end) = file.info(name, &[dtype(kind)])?.data_offsets;
        if end - begin != expected {
            return Err(format!("the tensor \"{name}\" has {} bytes, expected {expected}", end - begin));
        }
        let has_scales = kind.largest().is_some();
        let scales = has_scales.then(|| file.rows("scales", &[form.grids.tables(), k])).transpose()?;
        let codebooks = match kind {
            StoreKind::Codebook(bits) => codebooks(file, networks, 1 << bits, k)?,
            _ => Vec::new(),
        };
        Ok(Stores { file: file.clone(), kind, kept, starts, scales, codebooks })
    }

    /// That of a material, which is of a cluster.
    fn at(&self, material: usize, cluster: usize) -> Result<Store, String> {
        let kind = self.kind;
        let bytes = self.file.part(features_name(kind), self.starts[material]..self.starts[material + 1])?;
        let scaled = |integers| {
            let scales = self.scales.as_ref().map_or(Ok(Vec::new()), |scales| scales.row(material))?;
            Ok(Store::Scaled { kind, integers, scales })
        };
        match kind {
            StoreKind::F32 => {
                Ok(Store::F32(bytes.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect()))
            }
            StoreKind::F16 => {
                Ok(Store::F16(bytes.as_chunks().0.iter().map(|&b| f16::from_le_bytes(b)).collect()))
            }
            StoreKind::I8 => scaled(bytes.iter().map(|&b| b as i8).collect()),
            StoreKind::I4 => scaled(bytes.iter().flat_map(|&b| from_nibbles(b)).collect()),
            StoreKind::Codebook(bits) => {
                let indices = unpack(&bytes, bits, self.kept[material]);
                Ok(Store::Indexed { bits, indices, codebook: self.codebooks[cluster].clone() })
            }
        }
    }
}

/// The tensor that holds the features.
fn features_name(kind: StoreKind) -> &'static str {
    if matches!(kind, StoreKind::Codebook(_)) { "indices" } else { "features" }
}

fn codebooks(file: &Tensors, count: usize, size: usize, k: usize) -> Result<Vec<Arc<Codebook>>, String> {
    let (shape, bytes) = file.bytes("codebook", &[Dtype::F16])?;
    if shape != [count, size, k] {
        return Err(format!("the tensor \"codebook\" has shape {shape:?}, expected [{count}, {size}, {k}]"));
    }
    let primitives: Vec<f16> = bytes.as_chunks().0.iter().map(|&b| f16::from_le_bytes(b)).collect();
    Ok(primitives.chunks_exact(size * k).map(|p| Arc::new(Codebook { primitives: p.to_vec() })).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::library::{Entry, Library, Origin};
    use crate::models::spherical::tests::material;
    use crate::{Brdf, Material, Vec3};

    const KINDS: [StoreKind; 5] =
        [StoreKind::F32, StoreKind::F16, StoreKind::I8, StoreKind::I4, StoreKind::Codebook(5)];

    fn library(folder: &tempfile::TempDir, materials: Vec<Spherical>) -> Library {
        let entry = |(i, material)| Entry {
            name: format!("material {i}"),
            material: Material::from(material),
            origin: Origin::default(),
        };
        let entries = materials.into_iter().enumerate().map(entry).collect();
        Library::new(folder.path().join("library.safetensors"), entries).unwrap()
    }

    /// The same tables with another bound, in the same cluster.
    fn sibling(of: &Spherical) -> Spherical {
        Spherical::new(of.layout().clone(), of.network().clone(), of.features().clone(), 1.0).unwrap()
    }

    #[test]
    fn every_kind_of_store_survives_the_file() {
        let folder = tempfile::tempdir().unwrap();
        for kind in KINDS {
            for grids in [Grids::Lv, Grids::Iso] {
                let (a, c) = (material(form(grids), kind), material(form(grids), kind));
                let b = sibling(&a);
                // One network; two for three materials; one each.
                for materials in [vec![a.clone(), b.clone()], vec![a.clone(), b, c.clone()], vec![a, c]] {
                    let library = library(&folder, materials);
                    library.save().unwrap();
                    let back = Library::open(library.path()).unwrap();
                    for (before, after) in library.entries().unwrap().iter().zip(back.entries().unwrap()) {
                        let (l, v) = (Vec3::new(0.48, 0.6, 0.64), Vec3::new(-0.6, 0.0, 0.8));
                        assert_eq!(before.material.eval(l, v), after.material.eval(l, v), "{kind:?}");
                    }
                    assert_eq!(library.tensor_bytes().unwrap(), back.tensor_bytes().unwrap());
                }
            }
        }
    }

    /// N_side 64, k 16, b 9: 2 · 24,961 indices of 9 bits and 512 primitives of 16 halves, "0.07 MB".
    #[test]
    fn the_papers_indices_and_codebook_take_the_published_72_kilobytes() {
        let folder = tempfile::tempdir().unwrap();
        let form = Form { nside: 64.try_into().unwrap(), features: 16, ..form(Grids::Lv) };
        let library = library(&folder, vec![material(form, StoreKind::Codebook(9))]);
        let tensors = crate::library::tensors(&library.entries().unwrap());
        let bytes = |name: &str| tensors.iter().find(|t| t.name == name).unwrap().bytes.len();
        assert_eq!(bytes("indices") + bytes("codebook"), (2 * 24_961 * 9usize).div_ceil(8) + 512 * 16 * 2);
        assert_eq!((bytes("indices") + bytes("codebook")) / 1000, 72);
    }

    #[test]
    fn pruned_materials_survive_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let whole = material(form(Grids::Lv), StoreKind::F32);
        let Store::F32(features) = &whole.features().store else { unreachable!() };
        let rows = whole.layout().places().len();
        // The last half of either table is pruned to its first row.
        let (mut links, mut kept) = (Vec::new(), Vec::new());
        for row in 0..rows {
            let (table, within) = (row / (rows / 2), row % (rows / 2));
            if within < rows / 4 {
                links.push(kept.len() as u32 / 8);
                kept.extend(&features[row * 8..][..8]);
            } else {
                links.push((table * (rows / 4)) as u32);
            }
        }
        let features = Features { store: Store::F32(kept), links: Some(links) };
        let pruned = Spherical::new(whole.layout().clone(), whole.network().clone(), features, 2.0).unwrap();
        let library = library(&folder, vec![whole, pruned]);
        library.save().unwrap();
        let back = Library::open(library.path()).unwrap();
        // Low over the horizon, where the last rows are.
        let (l, v) = (Vec3::new(0.6, 0.768, 0.225), Vec3::new(-0.6, 0.0, 0.8));
        for (before, after) in library.entries().unwrap().iter().zip(back.entries().unwrap()) {
            assert_eq!(before.material.eval(l, v), after.material.eval(l, v));
        }
        assert_ne!(
            back.entries().unwrap()[0].material.eval(l, v),
            back.entries().unwrap()[1].material.eval(l, v)
        );
    }

    #[test]
    fn broken_files_say_what_was_expected() {
        use safetensors::tensor::{SafeTensors, TensorView};
        let folder = tempfile::tempdir().unwrap();
        let library = library(&folder, vec![material(form(Grids::Iso), StoreKind::Codebook(5))]);
        library.save().unwrap();
        let bytes = std::fs::read(library.path()).unwrap();
        let (_, metadata) = SafeTensors::read_metadata(&bytes).unwrap();
        let metadata = metadata.metadata().clone().unwrap();
        // The same file with one tensor replaced, left out, or with other metadata.
        let reopened =
            |name: &str, other: Option<(Dtype, Vec<usize>, Vec<u8>)>, json: &dyn Fn(String) -> String| {
                let tensors = SafeTensors::deserialize(&bytes).unwrap();
                let mut views: Vec<(String, TensorView)> =
                    tensors.tensors().into_iter().filter(|(n, _)| n != name).collect();
                if let Some((dtype, shape, data)) = &other {
                    views.push((name.to_owned(), TensorView::new(*dtype, shape.clone(), data).unwrap()));
                }
                let metadata = metadata.iter().map(|(k, v)| (k.clone(), json(v.clone()))).collect();
                let path = folder.path().join("broken.safetensors");
                std::fs::write(&path, safetensors::serialize(views, Some(metadata)).unwrap()).unwrap();
                Library::open(&path).unwrap_err().to_string()
            };
        let same = |text: String| text;
        let bytes = |n: usize| vec![0xffu8; n];
        for (name, tensor, expected) in [
            ("codebook", None, "\"codebook\" is missing"),
            ("codebook", Some((Dtype::F16, vec![1, 31, 8], bytes(496))), "expected [1, 32, 8]"),
            ("codebook", Some((Dtype::F32, vec![1, 32, 8], bytes(1024))), "is F32, expected F16"),
            ("codebook", Some((Dtype::F16, vec![1, 32, 8], bytes(512))), "not finite"),
            ("indices", Some((Dtype::U8, vec![10], bytes(10))), "has 10 bytes, expected "),
            ("network.0.weight", Some((Dtype::F16, vec![2, 32, 32], vec![0; 4096])), "expected 1 to 1"),
            ("bound", Some((Dtype::F32, vec![1], bytes(4))), "holds NaN"),
            ("links", Some((Dtype::U32, vec![1, 4], bytes(16))), "\"links\" has shape [1, 4]"),
        ] {
            let message = reopened(name, tensor, &same);
            assert!(message.contains(expected) && message.contains("broken.safetensors"), "{message}");
        }
        for (from, to, expected) in [
            ("\"nside\":8", "\"nside\":9", "expected a power of two up to 256"),
            ("\"codebook\":5", "\"codebook\":13", "expected 1 to 12"),
            ("\"features\":8", "\"features\":7", "expected 4, 8 or 16"),
            ("\"iso\"", "\"isotropic\"", "unknown variant"),
        ] {
            let message = reopened("none", None, &|json| {
                assert!(json.contains(from), "{json}");
                json.replace(from, to)
            });
            assert!(message.contains(expected), "{message}");
        }
    }
}

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

use super::codec::Codec;
use super::container::{Numbers, Tensor, Tensors, layer_at};
use crate::kernels::network::{Activation, Layer, Network};
use crate::models::spherical::store::{Codebook, Store, StoreKind, pack, unpack};
use crate::models::spherical::tables::{Form, Layout};
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

    fn decode(file: &Tensors, form: Option<&Value>) -> Result<Vec<Self>, String> {
        let form = form.ok_or("its metadata has no \"form\", which a spherical library needs")?;
        let StoredForm { form, store } = Deserialize::deserialize(form)
            .map_err(|e| format!("its \"glimt\" metadata is broken: the form: {e}"))?;
        store.validate()?;
        let layout = Arc::new(Layout::new(form)?);
        let networks = networks(file, form.inputs())?;
        let clusters = cluster_numbers(file, networks.len())?;
        let links = links(file, layout.places().len())?;
        let kept = |i: usize| {
            let last = |links: &Vec<u32>| links.iter().max().map_or(0, |&row| row as usize + 1);
            links.as_ref().map_or(layout.places().len(), |links| last(&links[i]))
        };
        let kept: Vec<usize> = (0..file.materials()).map(kept).collect();
        let stores = stores(file, store, form, &kept, &clusters, networks.len())?;
        let bounds = file.numbers("bound")?;
        file.each(|i| {
            let links = links.as_ref().map(|links| links[i].clone());
            let features = Features { store: stores[i].clone(), links };
            Spherical::new(layout.clone(), networks[clusters[i]].clone(), features, bounds[i])
        })
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

fn networks(file: &Tensors, inputs: usize) -> Result<Vec<Arc<Network>>, String> {
    let mut stacks: Vec<[Numbers; 2]> = Vec::new();
    while file.has(&format!("network.{}.weight", stacks.len())) {
        let name = |part: &str| format!("network.{}.{part}", stacks.len());
        stacks.push([file.floats(&name("weight"), &FLOATS)?, file.floats(&name("bias"), &FLOATS)?]);
    }
    let count = stacks.first().and_then(|[weight, _]| weight.shape.first().copied()).unwrap_or(0);
    if !(1..=file.materials()).contains(&count) {
        let materials = file.materials();
        return Err(format!(
            "it has {count} networks, expected 1 to {materials}, the number of its materials"
        ));
    }
    let network = |index| {
        let layers = stacks.iter().map(|stack| layer_at(stack, Some(count), index));
        let activation = file.activation_or(Activation::HardGelu);
        Network::new(layers.collect::<Result<_, _>>()?, inputs, activation).map(Arc::new)
    };
    (0..count).map(network).collect()
}

fn cluster_numbers(file: &Tensors, networks: usize) -> Result<Vec<usize>, String> {
    let materials = file.materials();
    if networks == 1 {
        return Ok(vec![0; materials]);
    }
    if networks == materials {
        return Ok((0..materials).collect());
    }
    let (_, shape, bytes) = file.bytes("cluster", &[Dtype::U16])?;
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
    let (_, shape, bytes) = file.bytes("links", &[Dtype::U32])?;
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

/// The stores of all materials, of which the i-th keeps `kept[i]` rows.
fn stores(
    file: &Tensors,
    kind: StoreKind,
    form: Form,
    kept: &[usize],
    clusters: &[usize],
    networks: usize,
) -> Result<Vec<Store>, String> {
    let k = usize::from(form.features);
    let counts: Vec<usize> = match kind {
        StoreKind::Codebook(bits) => kept.iter().map(|rows| (rows * usize::from(bits)).div_ceil(8)).collect(),
        StoreKind::I4 => kept.iter().map(|rows| rows * k / 2).collect(),
        StoreKind::F32 => kept.iter().map(|rows| rows * k * 4).collect(),
        StoreKind::F16 => kept.iter().map(|rows| rows * k * 2).collect(),
        StoreKind::I8 => kept.iter().map(|rows| rows * k).collect(),
    };
    let name = if matches!(kind, StoreKind::Codebook(_)) { "indices" } else { "features" };
    let (_, _, bytes) = file.bytes(name, &[dtype(kind)])?;
    let expected: usize = counts.iter().sum();
    if bytes.len() != expected {
        return Err(format!("the tensor \"{name}\" has {} bytes, expected {expected}", bytes.len()));
    }
    let mut rest = bytes;
    let parts = counts.iter().map(|&count| {
        let (part, after) = rest.split_at(count);
        rest = after;
        part
    });
    let parts: Vec<&[u8]> = parts.collect();
    let scales = match kind.largest() {
        None => Vec::new(),
        Some(_) => {
            let scales = file.take("scales")?;
            let expected = [file.materials(), form.grids.tables(), k];
            if scales.shape != expected {
                return Err(scales.unexpected_shape(&format!("{expected:?}")));
            }
            scales.data.chunks_exact(expected[1] * k).map(<[f32]>::to_vec).collect()
        }
    };
    let codebooks = match kind {
        StoreKind::Codebook(bits) => codebooks(file, networks, 1 << bits, k)?,
        _ => Vec::new(),
    };
    Ok(parts
        .into_iter()
        .enumerate()
        .map(|(i, bytes)| match kind {
            StoreKind::F32 => {
                Store::F32(bytes.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect())
            }
            StoreKind::F16 => {
                Store::F16(bytes.as_chunks().0.iter().map(|&b| f16::from_le_bytes(b)).collect())
            }
            StoreKind::I8 => {
                let integers = bytes.iter().map(|&b| b as i8).collect();
                Store::Scaled { kind, integers, scales: scales[i].clone() }
            }
            StoreKind::I4 => {
                let integers = bytes.iter().flat_map(|&b| from_nibbles(b)).collect();
                Store::Scaled { kind, integers, scales: scales[i].clone() }
            }
            StoreKind::Codebook(bits) => {
                let indices = unpack(bytes, bits, kept[i]);
                Store::Indexed { bits, indices, codebook: codebooks[clusters[i]].clone() }
            }
        })
        .collect())
}

fn codebooks(file: &Tensors, count: usize, size: usize, k: usize) -> Result<Vec<Arc<Codebook>>, String> {
    let (_, shape, bytes) = file.bytes("codebook", &[Dtype::F16])?;
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
    use crate::models::spherical::tables::Grids;
    use crate::models::spherical::tests::{form, material};
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
                    for (before, after) in library.entries().iter().zip(back.entries()) {
                        let (l, v) = (Vec3::new(0.48, 0.6, 0.64), Vec3::new(-0.6, 0.0, 0.8));
                        assert_eq!(before.material.eval(l, v), after.material.eval(l, v), "{kind:?}");
                    }
                    assert_eq!(library.tensor_bytes(), back.tensor_bytes());
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
        let tensors = library.tensors();
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
        for (before, after) in library.entries().iter().zip(back.entries()) {
            assert_eq!(before.material.eval(l, v), after.material.eval(l, v));
        }
        assert_ne!(back.entries()[0].material.eval(l, v), back.entries()[1].material.eval(l, v));
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

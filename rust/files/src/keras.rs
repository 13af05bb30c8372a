//! Weights of a network as Keras stores them in HDF5: a group for every layer with the datasets
//! `kernel:0`, [inputs][outputs], and `bias:0`.

use hdf5_reader::group::Group;
use hdf5_reader::{Dataset, Hdf5File};

use crate::npy::Array;

/// First bytes of an HDF5 file.
pub const MAGIC: &[u8; 8] = b"\x89HDF\r\n\x1a\n";

/// Deepest nesting of groups: Keras' own files have at most four levels.
const MAX_DEPTH: usize = 8;

/// Most groups that are looked into; Keras' own files have a dozen. A group may hold itself many times over.
const MAX_GROUPS: usize = 256;

/// Most names of groups and datasets times most entries of the trees that point to them. Trees may point to the
/// same names again and again.
const MAX_LISTED: usize = 1 << 16;

/// Most numbers of an array: more than the weights of a layer of the widest network. A file need not hold
/// what it claims, and is not believed beyond this.
const MAX_NUMBERS: u64 = 1 << 14;

/// A dense layer.
#[derive(Clone, Debug, PartialEq)]
pub struct Dense {
    /// [inputs][outputs].
    pub kernel: Array,
    /// [outputs].
    pub bias: Array,
}

/// The dense layers of a file in their order, by the numbers in their names (`dense_1`, `dense_2` …).
///
/// # Errors
/// In words, a file that is broken or holds other types than float32 and float64.
pub fn dense_layers(bytes: &[u8]) -> Result<Vec<Dense>, String> {
    check_nodes(bytes)?;
    let file = Hdf5File::from_bytes(bytes).map_err(|error| error.to_string())?;
    let root = file.root_group().map_err(|error| error.to_string())?;
    let mut found = Found::default();
    found.collect(&root, 0, 0)?;
    found.layers.sort_by_key(|&(number, _)| number);
    Ok(found.layers.into_iter().map(|(_, layer)| layer).collect())
}

/// Refuses files with which the HDF5 reader would take long or much memory: it makes room for as many names as a
/// node claims to list, and follows trees wherever they lead.
fn check_nodes(bytes: &[u8]) -> Result<(), String> {
    /// Fewest bytes of a name's entry.
    const ENTRY: usize = 32;
    let number =
        |at: usize| bytes.get(at..at + 2).map_or(0, |b| usize::from(u16::from_le_bytes([b[0], b[1]])));
    let (mut names, mut children) = (0, 0);
    for (at, signature) in bytes.windows(4).enumerate() {
        if signature == b"SNOD" {
            let claimed = number(at + 6);
            if claimed * ENTRY > bytes.len() - at {
                return Err(format!(
                    "a node at {at} claims to list {claimed} names, and the file is shorter"
                ));
            }
            names += claimed;
        } else if signature == b"TREE" {
            if bytes.get(at + 5).is_some_and(|&level| level > 0) {
                return Err(format!("the tree at {at} has several levels, expected one"));
            }
            children += number(at + 6);
        }
    }
    if names * children > MAX_LISTED {
        return Err(format!("its trees point {children} times to {names} names, expected fewer of both"));
    }
    Ok(())
}

/// What was found so far.
#[derive(Default)]
struct Found {
    groups: usize,
    layers: Vec<(u64, Dense)>,
}

impl Found {
    /// Adds the layers below `group`, each with the number that its name or that of a group around it ends in.
    fn collect(&mut self, group: &Group, number: u64, depth: usize) -> Result<(), String> {
        if depth > MAX_DEPTH {
            return Err(format!("its groups are nested more than {MAX_DEPTH} deep"));
        }
        self.groups += 1;
        if self.groups > MAX_GROUPS {
            return Err(format!("it has more than {MAX_GROUPS} groups"));
        }
        let number = trailing_number(group.name()).unwrap_or(number);
        let (groups, datasets) = group.members().map_err(|error| error.to_string())?;
        let named = |name: &str| datasets.iter().find(|dataset| last_part(dataset.name()) == name);
        if let (Some(kernel), Some(bias)) = (named("kernel:0"), named("bias:0")) {
            self.layers.push((number, Dense { kernel: read(kernel)?, bias: read(bias)? }));
        }
        groups.iter().try_for_each(|group| self.collect(group, number, depth + 1))
    }
}

fn read(dataset: &Dataset) -> Result<Array, String> {
    let count = dataset.shape().iter().try_fold(1, |n: u64, &axis| n.checked_mul(axis));
    if count.is_none_or(|count| count > MAX_NUMBERS) {
        return Err(format!(
            "the dataset {} claims the shape {:?}, expected at most {MAX_NUMBERS} numbers",
            dataset.name(),
            dataset.shape()
        ));
    }
    if let Ok(values) = dataset.read_array::<f64>() {
        let narrowed = values.iter().map(|&value| value as f32).collect();
        return Ok(Array { shape: values.shape().to_vec(), values: narrowed });
    }
    let values = dataset.read_array::<f32>().map_err(|error| {
        format!("the dataset {} is no array of float32 or float64: {error}", dataset.name())
    })?;
    Ok(Array { shape: values.shape().to_vec(), values: values.iter().copied().collect() })
}

fn last_part(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

fn trailing_number(name: &str) -> Option<u64> {
    let digits = name.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    name[digits..].parse().ok()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use hdf5_writer::{DatasetBuilder, Hdf5Builder, WriteOptions};

    /// An HDF5 file of these datasets.
    pub(crate) fn file(datasets: &[(String, &Array)]) -> Vec<u8> {
        let mut builder = Hdf5Builder::new();
        for (name, array) in datasets {
            let shape: Vec<u64> = array.shape.iter().map(|&axis| axis as u64).collect();
            builder = builder.dataset(DatasetBuilder::typed_data(name, shape, &array.values).unwrap());
        }
        builder.into_plan().unwrap().encode(WriteOptions::default()).unwrap()
    }

    #[test]
    fn layers_come_in_the_order_of_their_numbers() {
        let kernel = |value| Array { shape: vec![2, 1], values: vec![value, -value] };
        let bias = Array { shape: vec![1], values: vec![0.5] };
        let kernels: Vec<Array> = [9.0, 10.0, 11.0].map(kernel).to_vec();
        let mut datasets = Vec::new();
        for kernel in &kernels {
            let name = format!("dense_{}", kernel.values[0]);
            datasets.push((format!("model_weights/{name}/{name}/kernel:0"), kernel));
            datasets.push((format!("model_weights/{name}/{name}/bias:0"), &bias));
        }
        let layers = dense_layers(&file(&datasets)).unwrap();
        assert_eq!(layers.iter().map(|layer| layer.kernel.clone()).collect::<Vec<_>>(), kernels);
        assert!(layers.iter().all(|layer| layer.bias == bias));
    }

    #[test]
    fn what_keras_reads_is_read() {
        let builder = |name: &str, shape: Vec<u64>, values: &[f64]| {
            DatasetBuilder::typed_data(name, shape, values).unwrap()
        };
        let kernel = builder("dense_1/dense_1/kernel:0", vec![2, 1], &[0.5, -0.25]);
        let builder =
            Hdf5Builder::new().dataset(kernel).dataset(builder("dense_1/dense_1/bias:0", vec![1], &[2.0]));
        let mut bytes = builder.into_plan().unwrap().encode(WriteOptions::default()).unwrap();
        bytes.extend(b"bytes after the end");
        let dense = Dense {
            kernel: Array { shape: vec![2, 1], values: vec![0.5, -0.25] },
            bias: Array { shape: vec![1], values: vec![2.0] },
        };
        assert_eq!(dense_layers(&bytes), Ok(vec![dense]));
    }

    #[test]
    fn nodes_that_claim_more_than_the_file_holds_are_refused() {
        let refused = |node: &[u8]| check_nodes(&[node, &[0; 4000]].concat()).unwrap_err();
        assert!(refused(b"SNOD\x01\0\xff\xff").contains("claims to list 65535 names"));
        assert!(refused(b"TREE\0\x01\x02\0").contains("several levels"));
        assert!(refused(b"SNOD\x01\0\x64\0TREE\0\0\xe8\x03").contains("1000 times to 100 names"));
        assert_eq!(check_nodes(b"SNOD\x01\0\0\0 and SNOD"), Ok(()));
    }

    #[test]
    fn what_is_broken_is_refused() {
        let array = Array { shape: vec![3], values: vec![1.0; 3] };
        let bytes = file(&[("dense_1/bias:0".to_owned(), &array)]);
        assert_eq!(dense_layers(&bytes), Ok(Vec::new()));
        assert!(dense_layers(&bytes[..bytes.len() / 2]).is_err());
        assert!(dense_layers(b"text").is_err());
    }
}

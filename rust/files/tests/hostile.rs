//! Every reader on the corpus of the fuzz targets, and on mutations of it: what `fuzz/run` does at length.

use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::Arc;

use glimt_core::kernels::network::{Activation, Layer, Network};
use glimt_core::library::{Entry, Origin};
use glimt_core::microfacet::Microfacet;
use glimt_core::models::factor::{DIFF_BINS, Factor, Factors, HALF_BINS, Interpolation};
use glimt_core::models::ggx::Ggx;
use glimt_core::models::hybrid::{Form, Hybrid};
use glimt_core::{Kind, Library, Material};

#[path = "../../../fuzz/src/readers.rs"]
mod readers;

use readers::{READERS, with_peak};

/// Files of a reader's corpus.
fn corpus(reader: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus").join(reader);
    let paths = std::fs::read_dir(&folder).unwrap().map(|file| file.unwrap().path());
    let mut files: Vec<_> = paths.map(|path| (path.clone(), std::fs::read(path).unwrap())).collect();
    files.sort();
    files
}

#[test]
fn every_corpus_is_read_within_its_memory() {
    for (name, read) in READERS {
        let accepted = corpus(name).iter().filter(|(_, bytes)| read(bytes)).count();
        assert!(accepted > 0, "no file of the corpus {name} is accepted");
    }
}

#[test]
fn the_corpus_of_libraries_has_every_model_that_a_library_can_hold() {
    let opened =
        corpus("library").into_iter().filter_map(|(path, bytes)| Library::from_bytes(path, &bytes).ok());
    let found: HashSet<Kind> = opened.map(|library| library.kind()).collect();
    let missing: Vec<Kind> =
        Kind::ALL.into_iter().filter(|kind| *kind != Kind::Tabulated && !found.contains(kind)).collect();
    assert!(
        missing.is_empty(),
        "fuzz/corpus/library has no {missing:?}; the example export_catalogue of glimt-check writes some"
    );
}

/// Reads every truncation, and `rounds` times as many random changes of one to four bytes as a file has.
fn mutate(rounds: usize) {
    // A linear congruential generator (Knuth, MMIX): the same mutations in every run.
    let mut state = 1_u64;
    let mut random = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    for (name, read) in READERS {
        for (_, bytes) in corpus(name) {
            for length in 0..bytes.len() {
                read(&bytes[..length]);
            }
            for _ in 0..rounds * bytes.len() {
                let mut mutated = bytes.clone();
                for _ in 0..=random(4) {
                    let at = random(bytes.len());
                    mutated[at] = match random(3) {
                        0 => random(256) as u8,
                        1 => bytes[at] ^ (1 << random(8)),
                        _ => [0, 1, 0x7f, 0x80, 0xff, b'9', b'-', b'"'][random(8)],
                    };
                }
                read(&mutated);
            }
        }
    }
}

#[test]
fn mutated_files_are_an_error_or_keep_every_promise() {
    mutate(1);
}

#[test]
#[ignore = "long: a hundred times as many mutations"]
fn many_mutated_files_are_an_error_or_keep_every_promise() {
    mutate(100);
}

/// Peak memory over the file's length, when a library of these materials is read.
fn memory_of_library(name: &str, materials: impl Iterator<Item = Material>) -> f64 {
    let named = |(i, material)| Entry { name: format!("{name} {i}"), material, origin: Origin::default() };
    let entries: Vec<Entry> = materials.enumerate().map(named).collect();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("library.safetensors");
    Library::new(&path, entries).unwrap().save().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let (library, used) = with_peak(|| Library::from_bytes(&path, &bytes));
    assert!(library.is_ok());
    let ratio = used as f64 / bytes.len() as f64;
    println!("{name}: a file of {} bytes takes {used} bytes to read, {ratio:.1} times as much", bytes.len());
    ratio
}

/// `cargo test -p glimt-files --test hostile memory -- --nocapture` prints the figures of docs/notes/hostile-files.md.
#[test]
fn numbers_of_a_library_take_the_memory_that_they_are_worth_and_its_header_more() {
    let parameters = Microfacet { kd: [0.2; 3], eta: [1.5; 3], alpha: [0.1; 2] };
    let many = (0..5000).map(|_| Material::from(Ggx::new(parameters).unwrap()));
    let header = memory_of_library("5000 materials", many);
    let table = Factors::Bivariate(vec![[0.5; 3]; HALF_BINS * DIFF_BINS]);
    let table = Factor::new(table, Interpolation::Linear).unwrap();
    let table = memory_of_library("a table", std::iter::once(table.into()));
    // Networks of their own, so that numbers outweigh names.
    let form = Form::PAPER;
    let networks = (0..20).map(|i| {
        let sizes = [form.features() + 4, 64, 64, 64, form.composition.outputs()];
        let layer = |w: &[usize]| Layer { weight: vec![0.01 * i as f32; w[0] * w[1]], bias: vec![0.0; w[1]] };
        let layers = sizes.windows(2).map(layer).collect();
        let network = Network::new(layers, form.features(), Activation::HardGelu).unwrap();
        Hybrid::new(form, Arc::new(network), parameters, vec![0.0; 4], 1.0).unwrap().into()
    });
    let networks = memory_of_library("20 networks", networks);
    assert!(table < 6.0 && networks < 6.0 && header < 24.0);
}

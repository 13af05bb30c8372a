//! What a library keeps, what it refuses, and how much of it is read.

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
    let sides = [Vec3::new(0.48, 0.36, 0.8), Vec3::new(-0.6, 0.0, 0.8), Vec3::new(0.0, 0.8, 0.6), Vec3::Z];
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
        let [a, mut b] = Activation::ALL.map(|activation| libraries_of(kind, activation).remove(0).remove(0));
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

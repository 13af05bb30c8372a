//! Every reader on the corpus of the fuzz targets, and on mutations of it: what `fuzz/run` does at length.

use std::path::PathBuf;

#[path = "../../../fuzz/src/readers.rs"]
mod readers;

use readers::READERS;

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

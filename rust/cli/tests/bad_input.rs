//! Bad input of every kind: the right exit code, one line that names the file, and nothing written.

mod common;

use common::Folder;

const EVAL: [&str; 4] = ["--pairs", "pairs.npy", "-o", "f.npy"];

fn eval<'a>(file: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["eval", file], more, &EVAL].concat()
}

#[test]
fn files_that_are_not_there_or_not_known() {
    let folder = Folder::new();
    for file in ["none.safetensors", "none.bsdf", "none.npz", "none"] {
        for command in [eval(file, &[]), vec!["info", file], vec!["convert", file, "x.bin"]] {
            let line = folder.fails(1, &command);
            assert!(line.contains(file) && line.contains("No such file"), "{line}");
        }
    }
    std::fs::write(folder.path("notes.txt"), "hello").unwrap();
    let line = folder.fails(1, &["info", "notes.txt"]);
    assert!(line.contains("notes.txt") && line.contains("expected a model library"), "{line}");
    let line = folder.fails(1, &["info", "pairs.npy"]);
    assert!(line.contains("pairs.npy is not an array (n, 9) of scattered samples"), "{line}");
    let line = folder.fails(1, &["info", "*.bsdf"]);
    assert!(line.contains("*.bsdf matches no file"), "{line}");
}

#[test]
#[cfg(unix)]
fn devices_and_pipes_are_no_files() {
    let folder = Folder::new();
    for ending in ["safetensors", "bsdf", "binary", "bin", "csv", "npy", "npz", "h5", "fit"] {
        let file = format!("zero.{ending}");
        std::os::unix::fs::symlink("/dev/zero", folder.path(&file)).unwrap();
        let line = folder.fails(1, &["info", &file]);
        assert!(line.contains(&file) && line.contains("not a regular file"), "{line}");
    }
}

#[test]
fn broken_files_of_every_format() {
    let folder = Folder::new();
    folder.warns(&["convert", "cloth.bin", "cloth.binary"]);
    let library = std::fs::read(folder.path("lib.safetensors")).unwrap();
    let merl = std::fs::read(folder.path("cloth.binary")).unwrap();
    let mut nan = library.clone();
    let end = nan.len();
    nan[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    let catalogue: [(&str, &[u8]); 7] = [
        ("cut.safetensors", &library[..library.len() - 7]),
        ("nan.safetensors", &nan),
        ("empty.safetensors", b""),
        ("cut.binary", &merl[..merl.len() / 2]),
        ("cut.bsdf", b"tensor_file\0"),
        ("short.bin", b"12345678"),
        ("broken.npz", b"PK\x03\x04and no more"),
    ];
    for (file, bytes) in catalogue {
        std::fs::write(folder.path(file), bytes).unwrap();
        let fit = ["fit", file, "-o", "new.safetensors"];
        for command in [eval(file, &[]), vec!["info", file], vec!["convert", file, "x.bin"], fit.to_vec()] {
            let line = folder.fails(1, &command);
            assert!(line.contains(file), "{line}");
        }
    }
    let line = folder.fails(1, &["info", "nan.safetensors"]);
    assert!(line.contains("NaN"), "{line}");
}

#[test]
fn materials_that_are_not_there() {
    let folder = Folder::new();
    let line = folder.fails(1, &eval("lib.safetensors", &["--material", "ornage"]));
    assert!(line.contains("lib.safetensors") && line.contains("did you mean orange?"), "{line}");
    let line = folder.fails(1, &eval("lib.safetensors", &[]));
    assert!(line.contains("3 materials") && line.contains("orange, mint, grey"), "{line}");
    let line = folder.fails(1, &eval("cloth.bin", &["--material", "silk"]));
    assert!(line.contains("cloth.bin") && line.contains("it holds cloth"), "{line}");
    let line = folder.fails(1, &["convert", "lib.safetensors", "x.binary"]);
    assert!(line.contains("x.binary holds one material, but there are 3"), "{line}");
}

#[test]
fn outputs_that_cannot_be_written_are_found_before_the_work() {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("taken")).unwrap();
    for (out, reason) in [("missing/out", "No such file"), ("taken", "it is a directory")] {
        // Inputs that are missing too: the output is looked at first.
        for command in [
            vec!["eval", "none", "--pairs", "none", "-o", out],
            vec!["sample", "none", "--view", "0,0,1", "-n", "5", "-o", out],
            vec!["convert", "none", out, "--to", "library"],
            vec!["fit", "none", "-o", out],
            vec!["add", "lib.safetensors", "none", "-o", out],
        ] {
            let line = folder.fails(1, &command);
            assert!(line.contains("cannot write") && line.contains(reason), "{line}");
        }
    }
}

#[test]
fn pairs_of_wrong_shape_type_or_length() {
    let folder = Folder::new();
    folder.array("pairs.npy", &[2, 3], &[0.0; 6]);
    let line = folder.fails(1, &eval("cloth.bin", &[]));
    assert!(line.contains("pairs.npy has the shape [2, 3], expected [n, 6]"), "{line}");
    folder.array("pairs.npy", &[2, 6], &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0, 1.0]);
    let line = folder.fails(1, &eval("cloth.bin", &[]));
    assert!(line.contains("pairs.npy: the light of row 1 has length 2"), "{line}");
    let header = b"\x93NUMPY\x01\x00\x3c\x00{'descr': '<c16', 'fortran_order': False, 'shape': (1, 6), }";
    std::fs::write(folder.path("pairs.npy"), [&header[..], &[0; 96]].concat()).unwrap();
    let line = folder.fails(1, &eval("cloth.bin", &[]));
    assert!(line.contains("pairs.npy is not a NumPy array") && line.contains("<c16"), "{line}");
    std::fs::write(folder.path("pairs.npy"), "text").unwrap();
    assert!(folder.fails(1, &eval("cloth.bin", &[])).contains("pairs.npy is not a NumPy array"));
}

#[test]
fn conversions_that_make_no_sense() {
    let folder = Folder::new();
    let line = folder.fails(1, &["convert", "cloth.bin", "new.safetensors"]);
    assert!(line.contains("cannot hold a measurement") && line.contains("glimt fit"), "{line}");
    let line = folder.fails(1, &["convert", "lib.safetensors", "lib.safetensors", "new.safetensors"]);
    assert!(line.contains("two materials are named \"orange\""), "{line}");
    let line = folder.fails(2, &["convert", "lib.safetensors", "picture.png"]);
    assert!(line.contains("picture.png names no format"), "{line}");
    let line = folder.fails(2, &["convert", "lib.safetensors"]);
    assert!(line.contains("expected IN and OUT"), "{line}");
}

#[test]
fn fits_that_make_no_sense() {
    let folder = Folder::new();
    let fit = |more: &[&'static str]| [&["fit", "-o", "new.safetensors", "cloth.bin"], more].concat();
    let line = folder.fails(2, &fit(&["--model", "ggx", "--net", "32x2"]));
    assert!(line.contains("--net does not apply to --model ggx"), "{line}");
    let line = folder.fails(2, &fit(&["--model", "neural", "--reciprocal"]));
    assert!(line.contains("--reciprocal does not apply to --model neural"), "{line}");
    let line = folder.fails(2, &fit(&["--net", "32"]));
    assert!(line.contains("32x2"), "{line}");
    let line = folder.fails(2, &fit(&["--net", "17x9"]));
    assert!(line.contains("expected 16, 32 or 64 times 2 or 3"), "{line}");
    let line = folder.fails(1, &fit(&["cloth.bin"]));
    assert!(line.contains("two materials are named \"cloth\""), "{line}");
    let line = folder.fails(1, &fit(&["--resume"]));
    assert!(line.contains("new.safetensors.checkpoint") && line.contains("leave --resume out"), "{line}");
    let line = folder.fails(1, &["add", "lib.safetensors", "cloth.bin"]);
    assert!(line.contains("lib.safetensors holds ggx materials"), "{line}");
}

#[test]
fn bad_usage_has_its_own_exit_code() {
    let folder = Folder::new();
    for command in [
        vec!["eval"],
        vec!["draw"],
        vec!["sample", "cloth.bin", "--view", "0,0", "-n", "1", "-o", "s.npy"],
        vec!["sample", "cloth.bin", "--view", "0,0,-1", "-n", "1", "-o", "s.npy"],
        vec!["sample", "cloth.bin", "--view", "a,b,c", "-n", "1", "-o", "s.npy"],
        vec!["sample", "cloth.bin", "--view", "0,0,1", "-n", "-1", "-o", "s.npy"],
        vec!["info", "cloth.bin", "--threads", "0"],
    ] {
        folder.fails(2, &command);
    }
    assert!(folder.succeeds(&["--help"]).contains("Usage: glimt"));
    for command in ["fit", "add", "info", "eval", "sample", "convert"] {
        assert!(folder.succeeds(&[command, "--help"]).contains(&format!("Usage: glimt {command}")));
    }
    assert!(folder.succeeds(&["--version"]).starts_with("glimt "));
}

#[test]
fn output_that_nobody_reads_is_no_error() {
    let folder = Folder::new();
    let mut child = folder.command(&["info", "."]).stdout(std::process::Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
}

#[test]
fn scattered_samples_answer_no_other_directions() {
    let folder = Folder::new();
    std::fs::write(folder.path("scan.csv"), "0,0,1,0,0,1,0.5,0.5,0.5\n").unwrap();
    let line = folder.fails(1, &eval("scan.csv", &[]));
    assert!(line.contains("scan.csv holds scattered samples") && line.contains("glimt fit"), "{line}");
    std::fs::write(folder.path("scan.csv"), "0,0,1,0,0,1,0.5\n").unwrap();
    let line = folder.fails(1, &["info", "scan.csv"]);
    assert!(line.contains("line 1: 7 columns, expected 9"), "{line}");
}

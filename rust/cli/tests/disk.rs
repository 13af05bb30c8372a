//! What commands do to the files that are there: nothing is lost, whoever else writes and whatever fails.
#![cfg(unix)]

mod common;

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, TryLockError};
use std::io::Write;
use std::os::unix::ffi::OsStringExt;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};

use common::{Folder, ggx};
use glimt_core::library::{Entry, Origin};
use glimt_core::{Library, Material};

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Runs `script` of the shell, in which `$@` is a command of glimt.
fn shell(folder: &Folder, script: &str, arguments: &[&str]) -> Output {
    let mut shell = Command::new("sh");
    shell.args(["-c", script, "sh", env!("CARGO_BIN_EXE_glimt")]).args(arguments);
    shell.current_dir(folder.path("")).output().unwrap()
}

/// Saves a library of one material under any name.
fn save(path: impl Into<PathBuf>, name: &str) {
    let origin = Origin { source: name.to_owned(), ..Origin::default() };
    let entry = Entry { name: name.to_owned(), material: Material::from(ggx([0.5; 3])), origin };
    Library::new(path, vec![entry]).unwrap().save().unwrap();
}

/// A library of a network, to which can be added, and `count` materials in `new0.safetensors` ….
fn addable(count: usize) -> Folder {
    let folder = Folder::new();
    folder.succeeds(&["fit", "--net", "16x2", "--steps", "20", "-o", "fit.safetensors", "lib.safetensors"]);
    for i in 0..count {
        save(folder.path(&format!("new{i}.safetensors")), &format!("new{i}"));
    }
    folder
}

#[test]
fn materials_added_at_once_are_all_in_the_library() {
    const PROCESSES: usize = 5;
    let folder = addable(PROCESSES);
    let before = folder.files();
    let add = |i: usize| {
        let mut command = folder.command(&["add", "fit.safetensors", "--steps", "20"]);
        command
            .arg(format!("new{i}.safetensors"))
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    };
    let children: Vec<_> = (0..PROCESSES).map(add).collect();
    for child in children {
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let mut names = Library::open(folder.path("fit.safetensors")).unwrap().names();
    names.sort();
    assert_eq!(names, ["grey", "mint", "new0", "new1", "new2", "new3", "new4", "orange"]);
    assert_eq!(folder.files(), before);
}

#[test]
fn a_process_that_was_killed_blocks_nobody() {
    let folder = addable(2);
    let mut child = folder
        .command(&["add", "fit.safetensors", "new0.safetensors", "--steps", "1000000000"])
        .spawn()
        .unwrap();
    let library = File::open(folder.path("fit.safetensors")).unwrap();
    while !matches!(library.try_lock(), Err(TryLockError::WouldBlock)) {
        library.unlock().unwrap();
        std::thread::yield_now();
    }
    child.kill().unwrap();
    child.wait().unwrap();
    folder.succeeds(&["add", "fit.safetensors", "new1.safetensors", "--steps", "20"]);
    let names = Library::open(folder.path("fit.safetensors")).unwrap().names();
    assert_eq!(names, ["orange", "mint", "grey", "new1"]);
}

/// Commands that read `lib.safetensors` and `cloth.bin`, up to the name of their output.
const WRITERS: [(&[&str], &str); 7] = [
    (&["fit", "--model", "ggx", "lib.safetensors", "cloth.bin", "-o"], "a model library"),
    (&["add", "lib.safetensors", "cloth.bin", "-o"], "a model library"),
    (&["eval", "cloth.bin", "--pairs", "pairs.npy", "-o"], "a NumPy array"),
    (&["sample", "cloth.bin", "--view", "0,0,1", "-n", "5", "-o"], "a NumPy array"),
    (&["check", "cloth.bin", "--samples", "1000", "--html"], "a page of glimt"),
    (&["convert", "cloth.bin", "--to", "merl"], "a MERL table"),
    (&["convert", "cloth.bin", "--to", "library"], "a model library"),
];

#[test]
fn no_command_writes_over_what_it_reads() {
    let folder = Folder::new();
    let original = fs::read(folder.path("cloth.bin")).unwrap();
    symlink("cloth.bin", folder.path("symbolic")).unwrap();
    fs::hard_link(folder.path("cloth.bin"), folder.path("hard")).unwrap();
    let absolute = folder.path("cloth.bin").to_str().unwrap().to_owned();
    for output in ["cloth.bin", "./cloth.bin", &absolute, "symbolic", "hard"] {
        for (writer, _) in WRITERS {
            let line = folder.fails(1, &[writer, &[output, "--force"]].concat());
            assert!(line.contains("is read, and must not be overwritten"), "{writer:?} {output}: {line}");
        }
    }
    assert!(fs::read(folder.path("cloth.bin")).unwrap() == original);
    // Of several inputs each counts, and so do the files that belong to one.
    let pairs = ["eval", "cloth.bin", "--pairs", "pairs.npy", "-o", "pairs.npy"];
    assert!(folder.fails(1, &pairs).contains("is read"));
    let first = "paint_fc1.npy";
    for name in [first, "paint_b2.npy"] {
        folder.array(name, &[1, 1], &[0.0]);
    }
    let set = ["eval", first, "--pairs", "pairs.npy", "-o", "paint_b2.npy"];
    assert!(folder.fails(1, &set).contains("is read"));
    let here = folder.fails(1, &["convert", "cloth.bin", ".", "--to", "utia"]);
    assert!(here.contains("is read"), "{here}");
    let models = ["report", "cloth.bin", "out/libraries/ggx.safetensors", "--models", "ggx", "-o", "out"];
    fs::create_dir_all(folder.path("out/libraries")).unwrap();
    fs::copy(folder.path("lib.safetensors"), folder.path("out/libraries/ggx.safetensors")).unwrap();
    let line = folder.fails(1, &models);
    assert!(line.contains("is read"), "{line}");
}

#[test]
fn a_file_of_another_format_is_replaced_only_by_force() {
    let folder = Folder::new();
    let other = b"a measurement of another lab";
    for (writer, format) in WRITERS {
        fs::write(folder.path("other.bsdf"), other).unwrap();
        let line = folder.fails(1, &[writer, &["other.bsdf"]].concat());
        assert!(line.contains("cannot write other.bsdf") && line.contains(format), "{writer:?}: {line}");
        assert!(line.contains("--force"), "{line}");
        assert_eq!(fs::read(folder.path("other.bsdf")).unwrap(), other);
    }
    // The slip of a glob after -o.
    let line = folder.fails(1, &["fit", "-o", "cloth.bin", "lib.safetensors"]);
    assert!(line.contains("cloth.bin") && line.contains("is not a model library"), "{line}");
    let eval = ["eval", "cloth.bin", "--pairs", "pairs.npy", "-o", "other.bsdf"];
    folder.succeeds(&[&eval[..], &["--force"]].concat());
    // What an earlier run has written is no other format, and neither is an empty file.
    folder.succeeds(&eval);
    fs::write(folder.path("other.bsdf"), "").unwrap();
    folder.succeeds(&eval);
    fs::create_dir(folder.path("site")).unwrap();
    fs::write(folder.path("site/index.html"), "<!doctype html><title>my site</title>").unwrap();
    let line = folder.fails(1, &["report", "cloth.bin", "--models", "ggx", "-o", "site"]);
    assert!(line.contains("site/index.html") && line.contains("is not a page of glimt"), "{line}");
}

#[test]
fn a_full_disk_leaves_the_old_file() {
    let folder = Folder::new();
    let outputs = [
        (WRITERS[2].0, "f.npy"),
        (WRITERS[3].0, "s.npy"),
        (WRITERS[4].0, "page.html"),
        (WRITERS[5].0, "cloth.binary"),
        (&["convert", "lib.safetensors"][..], "copy.safetensors"),
        (&["fit", "--model", "ggx", "lib.safetensors", "-o"][..], "fit.safetensors"),
    ];
    for (writer, name) in outputs {
        // One of them warns.
        let output = shell(&folder, "exec \"$@\"", &[writer, &[name]].concat());
        assert!(output.status.success(), "{name}: {}", stderr(&output));
        let before = (folder.files(), fs::read(folder.path(name)).unwrap());
        // No file may have a byte, and the signal that says so is ignored, so that the write fails.
        let output = shell(&folder, "trap '' XFSZ; ulimit -f 0; exec \"$@\"", &[writer, &[name]].concat());
        assert_eq!(output.status.code(), Some(1), "{name}: {}", stderr(&output));
        let line = stderr(&output);
        assert!(line.contains(name) && line.contains("File too large"), "{line}");
        assert!(before == (folder.files(), fs::read(folder.path(name)).unwrap()), "{name}");
    }
}

#[test]
fn the_old_file_keeps_its_mode_and_its_links() {
    let folder = Folder::new();
    fs::create_dir(folder.path("real")).unwrap();
    fs::copy(folder.path("lib.safetensors"), folder.path("real/target")).unwrap();
    fs::set_permissions(folder.path("real/target"), fs::Permissions::from_mode(0o604)).unwrap();
    symlink("real/target", folder.path("link.safetensors")).unwrap();
    folder.succeeds(&["convert", "lib.safetensors", "link.safetensors", "--material", "mint"]);
    assert!(fs::symlink_metadata(folder.path("link.safetensors")).unwrap().is_symlink());
    assert_eq!(Library::open(folder.path("real/target")).unwrap().names(), ["mint"]);
    assert_eq!(fs::metadata(folder.path("real/target")).unwrap().permissions().mode() & 0o777, 0o604);
}

#[test]
fn messages_that_nobody_can_read_end_nothing() {
    let folder = Folder::new();
    fs::write(folder.path("black.csv"), "0,0,1,0,0,1,0,0,0\n").unwrap();
    let fit = ["fit", "--model", "ggx", "black.csv", "-o", "x.safetensors"];
    for script in ["exec \"$@\" 2>/dev/full", "exec \"$@\" 2>&-", "\"$@\" 2>&1 >/dev/null | true"] {
        let output = shell(&folder, script, &fit);
        assert_eq!(output.status.code(), Some(0), "{script}");
        fs::remove_file(folder.path("x.safetensors")).expect(script);
    }
    let failed = shell(&folder, "exec \"$@\" 2>/dev/full", &["info", "none"]);
    assert_eq!(failed.status.code(), Some(1));
    for arguments in [&["info", "lib.safetensors"][..], &["info", "lib.safetensors", "--json"], &["--help"]] {
        let output = shell(&folder, "exec \"$@\" >/dev/full", arguments);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(stderr(&output).contains("cannot write to the standard output"), "{}", stderr(&output));
    }
}

/// A name in Latin-1, which is no UTF-8.
fn latin(before: &str, after: &str) -> OsString {
    OsString::from_vec([before.as_bytes(), b"caf\xe9", after.as_bytes()].concat())
}

#[test]
fn names_in_other_encodings_work() {
    let folder = addable(0);
    let [measured, library] = [latin("", ".bin"), latin("", ".safetensors")];
    let place = |name: &OsStr| folder.path("").join(name);
    fs::copy(folder.path("cloth.bin"), place(&measured)).unwrap();
    let run = |arguments: &[&OsStr]| {
        let output = folder.command(&[]).args(arguments).output().unwrap();
        assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let words = |text: &'static str| text.split(' ').map(OsStr::new).collect::<Vec<_>>();
    let [input, output] = [measured.as_os_str(), library.as_os_str()];
    run(&[&words("fit --model ggx --json")[..], &[input, OsStr::new("-o"), output]].concat());
    let another = latin("another ", ".safetensors");
    save(place(&another), "another");
    run(&[&words("add fit.safetensors --steps 20")[..], &[&another]].concat());
    assert!(run(&[&words("info --json")[..], &[input, output]].concat()).contains("caf\u{fffd}"));
    run(&[&words("convert")[..], &[output, &latin("other ", ".binary")]].concat());
    let eval = words("eval --pairs pairs.npy -o");
    run(&[&eval[..], &[&latin("", ".npy"), input]].concat());
    run(&[&words("sample --view 0,0,1 -n 5 -o")[..], &[&latin("", ".npy"), input]].concat());
    run(&[&words("check --samples 1000 --html")[..], &[&latin("", ".html"), output]].concat());
    let report = words("report --pairs 1000 --size 16 --spp 1 --rounds 1 -o");
    run(&[&report[..], &[&latin("", ""), input, output]].concat());
    let simulated =
        folder.command(&["fit", "-o", "x.safetensors", "--from-mitsuba"]).arg(input).output().unwrap();
    assert_eq!(simulated.status.code(), Some(1));
    assert!(stderr(&simulated).contains("no name in UTF-8"), "{}", stderr(&simulated));
}

#[test]
fn names_do_not_command_the_terminal() {
    let folder = Folder::new();
    let name = "bad\u{1b}[31m\nname";
    let file = format!("{name}.safetensors");
    save(folder.path(&file), name);
    let shown = "bad\\u{1b}[31m\\nname";
    for command in [
        vec!["info", &file],
        vec!["check", &file, "--samples", "1000"],
        vec!["fit", "--model", "ggx", &file, "-o", "x.safetensors"],
    ] {
        let text = folder.succeeds(&command);
        assert!(text.contains(shown) && !text.contains('\u{1b}'), "{command:?}: {text}");
    }
    for arguments in
        [vec!["info", name], vec!["eval", &file, "--material", "\u{1b}x", "--pairs", "pairs.npy", "-o", "f"]]
    {
        let line = folder.fails(1, &arguments);
        assert!(line.contains("\\u{1b}") && !line.contains('\u{1b}'), "{line}");
    }
    assert!(!folder.fails(2, &["info", "--\u{1b}[31m"]).contains('\u{1b}'));
    for command in ["eval", "sample", "check", "convert"] {
        folder.fails(2, &[command, "cloth.bin", "--material", ""]);
    }
}

#[test]
fn a_dash_is_the_standard_input_or_output_where_that_makes_sense() {
    let folder = Folder::new();
    folder.succeeds(&["eval", "cloth.bin", "--pairs", "pairs.npy", "-o", "f.npy"]);
    let expected = fs::read(folder.path("f.npy")).unwrap();
    let pipe = |arguments: &[&str], input: &str| {
        let mut child =
            folder.command(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let bytes = fs::read(folder.path(input)).unwrap();
        child.stdin.take().unwrap().write_all(&bytes).unwrap();
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{arguments:?}");
        output.stdout
    };
    let before = folder.files();
    assert!(pipe(&["eval", "cloth.bin", "--pairs", "-", "-o", "-"], "pairs.npy") == expected);
    assert!(pipe(&["eval", "cloth.bin", "--pairs", "-", "-o", "/dev/stdout"], "pairs.npy") == expected);
    assert!(pipe(&["eval", "-", "--pairs", "pairs.npy", "-o", "-"], "cloth.bin") == expected);
    let samples = pipe(&["sample", "-", "--view", "0,0,1", "-n", "5", "-o", "-"], "cloth.bin");
    assert_eq!(glimt_files::Array::from_bytes(&samples).unwrap().shape, [5, 7]);
    let library = pipe(&["convert", "-", "-", "--to", "library"], "lib.safetensors");
    assert_eq!(Library::from_bytes("piped", &library).unwrap().names(), ["orange", "mint", "grey"]);
    let info = pipe(&["info", "--json", "-"], "lib.safetensors");
    let info: serde_json::Value = serde_json::from_slice(&info).unwrap();
    assert!(info["file"] == "-" && info["materials"][0]["name"] == "orange", "{info}");
    assert_eq!(folder.files(), before);
    for refused in [
        vec!["fit", "cloth.bin", "-o", "-"],
        vec!["fit", "-", "-o", "x.safetensors"],
        vec!["add", "-", "cloth.bin"],
        vec!["check", "-"],
        vec!["check", "cloth.bin", "--html", "-"],
        vec!["report", "cloth.bin", "-o", "-"],
        vec!["compare", "-", "-"],
        vec!["bench", "-"],
        vec!["eval", "-", "--pairs", "-", "-o", "-"],
    ] {
        let line = folder.fails(2, &refused);
        assert!(line.lines().next().unwrap().contains("standard input"), "{refused:?}: {line}");
    }
    assert!(folder.fails(1, &["info", "-", "cloth.bin"]).contains("./-"));
}

#[test]
fn a_second_run_does_not_read_what_the_first_has_written() {
    let folder = Folder::new();
    fs::remove_file(folder.path("lib.safetensors")).unwrap();
    let fit = ["fit", "--model", "ggx", "-o", "out.safetensors"];
    for inputs in [".", "*.[bs]*"] {
        let run = [&fit[..], &[inputs]].concat();
        folder.succeeds(&run);
        let first = fs::read(folder.path("out.safetensors")).unwrap();
        let second = folder.command(&run).output().unwrap();
        assert!(second.status.success(), "{}", stderr(&second));
        assert!(
            stderr(&second).contains("out.safetensors is written, and therefore not read"),
            "{}",
            stderr(&second)
        );
        assert!(fs::read(folder.path("out.safetensors")).unwrap() == first);
        fs::remove_file(folder.path("out.safetensors")).unwrap();
    }
    folder.succeeds(&[&fit[..], &["cloth.bin"]].concat());
    // As a shell expands it.
    let line = folder.fails(1, &[&fit[..], &["cloth.bin", "out.safetensors"]].concat());
    assert!(line.contains("out.safetensors is read, and must not be overwritten"), "{line}");
}

/// A fit of tables is interrupted with some materials finished, and goes on to the same bytes.
#[cfg(target_os = "linux")]
#[test]
fn an_interrupted_fit_of_tables_goes_on_to_the_same_library() {
    let folder = Folder::new();
    let fit =
        ["fit", "--model", "factor", "--variant", "bivariate", "-o", "tables.safetensors", "lib.safetensors"];
    let child = folder.command(&fit).stderr(Stdio::piped()).spawn().unwrap();
    let caught = || fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
    // SIGINT is the second bit of the mask of signals that are caught.
    let listens = |status: &str| {
        let mask = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
        mask.is_some_and(|mask| u64::from_str_radix(mask.trim(), 16).unwrap() & 2 != 0)
    };
    while !listens(&caught()) {
        std::thread::yield_now();
    }
    Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    let stopped = child.wait_with_output().unwrap();
    assert_eq!(stopped.status.code(), Some(1), "{}", stderr(&stopped));
    assert!(
        stderr(&stopped).contains("--resume goes on from tables.safetensors.checkpoint"),
        "{}",
        stderr(&stopped)
    );
    let line = folder.fails(1, &[&fit[..], &["--seed", "1", "--resume"]].concat());
    assert!(line.contains("other options"), "{line}");
    folder.succeeds(&[&fit[..], &["--resume"]].concat());
    assert!(!folder.files().contains(&"tables.safetensors.checkpoint".to_owned()));
    let resumed = fs::read(folder.path("tables.safetensors")).unwrap();
    folder.succeeds(&fit);
    assert!(resumed == fs::read(folder.path("tables.safetensors")).unwrap());
    assert!(folder.fails(1, &[&fit[..], &["--resume"]].concat()).contains("leave --resume out"));
}

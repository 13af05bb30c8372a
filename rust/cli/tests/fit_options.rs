//! Options of `glimt fit`: which apply to which model, errors as JSON, and what need not be fitted again.

mod common;

use common::Folder;
use glimt_core::Library;
use serde_json::Value;

fn fit<'a>(model: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["fit", "--model", model, "-o", "new.safetensors", "lib.safetensors"], more].concat()
}

#[test]
fn options_of_other_models_are_refused_with_the_models_that_have_them() {
    let folder = Folder::new();
    for (model, option, models) in [
        // At its default, too.
        ("hybrid", &["--nodes", "64"][..], "spherical"),
        ("hybrid", &["--variant", "naive"], "factor"),
        ("ggx", &["--net", "32x2"], "hybrid, neural, spherical and gated"),
        ("ggx", &["--steps", "100"], "hybrid, neural, spherical and gated"),
        ("ggx", &["--resume"], "hybrid, neural, factor, spherical and gated"),
        ("neural", &["--per-material"], "hybrid"),
        ("neural", &["--interpolation", "linear"], "factor and spherical"),
        ("factor", &["--rate", "0.1"], "hybrid, neural, spherical and gated"),
        ("factor", &["--hold-out", "0"], "ggx, hybrid, neural and spherical"),
        ("factor", &["--anisotropic"], "ggx, hybrid, neural and spherical"),
        ("factor", &["--paper"], "ggx, hybrid and neural"),
        ("spherical", &["--latent", "4"], "hybrid and neural"),
    ] {
        let line = folder.fails(2, &fit(model, option));
        let expected = format!("error: {} does not apply to --model {model}, but to {models}\n", option[0]);
        assert_eq!(line, expected);
    }
}

#[test]
fn interpolations_of_other_models_are_refused_with_those_that_apply() {
    let folder = Folder::new();
    let line = folder.fails(2, &fit("factor", &["--interpolation", "bilinear"]));
    assert!(
        line.contains("--interpolation bilinear") && line.contains("expected nearest or linear"),
        "{line}"
    );
    let line = folder.fails(2, &fit("spherical", &["--interpolation", "nearest"]));
    assert!(line.contains("expected bilinear or inverse-distance or constant"), "{line}");
}

#[test]
fn help_lists_the_values_of_every_option_under_the_models_that_have_it() {
    let folder = Folder::new();
    let help = folder.succeeds(&["fit", "--help"]);
    let section = |heading: &str| {
        let rest = help.split(&format!("\nOptions of {heading}:\n")).nth(1);
        rest.unwrap_or_else(|| panic!("{heading} in {help}")).split("\nOptions of ").next().unwrap()
    };
    for (heading, option, values) in [
        ("ggx, hybrid and neural", "--paper", &[][..]),
        ("hybrid, neural, spherical and gated", "--net", &["32x2"]),
        ("hybrid and neural", "--latent", &[]),
        ("hybrid", "--inputs", &["cartesian", "half-difference", "reciprocal"]),
        ("hybrid", "--composition", &["gated-residual", "additive", "log-multiplicative"]),
        ("factor", "--variant", &["independent-g", "g-from-d", "naive", "bivariate"]),
        (
            "factor and spherical",
            "--interpolation",
            &["nearest", "linear", "bilinear", "inverse-distance", "constant"],
        ),
        ("spherical", "--grids", &["lv", "hd", "iso"]),
        ("spherical", "--pixelation", &["healpix", "lat-long", "fibonacci"]),
        ("spherical", "--features", &["4", "8", "16"]),
        ("spherical", "--table-type", &["f32", "f16", "i8", "i4"]),
        ("gated", "--on", &["maps", "none"]),
        ("gated", "--precision", &["f32", "f16", "u8"]),
    ] {
        let section = section(heading);
        assert!(section.contains(option), "{option} under {heading}");
        values.iter().for_each(|value| assert!(section.contains(value), "{value} of {option}"));
    }
}

#[test]
fn errors_are_given_as_json_beside_the_table_or_instead_of_it() {
    let folder = Folder::new();
    let table = folder.succeeds(&fit("ggx", &["--json=errors.json"]));
    assert!(table.starts_with("material") && table.contains("mean"), "{table}");
    let file = std::fs::read_to_string(folder.path("errors.json")).unwrap();
    for option in ["--json", "--json=-"] {
        assert_eq!(folder.succeeds(&fit("ggx", &[option])), file, "{option}");
    }
    let json: Value = serde_json::from_str(&file).unwrap();
    let library = Library::open(folder.path("new.safetensors")).unwrap();
    let size = std::fs::metadata(folder.path("new.safetensors")).unwrap().len();
    assert_eq!((json["model"].as_str(), json["bytes"].as_u64()), (Some("ggx"), Some(size)));
    assert_eq!(json["shared_bytes"], 0);
    let materials = json["materials"].as_object().unwrap();
    assert_eq!(materials.len(), 3);
    let metric = |of: &Value, key: &str| of[key].as_f64().unwrap();
    let mut sum = 0.0;
    for entry in library.entries().unwrap() {
        let errors = &materials[&entry.name];
        assert_eq!(errors["bytes"], 28);
        for (key, value) in &entry.origin.metrics {
            assert_eq!(metric(errors, key), *value, "{key}");
        }
        sum += metric(errors, "smape");
        // What the table shows is what the file says.
        let row = table.lines().find(|line| line.starts_with(&entry.name)).unwrap();
        assert!(row.contains(&format!("{:.4}", metric(errors, "smape"))), "{row}");
    }
    assert!((metric(&json["mean"], "smape") - sum / 3.0).abs() < 1e-12);
    assert!(json["mean"]["bytes"].is_null());
}

#[test]
fn errors_of_added_materials_are_given_as_json_too() {
    let folder = Folder::new();
    folder.succeeds(&["fit", "--net", "16x2", "--steps", "20", "-o", "base.safetensors", "lib.safetensors"]);
    folder.succeeds(&["convert", "lib.safetensors", "--material", "grey", "slate.binary"]);
    let add = ["add", "base.safetensors", "slate.binary", "--steps", "10", "--json=errors.json"];
    assert!(folder.succeeds(&add).contains("slate"));
    let json: Value = serde_json::from_slice(&std::fs::read(folder.path("errors.json")).unwrap()).unwrap();
    assert_eq!(json["materials"].as_object().unwrap().keys().collect::<Vec<_>>(), ["slate"]);
    assert!(json["shared_bytes"].as_u64().unwrap() > 0);
}

#[test]
fn a_file_of_errors_replaces_nothing_else() {
    let folder = Folder::new();
    let line = folder.fails(1, &fit("ggx", &["--json=new.safetensors"]));
    assert!(line.contains("cannot be both the library and its errors"), "{line}");
    let line = folder.fails(1, &fit("ggx", &["--json=lib.safetensors"]));
    assert!(line.contains("lib.safetensors: it is there and is not JSON"), "{line}");
    let line = folder.fails(1, &fit("ggx", &["--json=lib.safetensors", "--force"]));
    assert!(line.contains("lib.safetensors is read, and must not be overwritten"), "{line}");
    let line = folder.fails(1, &fit("ggx", &["--json=missing/errors.json"]));
    assert!(line.contains("cannot write missing/errors.json"), "{line}");
}

/// A fit of two files, and whether it was skipped.
struct Again<'a>(&'a Folder);

impl Again<'_> {
    fn is_skipped(&self, more: &[&str]) -> bool {
        let command = ["fit", "--model", "ggx", "a.csv", "b.csv", "-o", "new.safetensors", "--if-changed"];
        let printed = self.0.succeeds(&[&command[..], more].concat());
        let is_skipped = printed == "new.safetensors is up to date: nothing it was fitted from has changed\n";
        assert!(is_skipped || printed.starts_with("material"), "{printed}");
        is_skipped
    }

    fn bytes(&self) -> Vec<u8> {
        std::fs::read(self.0.path("new.safetensors")).unwrap()
    }

    fn write(&self, bytes: &[u8]) {
        std::fs::write(self.0.path("new.safetensors"), bytes).unwrap();
    }

    fn scan(&self, file: &str, albedo: f32) {
        let row = |i: u8| {
            let (sin, cos) = (0.1 * f32::from(i % 14)).sin_cos();
            format!("{sin},0,{cos},0,{sin},{cos},{0},{0},{0}\n", albedo + 0.001 * f32::from(i))
        };
        std::fs::write(self.0.path(file), (0..100).map(row).collect::<String>()).unwrap();
    }
}

#[test]
fn a_fit_is_skipped_as_long_as_nothing_has_changed() {
    let folder = Folder::new();
    let fit = Again(&folder);
    fit.scan("a.csv", 0.02);
    fit.scan("b.csv", 0.05);
    assert!(!fit.is_skipped(&[]), "there is no output yet");
    let first = fit.bytes();
    assert!(fit.is_skipped(&[]));
    // Of no influence on the library.
    assert!(fit.is_skipped(&["--threads", "1", "--force"]));
    assert!(first == fit.bytes());

    assert!(!fit.is_skipped(&["--seed", "1"]));
    assert!(!fit.is_skipped(&[]), "the output is that of another seed");
    assert!(!fit.is_skipped(&["--hold-out", "0.2"]));
    assert!(!fit.is_skipped(&[]));

    fit.scan("b.csv", 0.1);
    assert!(!fit.is_skipped(&[]));
    assert!(fit.is_skipped(&[]));
    assert!(fit.bytes() != first);
    fit.scan("b.csv", 0.05);
    assert!(!fit.is_skipped(&[]));
    assert!(fit.bytes() == first);

    // The names of materials are those of files.
    std::fs::rename(folder.path("b.csv"), folder.path("c.csv")).unwrap();
    std::fs::rename(folder.path("a.csv"), folder.path("b.csv")).unwrap();
    std::fs::rename(folder.path("c.csv"), folder.path("a.csv")).unwrap();
    assert!(!fit.is_skipped(&[]));
}

#[test]
fn an_output_that_is_damaged_changed_or_of_something_else_is_fitted_anew() {
    let folder = Folder::new();
    let fit = Again(&folder);
    fit.scan("a.csv", 0.02);
    fit.scan("b.csv", 0.05);
    assert!(!fit.is_skipped(&[]));
    let good = fit.bytes();
    let mut flipped = good.clone();
    let end = flipped.len();
    flipped[end - 3] ^= 1;
    let name = b"\\\"name\\\":\\\"";
    let renamed = good.windows(name.len()).position(|bytes| bytes == name).unwrap() + name.len();
    let mut other_name = good.clone();
    assert_eq!(other_name[renamed], b'a');
    other_name[renamed] = b'x';
    for (what, bytes) in [("cut off", &good[..end - 1]), ("a flipped bit", &flipped), ("a name", &other_name)]
    {
        fit.write(bytes);
        assert!(!fit.is_skipped(&[]), "{what}");
        assert!(fit.bytes() == good, "{what}");
    }
    // A library of some of its materials is another one, whatever its materials say of themselves.
    folder.succeeds(&["convert", "new.safetensors", "--material", "a", "one.safetensors"]);
    std::fs::rename(folder.path("one.safetensors"), folder.path("new.safetensors")).unwrap();
    assert!(!fit.is_skipped(&[]));
    assert!(fit.bytes() == good);
}

#[test]
fn what_is_skipped_still_gives_its_errors_to_programs() {
    let folder = Folder::new();
    let fitted = folder.succeeds(&fit("ggx", &["--json"]));
    let output = folder.command(&fit("ggx", &["--json", "--if-changed"])).output().unwrap();
    assert_eq!(String::from_utf8(output.stdout).unwrap(), fitted);
    assert!(String::from_utf8(output.stderr).unwrap().contains("new.safetensors is up to date"));
    folder.succeeds(&fit("ggx", &["--json=errors.json", "--if-changed"]));
    assert_eq!(std::fs::read_to_string(folder.path("errors.json")).unwrap(), fitted);
}

#[test]
fn every_model_is_recognised_and_no_model_for_another() {
    let folder = Folder::new();
    let small: [(&str, &[&str]); 5] = [
        ("ggx", &[]),
        ("hybrid", &["--net", "16x2", "--steps", "20"]),
        ("neural", &["--net", "16x2", "--steps", "20"]),
        ("factor", &["--variant", "naive"]),
        ("spherical", &["--net", "16x2", "--steps", "20", "--nside", "2", "--nodes", "8", "--features", "4"]),
    ];
    for (model, options) in small {
        let command = fit(model, &[options, &["--if-changed"]].concat());
        assert!(folder.succeeds(&command).contains("SMAPE"), "{model}");
        assert!(folder.succeeds(&command).contains("is up to date"), "{model}");
    }
}

#[test]
fn a_scene_can_read_any_file_and_is_always_fitted() {
    let folder = Folder::new();
    let fit = ["fit", "--from-mitsuba", "bsdf.json", "--if-changed", "-o", "new.safetensors"];
    assert!(folder.fails(2, &fit).contains("cannot be used with"));
}

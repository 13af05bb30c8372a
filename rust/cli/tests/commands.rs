//! Every command as a process, on good input.

mod common;

use common::{Folder, ggx, shared};
use glimt_core::sampling::Sampler;
use glimt_core::{Brdf, Library, SampleBrdf, Vec3};
use glimt_files::{Array, Source};

#[test]
fn eval_answers_what_the_library_answers() {
    let folder = Folder::new();
    folder.succeeds(&[
        "eval",
        "lib.safetensors",
        "--material",
        "mint",
        "--pairs",
        "pairs.npy",
        "-o",
        "f.npy",
    ]);
    let f = Array::open(folder.path("f.npy")).unwrap();
    assert_eq!(f.shape, [3, 3]);
    let mint = ggx([0.3, 0.7, 0.5]);
    let expected = [
        mint.eval(Vec3::Z, Vec3::Z),
        mint.eval(Vec3::new(-0.6, 0.0, 0.8), Vec3::new(0.6, 0.0, 0.8)),
        Vec3::ZERO,
    ];
    assert_eq!(f.values, expected.map(|f| f.to_array()).concat());
    folder.succeeds(&["eval", "cloth.bin", "--pairs", "pairs.npy", "-o", "f.npy"]);
    let table = Source::open(folder.path("cloth.bin")).unwrap();
    let f = Array::open(folder.path("f.npy")).unwrap();
    assert_eq!(f.values[..3], table.brdf(None).unwrap().eval(Vec3::Z, Vec3::Z).to_array());
}

#[test]
fn eval_gives_zero_for_nan_and_takes_no_pairs() {
    let folder = Folder::new();
    folder.array("pairs.npy", &[1, 6], &[f32::NAN, 0.0, 1.0, 0.0, 0.0, 1.0]);
    folder.succeeds(&["eval", "cloth.bin", "--pairs", "pairs.npy", "-o", "f.npy"]);
    assert_eq!(Array::open(folder.path("f.npy")).unwrap().values, [0.0; 3]);
    folder.array("pairs.npy", &[0, 6], &[]);
    folder.succeeds(&["eval", "cloth.bin", "--pairs", "pairs.npy", "-o", "f.npy"]);
    assert_eq!(Array::open(folder.path("f.npy")).unwrap().shape, [0, 3]);
}

#[test]
fn sample_follows_the_seed_alone() {
    let folder = Folder::new();
    let sample = |seed: &str, threads: &str, file: &str| {
        let command = ["sample", "cloth.bin", "--view", "0.3,-0.2,0.9", "-n", "10000", "--seed", seed];
        folder.succeeds(&[&command[..], &["--threads", threads, "-o", file]].concat());
        Array::open(folder.path(file)).unwrap()
    };
    let samples = sample("7", "1", "a.npy");
    assert_eq!(samples.shape, [10_000, 7]);
    assert_eq!(samples, sample("7", "3", "b.npy"));
    assert_ne!(samples, sample("8", "1", "c.npy"));

    let table = Source::open(folder.path("cloth.bin")).unwrap();
    let (brdf, view) = (table.brdf(None).unwrap(), Vec3::new(0.3, -0.2, 0.9).normalize());
    let mut carried = 0;
    for row in samples.values.chunks_exact(7) {
        let (light, pdf) = (Vec3::from_slice(row), row[3]);
        if pdf > 0.0 {
            assert_eq!(pdf, brdf.pdf(light, view));
            let expected = brdf.eval(light, view) * light.z / pdf;
            assert!((Vec3::from_slice(&row[4..]) - expected).abs().max_element() < 1e-5);
            carried += 1;
        }
    }
    assert!(carried > 9000);
}

#[test]
fn info_says_what_files_hold() {
    let folder = Folder::new();
    let text = folder.succeeds(&["info", "lib.safetensors", "cloth.bin"]);
    assert!(text.contains("lib.safetensors: ggx models, 3 materials"), "{text}");
    assert!(text.contains("28 bytes per material and 0 shared"), "{text}");
    assert!(text.contains("orange  kd 0.600 0.300 0.100  eta 1.500 1.500 1.500"), "{text}");
    assert!(text.contains("cloth.bin: utia measurement"), "{text}");
    assert!(text.contains("form         6 × 48 lights and as many views"), "{text}");
    assert!(text.contains("form         Lambert and GGX with exact Fresnel"), "{text}");
    let lines = folder.succeeds(&["info", "--json", "."]);
    let objects: Vec<serde_json::Value> =
        lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(objects.len(), 2);
    assert_eq!(objects[0]["material"], "cloth");
    assert_eq!(objects[1]["bytes_per_material"], 28);
    assert_eq!(objects[1]["materials"][2]["kd"][0].as_f64().map(|kd| kd as f32), Some(0.2));
    assert_eq!(objects[1]["materials"][1]["source"], "mint.bsdf");
    assert_eq!(objects[1]["described"], "Lambert and GGX with exact Fresnel");
    // As many bytes as the table has that is made for the first sample.
    let cloth = Source::open(folder.path("cloth.bin")).unwrap();
    let Sampler::Table(table) = cloth.brdf(None).unwrap().sampler() else { panic!("no table") };
    assert_eq!(objects[0]["sampler"]["bytes"], table.bytes());
}

#[test]
fn convert_writes_tables_that_answer_like_the_model() {
    let folder = Folder::new();
    let near = |file: &str, kd: [f32; 3]| {
        let source = Source::open(folder.path(file)).unwrap();
        // Between the bins of a smooth lobe, a table is within a few percent.
        let (light, view) = (Vec3::new(-0.48, 0.36, 0.8), Vec3::new(0.36, 0.48, 0.8));
        let (f, expected) = (source.brdf(None).unwrap().eval(light, view), ggx(kd).eval(light, view));
        assert!((f - expected).abs().max_element() < 0.05 * expected.max_element(), "{file}: {f} {expected}");
    };
    folder.succeeds(&["convert", "lib.safetensors", "--material", "grey", "grey.binary"]);
    near("grey.binary", [0.2; 3]);
    folder.succeeds(&["convert", "lib.safetensors", "tables/", "--to", "utia"]);
    near("tables/orange.bin", [0.6, 0.3, 0.1]);
    near("tables/mint.bin", [0.3, 0.7, 0.5]);
    folder.succeeds(&["convert", "grey.binary", "grey.bin"]);
    near("grey.bin", [0.2; 3]);
}

#[test]
fn convert_merges_libraries_and_picks_from_them() {
    let folder = Folder::new();
    folder.succeeds(&["convert", "lib.safetensors", "one.safetensors", "--material", "mint"]);
    assert_eq!(Library::open(folder.path("one.safetensors")).unwrap().names(), ["mint"]);
    folder.succeeds(&["convert", "--material", "grey", "lib.safetensors", "two.safetensors"]);
    folder.succeeds(&["convert", "one.safetensors", "two.safetensors", "both.safetensors"]);
    let both = Library::open(folder.path("both.safetensors")).unwrap();
    assert_eq!(both.names(), ["mint", "grey"]);
    assert_eq!(both.entries().unwrap()[0].origin.source, "mint.bsdf");
}

mod reference_data {
    use super::*;

    #[test]
    #[ignore = "reads reference data from ../shared/data, which is not part of the project"]
    fn convert_makes_a_library_of_published_networks() {
        let networks = shared("nbrdf/merl");
        let folder = Folder::new();
        let glob = format!("{networks}/gold*.npz");
        folder.succeeds(&["convert", &glob, "gold.safetensors"]);
        let library = Library::open(folder.path("gold.safetensors")).unwrap();
        assert_eq!(library.names(), ["gold-metallic-paint", "gold-metallic-paint3", "gold-paint"]);
        assert_eq!(library.entries().unwrap()[0].origin.source, "gold-metallic-paint.npz");
        assert_eq!(library.entries().unwrap()[0].origin.sha256.len(), 64);
        let f = library.material(Some("gold-metallic-paint")).unwrap().eval(Vec3::Z, Vec3::Z);
        assert!((f - Vec3::new(0.4556, 0.3436, 0.1258)).abs().max_element() < 1e-4);
    }
}

#[test]
fn fit_finds_the_parameters_of_a_model_and_reports_its_error() {
    let folder = Folder::new();
    let report =
        folder.succeeds(&["fit", "--model", "ggx", "-o", "fit.safetensors", "lib.safetensors", "--json"]);
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert!(report["materials"]["orange"]["smape"].as_f64().unwrap() < 0.02, "{report}");
    let library = Library::open(folder.path("fit.safetensors")).unwrap();
    let microfacet = library.material(Some("orange")).unwrap().microfacet().unwrap();
    assert!((microfacet.alpha[0] - 0.3).abs() < 0.02, "{microfacet:?}");
    let origin = &library.entries().unwrap()[0].origin;
    assert_eq!(origin.command, "glimt fit --model ggx");
    assert_eq!(origin.source, "lib.safetensors");
    assert!(origin.metrics["log_mae"] < 0.01);
}

#[test]
fn add_leaves_the_other_materials_as_they_are() {
    let folder = Folder::new();
    folder.succeeds(&["fit", "--net", "16x2", "--steps", "200", "-o", "fit.safetensors", "lib.safetensors"]);
    let before = Library::open(folder.path("fit.safetensors")).unwrap();
    folder.succeeds(&["convert", "lib.safetensors", "--material", "grey", "slate.binary"]);
    folder.succeeds(&["add", "fit.safetensors", "slate.binary", "--steps", "100"]);
    let after = Library::open(folder.path("fit.safetensors")).unwrap();
    assert_eq!(after.names(), ["orange", "mint", "grey", "slate"]);
    assert_eq!(after.tensor_bytes().unwrap(), before.tensor_bytes().unwrap());
    let pair = (Vec3::new(-0.6, 0.0, 0.8), Vec3::new(0.48, 0.36, 0.8));
    for (a, b) in before.entries().unwrap().iter().zip(after.entries().unwrap()) {
        assert_eq!(a.material.eval(pair.0, pair.1), b.material.eval(pair.0, pair.1));
        assert_eq!(a.origin, b.origin);
    }
    assert!(folder.fails(1, &["add", "fit.safetensors", "slate.binary"]).contains("already has a material"));
}

/// An interrupt in the middle, and the same bytes in the end.
#[cfg(unix)]
#[test]
fn interrupted_fit_goes_on_to_the_same_library() {
    let folder = Folder::new();
    let (steps, message) = interrupted(&folder);
    assert!(message.contains("--resume goes on from parts.safetensors.checkpoint"), "{message}");
    assert!(folder.files().contains(&"parts.safetensors.checkpoint".to_owned()));
    assert!(!folder.files().contains(&"parts.safetensors".to_owned()));

    let more = (steps + 1).to_string();
    let refused = folder.fails(1, &[&fit(&more)[..], &["--resume"]].concat());
    assert!(refused.contains("other options"), "{refused}");

    folder.succeeds(&[&fit(&steps.to_string())[..], &["--resume", "--threads", "1"]].concat());
    let resumed = std::fs::read(folder.path("parts.safetensors")).unwrap();
    assert!(!folder.files().contains(&"parts.safetensors.checkpoint".to_owned()));
    folder.succeeds(&fit(&steps.to_string()));
    assert!(resumed == std::fs::read(folder.path("parts.safetensors")).unwrap());
}

#[cfg(unix)]
fn fit(steps: &str) -> [&str; 8] {
    ["fit", "--net", "16x2", "--steps", steps, "cloth.bin", "-o", "parts.safetensors"]
}

/// Starts fits until one is interrupted between its first and last step, on machines of any speed; its
/// steps and what it said.
#[cfg(unix)]
fn interrupted(folder: &Folder) -> (u64, String) {
    use std::process::{Command, Stdio};
    use std::time::Duration;

    let (mut steps, mut wait) = (5000, Duration::from_millis(500));
    loop {
        let child = folder.command(&fit(&steps.to_string())).stderr(Stdio::piped()).spawn().unwrap();
        std::thread::sleep(wait);
        Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
        let output = child.wait_with_output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        match output.status.code() {
            // It was done already.
            Some(0) => {
                std::fs::remove_file(folder.path("parts.safetensors")).unwrap();
                steps *= 2;
            }
            Some(1) if !message.contains("before there was anything to save") => return (steps, message),
            _ => wait *= 2,
        }
    }
}

#[test]
fn scattered_samples_are_described_and_fitted_to() {
    let folder = Folder::new();
    let material = ggx([0.5, 0.3, 0.1]);
    let mut csv = "theta_l,phi_l,theta_v,phi_v,r,g,b\n".to_owned();
    for i in 0..448 {
        let [theta_l, theta_v] = [(i % 8) as f32 * 0.18, (i / 64) as f32 * 0.2];
        let phi = ((i / 8) % 8) as f32 * 0.4;
        let direction =
            |theta: f32, phi: f32| Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
        let f = material.eval(direction(theta_l, phi), direction(theta_v, 0.0));
        csv += &format!("{theta_l},{phi},{theta_v},0,{},{},{}\n", f.x, f.y, f.z);
    }
    std::fs::write(folder.path("scan.csv"), csv).unwrap();
    let info = folder.succeeds(&["info", "scan.csv"]);
    assert!(info.contains("scan.csv: samples, 448 pairs") && info.contains("view up to 68.8°"), "{info}");
    let json = folder.succeeds(&["fit", "--model", "ggx", "scan.csv", "-o", "scan.safetensors", "--json"]);
    let smape = json.split("\"smape\":").nth(1).unwrap().split([',', '}']).next().unwrap();
    assert!(smape.parse::<f64>().unwrap() < 0.01, "{json}");
    assert!(!json.contains("swapped"), "{json}");
    assert!(json.contains("\"held_out\":44.0") && json.contains("fitted_smape"), "{json}");
    let fit = ["fit", "--model", "ggx", "scan.csv", "-o", "scan.safetensors", "--json"];
    let all = folder.succeeds(&[&fit[..], &["--hold-out", "0"]].concat());
    assert!(!all.contains("held_out") && !all.contains("fitted"), "{all}");
}

#[test]
fn check_passes_correct_materials_and_writes_table_json_and_page() {
    let folder = Folder::new();
    let quick = ["--samples", "5000"];
    let text = folder.succeeds(&[&["check", "lib.safetensors", "--html", "page.html"], &quick[..]].concat());
    for name in ["orange: pass", "mint: pass", "grey: pass", "chi-squared", "unbiased"] {
        assert!(text.contains(name), "{name} in {text}");
    }
    let page = std::fs::read_to_string(folder.path("page.html")).unwrap();
    assert!(page.starts_with("<!doctype html>") && page.contains("orange") && page.contains("<svg"));
    assert!(!page.contains("http"), "nothing is loaded from elsewhere");
    let command = ["check", "lib.safetensors", "--material", "mint", "--json"];
    let report: serde_json::Value =
        serde_json::from_str(&folder.succeeds(&[&command[..], &quick].concat())).unwrap();
    assert_eq!(report["verdict"], "pass");
    let subjects = report["subjects"].as_array().unwrap();
    assert!(
        subjects.len() == 1 && subjects[0]["name"] == "mint" && subjects[0]["claims"]["reciprocal"] == true
    );
    let p =
        subjects[0]["findings"].as_array().unwrap().iter().filter(|finding| finding["p"].is_f64()).count();
    assert_eq!(report["p_values"], p);
}

#[test]
fn what_is_hardly_meant_is_said() {
    let folder = Folder::new();
    std::fs::write(folder.path("black.csv"), "0,0,1,0,0,1,0,0,0\n").unwrap();
    std::fs::write(folder.path("again.csv"), "0,0,1,0,0,1,0,0,0\n").unwrap();
    let (_, warnings) =
        folder.warns(&["fit", "--model", "ggx", "black.csv", "again.csv", "-o", "x.safetensors"]);
    let warnings = warnings.join("\n");
    assert!(warnings.contains("warning: material \"black\" is black"), "{warnings}");
    assert!(warnings.contains("\"black\" and \"again\" come from files with the same content"), "{warnings}");
    assert!(warnings.contains("\"black\" has 1 samples of 3 values, fewer than the 7 numbers"), "{warnings}");
}

/// Samples of a Lambertian surface, `f` of each by its number.
fn scan(count: usize, f: impl Fn(usize) -> f32) -> String {
    let row = |i: usize| {
        let z = |step: f32| 0.2 + 0.8 * (i as f32 * step).fract();
        let direction = |z: f32, phi: f32| {
            let r = (1.0 - z * z).sqrt();
            format!("{},{},{z}", r * phi.cos(), r * phi.sin())
        };
        let (light, view) = (direction(z(0.618_034), i as f32), direction(z(0.754_878), 2.7 * i as f32));
        format!("{light},{view},{0},{0},{0}\n", f(i))
    };
    (0..count).map(row).collect()
}

#[test]
fn doubtful_samples_and_albedos_are_told_by_fit_and_add() {
    let folder = Folder::new();
    let write = |name: &str, text: String| std::fs::write(folder.path(name), text).unwrap();
    write("good.csv", scan(400, |i| 0.1 + 0.01 * (i as f32 * 0.3).sin()));
    write("few.csv", scan(2, |_| 0.1));
    write("outlier.csv", scan(400, |i| if i == 50 { 1e30 } else { 0.1 }));
    write("saturated.csv", scan(400, |i| if i % 40 == 7 { 4.0 } else { 0.1 + 1e-4 * i as f32 }));
    write("bright.csv", scan(400, |i| 1.6 + 0.01 * (i as f32 * 0.3).sin()));

    let fit = ["fit", "--model", "ggx", "-o", "x.safetensors", "--hold-out", "0"];
    folder.succeeds(&[&fit[..], &["good.csv"]].concat());
    folder.succeeds(&["fit", "--net", "16x2", "--steps", "100", "lib.safetensors", "-o", "base.safetensors"]);
    let add = ["add", "base.safetensors", "--steps", "10", "--hold-out", "0", "-o", "y.safetensors"];
    for (file, expected) in [
        ("few.csv", "\"few\" has 2 samples of 3 values, fewer than the "),
        ("outlier.csv", "\"outlier\" has outliers: 1 of its samples, from 1.000e30 on"),
        ("saturated.csv", "\"saturated\" looks saturated: 10 of its samples share the largest value, 4"),
    ] {
        for command in [&fit[..], &add] {
            let (_, warnings) = folder.warns(&[command, &[file]].concat());
            let said = warnings.iter().filter(|warning| warning.contains(expected)).count();
            assert_eq!(said, 1, "{file}: {warnings:?}");
        }
    }
    let hybrid = ["fit", "--net", "16x2", "--steps", "300", "-o", "z.safetensors", "bright.csv"];
    let (_, warnings) = folder.warns(&hybrid);
    let expected = "\"bright\" reflects more light than arrives: its fitted albedo is ";
    assert!(warnings.iter().any(|warning| warning.contains(expected)), "{warnings:?}");
}

#[test]
fn info_says_what_is_odd_about_files() {
    let folder = Folder::new();
    let measured = std::fs::read(folder.path("cloth.bin")).unwrap();
    let mut odd = measured.clone();
    odd[..8].copy_from_slice(&(-3.0_f64).to_le_bytes());
    odd.push(b'\n');
    std::fs::write(folder.path("odd.bin"), odd).unwrap();
    std::fs::write(folder.path("odd.csv"), "0,0,1,1,0,0,1,1,1\n0,0,1,0,0,1,1,-1,1\n").unwrap();
    let text = folder.succeeds(&["info", "odd.bin", "odd.csv"]);
    for line in [
        "  odd          1 negative number of f, taken as 0\n  odd          1 byte after the end, ignored\n",
        "  odd          1 negative number of f, taken as 0\n  odd          1 sample at the horizon, left out\n",
    ] {
        assert!(text.contains(line), "{text}");
    }
    assert!(!folder.succeeds(&["info", "cloth.bin"]).contains("odd"));
    let json: serde_json::Value =
        serde_json::from_str(&folder.succeeds(&["info", "--json", "odd.bin"])).unwrap();
    let expected = serde_json::json!([
        { "kind": "negative", "what": "f", "count": 1 },
        { "kind": "trailing", "bytes": 1 },
    ]);
    assert_eq!(json["odd"], expected);
}

#[test]
fn conversions_that_drop_anisotropy_say_so_and_the_others_do_not() {
    let folder = Folder::new();
    let (_, warnings) = folder.warns(&["convert", "cloth.bin", "cloth.binary"]);
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].contains("\"cloth\" is anisotropic, and MERL stores isotropic"), "{warnings:?}");
    let (_, warnings) = folder.warns(&["fit", "--model", "factor", "cloth.bin", "-o", "tables.safetensors"]);
    assert!(warnings[0].contains("\"cloth\" is anisotropic, and the model is not"), "{warnings:?}");
    folder.succeeds(&["convert", "cloth.bin", "again.bin"]);
}

#[test]
fn convert_writes_spectra_on_request() {
    let folder = Folder::new();
    let grey = ["convert", "lib.safetensors", "--material", "orange"];
    folder.succeeds(&[&grey[..], &["rgb.bsdf"]].concat());
    folder.succeeds(&[&grey[..], &["--spectral", "spectral.bsdf"]].concat());
    let bytes = std::fs::read(folder.path("spectral.bsdf")).unwrap();
    let (file, _) =
        glimt_measured::tensor::TensorFile::parse(std::path::Path::new("spectral.bsdf"), &bytes).unwrap();
    assert!(file.get("spectra").is_some() && file.get("wavelengths").is_some() && file.get("rgb").is_none());
    let f = |name: &str| {
        let source = Source::open(folder.path(name)).unwrap();
        source.brdf(None).unwrap().eval(Vec3::new(-0.48, 0.36, 0.8), Vec3::new(0.36, 0.48, 0.8))
    };
    let (rgb, spectral) = (f("rgb.bsdf"), f("spectral.bsdf"));
    assert!((rgb - spectral).abs().max_element() < 0.01 * rgb.max_element(), "{rgb} {spectral}");
    let line = folder.fails(2, &[&grey[..], &["--spectral", "x.binary"]].concat());
    assert!(line.contains("--spectral does not apply to .binary"), "{line}");
}

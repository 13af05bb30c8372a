//! Tables by command: `factor` fits, published fits, exports, measurements and table samplers.

mod common;

use common::{Folder, ggx, shared};
use glimt_core::models::factor::{Interpolation, Variant};
use glimt_core::{AnyModel, Brdf, Kind, Library, SampleBrdf, Vec3};
use glimt_files::{Array, Source};

/// Directions away from grazing ones.
const PAIR: (Vec3, Vec3) = (Vec3::new(-0.48, 0.36, 0.8), Vec3::new(0.36, 0.48, 0.8));

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap()
}

#[test]
fn every_variant_of_factor_is_fitted() {
    let folder = Folder::new();
    folder.succeeds(&["convert", "lib.safetensors", "--material", "orange", "orange.safetensors"]);
    let fit = ["fit", "--model", "factor", "orange.safetensors", "--json", "-o", "tables.safetensors"];
    let smape = |more: &[&str]| {
        let report = json(&folder.succeeds(&[&fit[..], more].concat()));
        report["materials"]["orange"]["smape"].as_f64().unwrap()
    };
    let form = || {
        let library = Library::open(folder.path("tables.safetensors")).unwrap();
        let AnyModel::Factor(factor) = library.material(Some("orange")).unwrap().model() else {
            panic!("no factor")
        };
        assert!(library.entries().unwrap()[0].origin.metrics["objective_blue"] > 0.0);
        assert!(library.entries().unwrap()[0].origin.command.starts_with("glimt fit --model factor"));
        (factor.form().variant, factor.form().interpolation)
    };
    assert!(smape(&[]) < 0.02);
    assert_eq!(form(), (Variant::IndependentG, Interpolation::Linear));
    let nearest = ["--variant", "g-from-d", "--interpolation", "nearest"];
    assert!(smape(&nearest) < 0.04);
    assert_eq!(form(), (Variant::GFromD, Interpolation::Nearest));
    assert!(smape(&["--variant", "naive"]) < 0.2);
    assert_eq!(form(), (Variant::Naive, Interpolation::Linear));
    assert!(smape(&["--variant", "bivariate"]) < 0.2);
    assert_eq!(form(), (Variant::Bivariate, Interpolation::Linear));
    let info = folder.succeeds(&["info", "tables.safetensors"]);
    assert!(info.contains("form         bivariate, linear in 90 × 90 bins"), "{info}");
    assert!(
        info.contains("factor models, 1 material") && info.contains("97,200 bytes per material"),
        "{info}"
    );
}

#[test]
fn the_same_seed_gives_the_same_tables() {
    let folder = Folder::new();
    let fit = |out: &str, threads: &str| {
        // The measurement is anisotropic, and tables are not.
        folder.warns(&[
            "fit",
            "--model",
            "factor",
            "--variant",
            "g-from-d",
            "cloth.bin",
            "--threads",
            threads,
            "-o",
            out,
        ]);
        std::fs::read(folder.path(out)).unwrap()
    };
    assert!(fit("one.safetensors", "1") == fit("two.safetensors", "2"));
}

#[test]
fn options_that_do_not_apply_to_tables_are_refused() {
    let folder = Folder::new();
    let fit = |more: &[&'static str]| [&["fit", "-o", "new.safetensors", "cloth.bin"], more].concat();
    for option in [&["--net", "32x2"][..], &["--rate", "0.1"], &["--paper"], &["--reciprocal"]] {
        let line = folder.fails(2, &[&fit(&["--model", "factor"])[..], option].concat());
        assert!(line.contains(&format!("{} does not apply to --model factor", option[0])), "{line}");
    }
    let line = folder.fails(2, &fit(&["--model", "ggx", "--variant", "naive"]));
    assert!(line.contains("--variant does not apply to --model ggx"), "{line}");
    let line = folder.fails(2, &fit(&["--model", "factor", "--variant", "dependent-g"]));
    assert!(line.contains("dependent-g") && line.contains("g-from-d"), "{line}");
    std::fs::write(folder.path("scan.csv"), "0,0,1,0,0,1,0.5,0.5,0.5\n").unwrap();
    let line = folder.fails(1, &["fit", "--model", "factor", "scan.csv", "-o", "new.safetensors"]);
    assert!(line.contains("scan") && line.contains("scattered samples"), "{line}");
}

#[test]
fn published_fits_become_a_library() {
    let folder = Folder::new();
    let text = "# comment\n\
        gold = Aggregate(Lambertian(albedo = [0.1, 0.05, 0.0]), NganWard(albedo = [0.2, 0.1, 0.05], roughness = 0.2))\n\
        jade = Aggregate(Lambertian(albedo = [0.0, 0.2, 0.1]), NganWard(albedo = [0.1, 0.1, 0.1], roughness = 0.1))\n";
    std::fs::write(folder.path("ward.fit"), text).unwrap();
    folder.succeeds(&["convert", "ward.fit", "ward.safetensors"]);
    let library = Library::open(folder.path("ward.safetensors")).unwrap();
    assert_eq!(library.names(), ["gold", "jade"]);
    let gold = library.material(Some("gold")).unwrap();
    assert_eq!(gold.kind(), Kind::Analytic);
    // Ward 1992 at the normal: k_d/π + k_s/(4π α²), times the database's factors of the channels.
    let expected = Vec3::new(0.1, 0.05, 0.0) / std::f32::consts::PI
        + Vec3::new(0.2, 0.1, 0.05) / (4.0 * std::f32::consts::PI * 0.04);
    let expected = expected * Vec3::new(1.0, 1.15, 1.66);
    assert!((gold.eval(Vec3::Z, Vec3::Z) - expected).abs().max_element() < 1e-5);
    let info = folder.succeeds(&["info", "ward.fit"]);
    assert!(info.contains("ward.fit: analytic models, 2 materials"), "{info}");

    std::fs::write(folder.path("ward.fit"), text.replace("NganWard", "NganHe")).unwrap();
    let line = folder.fails(1, &["convert", "ward.fit", "new.safetensors"]);
    assert!(line.contains("ward.fit") && line.contains("line 2") && line.contains("NganHe"), "{line}");
    std::fs::write(folder.path("ward.fit"), text.replace("roughness = 0.1", "roughness = -1")).unwrap();
    let line = folder.fails(1, &["convert", "ward.fit", "new.safetensors"]);
    assert!(line.contains("line 3") && line.contains("roughness"), "{line}");
}

mod reference_data {
    use super::*;

    #[test]
    #[ignore = "reads reference data from ../shared/data, which is not part of the project"]
    fn the_published_collections_are_read() {
        let fits = shared("merl-fits");
        let folder = Folder::new();
        for file in
            ["ngan_cooktorrance", "ngan_ward", "ngan_ashikhminshirley", "low_lowmicrofacet_E2", "bagher_sgd"]
        {
            folder.succeeds(&["convert", &format!("{fits}/{file}.fit"), "fits.safetensors"]);
            let library = Library::open(folder.path("fits.safetensors")).unwrap();
            assert!(library.names().len() >= 86, "{file}: {}", library.names().len());
            assert!(
                library
                    .entries()
                    .unwrap()
                    .iter()
                    .all(|entry| entry.material.eval(PAIR.0, PAIR.1).is_finite())
            );
        }
    }
}

#[test]
fn a_model_is_exported_to_rgl_and_to_merl_and_comes_back() {
    let folder = Folder::new();
    folder.succeeds(&["convert", "lib.safetensors", "--material", "mint", "mint.bsdf"]);
    folder.succeeds(&["convert", "mint.bsdf", "mint.binary"]);
    let expected = ggx([0.3, 0.7, 0.5]).eval(PAIR.0, PAIR.1);
    for (file, format) in [("mint.bsdf", "rgl measurement"), ("mint.binary", "merl measurement")] {
        let info = folder.succeeds(&["info", file]);
        assert!(info.contains(format), "{info}");
        let f = Source::open(folder.path(file)).unwrap().brdf(None).unwrap().eval(PAIR.0, PAIR.1);
        assert!((f - expected).abs().max_element() < 0.02 * expected.max_element(), "{file}: {f} {expected}");
    }
    let info = json(&folder.succeeds(&["info", "--json", "mint.bsdf"]));
    assert_eq!((info["sampler"]["name"].as_str(), info["isotropic"].as_bool()), (Some("warp"), Some(true)));
    assert!(info["description"].as_str().unwrap().contains("ggx model \"mint\""), "{info}");
}

#[test]
fn samplers_are_chosen_by_name() {
    let folder = Folder::new();
    let library = Library::open(folder.path("lib.safetensors")).unwrap();
    let mint = library.material(Some("mint")).unwrap();
    let sample = ["sample", "lib.safetensors", "--material", "mint", "--view", "0.36,0.48,0.8", "-n", "2000"];
    let command = |sampler: &'static str| [&sample[..], &["-o", "s.npy", "--sampler", sampler]].concat();
    for sampler in ["lobes", "table", "table:8x16x12", "table:paper"] {
        folder.succeeds(&command(sampler));
        let expected = mint.with_sampler(sampler.parse().unwrap());
        let samples = Array::open(folder.path("s.npy")).unwrap();
        let mut carried = 0;
        for row in samples.values.chunks_exact(7).filter(|row| row[3] > 0.0) {
            assert_eq!(row[3], expected.pdf(Vec3::from_slice(row), PAIR.1), "{sampler}");
            carried += 1;
        }
        assert!(carried > 1800, "{sampler}: {carried}");
    }
    let check = ["check", "lib.safetensors", "--material", "mint", "--samples", "5000", "--sampler"];
    assert!(folder.succeeds(&[&check[..], &["table:12x24x16"]].concat()).contains("mint: pass"));
    for wrong in ["tabel", "table:8x16", "table:1x1x1", "table:9999x9999x9999"] {
        let line = folder.fails(2, &[&sample[..], &["-o", "t.npy", "--sampler", wrong]].concat());
        assert!(line.contains(wrong.trim_start_matches("table:")) && line.contains("expected"), "{line}");
    }
}

#[cfg(unix)]
#[test]
fn a_simulation_that_does_not_start_is_told_in_a_line() {
    let folder = Folder::new();
    std::fs::write(folder.path("bsdf.json"), "{\"type\": \"diffuse\"}").unwrap();
    let fit = ["fit", "--model", "factor", "--from-mitsuba", "bsdf.json", "-o", "new.safetensors"];
    for (python, words) in [("/nowhere/python3", "cannot start"), ("/bin/false", "needs the packages glimt")]
    {
        let output = folder.command(&fit).env("GLIMT_PYTHON", python).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{stderr}");
        assert!(stderr.contains(words) && stderr.contains("GLIMT_PYTHON"), "{stderr}");
        assert!(!folder.path("new.safetensors").exists());
    }
}

/// A stand-in for Mitsuba that speaks its protocol; `answer` is Python that writes what `n` pairs are answered by.
#[cfg(unix)]
fn stand_in(folder: &Folder, answer: &str) -> std::path::PathBuf {
    use std::os::unix::fs::PermissionsExt;

    let server = format!(
        "#!/usr/bin/env python3\n\
         import os, signal, struct, sys\n\
         sys.stdout.write('{{\"name\": \"grey\", \"anisotropic\": false}}\\n'); sys.stdout.flush()\n\
         read, write = sys.stdin.buffer.read, sys.stdout.buffer.write\n\
         while header := read(4):\n\
         \x20   n, = struct.unpack('<I', header)\n\
         \x20   read(24 * n)\n\
         \x20   {answer}\n\
         \x20   sys.stdout.buffer.flush()\n"
    );
    let python = folder.path("python");
    std::fs::write(&python, server).unwrap();
    std::fs::set_permissions(&python, std::fs::Permissions::from_mode(0o755)).unwrap();
    std::fs::write(folder.path("bsdf.json"), "{}").unwrap();
    python
}

#[cfg(unix)]
#[test]
fn what_a_simulation_throws_is_passed_on_and_nothing_else_is_said() {
    for (answer, expected) in [
        (
            "m = b'ValueError: no data'; write(struct.pack('<I', len(m)) + m); sys.exit(1)",
            "error: the simulation of \"grey\" threw ValueError: no data\n",
        ),
        ("sys.exit(3)", "error: the simulation of \"grey\" ended with exit status: 3\n"),
        (
            "os.kill(os.getpid(), signal.SIGKILL)",
            "error: the simulation of \"grey\" ended with signal: 9 (SIGKILL)\n",
        ),
    ] {
        for model in ["ggx", "factor", "hybrid"] {
            let folder = Folder::new();
            let python = stand_in(&folder, answer);
            let fit = ["fit", "--model", model, "--from-mitsuba", "bsdf.json", "-o", "new.safetensors"];
            let output = folder.command(&fit).env("GLIMT_PYTHON", &python).output().unwrap();
            assert_eq!(output.status.code(), Some(1), "{model}");
            assert_eq!(String::from_utf8(output.stderr).unwrap(), expected, "{model}");
            assert!(!folder.path("new.safetensors").exists());
        }
    }
}

#[cfg(unix)]
#[test]
fn tables_are_fitted_to_a_simulation() {
    let folder = Folder::new();
    let python = stand_in(&folder, "write(bytes(4) + struct.pack('<f', 0.5) * (3 * n))");
    let mut command =
        folder.command(&["fit", "--model", "factor", "--variant", "g-from-d", "-o", "sim.safetensors"]);
    let output = command.args(["--from-mitsuba", "bsdf.json"]).env("GLIMT_PYTHON", &python).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let library = Library::open(folder.path("sim.safetensors")).unwrap();
    let f = library.material(Some("grey")).unwrap().eval(PAIR.0, PAIR.1);
    assert!((f - Vec3::splat(0.5)).abs().max_element() < 1e-3, "{f}");
}

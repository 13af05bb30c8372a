//! Published networks, and files that are opened by their content.

use std::f32::consts::PI;
use std::path::PathBuf;

use glimt_core::microfacet::Microfacet;
use glimt_core::models::ggx::Ggx;
use glimt_core::{Brdf, SampleBrdf, Vec3};
use glimt_files::Source;

fn direction(theta: f32, phi: f32) -> Vec3 {
    Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
}

/// The published networks themselves, which are not part of the project.
mod reference_data {
    use super::*;

    fn shared(file: &str) -> PathBuf {
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(file)
    }

    #[test]
    #[ignore = "reads reference data from ../shared/data, which is not part of the project"]
    fn gold_metallic_paint_has_its_published_values() {
        let source = Source::open(shared("nbrdf/merl/gold-metallic-paint.npz")).unwrap();
        assert_eq!((source.kind(), source.names()), ("nbrdf", vec!["gold-metallic-paint".to_owned()]));
        let brdf = source.brdf(None).unwrap();
        let near = |f: Vec3, expected: [f32; 3]| {
            assert!((f - Vec3::from(expected)).abs().max_element() < 1e-4, "{f} against {expected:?}");
        };
        near(brdf.eval(Vec3::Z, Vec3::Z), [0.4556, 0.3436, 0.1258]);
        let angle = PI / 6.0;
        near(brdf.eval(direction(angle, PI), direction(angle, 0.0)), [0.5497, 0.3907, 0.1153]);
    }

    #[test]
    #[ignore = "reads reference data from ../shared/data, which is not part of the project"]
    fn every_published_network_opens() {
        for folder in ["nbrdf/merl", "nbrdf/rgl"] {
            for file in std::fs::read_dir(shared(folder)).unwrap() {
                let path = file.unwrap().path();
                let source = Source::open(&path).unwrap();
                assert!(source.brdf(None).unwrap().eval(Vec3::Z, Vec3::Z).is_finite(), "{}", path.display());
            }
        }
    }
}

/// A material to be measured.
fn ggx() -> Ggx {
    Ggx::new(Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.5, 1.8, 2.5], alpha: [0.3; 2] }).unwrap()
}

#[test]
fn measurement_answers_by_its_name_only() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("chm_orange_rgb.bsdf");
    glimt_measured::write_rgl(&path, &ggx(), true, Default::default(), "a test").unwrap();
    let source = Source::open(path).unwrap();
    assert_eq!((source.kind(), source.names()), ("rgl", vec!["chm_orange".to_owned()]));
    assert!(source.brdf(Some("chm_orange")).is_ok());
    let message = source.brdf(Some("chm_ornage")).map(|_| ()).unwrap_err().to_string();
    assert!(message.contains("did you mean chm_orange?"), "{message}");
}

#[test]
fn tables_without_a_sampler_get_one_whose_weight_is_f_cos_over_pdf() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gold.bin");
    let encoding = glimt_measured::utia::Encoding::default();
    glimt_measured::write_utia(&path, &ggx(), encoding).unwrap();
    let table = Source::open(&path).unwrap();
    let (brdf, view) = (table.brdf(None).unwrap(), direction(0.5, 0.3));
    let mut carried = 0;
    for i in 0..200 {
        let i = i as f32;
        let sample = brdf.sample(view, Vec3::new(i * 0.819, i * 0.671, i * 0.549).fract());
        if sample.pdf > 0.0 {
            let expected = brdf.eval(sample.light, view) * sample.light.z / brdf.pdf(sample.light, view);
            assert!((sample.weight - expected).abs().max_element() <= 1e-5 * expected.max_element());
            carried += 1;
        }
    }
    assert!(carried > 100);
}

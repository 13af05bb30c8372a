//! Files that are not what they should be: one clear error each, and never a panic.

use std::fs;
use std::path::{Path, PathBuf};

use glimt_core::models::tabulated::Table;
use glimt_core::sampling::DirectionSampler;
use glimt_core::{Brdf, Oddity, Vec3};
use glimt_measured::tensor::{Field, TensorFile};
use glimt_measured::{Error, Measured, Rgl, write_merl, write_utia};
use proptest::prelude::*;

struct Lambert;

impl Brdf for Lambert {
    fn eval(&self, _: Vec3, _: Vec3) -> Vec3 {
        Vec3::new(0.3, 0.2, 0.1)
    }
}

/// The smallest valid file of the RGL database: isotropic, two elevations, 2 × 2 tables.
fn rgl() -> TensorFile<'static> {
    let floats = |name, shape: &[usize]| {
        let values: Vec<f32> = (0..shape.iter().product()).map(|k| 0.1 + k as f32).collect();
        Field::from_f32(name, shape, &values)
    };
    TensorFile {
        fields: vec![
            Field::from_bytes("description", b"tiny"),
            Field::from_f32("phi_i", &[1], &[0.0]),
            Field::from_f32("theta_i", &[2], &[0.0, 1.5]),
            floats("sigma", &[2, 2]),
            floats("ndf", &[2, 2]),
            floats("vndf", &[1, 2, 2, 2]),
            floats("luminance", &[1, 2, 2, 2]),
            floats("rgb", &[1, 2, 3, 2, 2]),
            Field::from_bytes("jacobian", &[1]),
        ],
    }
}

fn parse(file: &TensorFile) -> Result<Rgl, Error> {
    Rgl::from_bytes(Path::new("tiny.bsdf"), &file.to_bytes())
}

fn with(field: Field<'static>) -> TensorFile<'static> {
    let mut file = rgl();
    file.fields.retain(|other| other.name != field.name);
    file.fields.push(field);
    file
}

fn without(name: &str) -> TensorFile<'static> {
    let mut file = rgl();
    file.fields.retain(|field| field.name != name);
    file
}

#[test]
fn fields_that_are_missing_or_wrong_are_named() {
    assert!(parse(&rgl()).is_ok());
    let message = |file: &TensorFile| parse(file).unwrap_err().to_string();
    let floats = |name, shape: &[usize], values: &[f32]| message(&with(Field::from_f32(name, shape, values)));
    for (found, expected) in [
        (
            message(&without("ndf")),
            "tiny.bsdf: field `ndf`: found nothing, expected a Float32 tensor of rank 2",
        ),
        (
            message(&without("rgb")),
            "tiny.bsdf: field `wavelengths`: found nothing, expected a Float32 tensor of rank 1",
        ),
        (
            message(&with(Field::from_bytes("theta_i", b"ab"))),
            "tiny.bsdf: field `theta_i`: found a UInt8 tensor of shape [2], expected a Float32 tensor of rank 1",
        ),
        (
            message(&with(Field::from_bytes("jacobian", b""))),
            "tiny.bsdf: field `jacobian`: found 0 bytes, expected 1 byte",
        ),
        (
            floats("theta_i", &[2], &[0.5, 0.5]),
            "tiny.bsdf: field `theta_i`: found 0.5 before 0.5, expected strictly increasing numbers",
        ),
        (
            floats("phi_i", &[0], &[]),
            "tiny.bsdf: field `phi_i`: found none, expected strictly increasing numbers",
        ),
        (
            floats("phi_i", &[3], &[-3.1, -3.0, -1.0]),
            "tiny.bsdf: field `phi_i`: found azimuths over 120.3 degrees, expected 90, 180 or 360",
        ),
        (
            floats("ndf", &[1, 4], &[1.0; 4]),
            "tiny.bsdf: field `ndf`: found shape [1, 4], expected [] slices of at least 2 x 2",
        ),
        (
            floats("vndf", &[1, 1, 2, 2], &[1.0; 4]),
            "tiny.bsdf: field `vndf`: found shape [1, 1, 2, 2], expected [1, 2] slices of at least 2 x 2",
        ),
        (
            floats("rgb", &[1, 2, 4, 2, 2], &[1.0; 32]),
            "tiny.bsdf: field `rgb`: found shape [1, 2, 4, 2, 2], expected [1, 2, 3] slices of at least 2 x 2",
        ),
        (
            floats("sigma", &[2, 2], &[0.0; 4]),
            "tiny.bsdf: field `sigma`: found no area above 0, expected at least one, as they divide f",
        ),
        (
            floats("luminance", &[1, 2, 2, 2], &[1.0, 1.0, f32::NAN, 1.0, 1.0, 1.0, 1.0, 1.0]),
            "tiny.bsdf: field `luminance`: found NaN at index 2, expected finite numbers",
        ),
    ] {
        assert_eq!(found, expected);
    }
}

/// What Mitsuba's `measured` and the database's own reader read: odd, but not without meaning.
#[test]
fn what_the_formats_own_readers_accept_is_read_and_counted() {
    let odd = |field: Field<'static>, expected: &[Oddity]| {
        let brdf = parse(&with(field)).unwrap();
        assert_eq!(brdf.oddities(), expected);
        for k in 0..1000 {
            let at = |step: f32| {
                let (u, phi) = ((k as f32 * step).fract(), k as f32);
                let r = u.sqrt();
                Vec3::new(r * phi.cos(), r * phi.sin(), (1.0 - u).sqrt())
            };
            let (light, view) = (at(0.754_877_7), at(0.569_840_3));
            let f = brdf.eval(light, view);
            assert!(f.is_finite() && f.min_element() >= 0.0 && f.max_element() < 1e4, "{f}");
            assert!(brdf.pdf(light, view) >= 0.0);
        }
        brdf
    };
    let negative = |what, count| [Oddity::Negative { what, count }];
    // The least number of ilm_solo_m_68_rgb.bsdf.
    odd(Field::from_f32("luminance", &[1, 2, 2, 2], &[-7e-11; 8]), &negative("luminance", 8));
    odd(Field::from_f32("ndf", &[2, 2], &[1.0, -1e-9, 1.0, 1.0]), &negative("ndf", 1));
    odd(
        Field::from_f32("vndf", &[1, 2, 2, 2], &[1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
        &negative("vndf", 1),
    );
    let no_area = [Oddity::NoArea { count: 2 }];
    let filled = odd(Field::from_f32("sigma", &[2, 2], &[1.0, 0.0, 1.0, -1e-7]), &no_area);
    let whole = parse(&with(Field::from_f32("sigma", &[2, 2], &[1.0; 4]))).unwrap();
    let (light, view) = (Vec3::new(0.48, 0.36, 0.8), Vec3::new(0.6, 0.0, 0.8));
    assert_eq!(filled.eval(light, view), whole.eval(light, view));

    let (directory, paths) = valid_files();
    for path in &paths {
        let before = Measured::open(path).unwrap();
        fs::write(path, [&fs::read(path).unwrap()[..], b"end"].concat()).unwrap();
        let after = Measured::open(path).unwrap();
        assert_eq!(after.oddities(), [before.oddities(), &[Oddity::Trailing { bytes: 3 }]].concat());
        assert_eq!(after.eval(light, view), before.eval(light, view));
    }
    drop(directory);
}

#[test]
fn wavelengths_have_to_be_nanometres() {
    let mut file = without("rgb");
    file.fields.push(Field::from_f32("wavelengths", &[2], &[0.4, 0.7]));
    file.fields.push(Field::from_f32("spectra", &[1, 2, 2, 2, 2], &[0.5; 16]));
    assert_eq!(
        parse(&file).unwrap_err().to_string(),
        "tiny.bsdf: field `wavelengths`: found 0.4 to 0.7, expected wavelengths in nm between 360 and 830"
    );
}

/// A directory with a valid file of each format.
fn valid_files() -> (tempfile::TempDir, [PathBuf; 3]) {
    let directory = tempfile::tempdir().unwrap();
    let paths = ["a.bsdf", "b.binary", "c.bin"].map(|name| directory.path().join(name));
    rgl().write(&paths[0]).unwrap();
    write_merl(&paths[1], &Lambert).unwrap();
    write_utia(&paths[2], &Lambert, Default::default()).unwrap();
    (directory, paths)
}

#[test]
fn files_are_known_by_their_content() {
    let (directory, paths) = valid_files();
    for (path, name, isotropic) in [(&paths[0], "a", true), (&paths[1], "b", true), (&paths[2], "c", false)] {
        let disguised = directory.path().join(format!("{name}.dat"));
        fs::copy(path, &disguised).unwrap();
        for path in [path, &disguised] {
            let measured = Measured::open(path).unwrap();
            assert_eq!((measured.name(), measured.is_isotropic()), (name, isotropic));
            if name != "a" {
                let f = measured.eval(Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.0, 0.28, 0.96));
                assert!((f - Lambert.eval(Vec3::Z, Vec3::Z)).abs().max_element() < 1e-5, "{f}");
            }
            assert_eq!(measured.eval(Vec3::new(0.6, 0.0, -0.8), Vec3::Z), Vec3::ZERO);
            assert_eq!(measured.eval(Vec3::Z, Vec3::new(0.6, 0.0, 0.0)), Vec3::ZERO);
            assert_eq!(measured.eval(Vec3::new(f32::NAN, 0.0, 1.0), Vec3::Z), Vec3::ZERO);
        }
    }
    assert_eq!(Measured::open(&paths[0]).unwrap().description(), "tiny");
}

#[test]
fn files_of_no_known_format_are_refused_by_name() {
    let directory = tempfile::tempdir().unwrap();
    let message = |name: &str, bytes: &[u8]| {
        let path = directory.path().join(name);
        fs::write(&path, bytes).unwrap();
        let message = Measured::open(&path).unwrap_err().to_string();
        message.replace(&directory.path().display().to_string(), "dir")
    };
    assert_eq!(
        message("photo.png", b"\x89PNG\r\n"),
        "dir/photo.png: not a measured BRDF: found 6 bytes that begin with \"\\x89PNG\\r\\n\", \
         expected an RGL tensor file (.bsdf), a MERL table (.binary) or a UTIA table (.bin)"
    );
    assert_eq!(
        message("a.bsdf", b"not a tensor file"),
        "dir/a.bsdf: magic: found \"not a tensor\", expected \"tensor_file\\0\""
    );
    assert_eq!(
        message("empty.bsdf", b""),
        "dir/empty.bsdf: 0 bytes, expected 12 (at least, to hold the magic)"
    );
    assert_eq!(
        message("b.BINARY", &[1; 20]),
        "dir/b.BINARY: MERL dimensions: found [16843009, 16843009, 16843009], expected [90, 90, 180]"
    );
    assert_eq!(
        message("c.bin", &[0; 100]),
        "dir/c.bin: 100 bytes, expected 1990656 (3 planes of 288 x 288 float64)"
    );
}

#[test]
fn a_missing_file_and_a_directory_are_named() {
    let directory = tempfile::tempdir().unwrap();
    for path in [directory.path().join("missing.bsdf"), directory.path().to_owned()] {
        let error = Measured::open(&path).unwrap_err();
        assert!(matches!(error, Error::Read { .. }), "{error}");
        assert!(error.to_string().starts_with(&format!("{}: cannot be read: ", path.display())));
    }
    let nowhere = directory.path().join("none/x.binary");
    assert!(matches!(write_merl(&nowhere, &Lambert), Err(Error::Write { .. })));
}

#[test]
fn truncated_files_are_refused() {
    let (_directory, paths) = valid_files();
    for path in &paths {
        let bytes = fs::read(path).unwrap();
        for length in [bytes.len() - 1, bytes.len() / 2, 13] {
            fs::write(path, &bytes[..length]).unwrap();
            let message = Measured::open(path).unwrap_err().to_string();
            assert!(message.starts_with(&path.display().to_string()), "{message}");
        }
    }
}

proptest! {
    /// Whatever still opens answers with finite numbers that are not negative.
    #[test]
    fn no_mutated_file_panics(
        changes in prop::collection::vec((0_usize..1000, any::<u8>()), 1..4),
        cut in prop::option::of(0_usize..1000),
        light in prop::array::uniform3(prop::num::f32::ANY),
        view in prop::array::uniform3(prop::num::f32::ANY),
    ) {
        let mut bytes = rgl().to_bytes();
        let length = bytes.len();
        for (at, value) in changes {
            bytes[at % length] = value;
        }
        bytes.truncate(cut.map_or(length, |cut| cut % length));
        if let Ok(brdf) = Rgl::from_bytes(Path::new("tiny.bsdf"), &bytes) {
            let (light, view) = (Vec3::from(light), Vec3::from(view));
            for (light, view) in [(light, view), (light.normalize(), view.normalize()), (Vec3::Z, Vec3::Z)] {
                let f = brdf.eval(light, view);
                prop_assert!(f.is_finite() && f.min_element() >= 0.0, "{f}");
            }
        }
    }

    #[test]
    fn no_pair_of_directions_panics_or_gives_anything_but_finite_numbers(
        light in prop::array::uniform3(prop::num::f32::ANY),
        view in prop::array::uniform3(prop::num::f32::ANY),
        u in prop::array::uniform3(0.0_f32..1.0),
    ) {
        use glimt_core::SampleBrdf;
        let brdf = glimt_measured::Measured::Rgl(parse(&rgl()).unwrap()).into_material();
        let (light, view) = (Vec3::from(light), Vec3::from(view));
        for (light, view) in [(light, view), (light.normalize(), view.normalize())] {
            let (f, pdf, sample) = (brdf.eval(light, view), brdf.pdf(light, view), brdf.sample(view, u.into()));
            prop_assert!(f.is_finite() && f.min_element() >= 0.0, "{f}");
            prop_assert!(pdf.is_finite() && pdf >= 0.0, "{pdf}");
            prop_assert!(sample.pdf.is_finite() && sample.weight.is_finite(), "{sample:?}");
        }
    }
}

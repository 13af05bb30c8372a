//! The catalogue of extreme inputs through the C interface: single calls and batches of every length,
//! also of floats that begin anywhere, give the bits of the Rust core.

use std::ffi::CString;
use std::ptr;

use glimt_check::extremes::{self, Case};
use glimt_check::stability::eval_batch;
use glimt_core::{Brdf, SampleBrdf, Vec3};
use glimt_ffi::c_api::glimt_status::GLIMT_OK;
use glimt_ffi::c_api::*;

/// A material that C holds.
struct Held(*mut glimt_material);

impl Held {
    fn open(path: &std::path::Path) -> Held {
        let path = CString::new(path.to_str().unwrap()).unwrap();
        let (mut library, mut material) = (ptr::null_mut(), ptr::null_mut());
        // SAFETY: every pointer is valid for what the functions read and write.
        unsafe {
            assert_eq!(glimt_library_open(path.as_ptr(), &mut library), GLIMT_OK);
            assert_eq!(glimt_library_material(library, ptr::null(), &mut material), GLIMT_OK);
            glimt_library_close(library);
        }
        Held(material)
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        // SAFETY: it came from the library and is released once.
        unsafe { glimt_material_release(self.0) };
    }
}

const FAILED: glimt_light_sample =
    glimt_light_sample { light: [0.0; 3], pdf: f32::NAN, weight: [f32::NAN; 3] };

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|x| x.to_bits()).collect()
}

fn flat(sample: &glimt_light_sample) -> Vec<f32> {
    [&sample.light[..], &[sample.pdf], &sample.weight].concat()
}

fn check(held: &Held, case: &Case, pairs: &[extremes::Pair]) {
    let (material, name) = (&case.material, &case.name);
    let (light, view): (Vec<Vec3>, Vec<Vec3>) = pairs.iter().copied().unzip();
    let n = pairs.len();
    // One float in front, so that nothing is aligned to more than a float.
    let unaligned =
        |v: &[Vec3]| [0.0].into_iter().chain(v.iter().flat_map(|v| v.to_array())).collect::<Vec<f32>>();
    let (l, v) = (unaligned(&light), unaligned(&view));
    let (mut f, mut pdf) = (vec![f32::NAN; 3 * n + 1], vec![f32::NAN; n]);
    let mut samples = vec![FAILED; n];
    // SAFETY: the arrays hold n directions after their first float.
    unsafe {
        assert_eq!(
            glimt_eval_batch(held.0, n, l[1..].as_ptr(), v[1..].as_ptr(), f[1..].as_mut_ptr()),
            GLIMT_OK
        );
        assert_eq!(glimt_pdf_batch(held.0, n, l[1..].as_ptr(), v[1..].as_ptr(), pdf.as_mut_ptr()), GLIMT_OK);
        // The lights are no random numbers, but some of every kind: negative, beyond 1, NaN.
        assert_eq!(
            glimt_sample_batch(held.0, n, v[1..].as_ptr(), l[1..].as_ptr(), samples.as_mut_ptr()),
            GLIMT_OK
        );
    }
    let batch = eval_batch(material, pairs);
    for i in 0..n {
        let (mut one, mut density, mut sample) = ([f32::NAN; 3], f32::NAN, FAILED);
        // SAFETY: three floats each.
        unsafe {
            let (l, v) = (l[3 * i + 1..].as_ptr(), v[3 * i + 1..].as_ptr());
            assert_eq!(glimt_eval(held.0, l, v, one.as_mut_ptr()), GLIMT_OK);
            assert_eq!(glimt_pdf(held.0, l, v, &mut density), GLIMT_OK);
            assert_eq!(glimt_sample(held.0, v, l, &mut sample), GLIMT_OK);
        }
        let at = format!("{name}: light {}, view {}", light[i], view[i]);
        let expected = material.eval(light[i], view[i]).to_array();
        assert_eq!(bits(&one), bits(&expected), "{at}");
        assert_eq!(bits(&f[3 * i + 1..][..3]), bits(&batch[i].to_array()), "{at}");
        let expected = material.pdf(light[i], view[i]);
        assert_eq!([density, pdf[i]], [expected; 2], "{at}");
        let expected = flat(&material.sample(view[i], light[i]).into());
        assert_eq!(bits(&flat(&sample)), bits(&expected), "{at}");
        assert_eq!(bits(&flat(&samples[i])), bits(&expected), "{at}");
        assert!(expected.iter().all(|x| x.is_finite()), "{at}: {expected:?}");
    }
}

#[test]
fn extreme_inputs_have_the_bits_of_the_core() {
    let folder = tempfile::tempdir().unwrap();
    let families = extremes::families();
    // C asks for no sampler: materials have that with which they come.
    let files = extremes::save_files(folder.path()).unwrap().into_iter();
    for (path, case) in files.filter(|(_, case)| case.sampler.is_empty()) {
        let held = Held::open(&path);
        for family in &families {
            check(&held, &case, &family.pairs);
            check(&held, &case, &family.pairs[..0]);
            check(&held, &case, &family.pairs[..1]);
            check(&held, &case, &family.pairs[1..family.pairs.len() / 2]);
        }
    }
}

/// Places and footprints of any size, and such as are no numbers.
fn places() -> Vec<glimt_place> {
    let numbers = [0.0, 0.3, -2.7, 1e-30, 1e5, f32::MAX, f32::INFINITY, f32::NEG_INFINITY, f32::NAN];
    let n = numbers.len();
    let place = |i: usize| {
        let [u, v, dudx, dvdx, dudy, dvdy] = [1, 9, 5, 13, 3, 29].map(|k| numbers[(i * k + i / n) % n]);
        glimt_place { u, v, dudx, dvdx, dudy, dvdy }
    };
    (0..n * n).map(place).collect()
}

fn check_at(held: &Held, case: &Case, place: glimt_place, (light, view): extremes::Pair) {
    let (mut f, mut density, mut sample) = ([f32::NAN; 3], f32::NAN, FAILED);
    let (l, v) = (light.to_array(), view.to_array());
    // SAFETY: a place, and three floats each.
    unsafe {
        assert_eq!(glimt_eval_at(held.0, &place, l.as_ptr(), v.as_ptr(), f.as_mut_ptr()), GLIMT_OK);
        assert_eq!(glimt_pdf_at(held.0, &place, l.as_ptr(), v.as_ptr(), &mut density), GLIMT_OK);
        assert_eq!(glimt_sample_at(held.0, &place, v.as_ptr(), l.as_ptr(), &mut sample), GLIMT_OK);
    }
    let at = case.material.at(&place.into());
    let where_ = format!("{}: light {light}, view {view}, {place:?}", case.name);
    assert_eq!(bits(&f), bits(&at.eval(light, view).to_array()), "{where_}");
    assert_eq!(density, at.pdf(light, view), "{where_}");
    assert_eq!(bits(&flat(&sample)), bits(&flat(&at.sample(view, light).into())), "{where_}");
    let numbers = [&f[..], &[density], &flat(&sample)].concat();
    assert!(numbers.iter().all(|x| x.is_finite()), "{where_}: {numbers:?}");
}

/// A surface answers a batch as it does one by one, and all other materials as they do without places.
fn check_batch_at(held: &Held, case: &Case, places: &[glimt_place], pairs: &[extremes::Pair]) {
    let (light, view): (Vec<Vec3>, Vec<Vec3>) = pairs.iter().copied().unzip();
    let flat = |v: &[Vec3]| v.iter().flat_map(|v| v.to_array()).collect::<Vec<f32>>();
    let (l, v, mut f) = (flat(&light), flat(&view), vec![f32::NAN; 3 * pairs.len()]);
    let (p, n) = (places.as_ptr(), pairs.len());
    // SAFETY: the arrays hold n places and directions.
    let status = unsafe { glimt_eval_at_batch(held.0, n, p, l.as_ptr(), v.as_ptr(), f.as_mut_ptr()) };
    assert_eq!(status, GLIMT_OK);
    let alone = eval_batch(&case.material, pairs);
    for (i, &(light, view)) in pairs.iter().enumerate() {
        let at = case.material.at(&places[i].into());
        let expected = if case.material.is_surface() { at.eval(light, view) } else { alone[i] };
        assert_eq!(bits(&f[3 * i..][..3]), bits(&expected.to_array()), "{}, pair {i}", case.name);
    }
}

#[test]
fn extreme_places_have_the_bits_of_the_core() {
    let folder = tempfile::tempdir().unwrap();
    let (places, families) = (places(), extremes::families());
    let files = extremes::save_files(folder.path()).unwrap().into_iter();
    let mut surfaces = 0;
    for (path, case) in files.filter(|(_, case)| case.sampler.is_empty()) {
        let held = Held::open(&path);
        surfaces += u32::from(case.material.is_surface());
        for family in &families {
            // Of other materials a few pairs show that the place does not matter.
            let step = if case.material.is_surface() { 1 } else { 37 };
            let pairs: Vec<extremes::Pair> = family.pairs.iter().copied().step_by(step).collect();
            let at: Vec<glimt_place> = (0..pairs.len()).map(|i| places[i % places.len()]).collect();
            for (&place, &pair) in at.iter().zip(&pairs) {
                check_at(&held, &case, place, pair);
            }
            check_batch_at(&held, &case, &at, &pairs);
        }
    }
    assert!(surfaces > 1);
}

#[test]
fn an_enormous_batch_has_the_bits_of_small_ones() {
    const N: usize = 10_000_000;
    let folder = tempfile::tempdir().unwrap();
    let (path, case) = extremes::save_files(folder.path()).unwrap().swap_remove(0);
    let held = Held::open(&path);
    let pairs: Vec<extremes::Pair> =
        extremes::families().into_iter().flat_map(|family| family.pairs).collect();
    let of = |which: fn(&extremes::Pair) -> Vec3| -> Vec<f32> {
        (0..N).flat_map(|i| which(&pairs[i % pairs.len()]).to_array()).collect()
    };
    let (light, view, mut f) = (of(|pair| pair.0), of(|pair| pair.1), vec![f32::NAN; 3 * N]);
    // SAFETY: the arrays hold N directions.
    let status = unsafe { glimt_eval_batch(held.0, N, light.as_ptr(), view.as_ptr(), f.as_mut_ptr()) };
    assert_eq!(status, GLIMT_OK);
    let expected = eval_batch(&case.material, &pairs);
    for (i, f) in f.chunks_exact(3).enumerate() {
        assert_eq!(bits(f), bits(&expected[i % pairs.len()].to_array()), "pair {i}");
    }
}

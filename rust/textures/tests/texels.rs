//! What texels are read as, and images that are refused.

mod common;

use common::{
    encoded_exr, exr, flat, floats, grey_jpeg, halves, jpeg, maps, open, png, png_that_claims, png16, refusal,
};
use glimt_core::models::maps::Filter;
use glimt_core::surface::Wrap;
use glimt_textures::{Finding, Folder, MEMORY, Maps, Oddity, Size};
use proptest::prelude::*;

/// What is odd about the maps.
fn odd(maps: &Maps) -> Vec<(Oddity, u64)> {
    let odd = maps.findings.iter().filter_map(|finding| match finding {
        Finding::Odd { what, count, .. } => Some((*what, *count)),
        _ => None,
    });
    odd.collect()
}

fn ramp(x: usize, y: usize) -> [u8; 1] {
    [(40 * x + 7 * y) as u8]
}

#[test]
fn only_the_colour_is_srgb() {
    let grey = png([1, 1], |_, _| [128]);
    let list = [("a_Color.png", grey.clone()), ("a_Roughness.png", grey.clone()), ("a_Metalness.png", grey)];
    let maps = maps(&list);
    assert!((maps.base_color[0][1] - 0.215_860_5).abs() < 1e-6, "{:?}", maps.base_color);
    assert!((maps.roughness[0] - 128.0 / 255.0).abs() < 1e-7);
    assert_eq!(maps.metalness[0], maps.roughness[0]);
}

#[test]
fn the_same_image_in_every_format_has_the_same_texels() {
    let size = [5, 3];
    let value = |x: usize, y: usize| f32::from(ramp(x, y)[0]) / 255.0;
    let values: Vec<f32> = (0..15).map(|i| value(i % 5, i / 5)).collect();
    let color = ("a_Color.png", flat(size, [9; 3]));
    let roughness = |bytes| maps(&[color.clone(), ("a_Roughness.png", bytes)]).roughness;
    let eight = roughness(png(size, ramp));
    assert_eq!(eight, values);
    assert_eq!(roughness(png(size, |x, y| [ramp(x, y)[0]; 3])), eight);
    assert_eq!(roughness(png(size, |x, y| [ramp(x, y)[0], 0])), eight);
    assert_eq!(roughness(png(size, |x, y| [ramp(x, y)[0], ramp(x, y)[0], ramp(x, y)[0], 7])), eight);
    assert_eq!(roughness(png16(size, |x, y| [257 * u16::from(ramp(x, y)[0])])), eight);
    assert_eq!(roughness(exr(size, &[("Y", floats(&values))])), eight);
    let rgb =
        [("R", floats(&values)), ("G", floats(&values)), ("B", floats(&values)), ("A", floats(&[1.0; 15]))];
    assert_eq!(roughness(exr(size, &rgb)), eight);
    for (a, b) in roughness(exr(size, &[("V", halves(&values))])).iter().zip(&eight) {
        assert!((a - b).abs() < 1e-3);
    }
    // A palette, and an interlaced file, are what they show.
    assert_eq!(roughness(grey_jpeg(size, 200)), [200.0 / 255.0; 15]);
}

#[test]
fn sixteen_bits_are_more_than_eight() {
    let color = ("a_Color.png", png16([2, 1], |x, _| [32768 + x as u16; 3]));
    let maps = maps(&[color, ("a_Roughness.png", png16([2, 1], |x, _| [1000 + x as u16]))]);
    assert!((maps.roughness[1] - maps.roughness[0] - 1.0 / 65535.0).abs() < 1e-8);
    assert!(maps.base_color[1][0] > maps.base_color[0][0]);
}

#[test]
fn openexr_colours_are_linear() {
    let channels = [("R", floats(&[0.5])), ("G", floats(&[0.25])), ("B", floats(&[2.0]))];
    let maps = maps(&[("a_Color.exr", exr([1, 1], &channels))]);
    assert_eq!(maps.base_color[0], [0.5, 0.25, 1.0]);
    assert_eq!(odd(&maps), [(Oddity::OutOfRange, 1)]);
}

#[test]
fn what_is_odd_about_texels_is_counted() {
    let size = [4, 1];
    let normal = png(size, |x, _| match x {
        0 => [255, 255, 255],
        1 => [128, 128, 0],
        _ => [128, 128, 255],
    });
    let rough = exr(size, &[("Y", floats(&[f32::NAN, -1.0, 0.25, f32::INFINITY]))]);
    let color = png(size, |x, _| [9, 9, 9, if x < 3 { 255 } else { 0 }]);
    let maps = maps(&[
        ("a_Color.png", color),
        ("a_Roughness.exr", rough),
        ("a_Metalness.png", png(size, |_, _| [0, 0, 255])),
        ("a_Normal.png", normal),
    ]);
    assert_eq!(maps.roughness, [0.5, 0.0, 0.25, 0.5]);
    assert_eq!(
        odd(&maps),
        [
            (Oddity::Transparent, 1),
            (Oddity::NotFinite, 2),
            (Oddity::OutOfRange, 2),
            (Oddity::Colored, 4),
            (Oddity::Length, 1),
            (Oddity::Steep, 1),
        ]
    );
    check_promises(&maps);
    let line = maps.findings[0].to_string();
    assert_eq!(line, "colour: 1 of 4 texels of a_Color.png are transparent, taken as opaque");
}

/// All numbers are within their bounds, and normals are unit vectors above the surface.
fn check_promises(maps: &Maps) {
    let texels = maps.size[0] * maps.size[1];
    assert_eq!((maps.base_color.len(), maps.normal.len(), maps.roughness.len()), (texels, texels, texels));
    assert_eq!((maps.metalness.len(), maps.specular.len()), (texels, texels));
    let scalars = maps.roughness.iter().chain(&maps.metalness).chain(&maps.specular);
    assert!(scalars.chain(maps.base_color.iter().flatten()).all(|x| (0.0..=1.0).contains(x)));
    assert_eq!(maps.variance.len(), texels);
    assert!(maps.variance.iter().all(|x| x.is_finite() && *x >= 0.0));
    for [x, y, z] in &maps.normal {
        assert!((x * x + y * y + z * z - 1.0).abs() < 1e-5 && *z > 0.04);
    }
}

#[test]
fn grey_normal_maps_are_refused() {
    let color = ("a_Color.png", flat([4, 4], [9; 3]));
    let with = |bytes| refusal(&[color.clone(), ("a_Normal.png", bytes)]);
    let message = with(png([4, 4], ramp));
    assert_eq!(message, "wood/a_Normal.png has one grey channel, expected three channels for the normals");
    let message = with(png([4, 4], |x, y| [ramp(x, y)[0]; 3]));
    assert!(message.starts_with("wood/a_Normal.png holds no normals: all its texels are grey"), "{message}");
    let message = with(png([4, 4], |x, y| [ramp(x, y)[0], 0, 0]));
    assert!(message.contains("16 of its 16 texels point below the surface"), "{message}");
    let message = refusal(&[color.clone(), ("a_ORM.png", png([4, 4], ramp))]);
    assert!(message.contains("has one grey channel, expected three channels for the roughness"), "{message}");
    // As a map of heights it is none.
    assert_eq!(maps(&[color, ("a_Bump.png", png([4, 4], ramp))]).normal, [[0.0, 0.0, 1.0]; 16]);
}

#[test]
fn maps_of_other_shapes_are_refused_and_of_other_sizes_resized() {
    let color = ("a_Color.png", flat([8, 4], [9; 3]));
    let message = refusal(&[color.clone(), ("a_Roughness.png", png([8, 8], ramp))]);
    assert_eq!(
        message,
        "wood/a_Color.png has 8 × 4 texels and wood/a_Roughness.png has 8 × 8: expected maps of one shape"
    );
    // Means are the same whichever side a map is resized to.
    let smaller =
        open(&[color, ("a_Roughness.png", png([4, 2], |x, y| [if (x + y) % 2 == 0 { 255 } else { 0 }]))]);
    let smaller = smaller.unwrap();
    for size in [Size::Own, Size::LongestSide(2), Size::Exactly([3, 3])] {
        let maps = smaller.maps(size, MEMORY).unwrap();
        assert_eq!(maps.size, smaller.size(size));
        let mean = maps.roughness.iter().map(|r| r * r).sum::<f32>() / maps.roughness.len() as f32;
        assert!((mean - 0.5).abs() < 1e-6, "{size:?}: {mean}");
        check_promises(&maps);
    }
    assert_eq!(smaller.size(Size::LongestSide(2)), [2, 1]);
    assert_eq!(smaller.size(Size::LongestSide(100)), [8, 4]);
    let message = smaller.maps(Size::Exactly([0, 3]), MEMORY).unwrap_err().to_string();
    assert_eq!(message, "wood: maps of 0 × 3 texels were asked for, expected at least one");
}

#[test]
fn empty_damaged_and_truncated_images_are_refused() {
    let with = |name: &'static str, bytes: &[u8]| refusal(&[(name, bytes.to_vec())]);
    assert_eq!(with("a_Color.png", b""), "wood/a_Color.png is not an image: it is empty");
    assert_eq!(
        with("a_Color.jpg", b"<html>\n"),
        "wood/a_Color.jpg is not an image: it begins with \"<html>\\n\", expected PNG, JPEG or OpenEXR"
    );
    let images = [
        png([20, 20], |x, y| [ramp(x, y)[0], 3, (x * y) as u8]),
        jpeg([20, 20], [200, 100, 50], false),
        jpeg([40, 40], [200, 100, 50], true),
        exr([20, 20], &[("R", floats(&[0.3; 400])), ("G", halves(&[0.3; 400])), ("B", floats(&[0.3; 400]))]),
    ];
    for (i, image) in images.iter().enumerate() {
        maps(&[("a_Color.png", image.clone())]);
        for length in 0..image.len() {
            let message = with("a_Color.png", &image[..length]);
            assert!(message.starts_with("wood/a_Color.png is not a"), "{i}: {message}");
        }
    }
}

#[test]
fn memory_is_compared_with_the_limit_before_it_is_taken() {
    let folder = open(&[("a_Color.png", png_that_claims(30_000, 30_000))]).unwrap();
    let message = folder.maps(Size::Own, MEMORY).unwrap_err().to_string();
    assert_eq!(
        message,
        "wood/a_Color.png has 30000 × 30000 texels: to decode it and make maps of 30000 × 30000 takes 46.1 GiB, \
         expected at most 1.0 GiB"
    );
    let message = folder.maps(Size::LongestSide(256), MEMORY).unwrap_err().to_string();
    assert!(message.contains("make maps of 256 × 256 takes 2.5 GiB"), "{message}");
    let folder = open(&[("a_Color.png", flat([64, 64], [9; 3]))]).unwrap();
    let bytes = folder.memory(Size::Own);
    assert_eq!(bytes, 64 * 64 * (52 + 3));
    assert!(folder.maps(Size::Own, bytes - 1).is_err() && folder.maps(Size::Own, bytes).is_ok());
    assert!(folder.memory(Size::Exactly([usize::MAX; 2])) == u64::MAX);
}

#[test]
fn every_lossless_compression_of_openexr_is_read_and_b44_refused() {
    use exr::prelude::{Blocks, Compression, Encoding, LineOrder, Vec2};
    let size = [37, 21];
    let values: Vec<f32> = (0..37 * 21).map(|i| (i % 101) as f32 / 100.0).collect();
    let with = |compression, blocks| {
        let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
        let channels = [("R", floats(&values)), ("G", halves(&values)), ("B", floats(&values))];
        [("a_Color.exr", encoded_exr(encoding, size, &channels))]
    };
    use Compression::{PIZ, RLE, Uncompressed, ZIP1, ZIP16};
    for compression in [Uncompressed, RLE, ZIP1, ZIP16, PIZ] {
        for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(16, 16))] {
            let maps = maps(&with(compression, blocks));
            for (texel, value) in maps.base_color.iter().zip(&values) {
                assert!(texel[0] == *value && texel[2] == *value && (texel[1] - value).abs() < 1e-3);
            }
        }
    }
    let message = refusal(&with(Compression::B44, Blocks::ScanLines));
    assert!(message.ends_with("it is compressed as B44, which is not read; save it with ZIP"), "{message}");
}

#[test]
fn openexr_files_of_other_channels_are_refused() {
    let channels = |names: &[&'static str]| -> Vec<(&'static str, exr::prelude::FlatSamples)> {
        names.iter().map(|name| (*name, floats(&[0.3]))).collect()
    };
    let with = |names: &[&'static str]| refusal(&[("a_Color.exr", exr([1, 1], &channels(names)))]);
    assert!(with(&["X", "Z"]).contains("its channels are \"X\", \"Z\", expected R, G and B, or one"));
    assert!(with(&["A"]).contains("its channels are \"A\""));
}

/// A tile of grooves: three texels down for every one that leads up again, three times as steep.
fn grooves() -> Maps {
    let slope = |x: usize| if x % 4 == 3 { -0.9_f64 } else { 0.3 };
    let byte = |v: f64| (65535.0 * (0.5 + 0.5 * v)).round() as u16;
    let normal = png16([16, 16], |x, _| {
        let length = (1.0 + slope(x) * slope(x)).sqrt();
        [byte(slope(x) / length), byte(0.0), byte(1.0 / length)]
    });
    maps(&[("a_Color.png", png([16, 16], |x, y| [ramp(x, y)[0]; 3])), ("a_NormalGL.png", normal)])
}

#[test]
fn a_tile_of_grooves_stays_flat_in_the_mean() {
    let [x, y, z] = grooves().resized([4, 4]).normal[5];
    assert!(x.abs() < 1e-4 && y.abs() < 1e-4 && z > 0.9999, "{x} {y} {z}");
}

#[test]
fn decoding_to_a_size_is_decoding_and_resizing() {
    let folder = open(&[
        ("a_Color.png", png([8, 8], |x, y| [ramp(x, y)[0], 200, 3])),
        ("a_Roughness.png", png([8, 8], ramp)),
        ("a_Normal.png", png([8, 8], |x, y| [(118 + 3 * x) as u8, (118 + 3 * y) as u8, 254])),
    ]);
    let folder = folder.unwrap();
    let once = folder.maps(Size::Exactly([4, 2]), MEMORY).unwrap();
    let twice = folder.maps(Size::Own, MEMORY).unwrap().resized([4, 2]);
    let pairs = once.normal.iter().zip(&twice.normal).chain(once.base_color.iter().zip(&twice.base_color));
    for (a, b) in pairs {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6), "{a:?} {b:?}");
    }
    assert!(once.roughness.iter().zip(&twice.roughness).all(|(a, b)| (a - b).abs() < 1e-6));
    assert!(once.variance.iter().zip(&twice.variance).all(|(a, b)| *a > 0.0 && (a - b).abs() < 1e-6));
}

#[test]
fn a_reduction_keeps_the_mean_alpha_and_the_variance_of_slopes() {
    let grooves = grooves();
    assert!(grooves.variance.iter().all(|&variance| variance == 0.0));
    let halfway = grooves.resized([8, 8]);
    let (once, twice) = (grooves.resized([4, 4]), halfway.resized([4, 4]));
    for (a, b) in once.variance.iter().zip(&twice.variance) {
        // Of the slopes 0.3, 0.3, 0.3 and −0.9.
        assert!((a - 0.27).abs() < 1e-4 && (a - b).abs() < 1e-6, "{a} {b}");
    }
    let roughness = png([2, 1], |x, _| [if x == 0 { 51 } else { 204 }]);
    let maps = maps(&[("a_Color.png", png([2, 1], ramp)), ("a_Roughness.png", roughness)]).resized([1, 1]);
    assert!((maps.roughness[0] * maps.roughness[0] - 0.5 * (0.04 + 0.64)).abs() < 1e-6);
    // Between the texels of a larger map there is no roughness.
    assert!(grooves.resized([32, 32]).variance.iter().all(|&variance| variance == 0.0));
}

#[test]
fn a_surface_has_the_parameters_of_a_facet_from_the_bottom_up() {
    let byte = |x: f64| (65535.0 * (0.5 + 0.5 * x)).round() as u16;
    let maps = maps(&[
        // White above, black below.
        ("a_Color.png", png([1, 2], |_, y| [if y == 0 { 255 } else { 0 }; 3])),
        ("a_Metalness.png", png([1, 2], |_, y| [if y == 0 { 51 } else { 0 }])),
        ("a_Roughness.png", png([1, 2], |_, _| [51])),
        // To the right and up in the image: the surface falls along u and v.
        (
            "a_NormalGL.png",
            png16([1, 2], |_, y| {
                if y == 0 { [byte(0.36), byte(0.48), byte(0.8)] } else { [byte(0.0), byte(0.0), byte(1.0)] }
            }),
        ),
    ]);
    let surface = maps.surface(Wrap::Repeat, Filter::Average).unwrap();
    assert_eq!((surface.size(), surface.wrap(), surface.filter()), ([1, 2], Wrap::Repeat, Filter::Average));
    let [bottom, top] = [surface.texel(0, 0), surface.texel(0, 1)];
    assert_eq!((bottom.kd, bottom.f0, top.kd), ([0.0; 3], [0.04; 3], [0.8; 3]));
    assert!((top.f0[1] - (0.8 * 0.04 + 0.2)).abs() < 1e-6 && (top.alpha - 0.04).abs() < 1e-6);
    assert!((top.slope[0] + 0.45).abs() < 1e-3 && (top.slope[1] + 0.6).abs() < 1e-3, "{:?}", top.slope);
    assert!(bottom.slope.iter().all(|slope| slope.abs() < 1e-4));

    let reduced = maps.resized([1, 1]);
    let texel = |filter| reduced.texels(filter).next().unwrap();
    let [average, moments] = [Filter::Average, Filter::Moments].map(texel);
    assert!((average.alpha - 0.04).abs() < 1e-6);
    // Half of the way from the mean to either slope.
    let variance = (0.45 * 0.45 + 0.6 * 0.6) / 4.0;
    assert!((moments.alpha - f32::sqrt(0.04 * 0.04 + variance)).abs() < 1e-3, "{}", moments.alpha);
    assert_eq!(average.slope, moments.slope);
}

#[test]
fn a_crop_is_a_part() {
    let maps = grooves();
    let crop = maps.cropped([3, 5], [2, 4]);
    assert_eq!((crop.size, crop.roughness.len()), ([2, 4], 8));
    assert_eq!(crop.base_color[2 * 3 + 1], maps.base_color[16 * 8 + 4]);
    assert_eq!(crop.normal[0], maps.normal[16 * 5 + 3]);
    assert_eq!(maps.cropped([0, 0], [16, 16]), maps);
}

#[test]
fn a_pipe_is_not_waited_for() {
    let message = Folder::open("/dev/null").unwrap_err().to_string();
    assert_eq!(message, "cannot read /dev/null: it is no regular file");
}

proptest! {
    #[test]
    fn any_normal_map_of_vectors_becomes_unit_vectors_above_the_surface(
        texels in proptest::collection::vec([any::<u8>(), any::<u8>(), any::<u8>()], 12),
        size in [1_usize..7, 1_usize..7],
    ) {
        let normal = png([4, 3], |x, y| texels[4 * y + x]);
        let folder = open(&[("a_Color.png", flat([4, 3], [9; 3])), ("a_Normal.png", normal)]).unwrap();
        if let Ok(maps) = folder.maps(Size::Exactly(size), MEMORY) {
            check_promises(&maps);
        }
    }

    #[test]
    fn a_normal_of_8_bits_is_that_of_the_surface_within_a_step(tilt in 0.0_f64..1.2, turn in 0.0_f64..6.2) {
        let n = [tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), tilt.cos()];
        let texel = n.map(|v| (255.0 * (0.5 + 0.5 * v)).round() as u8);
        // A map that is nearly grey is one of heights.
        let spread = texel.iter().max().unwrap() - texel.iter().min().unwrap();
        prop_assume!(spread > 10);
        let maps = maps(&[("a_Color.png", flat([1, 1], [9; 3])), ("a_NormalGL.png", flat([1, 1], texel))]);
        let cos: f64 = maps.normal[0].iter().zip(n).map(|(a, b)| f64::from(*a) * b).sum();
        prop_assert!(cos > 1.0 - 3.0 / 255.0_f64.powi(2), "{:?} for {n:?}", maps.normal[0]);
    }
}
